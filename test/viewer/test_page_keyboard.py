"""The 3-D page by keyboard alone: choose, plan, look, move, stop; and what the pointer rests on is named."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from browser import Browser, Tab
from page_rig import browser_fixture, ready_backend, served_fixture, until  # noqa: F401 (fixtures)

from lime_planner.viewer.backend import Activity
from lime_planner.viewer.page import Page
from lime_planner.viewer.scene_backend import SceneBackend

pytestmark = pytest.mark.timed

#: Name of what has the focus, as a screen reader says it.
FOCUSED = "(e => e.getAttribute('aria-label') || e.innerText?.trim() || '')(document.activeElement)"


@pytest.fixture(scope="module")
def backend() -> Iterator[SceneBackend]:
    with ready_backend(iterations=3000, velocity_scaling=0.1) as made:  # slow: the Tab key takes a while to come to Stop
        yield made


@pytest.fixture(scope="module")
def tab(browser: Browser, served: Page) -> Iterator[Tab]:
    opened = Tab(browser, served.url)
    opened.page.set_viewport_size({"width": 760, "height": 420})  # few pixels: they are drawn by software
    opened.sees("press Plan")
    yield opened
    assert opened.complaints == []
    opened.close()


def go_to(tab: Tab, name: str) -> None:
    """Press Tab until something of that name has the focus; it may have to be enabled or unfolded first, by a slow browser."""
    passed: list[str] = []
    deadline = time.monotonic() + 60.0
    while len(passed) < 90 or time.monotonic() < deadline:
        tab.page.keyboard.press("Tab")
        passed.append(str(tab.page.evaluate(FOCUSED)).split("\n", 1)[0])
        if passed[-1] == name:
            return
    raise AssertionError(f"the Tab key does not come to {name!r}, but to {passed[-90:]}")


def choose(tab: Tab, option: str) -> None:
    """Choose from the list that has the focus, with the arrow keys."""
    marked = "document.querySelector('[role=option][data-combobox-selected]')?.innerText?.trim()"
    for _ in range(12):
        tab.page.keyboard.press("ArrowDown")  # the first one opens the list
        tab.page.wait_for_timeout(150)
        if tab.page.evaluate(marked) == option:
            tab.page.keyboard.press("Enter")
            return
    raise AssertionError(f"the arrow keys do not come to {option!r}")


def test_all_is_done_by_keyboard_alone(tab: Tab, backend: SceneBackend, served: Page) -> None:
    keyboard, moment = tab.page.keyboard, backend.moment
    go_to(tab, "Plan")
    keyboard.press("Enter")
    until(lambda: served._timeline is not None, "the plan to be drawn")
    go_to(tab, "Execute")
    go_to(tab, "Time [s]")
    until(lambda: served._player.t_s > 0.1, "the ghost arm to start by itself")
    keyboard.press("Home")
    until(lambda: served._player.t_s == 0.0 and not served._player.playing, "the time slider to move")

    go_to(tab, "Reach")
    choose(tab, "lime 1")
    until(lambda: served._goal.changed == "lime 1", "the lime to be chosen")
    tab.sees("lime 1 is chosen: press Plan")
    go_to(tab, "Along [°], 1 of 3")
    keyboard.press("ArrowUp")
    until(lambda: served._goal.changed == "this pose", "the direction of approach to be turned")
    go_to(tab, "Back to the first target")
    keyboard.press("Space")
    until(lambda: served._goal.changed == "", "the first target")
    go_to(tab, "Top")
    keyboard.press("Enter")
    camera = next(iter(served._server.get_clients().values())).camera
    until(lambda: float(camera.position[2]) > 1.5, "the view from above")

    go_to(tab, "Arm")  # a folder that is closed
    assert tab.page.evaluate("document.activeElement.getAttribute('aria-expanded')") == "false"
    keyboard.press("Enter")
    go_to(tab, "joint_1")
    stood, was = moment().q, float(served._arm_controls._sliders[0].value)
    keyboard.press("ArrowRight")
    until(lambda: abs(float(served._arm_controls._sliders[0].value) - was) > 0.005, "the joint's slider to move")
    until(lambda: moment().q is not None and not np.array_equal(moment().q, stood), "the arm to stand where its slider is")


def test_the_arm_is_moved_and_stopped_by_keyboard_alone(tab: Tab, backend: SceneBackend, served: Page) -> None:
    keyboard, moment = tab.page.keyboard, backend.moment
    for stop in ("the Escape key", "the button"):
        go_to(tab, "Plan")
        keyboard.press("Enter")
        until(lambda: moment().activity is Activity.IDLE and not moment().blocked_motion, "a plan")
        tab.sees("A path is found")
        go_to(tab, "Execute")
        keyboard.press("Enter")
        tab.sees("Move the arm?")
        assert moment().moving_s is None
        go_to(tab, "Cancel")  # the dialog holds the focus
        go_to(tab, "Move the arm")
        keyboard.press("Enter")
        until(lambda: moment().activity is Activity.MOVING, "the arm to move")
        if stop == "the button":
            go_to(tab, "Stop")
            keyboard.press("Enter")
        else:
            tab.sees("The arm moves")
            keyboard.press("Escape")
        until(lambda: moment().message.startswith("CANCELLED: stopped from the page"), f"{stop} to stop the arm")
        until(lambda: moment().activity is Activity.IDLE, "the arm to rest")


def test_what_the_pointer_rests_on_is_named(tab: Tab, backend: SceneBackend, served: Page) -> None:
    """In the middle of the window is what the camera looks at."""
    scene = backend.moment().scene
    assert scene is not None and scene.leaf_triangles is not None and scene.leaf_triangle_ids is not None
    top = int(np.argmax(scene.leaf_triangles.mean(axis=1)[:, 2]))
    middle = scene.leaf_triangles[top].mean(axis=0).astype(np.float64)
    client = next(iter(served._server.get_clients().values()))
    with client.atomic():
        client.camera.position, client.camera.look_at = middle + [-0.02, 0.0, 0.4], middle
    box = tab.page.locator("canvas").first.bounding_box()
    assert box is not None
    tip, name = tab.page.get_by_role("tooltip").filter(has_text="Leaf"), f"Leaf {scene.leaf_triangle_ids[top]} "
    for attempt in range(20):  # the camera gets there with the frames that the browser draws
        tab.page.mouse.move(box["x"] + 0.5 * box["width"] + 8 * (attempt % 2), box["y"] + 0.5 * box["height"])
        tab.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        time.sleep(0.5)
        if tip.count() and tip.inner_text().startswith(name):
            break
    assert tip.inner_text().startswith(name) and " m. " in tip.inner_text()
    tab.page.mouse.move(box["x"] + 3, box["y"] + 3)  # the sky
    until(lambda: tip.count() == 0, "the name to go")
