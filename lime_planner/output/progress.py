"""A sign of life on standard error while something takes its time; nothing where that is no terminal."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lime_planner.output.console import console

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as RichProgress

_TICK_S = 0.1


class Progress:
    """How far a command is, for whoever shows it; this one shows nothing."""

    def say(self, text: str) -> None:
        """Tell what is being done now."""

    def advance(self, steps: float = 1.0) -> None:
        """Tell that steps are done."""


class _Bar(Progress):
    """A bar of rich."""

    def __init__(self, progress: RichProgress, text: str, total: float | None) -> None:
        self._progress = progress
        self._task = progress.add_task(text, total=total)

    def say(self, text: str) -> None:
        self._progress.update(self._task, description=text)

    def advance(self, steps: float = 1.0) -> None:
        self._progress.advance(self._task, steps)


@contextlib.contextmanager
def working(text: str, *, total: float | None = None, seconds: float | None = None) -> Iterator[Progress]:
    """Show a bar while the context lasts.

    Args:
        text: what is being done.
        total: number of steps; None shows a bar without an end.
        seconds: instead of a total: the bar fills by itself in this time.
    """
    out = console(error=True)
    if not out.is_terminal:
        yield Progress()
        return
    with _shown(out) as progress:
        bar = _Bar(progress, text, seconds if seconds is not None else total)
        if seconds is None:
            yield bar
            return
        with _ticking(bar):
            yield bar


def _shown(out: Console) -> RichProgress:
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    return Progress(*columns, console=out, transient=True)


@contextlib.contextmanager
def _ticking(bar: Progress) -> Iterator[None]:
    """Advance a bar by the time that passes."""
    done = threading.Event()

    def tick() -> None:
        before = time.monotonic()
        while not done.wait(_TICK_S):
            now = time.monotonic()
            bar.advance(now - before)
            before = now

    thread = threading.Thread(target=tick, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
