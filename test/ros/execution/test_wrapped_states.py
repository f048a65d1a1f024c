"""Drivers that report continuous joints within one turn: the history, the watch, stops, retreats and the mock arm."""

from __future__ import annotations

import dataclasses
import time
from types import SimpleNamespace

import numpy as np
import pytest
from execution_rig import Rig, rested, snapshot  # noqa: F401  (a fixture)
from ros_fakes import START, result

from lime_planner.core.status import Status
from lime_planner.motion.contract import stop_violations
from lime_planner.motion.controllers.command import Command
from lime_planner.motion.controllers.simulated_arm import Faults, SimulatedArm
from lime_planner.motion.stop import braking_reach, speeds_ahead
from lime_planner.motion.timing import time_path
from lime_planner.motion.way_back import way_back
from lime_planner.ros.execution.motion import Motion, on_turns_of
from lime_planner.ros.execution.retreat import nearest_turns
from lime_planner.ros.execution.stopping import make_stop
from lime_planner.ros.inputs.joint_states import ArmState, JointHistory
from lime_planner.ros.parameters import snapshot_from

TURN = 2.0 * np.pi
FREE = np.array([True, False, True])
LOWEST = {"within π": -np.pi, "from 0": 0.0, "downwards": -TURN}


def wrapped(q: np.ndarray, lowest: float, free: np.ndarray = FREE) -> np.ndarray:
    return np.where(free, (np.asarray(q) - lowest) % TURN + lowest, q)


def reported(q: np.ndarray, at_s: float) -> ArmState:
    return ArmState(np.array(q, dtype=float), at_s, 100.0 + at_s, 0.0)


@pytest.mark.parametrize("lowest", LOWEST.values(), ids=LOWEST)
@pytest.mark.parametrize("speed", [0.8, -0.8, 7.0])
def test_the_history_has_no_jumps(lowest: float, speed: float) -> None:
    history = JointHistory(FREE)
    true = [np.array([2.9, 2.9, -1.0]) + speed * t * np.array([1.0, 1.0, -3.0]) for t in np.arange(0.0, 4.0, 0.1)]
    for k, q in enumerate(true):
        stored = history.add(reported(wrapped(q, lowest), 0.1 * k))
        assert history.newest is stored
        turns = stored.q - q
        assert turns == pytest.approx(np.where(FREE, wrapped(true[0], lowest) - true[0], 0.0)), "on the turns of the first report"
    between = history.at(100.0 + 2.05)
    assert between - turns == pytest.approx(0.5 * (true[20] + true[21])), "interpolated through the crossing"  # type: ignore[operator]
    history.take_reported_turns()
    assert history.newest is not None and history.newest.q == pytest.approx(wrapped(true[-1], lowest))
    assert history.at(100.0 + 2.05) - history.newest.q == pytest.approx(0.5 * (true[20] + true[21]) - true[-1])  # type: ignore[operator]


def test_only_joints_without_an_end_are_unwrapped_and_another_arm_begins_anew() -> None:
    history = JointHistory()
    history.add(reported([3.1], 0.0))
    assert history.add(reported([-3.1], 0.1)).q.tolist() == [-3.1]
    history.clear([True])
    assert history.add(reported([-3.1], 0.2)).q.tolist() == [-3.1]
    assert history.add(reported([3.1], 0.3)).q == pytest.approx([3.1 - TURN])
    late = dataclasses.replace(reported([-3.0], 0.4), stamp_s=5.0)  # simulated time was set back: the turns still count
    assert history.add(late).q == pytest.approx([-3.0])
    assert history.add(dataclasses.replace(late, q=np.array([3.1]), stamp_s=5.1)).q == pytest.approx([3.1 - TURN])


def test_at_rest_on_the_edge_the_arm_rests() -> None:
    history, now_s, rng = JointHistory(FREE), time.monotonic(), np.random.default_rng(0)
    for k in range(30):
        q = np.array([np.pi, 1.0, -np.pi]) + rng.normal(scale=0.0005, size=3)
        history.add(ArmState(wrapped(q, -np.pi), now_s - 0.3 + 0.01 * k, 0.0, 0.0))
    assert history.still(0.25, 0.005)
    assert not history.moving(0.25, 0.005)
    assert np.ptp([state.q[0] for state in history._states]) < 0.005


@pytest.mark.parametrize("lowest", LOWEST.values(), ids=LOWEST)
def test_a_motion_is_followed_through_the_crossing(rig: Rig, lowest: float) -> None:
    start = np.where(FREE, 3.08, START)
    rig.joints.clear(FREE)
    rig.rest(wrapped(start, lowest))
    first = rig.joints.newest
    assert first is not None
    plan = result(first.q, first.q + 0.2, 0.4)
    assert rig.execution.send(7, plan, plan.trajectory, snapshot(execution_tolerance_rad=0.05), lambda: True) is not None
    rig.play(lambda t: wrapped(plan.trajectory.sample(t), lowest), 0.7)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED]
    assert len(rig.sent) == 1


