"""Sending, watching and stopping motions, with a played arm."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from ros_fakes import JOINTS, START, FakeRobot, result, trajectory
from scipy.signal import lfilter

from lime_planner.motion.command import Command, judge_jtc
from lime_planner.motion.jtc import JtcLaw
from lime_planner.motion.progress import best_fit
from lime_planner.motion.timing import time_path
from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros.execution import Execution
from lime_planner.ros.joints import ArmState, JointHistory
from lime_planner.ros.motions import Ended, Motion
from lime_planner.ros.params import Snapshot, snapshot_from
from lime_planner.ros.refusal import Refusal
from lime_planner.ros.stops import make_stop
from lime_planner.ros.watch import StemWatch
from lime_planner.status import Status

pytestmark = pytest.mark.alone

QUICK = {"stillness_time_s": 0.06, "goal_time_s": 0.3, "stillness_timeout_s": 0.5, "execution_lag_s": 0.1}


class Rig:
    """An execution with everything around it played."""

    def __init__(self) -> None:
        self.joints = JointHistory()
        self.sent: list[Trajectory] = []
        self.ended: list[Ended] = []
        self.stopped: list[Motion] = []
        self.subscribers = 1
        self.allowed = True
        self.simulated: Callable[[], float | None] = lambda: None
        self.execution = Execution(
            self.joints,
            lambda trajectory: trajectory,
            self.sent.append,
            lambda: self.subscribers,
            lambda motion, state, on_path: make_stop(FakeRobot(), motion, state, on_path),
            self.stopped.append,
            self.ended.append,
            lambda: self.allowed,
            lambda: self.simulated(),
        )

    def state(self, q: np.ndarray) -> None:
        state = ArmState(np.array(q, dtype=float), time.monotonic(), 0.0, 0.0)
        self.joints.add(state)
        self.execution.on_state(state)
        self.execution.tick()

    def rest(self, q: np.ndarray, duration_s: float = 0.08) -> None:
        self.play(lambda t: q, duration_s)

    def play(self, q_of: Callable[[float], np.ndarray], duration_s: float) -> None:
        began = time.monotonic()
        while time.monotonic() - began < duration_s:
            self.state(q_of(time.monotonic() - began))
            time.sleep(0.005)

    def send(self, duration_s: float = 0.3, commit: Callable[[], bool] = lambda: True, **settings: object) -> Motion | None:
        plan = result(START, START + 0.2, duration_s)
        return self.execution.send(7, plan, plan.trajectory, snapshot(**settings), commit)


def snapshot(**settings: object) -> Snapshot:
    return snapshot_from({**QUICK, **settings})


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.rest(START)
    return rig


def refusal_of(call: Callable[[], object]) -> tuple[Status, str]:
    with pytest.raises(Refusal) as caught:
        call()
    return caught.value.status, str(caught.value)


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


@pytest.mark.parametrize("controller", ["jtc", "kinova"])
def test_a_stop_is_on_the_wire_at_once_and_ends_at_rest(rig: Rig, controller: str) -> None:
    motion = rig.send(1.0, controller=controller)
    assert motion is not None
    rig.play(motion.trajectory.sample, 0.4)
    began = time.monotonic()
    assert rig.execution.stop(Status.CANCELLED, "stopped")
    assert time.monotonic() - began < 0.05
    assert rig.stopped == [motion]
    stop = rig.sent[1]
    assert not stop.velocities[-1].any()
    if controller == "kinova":
        assert (len(stop), stop.duration_s) == (1, 0.2)
        assert np.allclose(stop.positions[0], motion.trajectory.sample(0.4), atol=0.02)
    else:
        assert len(stop) > 3
        assert stop.positions[0] == pytest.approx(motion.trajectory.sample(0.42), abs=0.01)
    assert rig.execution.stopping
    assert not rig.ended
    rig.rest(stop.positions[-1], 0.15)
    assert [(ended.status, ended.sentence) for ended in rig.ended] == [(Status.CANCELLED, "stopped")]
    assert not rig.execution.stop(Status.CANCELLED, "again")
    assert len(rig.sent) == 2


def test_an_arm_that_does_not_rest_after_a_stop_is_told(rig: Rig) -> None:
    motion = rig.send(1.0)
    assert motion is not None
    rig.execution.stop(Status.CANCELLED, "stopped")
    rig.play(lambda t: START + t, 0.6)
    assert "could not be seen to rest" in rig.ended[0].sentence


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


def test_who_stops_an_arm_that_is_being_stopped_wants_it_to_stay(rig: Rig) -> None:
    motion = rig.send()
    assert motion is not None and rig.execution.ending is None
    rig.execution.stop(Status.STEM_APPEARED, "a twig")
    assert rig.execution.ending is motion
    cancels = rig.execution.cancels
    assert rig.execution.stop(Status.STEM_APPEARED, "another twig")
    assert rig.execution.cancels == cancels
    assert rig.execution.stop(Status.CANCELLED, "by hand")
    rig.rest(rig.joints.newest.q, 0.15)
    assert [(ended.status, ended.sentence) for ended in rig.ended] == [(Status.CANCELLED, "by hand")]
    assert rig.ended[0].cancels == rig.execution.cancels == cancels + 1
    assert len(rig.sent) == 2  # one motion, one stop


def test_a_motion_of_unknown_origin_is_held_on_request_only(rig: Rig) -> None:
    assert not rig.execution.hold_foreign_motion(snapshot())
    rig.play(lambda t: START + 0.5 * t, 0.1)
    assert "no hold was sent, because motion_enabled is false" in rig.execution.hold_foreign_motion(snapshot(motion_enabled=False))
    assert not rig.sent
    assert rig.execution.hold_foreign_motion(snapshot()) == "the arm moved, but not by this node: a hold was sent"
    assert len(rig.sent[0]) == 1


def test_the_best_fit_is_looked_for_where_the_arm_may_be() -> None:
    planned = trajectory(np.zeros(3), np.array([1.0, 0.5, 0.0]), 1.0)
    moment_s, off = best_fit(planned, planned.sample(0.3), 0.2, 0.5)
    assert moment_s == pytest.approx(0.3, abs=0.003) and np.abs(off).max() < 0.005
    moment_s, off = best_fit(planned, planned.sample(0.5) + np.array([0.0, 0.2, 0.0]), 0.5, 0.5)
    assert moment_s == 0.5 and off == pytest.approx([0.0, 0.2, 0.0])
    assert best_fit(planned, planned.sample(0.0), -0.4, -0.1)[0] == 0.0
    assert best_fit(planned, planned.sample(0.9), 0.0, 1e9)[0] == pytest.approx(0.9, abs=0.003)


def test_braking_begins_where_the_arm_is_not_where_the_clock_has_it(rig: Rig) -> None:
    motion = rig.send(2.0, controller="jtc", execution_lag_s=0.4)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(max(t - 0.3, 0.0)), 0.9)  # a controller at a lower speed, by now 0.3 s late
    assert rig.execution.reached_s(motion) == pytest.approx(0.6, abs=0.04)
    there, then_s = rig.joints.newest.q, motion.elapsed_s() - 0.3
    rig.execution.stop(Status.CANCELLED, "stopped")
    stop = rig.sent[1]
    speed = motion.trajectory.sample_velocity(then_s)
    assert len(stop) > 3
    assert np.abs((stop.positions[0] - there) / stop.first_time_s - speed).max() < 0.5 * np.abs(speed).max()
    assert np.abs(stop.positions[0] - motion.trajectory.sample(then_s + stop.first_time_s)).max() < 0.01


@pytest.mark.parametrize(("pace", "lag_s"), [(1.0, 0.0), (0.95, 0.0), (0.9, 0.0), (0.85, 0.0), (1.0, 0.05), (1.0, 0.1), (0.95, 0.1)])
def test_a_stop_asks_no_speed_of_the_arm_that_it_has_not(pace: float, lag_s: float) -> None:
    """What a joint trajectory controller makes of the stop, at a lower pace, and with an arm that follows it late."""
    velocities, accelerations = np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0]), np.full(6, 1.0)
    names = tuple(f"joint_{i}" for i in range(1, 7))
    plan = time_path(np.array([[0.0] * 6, [3.0, 1.0, -1.0, 1.0, 0.5, 1.0]]), velocities, accelerations, joint_names=names)
    robot = SimpleNamespace(joint_names=names, velocity_limits=velocities, acceleration_limits=accelerations)
    step_s = 0.001
    for at_s in (0.3, 1.0, 2.5, 3.5, 4.5):
        moments = np.arange(0.0, at_s, step_s)
        wanted = plan.sample(pace * moments)
        q = np.array(wanted) if lag_s == 0.0 else lfilter([step_s / lag_s], [1.0, step_s / lag_s - 1.0], wanted, axis=0)
        speed = (q[-1] - q[-2]) / step_s
        motion = Motion(1, None, plan, time.monotonic() - at_s, snapshot_from({"controller": "jtc"}))
        stop = make_stop(robot, motion, ArmState(q[-1], time.monotonic(), 0.0, 0.0), True)
        assert stop is not None
        command = Command.from_trajectory(stop)
        assert judge_jtc(command, names, q[-1].tolist()).accepted
        law = JtcLaw(command, names, q[-1], speed, np.zeros(6, dtype=bool))
        played = np.array([law.sample(t) for t in np.arange(0.0, law.duration_s, step_s)])
        fastest = np.abs(np.diff(played, axis=0) / step_s).max(axis=0)
        assert (fastest <= 1.2 * velocities).all(), f"stopped at {at_s} s: {fastest / velocities}"


def test_an_arm_beside_its_path_is_led_back_before_it_brakes_or_held(rig: Rig) -> None:
    beside = np.array([0.03, 0.0, 0.0])
    motion = rig.send(2.0, controller="jtc")
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t) + beside, 0.5)
    rig.execution.stop(Status.CANCELLED, "stopped")
    stop = rig.sent[1]
    assert stop.first_time_s == pytest.approx(0.06)  # 0.03 rad at half of 1 rad/s
    assert np.abs(stop.positions[0] - motion.trajectory.sample(0.56)).max() < 0.01
    rig.rest(stop.positions[-1], 0.15)
    far = np.array([0.08, 0.0, 0.0])
    rig.rest(START)
    motion = rig.send(2.0, controller="jtc")
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t) + far, 0.5)
    rig.execution.stop(Status.CANCELLED, "stopped")
    stop = rig.sent[3]
    assert len(stop) == 1 and not stop.velocities.any()
    assert np.abs(stop.positions[0] - motion.trajectory.sample(0.5) - far).max() < 0.01


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


def test_stopping_again_holds_an_arm_that_goes_on(rig: Rig) -> None:
    motion = rig.send(2.0, controller="kinova")
    assert motion is not None
    rig.play(motion.trajectory.sample, 0.4)
    assert rig.execution.stop(Status.CANCELLED, "stopped")
    assert rig.execution.stop(Status.CANCELLED, "stopped"), "the first one needs its time"
    assert len(rig.sent) == 2
    rig.play(lambda t: motion.trajectory.sample(0.4 + t), 0.4)
    assert rig.execution.stop(Status.CANCELLED, "stopped")
    assert len(rig.sent) == 3 and len(rig.sent[2]) == 1
    assert np.abs(rig.sent[2].positions[0] - rig.joints.newest.q).max() < 1e-9
    rig.play(lambda t: motion.trajectory.sample(0.8 + t), 0.4)
    assert "could not be seen to rest" in rig.ended[0].sentence
    # It is ours still: it may be held although motions are forbidden by now.
    said = rig.execution.hold_foreign_motion(snapshot(motion_enabled=False))
    assert said == "the arm has not come to rest since plan 7: a hold was sent"
    assert len(rig.sent) == 4
    rig.rest(START)
    rig.play(lambda t: START + 0.5 * t, 0.1)  # somebody else's
    assert "no hold was sent" in rig.execution.hold_foreign_motion(snapshot(motion_enabled=False))


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
