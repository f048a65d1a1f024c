"""Take the pictures of the 3-D page in docs/figures, in a headless Chromium: run by hand on a quiet machine.

PYTHONPATH=test python docs/tools/shoot_page.py
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from browser import chromium
from PIL import Image
from playwright.sync_api import Page as Tab

from lime_planner.core.parameters import settings_from
from lime_planner.robot.model import load_robot
from lime_planner.ros.demo.demo import DEFAULT_SEED
from lime_planner.scene.plants.generator import generate_plant
from lime_planner.viewer.access import Access
from lime_planner.viewer.backend import Activity
from lime_planner.viewer.page import Page
from lime_planner.viewer.scene_backend import SceneBackend

FIGURES = Path(__file__).resolve().parents[1] / "figures"
SIZE = {"width": 1280, "height": 760}
SEED = 1


def until(holds: Callable[[], bool], timeout_s: float = 120.0) -> None:
    """Wait."""
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            raise SystemExit("waited in vain")
        time.sleep(0.05)


def shoot(tab: Tab, name: str) -> None:
    """Save what the window shows, in few colours."""
    time.sleep(4.0)  # software draws slowly
    picture = Image.open(io.BytesIO(tab.screenshot()))
    picture.convert("RGB").quantize(192, dither=Image.Dither.NONE).save(FIGURES / name, optimize=True)
    print(FIGURES / name)


def main() -> None:
    """Plan, stand among the leaves, and take both pictures."""
    scene = generate_plant(np.random.default_rng(DEFAULT_SEED))
    backend = SceneBackend(lambda: load_robot("kinova_j2s6s200"), settings_from({"seed": SEED}), scene=scene, title="plant")
    until(lambda: backend.moment().activity is Activity.IDLE)
    page = Page(backend, Access(), 0)
    with chromium() as browser:
        tab = browser.new_context(viewport=SIZE).new_page()  # type: ignore[arg-type]
        tab.set_default_timeout(60_000.0)
        tab.goto(page.url)
        tab.locator(".mantine-Notification-closeButton").first.click()  # that there is no graphics card is no news here
        tab.get_by_role("button", name="Plan", exact=True).first.click()
        until(lambda: backend.moment().shown is not None and page._timeline is not None)
        timeline = page._timeline
        assert timeline is not None
        page._player.playing = False
        page._player.t_s = float(timeline.times_s[max(int(np.argmax(timeline.leaf > 0.0)), 1)])
        shoot(tab, "view.png")
        tab.get_by_text("Show", exact=True).first.click()
        tab.get_by_label("Search tree", exact=True).click()
        until(lambda: page._extras._tree is not None)
        tab.mouse.move(640, 700)  # away from the tooltip
        shoot(tab, "view-tree.png")
    page.close()
    backend.close()


if __name__ == "__main__":
    main()
