"""Many independent trials in parallel processes, with a progress bar, and nothing lost when they are interrupted."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Task = TypeVar("Task")
Result = TypeVar("Result")

_LOOK_S = 0.2  # between two looks at whether ctrl-C was pressed
_IN_FLIGHT = 4  # tasks handed out ahead for each process: busy processes, and little to cancel


def default_jobs() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _ignore_interrupt() -> None:
    # The terminal sends ctrl-C to all processes; only the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def _first_interrupt() -> Iterator[threading.Event]:
    """Turn the first ctrl-C into an event; the second one interrupts as ever.

    An exception out of nowhere can leave the pool's locks held, and everybody waits for good.
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield pressed
        return

    def note(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        pressed.set()

    signal.signal(signal.SIGINT, note)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextlib.contextmanager
def progress_bar(description: str, total: int, console: Console) -> Iterator[Callable[[], None]]:
    """Show a bar while the context lasts, on a terminal only; call what it yields for each step."""
    if not console.is_terminal:
        yield lambda: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task(description, total=total)
        yield lambda: progress.advance(bar)


def run_trials(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    on_result: Callable[[Result], None],
    *,
    jobs: int,
    description: str,
    console: Console | None = None,
) -> bool:
    """Call `function` on every task and hand each result to `on_result`, in the order in which they finish.

    Args:
        function: importable by name (processes are spawned), and so are its argument and result.
        tasks: what to do.
        on_result: called in this process.
        jobs: number of processes; 1 runs everything in this one.
        description: beside the progress bar, which shows on a terminal only.
        console: where the bar goes (default: standard error).

    Returns:
        True when all are done; False after ctrl-C: what runs in other processes is finished and handed over, the others dropped.
    """
    console = console or Console(stderr=True)
    told = partial(console.print, "Stopping: the trials under way are finished and kept (ctrl-C again drops them).")
    with progress_bar(description, len(tasks), console) as advance:

        def done(result: Result) -> None:
            on_result(result)
            advance()

        if jobs <= 1:
            try:
                for task in tasks:
                    done(function(task))
            except KeyboardInterrupt:
                return False
            return True
        with (
            _first_interrupt() as pressed,
            ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_ignore_interrupt) as pool,
        ):
            return _drain(pool, function, tasks, done, jobs * _IN_FLIGHT, pressed, told)


def _drain(
    pool: ProcessPoolExecutor,
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    done: Callable[[Result], None],
    ahead: int,
    pressed: threading.Event,
    tell: Callable[[], None],
) -> bool:
    """Keep `ahead` tasks in the pool until all are done, or until ctrl-C."""
    waiting = iter(tasks)
    pending: set[Future[Result]] = set()
    interrupted = False
    while True:
        try:
            if pressed.is_set() and not interrupted:
                interrupted = True
                tell()
                pending = {future for future in pending if not future.cancel()}
            while not interrupted and len(pending) < ahead and (task := next(waiting, None)) is not None:
                pending.add(pool.submit(function, task))
            if not pending:
                return not interrupted
            finished, _ = wait(pending, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
            for future in finished:
                pending.discard(future)
                done(future.result())
        except BrokenProcessPool:
            if not pressed.is_set():
                raise
            return False  # ctrl-C met a process that was still starting


def write_atomically(path: Path, text: str) -> None:
    """Replace a file's contents such that a reader, or a crash, never meets half of them."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text)
    temporary.replace(path)


def write_json(path: Path, data: Any) -> None:
    """Write JSON (no NaN, no inf) atomically."""
    write_atomically(path, json.dumps(data, allow_nan=False, separators=(",", ":")) + "\n")
