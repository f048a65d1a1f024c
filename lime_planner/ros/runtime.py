"""How every node of the package is run and ended: exit code 0 after SIGINT or SIGTERM, at any moment, as often as they come.

The usual spin-and-catch loop ends with code 1 or a traceback when a signal arrives inside a wait, or twice. Here the signals are only
written to a pipe; a thread spins; the main thread waits at the pipe's other end and then takes the node down in a fixed order.
"""

from __future__ import annotations

import faulthandler
import os
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from lime_planner.core.errors import LimePlannerError
from lime_planner.core.signals import EndSignals

#: How long the spinning thread may take to come back from the callback it is in [s].
JOIN_TIMEOUT_S = 5.0
#: A process that has not ended this long after its signal says where it hangs and ends with code 1, so that it can be started anew [s].
END_TIMEOUT_S = 20.0


class _Stop(Future):
    """The future that ends spinning.

    `spin_until_future_complete` registers one more wake-up at every turn, which would grow for as long as the node runs; one is enough.
    """

    def __init__(self) -> None:
        super().__init__()
        self._registered = False

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
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
