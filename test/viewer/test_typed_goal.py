"""Numbers that are typed quickly into the goal's fields all arrive: viser's calls come late, at once, and in any order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from arm_helpers import scene_of
from browser import Browser, Tab
from page_rig import browser_fixture, ready_backend, served_fixture, until  # noqa: F401 (fixtures)

from lime_planner.core.geometry import pose_to_matrix
from lime_planner.viewer.goal import POSED, Goal, frame_of
from lime_planner.viewer.page import Page
from lime_planner.viewer.scene_backend import SceneBackend

GIVEN_POSE = np.array([0.589, -0.012, 0.444, 0.0, 0.70710678, 0.0, 0.70710678])


class Field:
    """A field whose user goes on typing whenever somebody looks at it or writes into it."""

    def __init__(self, value: Any, **options: Any) -> None:
        self._value, self.options, self.calls = value, options.get("options", ()), []
        self.typing: list[Any] = []
        self.on_typed: Callable[[], None] = lambda: None

    def on_update(self, call: Any) -> None:
        self.calls.append(call)

    def type(self) -> None:
        """Type the next value; the field's calls come later."""
        if self.typing:
            self._value = self.typing.pop(0)
            self.on_typed()

    @property
    def value(self) -> Any:
        seen = self._value
        self.type()
        return seen

    @value.setter
    def value(self, value: Any) -> None:
        self._value = value


class Gui:
    def __init__(self) -> None:
        self.fields: dict[str, Any] = {}

    def add_dropdown(self, name: str, options: Any, initial_value: Any, hint: str) -> Field:
        self.fields[name] = Field(initial_value, options=options)
        return self.fields[name]

    def add_vector3(self, name: str, value: Any, **_: Any) -> Field:
        self.fields[name] = Field(value)
        return self.fields[name]

    def add_button(self, *_: Any, **__: Any) -> Any:
        return SimpleNamespace(on_click=lambda call: None)


def rig() -> tuple[Goal, Gui, list[Callable[[], None]]]:
    """A goal at a target, its fields, and the notes that it leaves."""
    gui, notes = Gui(), []
    gizmo = SimpleNamespace(position=np.zeros(3), wxyz=np.array([1.0, 0.0, 0.0, 0.0]), visible=False, on_update=lambda call: None)
    api = SimpleNamespace(add_transform_controls=lambda *_, **__: gizmo, add_arrows=lambda *_, **__: None)
    goal = Goal(api, gui, notes.append)
    goal.take(scene_of(stems=[[0.5, 0.0, 0.5]], leaves=[]), forget=True)
    goal.follow(GIVEN_POSE)
    return goal, gui, notes


@pytest.mark.parametrize("seed", range(20))
def test_what_is_typed_while_the_page_looks_is_never_written_over(seed: int) -> None:
    rng = np.random.default_rng(seed)
    goal, gui, notes = rig()
    place, towards = gui.fields["At [m]"], gui.fields["Along [°]"]
    wanted = {place: tuple(rng.uniform(-0.9, 0.9, 3).tolist()), towards: tuple(rng.uniform(-80.0, 80.0, 3).tolist())}
    calls: list[Callable[[], None]] = []
    browser = SimpleNamespace(client=object())
    for field, numbers in wanted.items():
        before = field.value
        field.typing = [(*numbers[: k + 1], *before[k + 1 :]) for k in range(3)]  # the browser sends all three each time
        field.on_typed = lambda field=field: calls.extend(partial(call, browser) for call in field.calls)  # type: ignore[misc]
    while place.typing or towards.typing or calls or notes:
        chance = rng.integers(4)
        if chance == 0:
            (place if place.typing else towards).type()
        elif chance == 1 and calls:
            calls.pop(rng.integers(len(calls)))()
        elif chance == 2 and notes:
            notes.pop(0)()
        elif chance == 3:
            goal.follow(GIVEN_POSE.copy())  # the target is published once more
    goal.take_typed()
    for field, numbers in wanted.items():
        assert field.value == numbers, "the fields hold what was typed, not something rounded"
    pose, fruit = goal.wish()
    assert pose is not None and fruit is None and goal.changed == POSED
    np.testing.assert_allclose(pose[:3], wanted[place], atol=1e-12)
    np.testing.assert_allclose(pose_to_matrix(pose)[:3, :3], frame_of(wanted[towards]), atol=1e-9)


def test_a_newer_look_at_the_plant_leaves_the_choice_and_another_plant_does_not() -> None:
    goal, gui, _ = rig()
    scene = scene_of(stems=[[0.4, 0.0, 0.5]], leaves=[])
    gui.fields["At [m]"].value = (0.6, 0.1, 0.2)
    goal.take_typed()
    goal.take(scene, forget=False)
    goal.follow(GIVEN_POSE + np.array([0.01, 0, 0, 0, 0, 0, 0]))
    assert goal.changed == POSED and gui.fields["At [m]"].value == (0.6, 0.1, 0.2)
    goal.take(scene, forget=True)
    goal.follow(GIVEN_POSE)
    assert goal.changed == "" and gui.fields["At [m]"].value == pytest.approx(GIVEN_POSE[:3])


@pytest.fixture(scope="module")
def backend() -> Iterator[SceneBackend]:
    with ready_backend(iterations=400) as made:
        yield made


@pytest.mark.timed
def test_six_numbers_typed_without_pause_arrive(browser: Browser, backend: SceneBackend, served: Page) -> None:
    tab = Tab(browser, served.url)
    tab.page.set_viewport_size({"width": 760, "height": 420})  # few pixels: they are drawn by software
    tab.sees("press Plan")
    rng = np.random.default_rng(0)
    rows = [tab._row(label).locator("input") for label in ("At [m]", "Along [°]")]
    for _ in range(20):
        place, angles = np.round(rng.uniform(-0.9, 0.9, 3), 3), np.round(rng.uniform(-80.0, 80.0, 3))
        for row, numbers in zip(rows, (place, angles), strict=True):
            for number, value in enumerate(numbers):
                row.nth(number).fill(f"{value:g}")
                row.nth(number).press("Enter")

        def arrived(place: np.ndarray = place, angles: np.ndarray = angles) -> bool:
            pose, _ = served._goal.wish()
            same = pose is not None and np.allclose(pose[:3], place, atol=1e-9)
            return same and bool(np.allclose(pose_to_matrix(pose)[:3, :3], frame_of(angles), atol=1e-6))

        until(arrived, f"{place} {angles}", 30.0)
        tab.page.wait_for_timeout(150)  # for what might still be written back
        assert arrived()
        for row, numbers in zip(rows, (place, angles), strict=True):
            assert [float(row.nth(number).input_value()) for number in range(3)] == pytest.approx(numbers)
    assert tab.complaints == []
    tab.close()
