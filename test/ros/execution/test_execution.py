"""Sending and watching motions, with a played arm."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from execution_rig import Rig, real_sleep, refusal_of, rested, snapshot  # noqa: F401  (a fixture)
from ros_fakes import JOINTS, START, result, trajectory

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros.execution.motion import Motion
from lime_planner.ros.execution.stem_watch import StemWatch


def test_a_motion_that_is_followed_succeeds(rig: Rig) -> None:
    motion = rig.send()
    assert motion is not None
    assert rig.execution.active
    rig.play(lambda t: motion.trajectory.sample(max(t - 0.03, 0.0)), 0.5)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED], rig.ended[0].sentence
    assert not rig.execution.active
    assert len(rig.sent) == 1


def test_nothing_is_sent_when_it_must_not_be(rig: Rig) -> None:
    assert refusal_of(lambda: rig.send(motion_enabled=False))[0] is Status.MOTION_DISABLED
    rig.output.listeners = 0
    assert refusal_of(rig.send)[0] is Status.NO_CONTROLLER
    rig.output.listeners = 1
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


def test_an_arm_that_leaves_its_path_is_stopped(rig: Rig) -> None:
    motion = rig.send(0.4, execution_tolerance_rad=0.05)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t) + np.array([0.0, 0.3 * t, 0.0]), 0.4)
    assert rig.stopped == [motion]
    assert len(rig.sent[1]) == 1, "one point, for the arm is not where the plan has it"
    rig.rest(rig.sent[1].positions[-1], 0.15)
    assert rig.ended[0].status is Status.EXECUTION_DEVIATED
    assert "j2 is 0.0" in rig.ended[0].sentence and "from the path" in rig.ended[0].sentence
    assert "the limit is 0.05 rad" in rig.ended[0].sentence


@pytest.mark.parametrize("at_s", [0.0, 0.12, 0.24])
def test_an_arm_that_does_not_come_on_is_stopped_after_a_while(rig: Rig, at_s: float) -> None:
    motion = rig.send(0.4, execution_tolerance_rad=0.02, progress_timeout_s=0.4, goal_time_s=0.4)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(min(t, at_s)), at_s + 0.35)
    assert rig.execution.motion is motion, "a pause is normal"
    rig.play(lambda t: motion.trajectory.sample(at_s), 0.4)
    assert rig.stopped == [motion]
    assert rig.ended[0].status is Status.EXECUTION_DEVIATED
    assert "has not come on along its path for 0.4" in rig.ended[0].sentence


def pausing(t: float) -> float:
    return t if t < 0.2 else max(0.2, t - 0.5)


def uneven(t: float) -> float:
    return 0.5 * t if t < 0.3 else 0.15 + 0.1 * (t - 0.3) if t < 1.3 else 0.25 + 1.5 * (t - 1.3)


@pytest.mark.parametrize(
    "clock",
    [lambda t: 0.5 * t, lambda t: 0.1 * t, lambda t: max(t - 0.4, 0.0), pausing, uneven],
    ids=["half", "tenth", "late", "paused", "uneven"],
)
@pytest.mark.parametrize("noise_rad", [0.0, 0.0005])
def test_how_fast_the_path_is_followed_does_not_matter(rig: Rig, clock: Callable[[float], float], noise_rad: float) -> None:
    motion = rig.send(0.6, execution_tolerance_rad=0.01, progress_timeout_s=0.6, goal_time_s=0.6, stillness_rad=0.006)
    assert motion is not None
    rng, began_s, seen = np.random.default_rng(0), time.monotonic(), []
    while not rig.ended and time.monotonic() - began_s < 10.0:
        t = time.monotonic() - began_s
        rig.state(motion.trajectory.sample(clock(t)) + noise_rad * rng.standard_normal(3))
        seen.append((clock(t), rig.execution.reached_s(motion)))
        time.sleep(0.02)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED], rig.ended[0].sentence
    assert len(rig.sent) == 1
    assert clock(time.monotonic() - began_s) > 0.59, "the end is waited for"
    inside = np.array([pair for pair in seen if 0.1 < pair[0] < 0.5])
    assert np.abs(inside[:, 0] - inside[:, 1]).max() < 0.05


def test_a_path_that_passes_a_place_twice_is_followed_once_round(rig: Rig) -> None:
    """There and back: the arm is at the goal when it has been away, not when it begins."""
    there, back = trajectory(START, START + 0.3, 0.4), trajectory(START + 0.3, START, 0.4)
    both = Trajectory(
        JOINTS, 0.02, np.concatenate([there.positions, back.positions[1:]]), np.concatenate([there.velocities, back.velocities[1:]])
    )
    plan = dataclasses.replace(result(START, START), trajectory=both)
    motion = rig.execution.send(7, plan, both, snapshot(execution_tolerance_rad=0.02, progress_timeout_s=3.0), lambda: True)
    assert motion is not None
    rig.play(lambda t: START, 1.5)
    assert not rig.ended, "it has not even begun"
    rig.play(lambda t: both.sample(0.5 * t), 2.5)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED], rig.ended[0].sentence


def test_stopping_short_of_the_end_is_a_deviation(rig: Rig) -> None:
    motion = rig.send(0.2, goal_time_s=0.3, progress_timeout_s=2.0)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t) - 0.2 * (motion.trajectory.sample(t) - START), 0.9)
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
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED], rig.ended[0].sentence
    assert len(rig.sent) == 1


@pytest.mark.parametrize("clock", [lambda: 0.0, lambda: -time.monotonic(), lambda: 2.0 * time.monotonic()])
def test_a_motion_may_go_by_real_time_whatever_the_simulated_clock_does(rig: Rig, clock: Callable[[], float]) -> None:
    rig.simulated = clock
    motion = rig.send(1.0, execution_tolerance_rad=0.02)
    assert motion is not None
    rig.play(motion.trajectory.sample, 1.2)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED], rig.ended[0].sentence
    rig.rest(motion.trajectory.positions[-1])
    back = result(motion.trajectory.positions[-1], START, 1.0)
    assert rig.execution.send(8, back, back.trajectory, snapshot(execution_tolerance_rad=0.02), lambda: True) is not None
    rig.play(lambda t: back.trajectory.sample(min(t, 0.3)), 8.0)  # it stalls
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
    real_sleep(0.05)
    assert len(answers) == 4, "nothing runs"
    rig.rest(START)
    motion = rig.send(2.0)
    for _ in range(4):
        assert not rig.stopped
        watch.notice()
        assert looked.acquire(timeout=1.0)
        real_sleep(0.05)
    assert rig.stopped == [motion]
    rig.rest(rig.sent[1].positions[-1], 0.15)
    assert (rig.ended[0].status, rig.ended[0].sentence) == (Status.STEM_APPEARED, "a stem stands there")
    assert "no transform" in warned[0]
    assert "oops" in warned[1]
    assert watch.close()
    assert JOINTS
