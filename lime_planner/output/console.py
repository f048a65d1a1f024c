"""What commands print on a terminal: a plan's figures as a short table, on at most 80 columns, warnings, and progress."""

from __future__ import annotations

import contextlib
import os
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lime_planner.core.atomic_files import write_json
from lime_planner.pipeline.result import OF_VIEWS, ROWS

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as RichProgress

_TICK_S = 0.1
_LINE_EVERY_S = 5.0  # in a pipe or a log
_COMPILING = "compiling, once after an installation or an update"

__all__ = ["ROWS", "cell", "console", "headline", "print_plans", "print_wrapped", "warn", "wrapped", "write_json"]


def console(*, error: bool = False) -> Console:
    """Return a console of at most 80 columns, fewer where the terminal (or COLUMNS) has fewer."""
    from rich.console import Console

    class OwnConsole(Console):
        """One whose reader may leave: rich would end the program with 1."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    plain = OwnConsole(stderr=error, highlight=False)
    return OwnConsole(stderr=error, highlight=False, width=min(80, plain.width))


def wrapped(text: str, indent: str = "  ", first: str = "") -> list[str]:
    """Return text as lines within the console's columns; words are never torn, for they may be paths or commands.

    Args:
        text: one paragraph.
        indent: before every line but the first.
        first: before that.
    """
    width = console().width
    return textwrap.wrap(text, width, initial_indent=first, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def print_wrapped(text: str) -> None:
    """Print a paragraph within the columns of the terminal, or of COLUMNS; in a pipe without that it stays one line, for grep."""
    narrow = console().is_terminal or "COLUMNS" in os.environ
    print("\n".join(wrapped(text)) if narrow else text)


def warn(sentence: str) -> None:
    """Say on standard error, on a line of its own, what is suspicious but no reason to refuse."""
    print(f"warning: {sentence}", file=sys.stderr)


def cell(figures: Mapping[str, Any], key: str, factor: float = 1.0, decimals: int = 2) -> str:
    """Return one figure as text; a dash where there is none."""
    value = figures.get(key)
    if value is None or (isinstance(value, float) and value != value):
        return "–"
    return f"{float(value) * factor:.{decimals}f}"


def headline(figures: Mapping[str, Any]) -> str:
    """Return planner, leaf contact, length and clearance in one line, as the table shows them."""
    texts = {key: cell(figures, key, factor, decimals) for key, _, _, factor, decimals in ROWS}
    contact, length, clearance = (texts[key] for key in ("leaf_contact_rad", "path_length_rad", "min_stem_clearance_m"))
    return f"{figures.get('planner', '')}: leaf contact {contact} rad of {length} rad, stem clearance {clearance} mm"


def print_plans(title: str, columns: Sequence[tuple[str, Mapping[str, Any]]], extra: Sequence[tuple[str, Sequence[str]]] = ()) -> None:
    """Print plans side by side.

    Args:
        title: above the table.
        columns: heading and figures of each plan; figures without a path show dashes.
        extra: further rows: words, and one text for each column.
    """
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", show_edge=False, pad_edge=False)
    table.add_column("")
    for heading, _ in columns:
        table.add_column(heading, justify="right", overflow="fold")
    table.add_row("status", *(str(figures.get("status", "–")) for _, figures in columns))
    seen = any(int(figures.get("views") or 0) for _, figures in columns)
    for key, words, unit, factor, decimals in ROWS:
        if key == OF_VIEWS and not seen:
            continue
        table.add_row(f"{words} [{unit}]".replace("[", r"\["), *(cell(figures, key, factor, decimals) for _, figures in columns))
    for words, texts in extra:
        table.add_row(words.replace("[", r"\["), *texts)
    console().print(table)


class Progress:
    """How far a command is; this one shows nothing, where standard error is no terminal."""

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


def _compiled(done: int) -> str:
    """Tell how far the compiler is; where the cache holds nearly everything, there is nothing to count."""
    return f"{_COMPILING}: {done} functions done" if done else "looking for what is not compiled yet"


@contextlib.contextmanager
def _compilation_shown() -> Iterator[Callable[[int, float], None]]:
    """Give a function that shows on standard error how far the compiler is: a bar, or lines where that is no terminal."""
    if sys.stderr.isatty():
        with working(_compiled(0)) as progress:
            yield lambda done, elapsed_s: progress.say(_compiled(done))
        return
    last_s = [-_LINE_EVERY_S]

    def line(done: int, elapsed_s: float) -> None:
        if elapsed_s - last_s[0] >= (_LINE_EVERY_S if elapsed_s < 60.0 else 6.0 * _LINE_EVERY_S):
            last_s[0] = elapsed_s
            print(f"{_compiled(done)}, {elapsed_s:.0f} s", file=sys.stderr, flush=True)

    yield line


def compile_first() -> bool:
    """Compile what the cache does not hold, and show it; whether there was anything."""
    from lime_planner.core.kernel_cache import all_compiled
    from lime_planner.pipeline.compilation import ensure_compiled

    if all_compiled():
        return False
    with _compilation_shown() as report:
        return ensure_compiled(report)
