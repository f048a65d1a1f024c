"""A headless Chromium for the tests of the 3-D page; run as a program, it says which one there is."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from playwright.sync_api import Browser, ConsoleMessage, Page, sync_playwright

#: Names of a system's own Chromium; a snap cannot be driven from outside.
NAMES = ("chromium", "google-chrome-stable", "google-chrome")
#: Software rendering: no machine needs a graphics card for the tests.
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
ADVICE = "no Chromium: scripts/browser.sh installs one (Debian: apt-get install chromium)"
SIZE = {"width": 1000, "height": 640}


def executable(own: str) -> str | None:
    """Path of a Chromium: the system's, or Playwright's own, whose path is given."""
    for name in NAMES:
        path = shutil.which(name)
        if path is not None and "/snap/" not in str(Path(path).resolve()):
            return path
    return own if Path(own).is_file() else None


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start the browser."""
    with sync_playwright() as playwright:
        path = executable(playwright.chromium.executable_path)
        assert path is not None, ADVICE
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


class Tab:
    """One browser window of its own on a page, and what its console said."""

    def __init__(self, browser: Browser, url: str, scheme: Literal["light", "dark"] = "light") -> None:
        self.complaints: list[str] = []
        self.context = browser.new_context(viewport=SIZE, color_scheme=scheme)  # type: ignore[arg-type]
        self.page: Page = self.context.new_page()
        self.page.set_default_timeout(60_000.0)  # drawing by software takes its time on a machine that is busy
        self.page.on("console", self._on_console)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(url)

    def _on_console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.complaints.append(message.text)

    def press(self, name: str, timeout_s: float = 60.0) -> None:
        """Press a button as soon as it can be pressed."""
        self.page.get_by_role("button", name=name, exact=True).first.click(timeout=1000.0 * timeout_s)

    def sees(self, text: str, timeout_s: float = 60.0) -> None:
        """Wait until a text is on the page."""
        self.page.get_by_text(text).first.wait_for(timeout=1000.0 * timeout_s)

    def field(self, label: str) -> str:
        """Value of the number that stands beside a slider."""
        return str(self._field(label).input_value())

    def fill(self, label: str, value: str) -> None:
        """Type a number beside a slider."""
        field = self._field(label)
        field.fill(value)
        field.press("Enter")

    def open(self, label: str) -> None:
        """Open the choice beside a label."""
        self._row(label).locator("input:not([type=hidden])").first.click()

    def _field(self, label: str):  # type: ignore[no-untyped-def]
        return self._row(label).locator("input").last

    def _row(self, label: str):  # type: ignore[no-untyped-def]
        return self.page.get_by_text(label, exact=True).locator("xpath=ancestor::*[.//input][1]")

    def close(self) -> None:
        self.context.close()


if __name__ == "__main__":
    with chromium() as browser:
        print(browser.version)
    sys.exit(0)
