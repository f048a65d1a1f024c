"""Where a page is, in words, and the wait until its user ends it."""

from __future__ import annotations

import contextlib
import os
import sys
import webbrowser
from collections.abc import Iterator

from lime_planner.core.signals import EndSignals
from lime_planner.viewer.access import Access

DEFAULT_PORT = 8080


def announce(url: str, access: Access, *, open_browser: bool) -> None:
    """Say where the page is, and open it where there is a desktop."""
    print(f"the page is at {url}   (Ctrl-C ends it)", flush=True)
    if not access.local:
        who = "browsers that open this very address may use the buttons" if access.token else "they may look only"
        print(f"other machines can open it; {who}", flush=True)
    if open_browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or sys.platform == "darwin"):
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(url)


@contextlib.contextmanager
def until_signal() -> Iterator[EndSignals]:
    """Yield what waits for the first Ctrl-C or SIGTERM."""
    signals = EndSignals()
    try:
        yield signals
    finally:
        signals.close()
