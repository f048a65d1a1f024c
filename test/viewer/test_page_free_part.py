"""Plant and arm stand in the part of the window that the panel leaves free, at every width and from every preset."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from browser import Browser, Tab
from page_rig import browser_fixture, ready_backend, served_fixture, until  # noqa: F401 (fixtures)

from lime_planner.viewer.page import Page
from lime_planner.viewer.scene_backend import SceneBackend

pytestmark = pytest.mark.timed

PROJECTED = """points => {
  const {camera, nodeRefFromName} = window.__viserMutable, root = nodeRefFromName[""];
  const box = document.querySelector("canvas").getBoundingClientRect();
  return points.map(point => {
    const at = root.localToWorld(camera.position.clone().set(...point)).project(camera);
    return [box.left + 0.5 * (at.x + 1) * box.width, box.top + 0.5 * (1 - at.y) * box.height];
  });
}"""
FREE = """() => {
  const box = document.querySelector("canvas").getBoundingClientRect();
  const sheet = document.querySelector("[style*='position: fixed'][style*='max-height: 60%']")?.getBoundingClientRect();
  return [box.left, box.top, box.right, sheet ? Math.min(sheet.top, box.bottom) : box.bottom];
}"""


@pytest.fixture(scope="module")
def backend() -> Iterator[SceneBackend]:
    with ready_backend(iterations=400) as made:
        yield made


def seen(tab: Tab, points: np.ndarray) -> bool:
    """Whether points (N, 3) [m] lie in the free part, most of which they fill in one direction or the other."""
    left, top, right, bottom = tab.page.evaluate(FREE)
    at = np.array(tab.page.evaluate(PROJECTED, points.tolist()))
    inside = bool(((at >= [left, top]) & (at <= [right, bottom])).all())
    return inside and bool((np.ptp(at, axis=0) > 0.25 * np.array([right - left, bottom - top])).any())


def test_nothing_stands_behind_the_panel(browser: Browser, backend: SceneBackend, served: Page) -> None:
    scene = backend.moment().scene
    assert scene is not None
    cloud = np.concatenate([scene.stem_points, scene.leaf_points]).astype(float)
    points = np.concatenate([[[0.0, 0.0, 0.0]], cloud[cloud.argmin(axis=0)], cloud[cloud.argmax(axis=0)]])
    tab = Tab(browser, served.url)
    tab.sees("press Plan")
    for width, height in ((1000, 640), (700, 640), (390, 844), (820, 500)):  # the window is narrowed and widened while the page is open
        tab.page.set_viewport_size({"width": width, "height": height})
        for preset in ("Start", "Side"):
            tab.press(preset)
            until(lambda: seen(tab, points), f"the plant from {preset} at {width} px", 20.0)
    tab.page.reload()
    tab.sees("press Plan")
    until(lambda: seen(tab, points), "the first view", 20.0)
    assert tab.complaints == []
    tab.close()
