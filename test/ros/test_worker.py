"""One request at a time, the newest; one answer each."""

from __future__ import annotations

import threading
import time
from collections import Counter

import pytest

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.ros.requests.worker import Answer, Ticket, Worker, answered_after

pytestmark = pytest.mark.timed

DONE = Answer(Status.SUCCEEDED, "done")


class Caller:
    """Collects answers with their times."""

    def __init__(self) -> None:
        self.answers: list[tuple[int, Answer, float]] = []
        self.condition = threading.Condition()

    def __call__(self, ticket: Ticket, answer: Answer) -> None:
        with self.condition:
            self.answers.append((ticket.plan_id, answer, time.monotonic()))
            self.condition.notify_all()

    def wait(self, count: int, timeout_s: float = 5.0) -> dict[int, Answer]:
        with self.condition:
            assert self.condition.wait_for(lambda: len(self.answers) >= count, timeout_s)
        return {plan_id: answer for plan_id, answer, _ in self.answers}


@pytest.fixture
def defects() -> list[str]:
    return []


@pytest.fixture
def worker(defects: list[str]):
    worker = Worker(defects.append)
    yield worker
    assert worker.close()


def deaf(_ticket: Ticket) -> Answer:
    time.sleep(0.3)
    return DONE


def test_the_newest_wins_at_once_even_over_a_deaf_job(worker: Worker) -> None:
    caller = Caller()
    worker.submit("plan", deaf, caller)
    time.sleep(0.05)
    began = time.monotonic()
    worker.submit("plan", lambda ticket: DONE, caller)
    answers = caller.wait(2)
    assert answers[1].status is Status.PREEMPTED
    assert answers[2].status is Status.SUCCEEDED
    assert caller.answers[0][2] - began < 0.05
    time.sleep(0.35)
    assert len(caller.answers) == 2


def test_stop_cancels_what_runs_and_what_waits(worker: Worker) -> None:
    caller = Caller()
    heard = threading.Event()

    def obedient(ticket: Ticket) -> Answer:
        while not ticket.should_stop():
            time.sleep(0.001)
        heard.set()
        return DONE

    worker.submit("plan", obedient, caller)
    time.sleep(0.02)
    assert worker.cancel("stopped") == 1
    assert caller.wait(1)[1].message == "CANCELLED: stopped"
    assert heard.wait(0.5)
    assert worker.wait_idle(0.5)
    assert worker.cancel("stopped") == 0


def test_a_committed_request_answers_for_itself(worker: Worker) -> None:
    caller = Caller()
    committed, go_on = threading.Event(), threading.Event()

    def sender(ticket: Ticket) -> Answer:
        assert ticket.commit()
        committed.set()
        go_on.wait(2.0)
        return DONE

    worker.submit("plan", sender, caller)
    assert committed.wait(2.0)
    assert worker.cancel("stopped") == 0
    worker.submit("plan", lambda ticket: DONE, caller)
    assert not caller.answers
    go_on.set()
    answers = caller.wait(2)
    assert answers[1].status is Status.SUCCEEDED
    assert answers[2].status is Status.SUCCEEDED


def test_an_answered_request_cannot_commit(worker: Worker) -> None:
    caller = Caller()
    outcome: list[bool] = []
    started = threading.Event()

    def late(ticket: Ticket) -> Answer:
        started.set()
        while not ticket.should_stop():
            time.sleep(0.001)
        outcome.append(ticket.commit())
        return DONE

    worker.submit("plan", late, caller)
    assert started.wait(2.0)
    worker.cancel("stopped")
    assert worker.wait_idle(1.0)
    assert outcome == [False]