@pytest.mark.parametrize("controller", ["jtc", "kinova"])
@pytest.mark.parametrize("on_path", [True, False])
@pytest.mark.parametrize("lowest", LOWEST.values(), ids=LOWEST)
def test_no_stop_takes_a_joint_farther_than_braking_needs(
    monkeypatch: pytest.MonkeyPatch, controller: str, on_path: bool, lowest: float
) -> None:
    """All crossings: every joint crosses the edge of its report in one of the motions, up or down, and is stopped all along it."""
    names = tuple(f"joint_{i}" for i in range(1, 7))
    free = np.array([True, False, False, True, True, True])
    velocities, accelerations = np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0]), np.full(6, 1.0)
    limits = {"lower": np.full(6, -np.inf), "upper": np.full(6, np.inf)}
    robot = SimpleNamespace(joint_names=names, velocity_limits=velocities, acceleration_limits=accelerations, **limits)
    rng, now = np.random.default_rng(3), [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    crossings = 0
    for _ in range(6):
        middle = lowest + rng.uniform(-0.3, 0.3, 6)
        half = rng.uniform(0.4, 1.2, 6) * rng.choice([-1.0, 1.0], 6)
        history = JointHistory(free)
        start = history.add(ArmState(wrapped(middle - half, lowest, free), now[0], 0.0, 0.0)).q
        plan = time_path(np.array([start, start + 2.0 * half]), velocities, accelerations, joint_names=names)
        began_s = now[0]
        motion = Motion(1, None, plan, began_s, snapshot_from({"controller": controller}))
        while now[0] < began_s + plan.duration_s:
            now[0] += 0.05
            true = plan.sample(now[0] - began_s) + rng.normal(scale=0.002, size=6)
            state = history.add(ArmState(wrapped(true, lowest, free), now[0], 0.0, 0.0))
            crossings += bool((np.abs(state.q - wrapped(true, lowest, free)) > 1.0).any())
            stop = make_stop(robot, motion, state, on_path, controller)
            assert stop is not None
            moment_s, off = motion.follower.moment_s, motion.follower.off
            speeds = speeds_ahead(plan, moment_s, accelerations, 0.03)
            if not on_path and state.velocity is not None:
                speeds = np.maximum(speeds, np.minimum(np.abs(state.velocity), velocities))
            reach = np.abs(off) + braking_reach(speeds, accelerations, 0.03)
            assert reach.max() < 0.6
            assert stop_violations(stop, q_measured=state.q, reach_rad=reach) == []
            # What the driver reports agrees with the stop but for whole turns of joints that have them.
            apart = stop.positions[-1] - wrapped(true, lowest, free)
            assert (np.abs(apart - np.where(free, TURN * np.round(apart / TURN), 0.0)) <= reach).all()
        now[0] += 1.0
    assert crossings > 100


def test_a_stop_that_is_too_far_is_named() -> None:
    plan = time_path(np.array([[0.0, 0.0], [1.0, 2.0]]), [0.6, 0.6], [1.0, 1.0], joint_names=("a", "b"))
    reach = braking_reach(speeds_ahead(plan, 1.0, [1.0, 1.0], 0.1), [1.0, 1.0], 0.1)
    stop = dataclasses.replace(plan, positions=plan.positions[:1] + [[0.0, TURN]], velocities=np.zeros((1, 2)), first_time_s=0.2)
    found = stop_violations(stop, q_measured=[0.0, 0.0], reach_rad=reach)
    assert len(found) == 1 and "takes b 6.2832 rad from where it was measured (point 0); braking needs at most 0." in found[0]
    moving = dataclasses.replace(stop, positions=np.zeros((1, 2)), velocities=np.array([[0.0, 0.1]]))
    assert "the last velocity of b" in stop_violations(moving, q_measured=[0.0, 0.0], reach_rad=reach)[0]
    assert "not finite" not in str(found) and "must be finite" in str(
        stop_violations(dataclasses.replace(stop, positions=np.full((1, 2), np.nan)), q_measured=[0.0, 0.0], reach_rad=reach)
    )


def test_the_way_back_is_found_on_whatever_turns_the_driver_reports() -> None:
    path = np.array([[3.0, 0.0], [3.3, 0.2], [3.6, 0.2], [9.5, 0.3]])
    for turns in (-2, 0, 3):
        here = np.array([3.4 + turns * TURN, 0.2])
        shifted = nearest_turns(path, here, [True, False])
        assert way_back(shifted, here) == pytest.approx(np.array([here, path[1] + [turns * TURN, 0], path[0] + [turns * TURN, 0]]))
    assert nearest_turns(path, np.array([3.4 + TURN, 0.2]), [False, False]) == pytest.approx(path)


def test_a_previewed_plan_moves_with_the_turns_that_are_reported() -> None:
    plan = result(START, START + 0.2)
    assert on_turns_of(plan, START + 0.001, FREE) is plan
    moved = on_turns_of(plan, START + [TURN, 0.0, -2 * TURN], FREE)
    assert moved.trajectory.positions == pytest.approx(plan.trajectory.positions + [TURN, 0.0, -2 * TURN])
    assert moved.waypoints == pytest.approx(plan.waypoints + [TURN, 0.0, -2 * TURN])
    assert on_turns_of(plan, START + [0.0, TURN, 0.0], FREE) is plan, "this joint has an end"


def test_the_mock_arm_reports_within_a_turn() -> None:
    rng = np.random.default_rng(0)
    arm = SimulatedArm(("a", "b", "c"), [3.0, 3.0, 9.0], rng=rng, continuous=FREE, faults=Faults(report_wrapped=True))
    plan = time_path(np.array([[3.0, 3.0, 9.0], [3.6, 3.6, 9.6]]), [0.6] * 3, [1.0] * 3, joint_names=("a", "b", "c"))
    assert arm.command(Command.from_trajectory(plan)).accepted
    arm.step(plan.duration_s + 0.1)
    reading = arm.state()
    assert reading is not None
    assert reading.positions == pytest.approx([3.6 - TURN, 3.6, 9.6 - 2 * TURN])
    assert arm.configuration == pytest.approx([3.6, 3.6, 9.6])
