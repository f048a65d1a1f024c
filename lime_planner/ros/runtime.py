"""What every node of the package runs on: the program's beginning and end, threads beside the executor's, the log, freed memory.

A program ends with exit code 0 after SIGINT or SIGTERM, at any moment, as often as they come. The usual spin-and-catch loop ends with
code 1 or a traceback when a signal arrives inside a wait, or twice. Here the signals are only written to a pipe; a thread spins; the
main thread waits at the pipe's other end and then takes the node down in a fixed order.
"""

from __future__ import annotations

import ctypes
import enum
import faulthandler
import os
import re
import sys
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from lime_planner.core.errors import LimePlannerError
from lime_planner.core.signals import EndSignals

#: How long the spinning thread may take to come back from the callback it is in [s].
JOIN_TIMEOUT_S = 5.0
#: A process that has not ended this long after its signal says where it hangs and ends with code 1, so that it can be started again [s].
END_TIMEOUT_S = 20.0

_NUMBERS = re.compile(r"[-+0-9.]+")
_KINDS_REMEMBERED = 200


class _Stop(Future):
    """The future that ends spinning.

    `spin_until_future_complete` registers one more wake-up at every turn, which would grow for as long as the node runs; one is enough.
    """

    def __init__(self) -> None:
        super().__init__()
        self._registered = False

    def add_done_callback(self, callback: Callable[[Future], None]) -> None:
        if not self._registered:
            self._registered = True
            super().add_done_callback(callback)


def run_node(factory: Callable[[], Node], *, args: Sequence[str] | None = None, threads: int = 1) -> int:
    """Create a node, serve it until SIGINT or SIGTERM, and take it down.

    For the main thread only (Python delivers signals there). An exception in the factory or in a callback is printed and ends the
    program with code 1; of this package's own exceptions, whose text is for users, the factory's are printed without a traceback.

    If the node has a method `shut_down`, it is called once, from the main thread, while callbacks may still run: the place to cancel
    work, so that callbacks that wait for it return, and to stop worker threads.

    Args:
        factory: builds the node; called after `rclpy.init`.
        args: command line for rclpy; `sys.argv` by default.
        threads: threads for callbacks; above 1 a `MultiThreadedExecutor` serves them.

    Returns:
        The process' exit code: 0 after a signal, 1 after an exception.
    """
    signals = EndSignals()
    failures: list[BaseException] = []
    try:
        rclpy.init(args=sys.argv if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
        node = factory()
    except LimePlannerError as error:
        print(error, file=sys.stderr, flush=True)
        rclpy.try_shutdown()
        return 1
    except Exception:
        traceback.print_exc()
        rclpy.try_shutdown()
        return 1
    executor: Executor = SingleThreadedExecutor() if threads <= 1 else MultiThreadedExecutor(num_threads=threads)
    executor.add_node(node)
    stop = _Stop()

    def spin() -> None:
        try:
            executor.spin_until_future_complete(stop)
        except BaseException as error:
            failures.append(error)
            traceback.print_exc()
        finally:
            signals.wake()

    thread = threading.Thread(target=spin, name="spin", daemon=True)
    thread.start()
    signals.wait()
    signals.ignore()
    faulthandler.dump_traceback_later(END_TIMEOUT_S, exit=True, file=sys.__stderr__ or sys.stderr)
    try:
        shut_down = getattr(node, "shut_down", None)
        if shut_down is not None:
            shut_down()
    except Exception as error:
        failures.append(error)
        traceback.print_exc()
    stop.set_result(None)
    _take_down(node, executor, thread)
    return 1 if failures else 0


def _take_down(node: Node, executor: Executor, thread: threading.Thread) -> None:
    thread.join(JOIN_TIMEOUT_S)
    if thread.is_alive():
        # Nothing may be destroyed under a running callback, and nothing can interrupt it: leave without clean-up.
        print(f"{node.get_name()}: a callback did not return within {JOIN_TIMEOUT_S} s; leaving without it", file=sys.stderr, flush=True)
        os._exit(1)
    pool = getattr(executor, "_executor", None)  # Executor.shutdown does not wait for the callbacks of a MultiThreadedExecutor
    if pool is not None:
        pool.shutdown(wait=True, cancel_futures=True)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


class Severity(enum.IntEnum):
    """How bad a thing is, in the log and, by the same numbers, in diagnostics."""

    OK = 0
    WARN = 1
    ERROR = 2


class BackgroundThread(ABC):
    """A daemon thread that waits at `_condition` for work, until it is closed; a subclass says in `_run` what it does."""

    def __init__(self, name: str) -> None:
        """Make the thread; the subclass calls `_start` once it is complete.

        Args:
            name: of the thread, as debuggers and logs show it.
        """
        self._condition = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def _start(self) -> None:
        self._thread.start()

    def close(self, timeout_s: float = 2.0) -> bool:
        """End the thread; False if it is still at work after `timeout_s` (it dies with the process then)."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @abstractmethod
    def _run(self) -> None:
        """Work until `_closed`."""


class Spinning:
    """A client's node, its executor and a thread that spins them; `close` takes all of them, and the node's context, down."""

    def __init__(self, node: Node) -> None:
        """Start to spin; the node is complete."""
        self.node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._done = Future()
        self._thread = threading.Thread(target=self._executor.spin_until_future_complete, args=(self._done,), name="spin", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._done.set_result(None)
        self._executor.wake()
        self._thread.join(5.0)
        self._executor.shutdown()
        context = self.node.context
        self.node.destroy_node()
        context.try_shutdown()


class Throttle:
    """Keeps a repeated warning from filling the log, without hiding a different one behind it.

    Each kind of sentence is passed on once in a while; sentences that differ only in their numbers are of one kind.
    """

    def __init__(self, log: Callable[[str], object], period_s: float) -> None:
        """Make a throttle.

        Args:
            log: where sentences go.
            period_s: shortest time between two of one kind [s].
        """
        self._log = log
        self._period_s = period_s
        self._lock = threading.Lock()
        self._seen: dict[str, tuple[float, int]] = {}

    def __call__(self, sentence: str) -> None:
        """Log the sentence, or count it for the next time."""
        kind = _NUMBERS.sub("#", sentence)
        now_s = time.monotonic()
        with self._lock:
            last_s, held_back = self._seen.get(kind, (-float("inf"), 0))
            if now_s - last_s < self._period_s:
                self._seen[kind] = (last_s, held_back + 1)
                return
            if len(self._seen) >= _KINDS_REMEMBERED:
                self._seen.clear()
            self._seen[kind] = (now_s, 0)
        self._log(f"{sentence} ({held_back} more like this since the last)" if held_back else sentence)


def _find_trim() -> Callable[[int], int] | None:
    try:
        trim: Callable[[int], int] = ctypes.CDLL(None).malloc_trim  # glibc's; calls release the GIL
    except (OSError, AttributeError, TypeError):
        return None
    return trim


_TRIM = _find_trim()


def give_back() -> None:
    """Return freed pages to the system; takes a few milliseconds, and does nothing where the C library is not glibc.

    A plan allocates and frees tens of megabytes of distance fields in several threads. glibc keeps what lies between blocks that are
    still in use, in an arena for each thread, so that without this the node grows with every rare combination of sizes.
    """
    if _TRIM is not None:
        _TRIM(0)
