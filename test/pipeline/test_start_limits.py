"""Starts at and beyond joint limits: led back inside, or refused at once with joint and limit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arm_helpers import pipeline_of, robot_named, scene_of, settings

from lime_planner.core.status import Status
from lime_planner.motion.contract import violations
from lime_planner.pipeline import PlanResult
from lime_planner.robot.model import home
from lime_planner.ros.parameters import snapshot_from

QUICK = {"iterations": 400, "ik_starts": 128}
FAR = [[0.0, 0.0, 1.8]]  # a stem out of everyone's way
LIMITS = [(1, "lower"), (2, "lower"), (2, "upper"), (4, "lower"), (4, "upper")]


def plan(q: np.ndarray, **values: float) -> PlanResult:
    T = robot_named().forward(home(robot_named()) + np.array([0.3, 0.0, 0.2, 0.1, 0.0, 0.0]))
    return pipeline_of().plan(scene_of(FAR), T, q, settings(**(QUICK | values)), seed=1)


def beyond(joint: int, side: str, by_rad: float) -> np.ndarray:
    q = home(robot_named())
    limit = getattr(robot_named(), side)[joint]
    q[joint] = limit - by_rad if side == "lower" else limit + by_rad
    return q


@pytest.mark.parametrize(("joint", "side"), LIMITS)
def test_a_start_just_beyond_a_limit_is_led_back_inside(joint: int, side: str) -> None:
    robot, answered = robot_named(), 0
    for by_rad in (0.0, 1e-6, 1e-4, 5e-4, 1e-3, 0.01, 0.0299):
        q = beyond(joint, side, by_rad)
        result = plan(q)
        assert result.status is not Status.PATH_INVALID, f"{by_rad}: {result.message}"
        if result.status is not Status.SUCCEEDED:  # folded up, the arm touches itself: said so, whatever the limit
            assert "touches" in result.message, result.message
            continue
        answered += 1
        assert result.trajectory is not None
        rows = result.trajectory.configurations(0.005)
        assert rows[0] == pytest.approx(q, abs=1e-12)
        excess = np.maximum(robot.lower - rows, rows - robot.upper).max(axis=1)
        assert (np.diff(np.maximum(excess, 0.0)) <= 2e-6).all(), "never farther out"
        assert excess[-1] <= 1e-6
        back = pipeline_of().follow(result.waypoints[::-1], scene_of(FAR), None, settings(**QUICK))
        assert back.status is Status.SUCCEEDED, back.message
        again = pipeline_of().recheck(result, scene_of(FAR), q + 1e-4, settings(**QUICK))
        assert again[0] is Status.SUCCEEDED, again[1]
    assert answered in (0, 7)


def test_some_limits_can_be_started_at() -> None:
    assert sum(plan(beyond(joint, side, 0.0005)).status is Status.SUCCEEDED for joint, side in LIMITS) >= 3


@pytest.mark.parametrize(("joint", "side"), LIMITS)
def test_a_start_farther_out_is_refused_by_joint_and_limit(joint: int, side: str) -> None:
    robot = robot_named()
    limit = f"{getattr(robot, side)[joint]:.4f}"
    for by_rad, more in ((0.031, {}), (0.4, {}), (0.002, {"start_limit_tolerance_rad": 0.001})):
        result = plan(beyond(joint, side, by_rad), **more)
        assert result.status is Status.START_INVALID
        assert robot.joint_names[joint] in result.message and limit in result.message
    q = beyond(joint, side, 0.05)
    back = pipeline_of().follow(np.stack([q, home(robot)]), scene_of(FAR), None, settings(**QUICK))
    assert back.status is Status.START_INVALID and robot.joint_names[joint] in back.message and limit in back.message


def test_where_a_motion_may_end_the_next_may_begin() -> None:
    for tolerance_rad in (0.001, 0.02, 0.1, 0.5):
        assert snapshot_from({"goal_tolerance_rad": tolerance_rad}).plan.start_limit_tolerance_rad > tolerance_rad


def test_the_contract_lets_a_joint_come_back_and_never_go_farther_out() -> None:
    robot = robot_named()
    q = beyond(2, "lower", 0.01)
    motion = plan(q).trajectory
    assert motion is not None
    limits = {"lower": np.where(robot.continuous, -99.0, robot.lower), "upper": np.where(robot.continuous, 99.0, robot.upper)}
    limits |= {"velocity_limits": robot.velocity_limits, "acceleration_limits": robot.acceleration_limits, "q_measured": q}
    assert violations(motion, limit_tolerance_rad=0.03, **limits) == []
    assert "below its limit" in violations(motion, limit_tolerance_rad=0.005, **limits)[0]
    assert "below its limit" in violations(motion, **limits)[0]
    out = np.array(motion.positions)
    out[-5:, 2] = robot.lower[2] - 0.009  # inside meanwhile: no way back out
    found = violations(dataclasses.replace(motion, positions=out), limit_tolerance_rad=0.03, **limits)
    assert any("below its limit" in sentence for sentence in found)
