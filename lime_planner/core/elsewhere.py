"""How many processors there are, and calls in a process of their own, for what would hold the interpreter from other threads for long.

Open3D's distances, FCL's and Pinocchio's models keep Python's lock for seconds; a node that computed them in one of its threads could
not serve a stop meanwhile. Waiting for another process keeps no lock. A program without other threads computes at once.
"""

from __future__ import annotations

import importlib
import math
import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from lime_planner.core.errors import LimePlannerError, Refusal
from lime_planner.core.status import Status

T = TypeVar("T")

_POLL_S = 0.02
_CGROUP = Path("/sys/fs/cgroup")

# Not multiprocessing's spawn, which would run the main module of a program that uses this package as a library once more.
_CHILD = "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); from lime_planner.core.elsewhere import _serve; _serve()"


def call_elsewhere(function: Callable[..., T], *arguments: Any, should_stop: Callable[[], bool] = lambda: False) -> T:
    """Call a function in a process of its own and return what it returns.

    From the main thread, which has no services to answer, it is called here.

    Args:
        function: of a module, not nested; it must not print.
        arguments: that can be pickled.
        should_stop: ends the process, asked every few hundredths of a second.

    Raises:
        Refusal: CANCELLED.
        LimePlannerError: what the function raised of the package's own errors, or that the process failed, with its last words.
    """
    if threading.current_thread() is threading.main_thread():
        return function(*arguments)
    call = pickle.dumps(sys.path) + pickle.dumps((function.__module__, function.__qualname__)) + pickle.dumps(arguments, protocol=5)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # the callbacks want a core too
    with tempfile.TemporaryFile() as given:  # not a pipe: what does not fit into one is not written any more after a time-out
        given.write(call)
        given.seek(0)
        child = subprocess.Popen([sys.executable, "-c", _CHILD], stdin=given, stdout=-1, stderr=-1, env=environment)
    while True:
        try:
            output, errors = child.communicate(timeout=_POLL_S)
            break
        except subprocess.TimeoutExpired:
            if should_stop():
                child.kill()
                child.communicate()
                raise Refusal(Status.CANCELLED, "the request was stopped") from None
    try:
        good, result = pickle.loads(output)
    except Exception:
        words = errors.decode(errors="replace").strip().splitlines()
        raise LimePlannerError(
            f"the process that was to call {function.__name__} ended with {child.returncode}: {words[-1] if words else 'without a word'}"
        ) from None
    if not good:
        raise result
    value: T = result
    return value


def _serve() -> None:
    """Read one call from the standard input, make it, write the outcome to the standard output."""
    outcome = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no part of it
    module, name = pickle.load(sys.stdin.buffer)
    arguments = pickle.load(sys.stdin.buffer)
    try:
        result: tuple[bool, Any] = True, getattr(importlib.import_module(module), name)(*arguments)
    except LimePlannerError as error:
        result = False, error
    pickle.dump(result, outcome, protocol=5)
    outcome.close()


def usable_cores(cgroup: Path = _CGROUP) -> int:
    """Return the number of processors this process may use, at least 1: a container's quota counts, and a processor affinity.

    Args:
        cgroup: where the kernel says what a container may use.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.floor(min(cores, _quota(cgroup))))


def _quota(cgroup: Path) -> float:
    """Return the processors that a container's quota amounts to (version 2 of control groups, then 1); inf without one."""
    try:
        texts = (cgroup / "cpu.max").read_text(encoding="ascii").split()
    except (OSError, UnicodeDecodeError):
        try:
            folder = cgroup / "cpu"
            texts = [(folder / f"cpu.cfs_{name}_us").read_text(encoding="ascii").strip() for name in ("quota", "period")]
        except (OSError, UnicodeDecodeError):
            return math.inf
    try:
        quota, period = (float(text) for text in texts)
    except ValueError:  # "max": no quota
        return math.inf
    return quota / period if quota > 0.0 and period > 0.0 else math.inf
