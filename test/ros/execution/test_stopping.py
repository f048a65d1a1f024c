"""Stops: at once, from where the arm is, and again where it goes on, with a played arm."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest
from execution_rig import Rig, rested, snapshot  # noqa: F401  (a fixture)
from ros_fakes import START, trajectory
from scipy.signal import lfilter

from lime_planner.core.status import Status
from lime_planner.motion.controllers.command import Command, judge_jtc
from lime_planner.motion.controllers.joint_trajectory_controller import JtcLaw
from lime_planner.motion.progress import best_fit
from lime_planner.motion.timing import time_path
from lime_planner.ros.execution.motion import Motion
from lime_planner.ros.execution.stopping import make_stop
from lime_planner.ros.inputs.joint_states import ArmState
from lime_planner.ros.parameters import snapshot_from

FREE = {"lower": np.full(6, -np.inf), "upper": np.full(6, np.inf)}


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
        assert len(stop) >= 1
        assert stop.first_time_s > 0.08, "the controller is left the time to blend"
        assert np.abs(stop.positions[0] - motion.trajectory.sample(0.4 + stop.first_time_s)).max() < 0.03
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
    motion = rig.send(2.0, controller="jtc")
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(max(t - 0.3, 0.0)), 0.9)  # a controller at a lower speed, by now 0.3 s late
    assert rig.execution.reached_s(motion) == pytest.approx(0.6, abs=0.04)
    there, then_s = rig.joints.newest.q, motion.elapsed_s() - 0.3
    rig.execution.stop(Status.CANCELLED, "stopped")
    stop = rig.sent[1]
    speed = motion.trajectory.sample_velocity(then_s)
    gone = (stop.positions[0] - there) / stop.first_time_s
    assert (np.abs(gone) < 1.1 * np.abs(speed)).all() and (gone * speed > 0.3 * speed**2).all()


@pytest.mark.parametrize(("pace", "lag_s"), [(1.0, 0.0), (0.95, 0.0), (0.9, 0.0), (0.85, 0.0), (1.0, 0.05), (1.0, 0.1), (0.95, 0.1)])
def test_a_stop_asks_no_speed_of_the_arm_that_it_has_not(monkeypatch: pytest.MonkeyPatch, pace: float, lag_s: float) -> None:
    """What a joint trajectory controller makes of the stop, at a lower pace, and with an arm that follows it late."""
    now_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    velocities, accelerations = np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0]), np.full(6, 1.0)
    names = tuple(f"joint_{i}" for i in range(1, 7))
    plan = time_path(np.array([[0.0] * 6, [3.0, 1.0, -1.0, 1.0, 0.5, 1.0]]), velocities, accelerations, joint_names=names)
    robot = SimpleNamespace(joint_names=names, velocity_limits=velocities, acceleration_limits=accelerations, **FREE)
    step_s = 0.001
    for at_s in (0.3, 1.0, 2.5, 3.5, 4.5):
        moments = np.arange(0.0, at_s, step_s)
        wanted = plan.sample(pace * moments)
        q = np.array(wanted) if lag_s == 0.0 else lfilter([step_s / lag_s], [1.0, step_s / lag_s - 1.0], wanted, axis=0)
        speed = (q[-1] - q[-2]) / step_s
        motion = Motion(1, None, plan, now_s - at_s, snapshot_from({"controller": "jtc"}))
        stop = make_stop(robot, motion, ArmState(q[-1], now_s, 0.0, 0.0), True, "jtc")
        assert stop is not None
        command = Command.from_trajectory(stop)
        assert judge_jtc(command, names, q[-1].tolist()).accepted
        law = JtcLaw(command, names, q[-1], speed, np.zeros(6, dtype=bool))
        played = np.array([law.sample(t) for t in np.arange(0.0, law.duration_s, step_s)])
        fastest = np.abs(np.diff(played, axis=0) / step_s).max(axis=0)
        assert (fastest <= 1.2 * velocities).all(), f"stopped at {at_s} s: {fastest / velocities}"


def test_an_arm_beside_its_path_brakes_in_parallel_to_it(rig: Rig) -> None:
    beside = np.array([0.03, 0.0, 0.0])
    motion = rig.send(2.0, controller="jtc")
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t) + beside, 0.5)
    rig.execution.stop(Status.CANCELLED, "stopped")
    off = motion.follower.off
    for row in rig.sent[1].positions:
        assert np.abs(row - off - motion.trajectory.sample(np.linspace(0.4, 1.2, 801))).max(axis=1).min() < 1e-3


def test_an_arm_that_left_its_path_brakes_every_joint_by_itself(rig: Rig) -> None:
    motion = rig.send(2.0, controller="jtc", execution_tolerance_rad=0.05)
    assert motion is not None
    rig.play(lambda t: START + np.array([0.4 * t, 0.0, -0.2 * t]), 0.6)
    assert rig.stopped == [motion]
    stop = rig.sent[1]
    assert len(stop) == 1 and not stop.velocities.any()
    travelled = stop.positions[0] - START
    assert travelled[0] == pytest.approx(-2.0 * travelled[2], rel=0.05) and abs(travelled[1]) < 1e-9
    assert stop.first_time_s == pytest.approx(0.2)  # 0.4 rad/s at 2 rad/s²


def test_a_glitch_of_the_measurement_does_not_make_a_stop_go_far() -> None:
    names = tuple(f"joint_{i}" for i in range(1, 7))
    robot = SimpleNamespace(joint_names=names, velocity_limits=np.full(6, 0.6), acceleration_limits=np.full(6, 1.0), **FREE)
    wild = ArmState(np.zeros(6), time.monotonic(), 0.0, 0.0, np.array([50.0, -50.0, 0.1, 0.0, 0.0, 0.0]))
    hold = make_stop(robot, None, wild, False, "jtc")
    assert hold is not None and np.abs(hold.positions).max() < 0.25 and hold.duration_s == pytest.approx(0.6)
    robot.lower, robot.upper = np.full(6, -0.05), np.full(6, 0.05)
    hold = make_stop(robot, None, wild, False, "jtc")
    assert hold is not None and np.abs(hold.positions).max() <= 0.05
    assert make_stop(robot, None, wild, False, "kinova").positions[0].tolist() == [0.0] * 6  # type: ignore[union-attr]
    assert make_stop(None, None, wild, False, "jtc") is None and make_stop(robot, None, None, False, "jtc") is None


def test_stopping_again_holds_an_arm_that_goes_on(rig: Rig) -> None:
    motion = rig.send(2.0, controller="kinova")
    assert motion is not None
    rig.play(motion.trajectory.sample, 0.4)
    assert rig.execution.stop(Status.CANCELLED, "stopped")
    assert rig.execution.stop(Status.CANCELLED, "stopped"), "the first one needs its time"
    assert len(rig.sent) == 2
    rig.play(lambda t: motion.trajectory.sample(0.4 + t), 0.45)
    assert rig.execution.stop(Status.CANCELLED, "stopped")
    assert len(rig.sent) == 3 and len(rig.sent[2]) == 1
    assert np.abs(rig.sent[2].positions[0] - rig.joints.newest.q).max() < 1e-9
    rig.play(lambda t: motion.trajectory.sample(0.85 + t), 0.4)
    assert "could not be seen to rest" in rig.ended[0].sentence
    # It is ours still: it may be held although motions are forbidden by now.
    said = rig.execution.hold_foreign_motion(snapshot(motion_enabled=False))
    assert said == "the arm has not come to rest since plan 7: a hold was sent"
    assert len(rig.sent) == 4
    rig.rest(START)
    rig.play(lambda t: START + 0.5 * t, 0.1)  # somebody else's
    assert "no hold was sent" in rig.execution.hold_foreign_motion(snapshot(motion_enabled=False))
