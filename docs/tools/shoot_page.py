"""Take the pictures of the 3-D page in docs/figures with the commands that the page on looking at plans prints.

Run by hand on a quiet machine: PYTHONPATH=test/helpers python docs/tools/shoot_page.py
"""

from __future__ import annotations

import io
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from browser import chromium
from PIL import Image
from playwright.sync_api import Page as Tab

FIGURES = Path(__file__).resolve().parents[1] / "figures"
SIZE = {"width": 1280, "height": 820}
#: Inside the trunk of the plant: a target that is refused.
IN_THE_TRUNK = ("0.613", "-0.056", "0.301")


def shoot(tab: Tab, name: str) -> None:
    """Save what the window shows, in few colours."""
    tab.mouse.move(400, 780)  # away from tooltips
    tab.wait_for_timeout(4000)  # software draws slowly
    picture = Image.open(io.BytesIO(tab.screenshot()))
    picture.convert("RGB").quantize(192, dither=Image.Dither.NONE).save(FIGURES / name, optimize=True)
    print(FIGURES / name)


def main() -> None:
    """Plan, look at the tree, and ask for what cannot be reached."""
    program = [sys.executable, "-m", "lime_planner"]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([*program, "scene", "plant", "--seed", "15", "--out", "plant.npz"], cwd=folder, check=True)
        view = subprocess.Popen([*program, "view", "plant.npz", "--no-browser"], cwd=folder, stdout=subprocess.PIPE, text=True)
        try:
            assert view.stdout is not None
            address = re.search(r"http://\S+", view.stdout.readline())
            assert address is not None
            with chromium() as browser:
                tab = browser.new_context(viewport=SIZE, color_scheme="light").new_page()  # type: ignore[arg-type]
                tab.set_default_timeout(120_000.0)
                tab.goto(address[0])
                tab.locator(".mantine-Notification-closeButton").first.click()  # that there is no graphics card is no news here
                tab.get_by_text("press Plan").first.wait_for()
                tab.get_by_role("button", name="Plan", exact=True).first.click()
                tab.get_by_text("A path is found").first.wait_for()
                shoot(tab, "view.png")
                tab.get_by_text("Show", exact=True).first.click()
                tab.get_by_label("Search tree", exact=True).click()
                tab.get_by_text(re.compile("search tree: ")).first.wait_for()
                shoot(tab, "view-tree.png")
                tab.get_by_label("Search tree", exact=True).click()
                fields = tab.get_by_text("At [m]", exact=True).locator("xpath=ancestor::*[.//input][1]").locator("input")
                for place, value in enumerate(IN_THE_TRUNK):
                    fields.nth(place).fill(value)
                    fields.nth(place).press("Enter")
                tab.get_by_role("button", name="Plan", exact=True).first.click()
                tab.get_by_text("Refused: ").first.wait_for()
                tab.get_by_role("button", name="Target", exact=True).first.click()
                tab.locator(".lp-status").first.scroll_into_view_if_needed()
                shoot(tab, "view-refused.png")
        finally:
            view.send_signal(signal.SIGINT)
            view.wait(30.0)


if __name__ == "__main__":
    main()
