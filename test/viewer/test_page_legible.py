"""The 3-D page can be read: contrast and widths of its controls, on a desk, a tablet and a phone, light and dark, in each state."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
import pytest
from arm_helpers import plant
from browser import Browser, Tab
from legible import WIDTHS, faint, too_wide
from page_rig import browser_fixture, ready_backend, served_fixture, until  # noqa: F401 (fixtures)

from lime_planner.viewer.backend import Activity
from lime_planner.viewer.page import Page
from lime_planner.viewer.scene_backend import SceneBackend

pytestmark = pytest.mark.timed

FOLDERS = ("Target", "Arm", "Plans", "How to search", "Show", "Legend")
#: A folder that pictures of each state are put into, for a person to look at; none by default.
PICTURES = os.environ.get("LIME_PLANNER_TEST_PICTURES", "")


@pytest.fixture(scope="module")
def backend() -> Iterator[SceneBackend]:
    with ready_backend(iterations=3000) as made:
        yield made


def judged(tab: Tab, state: str, widths: Sequence[int]) -> list[str]:
    """Return what cannot be read in a state of the page, at each of some widths."""
    found = []
    for width in widths:
        tab.page.set_viewport_size({"width": width, "height": 844 if width < 500 else 768})
        tab.page.wait_for_timeout(400)  # the panel moves to its place
        found += [f"{state}, {width} px: {what}" for what in (*faint(tab.page), *too_wide(tab.page))]
        if PICTURES:
            tab.page.wait_for_timeout(2500)  # the scene is drawn by software
            tab.page.screenshot(path=os.path.join(PICTURES, f"{state}-{width}.png"), timeout=180_000)
    return found


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_can_be_read(scheme: Literal["light", "dark"], browser: Browser, backend: SceneBackend, served: Page) -> None:
    backend.open(plant(15), "plant")  # what the browser before has done is forgotten
    widths = WIDTHS if PICTURES or scheme == "light" else WIDTHS[-1:]  # colours take no room
    until(lambda: served._shown is None and backend.moment().activity is Activity.IDLE, "the plant")
    with contextlib.closing(Tab(browser, served.url, scheme)) as tab:  # one that stays open goes on drawing
        tab.page.get_by_role("button", name="Plan", exact=True).first.wait_for()
        found = judged(tab, f"{scheme}-ready", widths)
        tab.press("Plan")
        tab.sees("A path is found; nothing has moved.")
        found += judged(tab, f"{scheme}-planned", widths)
        for name in FOLDERS:
            tab.page.get_by_role("button", name=name, exact=True).first.click()
        found += judged(tab, f"{scheme}-unfolded", widths)
        scene = backend.moment().scene
        assert scene is not None
        stem = scene.stem_points[int(np.argmax(scene.stem_points[:, 2]))]
        fields = tab._row("At [m]").locator("input")
        for place, value in enumerate(stem):
            fields.nth(place).fill(f"{value:.3f}")
            fields.nth(place).press("Enter")
        until(lambda: served._goal.changed == "this pose", "the pose")
        tab.press("Plan")
        tab.sees("Refused: ")
        found += judged(tab, f"{scheme}-refused", widths)
        tab.press("Back to the first target")
        until(lambda: served._goal.changed == "", "the first target")
        tab.press("Plan")
        tab.sees("A path is found; nothing has moved.")
        tab.press("Execute")
        tab.sees("Move the arm?")
        found += judged(tab, f"{scheme}-dialog", widths)
        tab.press("Cancel")
        assert "\n".join(found) == ""
        assert tab.complaints == []
