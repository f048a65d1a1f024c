"""Run a function in a child process of its own: a crash, a hang or a generator that can be seeded only once stays in there."""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable
from typing import Any, TypeVar

Result = TypeVar("Result")

_CHUNK_BYTES = 1 << 16


class IsolatedError(RuntimeError):
    """The child did not give a result; the text says why."""


def _child(write_end: int, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
    """Send the result, or the traceback, and end at once: libraries of peers complain and crash while they are taken down."""
    try:
        answer = pickle.dumps((True, function(*args)))
    except BaseException:
        answer = pickle.dumps((False, traceback.format_exc()))
    with contextlib.suppress(BaseException):
        with os.fdopen(write_end, "wb") as pipe:
            pipe.write(answer)
        sys.stdout.flush()
    os._exit(0)


def _read_all(read_end: int, timeout_s: float) -> bytes:
    parts: list[bytes] = []
    deadline_s = time.monotonic() + timeout_s
    while True:
        ready, _, _ = select.select([read_end], [], [], max(0.0, deadline_s - time.monotonic()))
        if not ready:
            raise IsolatedError(f"no answer within {timeout_s:.0f} s")
        part = os.read(read_end, _CHUNK_BYTES)
        if not part:
            return b"".join(parts)
        parts.append(part)


def run_isolated(function: Callable[..., Result], *args: Any, timeout_s: float) -> Result:
    """Call `function(*args)` in a forked copy of this process, which starts with everything that is loaded and compiled here.

    Not through `multiprocessing`, which allows no children to the daemonic workers of a cluster.

    Raises:
        IsolatedError: it raised, crashed, or took longer than `timeout_s`, after which it is killed.
    """
    read_end, write_end = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        os.close(read_end)
        _child(write_end, function, args)
    os.close(write_end)
    try:
        data = _read_all(read_end, timeout_s)
    finally:
        os.close(read_end)
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)  # it has answered or will not be heard
        _, status = os.waitpid(pid, 0)
    if not data:
        raise IsolatedError(f"the process ended without an answer, exit status {os.waitstatus_to_exitcode(status)}")
    ok, answer = pickle.loads(data)
    if not ok:
        raise IsolatedError(str(answer))
    result: Result = answer
    return result
