"""Many independent trials in parallel processes, with a progress bar, and nothing lost when they are interrupted."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from types import FrameType
from typing import Generic, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lime_planner.core.elsewhere import usable_cores
from lime_planner.core.errors import LimePlannerError

Task = TypeVar("Task")
Result = TypeVar("Result")

_LOOK_S = 0.2  # between two looks at whether ctrl-C was pressed
_IN_FLIGHT = 4  # tasks handed out ahead for each process: busy processes, and little to cancel
RETRIES = 2  #: of a task that was under way when a process died


class WorkerError(LimePlannerError):
    """A task ends every process that takes it up."""


def default_jobs() -> int:
    """Return the number of processors this process may use."""
    return usable_cores()


def _ignore_interrupt() -> None:
    # The terminal sends ctrl-C to all processes; only the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def _first_interrupt() -> Iterator[threading.Event]:
    """Turn the first ctrl-C into an event; the second one interrupts as ever.

    An exception out of nowhere can leave the pool's locks held, and the program waits for good.
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

    Raises:
        WorkerError: a task ended one process after the other; all others are done first.
        Exception: what a task raised; what runs in other processes is finished and handed over first.
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
        with _first_interrupt() as pressed:
            return _Hand(function, tasks, done, jobs).drain(pressed, told)


class _Hand(Generic[Task, Result]):
    """Hands tasks out to processes of this machine, a few ahead for each, and takes back whatever becomes of them.

    A process that dies takes the whole pool with it, and which task was its last stays unknown. All that were handed out are tried
    again in a new pool. A task that was there twice is tried last and alone, so that no other one is blamed for a third death.
    """

    def __init__(self, function: Callable[[Task], Result], tasks: Sequence[Task], done: Callable[[Result], None], jobs: int) -> None:
        self.function, self.done, self.jobs = function, done, jobs
        self.fresh = iter(tasks)
        self.again: deque[tuple[Task, int]] = deque()  # task, deaths that it was there at
        self.alone: deque[tuple[Task, int]] = deque()
        self.pending: dict[Future[Result], tuple[Task, int]] = {}
        self.error: BaseException | None = None
        self.killer: WorkerError | None = None  # what is said in the end about tasks that end every process; the others are done first
        self.lost = False  # whether any process died
        self.pool = self._new_pool()

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.jobs, mp_context=get_context("spawn"), initializer=_ignore_interrupt)

    def drain(self, pressed: threading.Event, tell: Callable[[], None]) -> bool:
        """Keep the processes busy until all tasks are done, an error, or ctrl-C; what is finished by then is handed over in any case.

        Returns:
            False after ctrl-C.

        Raises:
            WorkerError: a task ended one process after the other.
            Exception: what a task raised, after the tasks under way have ended.
        """
        stopped = told = False
        try:
            while True:
                if pressed.is_set() and not told:
                    told = True
                    tell()
                if (told or self.error is not None) and not stopped:
                    stopped = True
                    self.pending = {future: held for future, held in self.pending.items() if not future.cancel()}
                broken = not stopped and not self._hand_out()
                if not self.pending and not broken:
                    break
                finished = wait(self.pending, timeout=_LOOK_S, return_when=FIRST_COMPLETED).done
                broken |= any(isinstance(future.exception(), BrokenProcessPool) for future in finished)
                if broken:
                    finished = wait(self.pending).done  # a broken pool ends all of them at once
                self._take([future for future in self.pending if future in finished])
                if broken:
                    told |= pressed.is_set()  # ctrl-C met a process that was still starting
                    if told or self.error is not None:
                        break
                    self._rebuild()
        finally:
            self.pool.shutdown(cancel_futures=True)
        if error := self.error or self.killer:
            raise error
        return not told

    def _hand_out(self) -> bool:
        """Hand out as many as may be under way; False where the pool turns out to be broken."""
        # After a death no more than can run, so that few are suspected at the next one.
        ahead = self.jobs if self.lost else self.jobs * _IN_FLIGHT
        while len(self.pending) < ahead:
            if self.again:
                held = self.again.popleft()
            elif (task := next(self.fresh, None)) is not None:
                held = task, 0
            elif self.alone and not self.pending:
                held, ahead = self.alone.popleft(), 1
            else:
                break
            try:
                self.pending[self.pool.submit(self.function, held[0])] = held
            except BrokenProcessPool:
                (self.alone if held[1] >= RETRIES else self.again).appendleft(held)
                return False
        return True

    def _take(self, futures: Iterable[Future[Result]]) -> None:
        """Hand finished results over, note the first error, and set aside for another attempt what lost its process."""
        for future in futures:
            task, deaths = self.pending.pop(future)
            try:
                result = future.result()
            except BrokenProcessPool as error:
                self.lost = True
                if deaths >= RETRIES:  # it was alone
                    self.killer = self.killer or WorkerError(f"a process died in each of {deaths + 1} attempts at {task!r}")
                    self.killer.__cause__ = self.killer.__cause__ or error
                elif deaths + 1 >= RETRIES:
                    self.alone.append((task, deaths + 1))
                else:
                    self.again.append((task, deaths + 1))
            except Exception as error:  # of the task; the others' results come first
                self.error = self.error or error
            else:
                self.done(result)

    def _rebuild(self) -> None:
        self.pool.shutdown()
        self.pool = self._new_pool()
