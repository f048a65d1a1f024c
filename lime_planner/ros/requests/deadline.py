"""Keeps a request's deadline from outside: its job may be where it cannot look at the clock, in a cloud of millions of points, say."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

from lime_planner.core.status import Status
from lime_planner.ros.requests.worker import Answer, Ticket

#: How long after its deadline a request is given up for a job that has not noticed by itself [s].
_GRACE_S = 0.02

#: Time left until the deadline [s]; None without one.
Left = Callable[[], float | None]


@contextlib.contextmanager
def deadline(ticket: Ticket, deadline_s: float) -> Iterator[Left]:
    """Keep the deadline of one request from here to the end of the block.

    Args:
        ticket: of the request.
        deadline_s: from now [s]; 0: none.
    """
    if deadline_s <= 0.0:
        yield lambda: None
        return
    began_s = time.monotonic()
    late = Answer(Status.TIMED_OUT, f"the deadline of {deadline_s:.2f} s passed before a motion was certified")
    with answered_after(deadline_s + _GRACE_S, ticket, late):
        yield lambda: max(began_s + deadline_s - time.monotonic(), 0.0)


@contextlib.contextmanager
def answered_after(seconds: float, ticket: Ticket, answer: Answer) -> Iterator[None]:
    """Take a request away from a job that is still at work on it after a time, whatever it is doing.

    Args:
        seconds: from now; the block's end calls it off.
        ticket: of the job.
        answer: what the caller is told.
    """
    timer = threading.Timer(seconds, ticket.take_away, (answer,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
