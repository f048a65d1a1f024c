"""Trials on the workers of a Dask cluster: the same results as on one machine, whatever becomes of single workers.

A trial depends on its task alone, and every task holds its own seed; so it does not matter where it runs, or how often. Needs the
extra `cluster` here and on the workers, and the same version of this package there.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rich.console import Console

from lime_planner import __version__
from lime_planner.core.errors import LimePlannerError, ParameterError
from lime_planner.experiments.runs.parallel import progress_bar

Task = TypeVar("Task")
Result = TypeVar("Result")

CONNECT_TIMEOUT_S = 20.0
ATTEMPTS = 5  #: to carry out a trial that Dask gives up, each of which has cost the lives of several workers
_IN_FLIGHT = 3  # tasks handed out ahead for each worker: busy workers, and little to do again when one dies
_FEWEST_IN_FLIGHT = 8
_COUNT_EVERY_S = 2.0
_FETCH_TIMEOUT_S = 10.0

_ONE_AT_A_TIME = threading.Lock()  # a worker may have several threads, but scenes and checkers are kept for one


class ClusterError(LimePlannerError):
    """The cluster cannot be used, or a trial cannot be carried out on it."""


def carry_out(version: str, function: Callable[[Task], Result], task: Task) -> Result:
    """Run a trial; this is what workers call.

    Raises:
        ClusterError: the worker has another version of this package.
    """
    if version != __version__:
        raise ClusterError(f"a worker has lime_planner {__version__}, the trials come from {version}")
    with _ONE_AT_A_TIME:
        return function(task)


def _check_address(address: str) -> None:
    """Refuse what no connection can be tried to: a client that fails over it takes most of a minute to end, and prints a traceback.

    Raises:
        ParameterError: unknown scheme, or no host and port.
    """
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    try:
        scheme, location = parse_address(address)
        get_backend(scheme)
        if scheme in ("tcp", "tls"):
            host, port = parse_host_port(location)
            if not host or not 1 <= port <= 65535:
                raise ValueError("no host" if not host else f"port {port}; allowed are 1 to 65535")
    except ValueError as error:
        raise ParameterError(f"--scheduler {address}: is no address like tcp://host:8786 ({error})") from error


def _client(address: str) -> Any:
    from distributed import Client

    _check_address(address)
    try:
        return Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ParameterError(f"--scheduler {address}: no Dask scheduler answers there ({error or type(error).__name__})") from error


def run_on_cluster(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    on_result: Callable[[Result], None],
    *,
    scheduler: str,
    description: str,
    console: Console | None = None,
) -> bool:
    """Call `function` on every task on a cluster's workers and hand each result to `on_result`, in the order in which they finish.

    A trial whose worker dies is run again on another one; results that have arrived stay. Workers may come and go; without any it waits.

    Args:
        function: importable by name on the workers, and so are its argument and result; it must not depend on what ran before.
        tasks: what to do.
        on_result: called in this process.
        scheduler: address, for example `tcp://host:8786`.
        description: beside the progress bar, which shows on a terminal only.
        console: where the bar goes (default: standard error).

    Returns:
        True when all are done; False after ctrl-C: what has not arrived by then is dropped.

    Raises:
        ParameterError: the address is none, or no scheduler answers there.
        ClusterError: the workers have another version of this package, the scheduler is gone, or a trial killed worker after worker.
        Exception: what a trial raised; results that have arrived by then are handed over first.
    """
    from distributed import as_completed

    with _client(scheduler) as client, progress_bar(description, len(tasks), console or Console(stderr=True)) as advance:
        hand = _Hand(client, function, tasks)
        running: Any = as_completed(hand.out(), loop=client.loop)
        try:
            for future in running:
                result, again = hand.back(future)
                if again is None:
                    on_result(result)
                    advance()
                running.update([*([] if again is None else [again]), *hand.out()])
        except KeyboardInterrupt:
            client.cancel(list(hand.held))
            return False
        except Exception:
            for result in hand.finished():
                on_result(result)
            raise
    return True


class _Hand:
    """Hands tasks out to a cluster, a few ahead for each worker."""

    def __init__(self, client: Any, function: Callable[[Any], Any], tasks: Sequence[Any]) -> None:
        self.client, self.function = client, function
        self.waiting = iter(tasks)
        self.held: dict[Any, tuple[Any, int]] = {}  # future: task, attempt
        self.ahead, self.counted_s = _FEWEST_IN_FLIGHT, -_COUNT_EVERY_S

    def out(self) -> list[Any]:
        """Hand out as many as may be under way, and return their futures."""
        if time.monotonic() - self.counted_s >= _COUNT_EVERY_S:
            self.ahead = max(_FEWEST_IN_FLIGHT, _IN_FLIGHT * len(self.client.nthreads()))
            self.counted_s = time.monotonic()
        futures = []
        while len(self.held) < self.ahead and (task := next(self.waiting, None)) is not None:
            futures.append(self.submit(task, 1))
        return futures

    def submit(self, task: Any, attempt: int) -> Any:
        """Hand one out."""
        future = self.client.submit(carry_out, __version__, self.function, task, pure=False)
        self.held[future] = task, attempt
        return future

    def back(self, future: Any) -> tuple[Any, Any]:
        """Take a finished future: its result, and None; or the future of another attempt where Dask gave it up.

        Raises:
            ClusterError: not again.
            Exception: what the trial itself raised.
        """
        from concurrent.futures import CancelledError

        from distributed import KilledWorker

        task, attempt = self.held.pop(future)
        try:
            return future.result(), None
        except KilledWorker as error:
            if attempt >= ATTEMPTS:
                raise ClusterError(f"a trial ended worker after worker, in {attempt} attempts: {error}") from error
            return None, self.submit(task, attempt + 1)
        except CancelledError as error:
            raise ClusterError("the cluster's scheduler is gone; --resume continues with another one") from error

    def finished(self) -> list[Any]:
        """Results that are there, but have not been taken yet."""
        futures = [future for future in self.held if future.status == "finished"]
        results = []
        for future in futures:
            # A worker that has died since takes its results with it.
            with contextlib.suppress(Exception):
                results.append(future.result(timeout=_FETCH_TIMEOUT_S))
        return results
