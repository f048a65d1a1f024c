"""Sending and watching motions, with a played arm."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from execution_rig import Rig, refusal_of, rested, snapshot  # noqa: F401  (a fixture)
from ros_fakes import JOINTS, START, result

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.ros.execution.motion import Motion
from lime_planner.ros.execution.stem_watch import StemWatch

pytestmark = pytest.mark.alone


def test_a_motion_that_is_followed_succeeds(rig: Rig) -> None:
    motion = rig.send()
    assert motion is not None
    assert rig.execution.active
    rig.play(lambda t: motion.trajectory.sample(max(t - 0.03, 0.0)), 0.5)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED]
    assert not rig.execution.active
    assert len(rig.sent) == 1
    assert rig.execution.last is motion


def test_nothing_is_sent_when_it_must_not_be(rig: Rig) -> None:
    assert refusal_of(lambda: rig.send(motion_enabled=False))[0] is Status.MOTION_DISABLED
    rig.subscribers = 0
    assert refusal_of(rig.send)[0] is Status.NO_CONTROLLER
    rig.subscribers = 1
    assert rig.send(commit=lambda: False) is None
    rig.state(START + np.array([0.0, 0.02, 0.0]))
    status, sentence = refusal_of(rig.send)
    assert status is Status.ARM_MOVING
    assert "j2 is 0.020 rad" in sentence
    rig.state(START + np.array([0.0, 2 * np.pi, 0.0]))
    assert refusal_of(rig.send)[0] is Status.ARM_MOVING, "a turn away is not the same place"
    rig.state(START)
    time.sleep(0.12)
    assert refusal_of(lambda: rig.send(max_joint_state_age_s=0.1))[0] is Status.STALE_INPUT
    assert not rig.sent
    rig.state(START)
    assert rig.send() is not None
    assert refusal_of(rig.send)[0] is Status.ARM_MOVING
    rig.execution.stop(Status.CANCELLED, "stop")
    assert refusal_of(rig.send)[0] is Status.ARM_MOVING
    assert len(rig.sent) == 2


def test_a_stall_is_a_deviation(rig: Rig) -> None:
    motion = rig.send(0.4, execution_tolerance_rad=0.05)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(min(t, 0.12)), 0.5)
    assert rig.stopped == [motion]
    assert len(rig.sent[1]) == 1, "one point, for the arm is not where the plan has it"
    assert rig.ended[0].status is Status.EXECUTION_DEVIATED
    assert "the limit is 0.05 rad" in rig.ended[0].sentence


def test_stopping_short_of_the_end_is_a_deviation(rig: Rig) -> None:
    motion = rig.send(0.2)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t) - 0.2 * (motion.trajectory.sample(t) - START), 0.7)
    assert rig.ended[0].status is Status.EXECUTION_DEVIATED
    assert "0.040 rad from its last point" in rig.ended[0].sentence


def test_silence_stops_the_motion(rig: Rig) -> None:
    motion = rig.send(2.0, max_joint_state_age_s=0.15)
    assert motion is not None
    rig.play(motion.trajectory.sample, 0.2)
    silent_from = time.monotonic()
    while not rig.stopped and time.monotonic() < silent_from + 2.0:
        rig.execution.tick()
        time.sleep(0.005)
    assert 0.45 < time.monotonic() - silent_from < 1.0
    assert rig.stopped == [motion]
    rig.rest(rig.sent[1].positions[-1], 0.15)
    assert rig.ended[0].status is Status.STALE_INPUT
    assert "silent" in rig.ended[0].sentence


@pytest.mark.parametrize("pace", [0.5, 1.5])
def test_a_motion_may_go_by_simulated_time(rig: Rig, pace: float) -> None:
    rig.simulated = lambda: 1000.0 + pace * time.monotonic()
    motion = rig.send(1.0, execution_tolerance_rad=0.02)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(pace * t), 1.2 / pace)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED]
    assert len(rig.sent) == 1


@pytest.mark.parametrize("clock", [lambda: 0.0, lambda: -time.monotonic(), lambda: 2.0 * time.monotonic()])
def test_a_motion_may_go_by_real_time_whatever_the_simulated_clock_does(rig: Rig, clock: Callable[[], float]) -> None:
    rig.simulated = clock
    motion = rig.send(1.0, execution_tolerance_rad=0.02)
    assert motion is not None
    rig.play(motion.trajectory.sample, 1.2)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED]
    rig.rest(motion.trajectory.positions[-1])
    back = result(motion.trajectory.positions[-1], START, 1.0)
    assert rig.execution.send(8, back, back.trajectory, snapshot(execution_tolerance_rad=0.02), lambda: True) is not None
    rig.play(lambda t: back.trajectory.sample(min(t, 0.3)), 1.6)  # it stalls
    assert rig.ended[-1].status is Status.EXECUTION_DEVIATED


def test_the_watch_stops_for_stems_only_while_something_runs(rig: Rig) -> None:
    answers: list[object] = [Refusal(Status.TF_ERROR, "no transform"), ZeroDivisionError("oops"), None, "a stem stands there"]
    warned: list[str] = []
    looked = threading.Semaphore(0)

    def look(motion: Motion, should_stop: Callable[[], bool]) -> str | None:
        answer = answers.pop(0)
        looked.release()
        if isinstance(answer, Exception):
            raise answer
        return answer  # type: ignore[return-value]

    watch = StemWatch(rig.execution, look, warned.append)
    watch.notice()
    time.sleep(0.05)
    assert len(answers) == 4, "nothing runs"
    rig.rest(START)
    motion = rig.send(2.0)
    for _ in range(4):
        assert not rig.stopped
        watch.notice()
        assert looked.acquire(timeout=1.0)
        time.sleep(0.03)
    assert rig.stopped == [motion]
    rig.rest(rig.sent[1].positions[-1], 0.15)
    assert (rig.ended[0].status, rig.ended[0].sentence) == (Status.STEM_APPEARED, "a stem stands there")
    assert "no transform" in warned[0]
    assert "oops" in warned[1]
    assert watch.close()
    assert JOINTS