def test_refusals_and_defects_are_answers(worker: Worker, defects: list[str]) -> None:
    caller = Caller()

    def refusing(_ticket: Ticket) -> Answer:
        raise Refusal(Status.NO_CLOUD, "nothing there")

    def failing(_ticket: Ticket) -> Answer:
        raise ZeroDivisionError("oops")

    worker.submit("plan", refusing, caller)
    caller.wait(1)
    assert not defects
    worker.submit("plan", failing, caller)
    answers = caller.wait(2)
    assert answers[1].message == "NO_CLOUD: nothing there"
    assert answers[2].message == "INTERNAL_ERROR: ZeroDivisionError: oops"
    assert "oops" in defects[0]
    worker.submit("plan", lambda ticket: DONE, caller)
    assert caller.wait(3)[3].status is Status.SUCCEEDED


def test_many_callers_from_many_threads_get_one_answer_each(worker: Worker) -> None:
    caller = Caller()

    def job(ticket: Ticket) -> Answer:
        deadline = time.monotonic() + 0.003
        while time.monotonic() < deadline and not ticket.should_stop():
            time.sleep(0.0005)
        return DONE

    def client() -> None:
        for k in range(50):
            worker.submit("plan", job, caller)
            if k % 10 == 9:
                worker.cancel("stopped")

    threads = [threading.Thread(target=client) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    answers = caller.wait(200)
    time.sleep(0.05)
    counts = Counter(plan_id for plan_id, _, _ in caller.answers)
    assert sorted(counts) == list(range(1, 201))
    assert set(counts.values()) == {1}
    assert {answer.status for answer in answers.values()} <= {Status.SUCCEEDED, Status.PREEMPTED, Status.CANCELLED}


def test_it_tidies_up_after_every_job_even_one_that_failed() -> None:
    seen: list[int] = []
    caller = Caller()
    worker = Worker(lambda trace: None, lambda: seen.append(len(caller.answers)))

    def broken(_ticket: Ticket) -> Answer:
        raise ZeroDivisionError

    for number, job in enumerate((lambda ticket: DONE, broken), start=1):
        worker.submit("plan", job, caller)
        caller.wait(number)
        assert worker.wait_idle(5.0)
    assert seen == [1, 2]  # each time the caller had its answer before
    assert worker.close()


def test_a_late_job_loses_its_request_even_if_it_does_not_look(worker: Worker) -> None:
    caller, late = Caller(), Answer(Status.TIMED_OUT, "too late")
    commits = []

    def job(ticket: Ticket) -> Answer:
        with answered_after(0.02, ticket, late):
            time.sleep(0.0 if ticket.plan_id == 2 else 0.3)
        commits.append(ticket.commit())
        time.sleep(0.1)  # long enough for a timer that was not called off
        return DONE

    worker.submit("plan", job, caller)
    began = time.monotonic()
    assert caller.wait(1)[1] == late
    assert time.monotonic() - began < 0.25
    assert worker.wait_idle(5.0)
    worker.submit("plan", job, caller)
    assert caller.wait(2)[2] is DONE
    assert commits == [False, True]  # what was taken away moves no arm


def test_from_a_refusal_on_nothing_is_committed() -> None:
    worker, caller = Worker(lambda trace: None), Caller()
    commits = []

    def deaf_sender(ticket: Ticket) -> Answer:
        time.sleep(0.1)
        commits.append(ticket.commit())
        return DONE

    worker.submit("plan", deaf_sender, caller)
    time.sleep(0.02)
    worker.refuse()
    assert caller.wait(1)[1].status is Status.CANCELLED
    worker.submit("plan", deaf_sender, caller)
    assert caller.wait(2)[2].status is Status.NOT_READY
    assert worker.close()
    assert commits == [False]


def test_closing_answers_everyone() -> None:
    worker, caller = Worker(lambda trace: None), Caller()

    def obedient(ticket: Ticket) -> Answer:
        while not ticket.should_stop():
            time.sleep(0.001)
        return DONE

    worker.submit("plan", obedient, caller)
    time.sleep(0.02)
    assert worker.close()
    worker.submit("plan", obedient, caller)
    answers = caller.wait(2)
    assert answers[1].status is Status.CANCELLED
    assert answers[2].status is Status.NOT_READY
