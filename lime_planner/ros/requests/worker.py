"""One thread that works on one request at a time, the newest; every request is answered exactly once.

A request is a `Ticket`. It is answered by the job itself, or earlier by the request that takes its place (PREEMPTED) or stops it
(CANCELLED): at once, without waiting until the job notices. What a job still does after that is lost, and it cannot move the arm,
because it must `commit` first, and a ticket that is answered does not commit. A deadline answers from outside too: a job may be where
it cannot look at the clock, in a cloud of millions of points, say.
"""

from __future__ import annotations

import contextlib
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.ros.inputs.latest import Target

#: How long after its deadline a request is given up for a job that has not noticed by itself [s].
_GRACE_S = 0.02

#: Time left until the deadline [s]; None without one.
Left = Callable[[], float | None]


@dataclass(frozen=True)
class Answer:
    """What a request ended with.

    Attributes:
        status: its code.
        sentence: one sentence.
        tool_path: the plan's, (K, 7) x y z qx qy qz qw, where there is one.
        moves: whether a motion was sent.
    """

    status: Status
    sentence: str
    tool_path: Array | None = None
    moves: bool = False

    @property
    def message(self) -> str:
        """`CODE: sentence`."""
        return self.status.message(self.sentence)


@dataclass(frozen=True)
class RequestContext:
    """What is known about a request besides its kind.

    Attributes:
        target: what it is about, as far as that is known yet.
        replans_left: how often its motion may be planned again if it is aborted; None for as often as the parameters say.
    """

    target: Target | None = None
    replans_left: int | None = None


@dataclass
class Ticket:
    """One request on its way.

    Attributes:
        plan_id: its number, counted from 1.
        kind: `plan`, `preview`, `execute`, ...
        on_answer: called once, with the ticket and its answer, from whichever thread answers.
        context: what is known about it; the job replaces it as it finds out more.
    """

    plan_id: int
    kind: str
    on_answer: Callable[[Ticket, Answer], None]
    context: RequestContext = RequestContext()
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _answer: Answer | None = None
    _committed: bool = False

    @property
    def answered(self) -> bool:
        """Whether the answer is given; the `should_stop` of the job."""
        return self._answer is not None

    @property
    def given(self) -> Answer | None:
        """The answer, as soon as there is one."""
        return self._answer

    def is_open(self) -> bool:
        """Tell whether the request still has no answer: then a motion may be sent on its way to the one that it is about."""
        with self._lock:
            return self._answer is None

    def should_stop(self) -> bool:
        """Tell the job that its answer is not waited for any more."""
        return self._answer is not None

    def commit(self) -> bool:
        """Pass the point of no return: from here on only the job itself can answer. False if it is answered already."""
        with self._lock:
            if self._answer is None:
                self._committed = True
            return self._committed

    def answer(self, answer: Answer) -> bool:
        """Answer, unless it is answered; tell whether this was the answer."""
        with self._lock:
            if self._answer is not None:
                return False
            self._answer = answer
        self.on_answer(self, answer)
        return True

    def take_away(self, answer: Answer) -> bool:
        """Answer from outside, unless the job is past the point of no return."""
        with self._lock:
            if self._committed or self._answer is not None:
                return False
            self._answer = answer
        self.on_answer(self, answer)
        return True


class Worker:
    """The thread, its one waiting place, and the request in work."""

    def __init__(self, on_defect: Callable[[str], None], tidy: Callable[[], None] = lambda: None) -> None:
        """Start the thread.

        Args:
            on_defect: is given the traceback of an exception that a job should not have raised.
            tidy: is called in the worker's thread after each job, when its caller has the answer; must not raise.
        """
        self._on_defect = on_defect
        self._tidy = tidy
        self._condition = threading.Condition()
        self._submitting = threading.Lock()  # one submitter at a time: no request is overwritten unanswered
        self._waiting: tuple[Ticket, Callable[[Ticket], Answer]] | None = None
        self._current: Ticket | None = None
        self._newest: Ticket | None = None
        self._count = 0
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="planning", daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether a job runs or waits."""
        with self._condition:
            return self._current is not None or self._waiting is not None

    @property
    def current(self) -> Ticket | None:
        """The request in work."""
        return self._current

    @property
    def newest(self) -> Ticket | None:
        """The request that came last, answered or not."""
        return self._newest

    def submit(
        self,
        kind: str,
        job: Callable[[Ticket], Answer],
        on_answer: Callable[[Ticket, Answer], None],
        context: RequestContext | None = None,
    ) -> Ticket:
        """Hand in a request; it takes the place of every older one.

        Args:
            kind: its name.
            job: does the work in the worker's thread; its return value is the answer. A `Refusal` it raises is one too.
            on_answer: see `Ticket`.
            context: what is known about it before the job begins.
        """
        with self._submitting:
            self._count += 1
            ticket = self._newest = Ticket(self._count, kind, on_answer, context or RequestContext())
            preempted = Answer(Status.PREEMPTED, f"request {ticket.plan_id} ({kind}) took over")
            for other in self._older():
                other.take_away(preempted)
            with self._condition:
                closed = self._closed
                if not closed:
                    self._waiting = (ticket, job)
                    self._condition.notify_all()
        if closed:
            ticket.answer(Answer(Status.NOT_READY, "the node is shutting down"))
        return ticket

    def cancel(self, sentence: str) -> int:
        """Answer everything waiting or in work with CANCELLED; return how many there were."""
        with self._submitting:
            older = self._older()
            with self._condition:
                self._waiting = None
        return sum(ticket.take_away(Answer(Status.CANCELLED, sentence)) for ticket in older)

    def wait_idle(self, timeout_s: float) -> bool:
        """Wait until no job runs or waits; False when it takes longer."""
        with self._condition:
            return self._condition.wait_for(lambda: self._current is None and self._waiting is None, timeout_s)

    def refuse(self) -> None:
        """Cancel what there is and take nothing more: from now on no request passes its point of no return."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self.cancel("the node is shutting down")

    def close(self, timeout_s: float = 2.0) -> bool:
        """Cancel what there is and end the thread; False if it does not end in time."""
        self.refuse()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _older(self) -> list[Ticket]:
        with self._condition:
            waiting = [self._waiting[0]] if self._waiting is not None else []
            return ([self._current] if self._current is not None else []) + waiting

    def _run(self) -> None:
        while True:
            with self._condition:
                self._current = None
                self._condition.notify_all()
                self._condition.wait_for(lambda: self._waiting is not None or self._closed)
                if self._waiting is None:
                    return
                (ticket, job), self._waiting = self._waiting, None
                self._current = ticket
            if not ticket.answered:
                ticket.answer(self._work(ticket, job))
                del job  # and with it what it holds of its scene
                self._tidy()

    def _work(self, ticket: Ticket, job: Callable[[Ticket], Answer]) -> Answer:
        try:
            return job(ticket)
        except Refusal as refusal:
            return Answer(refusal.status, str(refusal))
        except Exception as error:  # whatever it is, the caller gets an answer and the next request is served
            self._on_defect(traceback.format_exc())
            return Answer(Status.INTERNAL_ERROR, f"{type(error).__name__}: {error}")


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
