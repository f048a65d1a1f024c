"""Inverse kinematics: residuals, completeness, turns, and the two ways to have no solution."""

from __future__ import annotations

from functools import cache
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lime_planner.core.errors import ProblemError
from lime_planner.robot.ik import DEFAULT_STARTS, TURN, pose_error, solve_ik
from lime_planner.robot.model import Robot, home, load_robot, robot_from_urdf

robot_named = cache(load_robot)
ARMS = ["kinova_j2s6s200", "kinova_j2n6s300"]


def random_configuration(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    low, high = np.where(np.isfinite(robot.lower), robot.lower, -np.pi), np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return rng.uniform(low, high)


def wrapped(difference: np.ndarray) -> np.ndarray:
    return (difference + np.pi) % TURN - np.pi


@pytest.mark.parametrize("name", ARMS)
def test_solutions_are_solutions(name: str) -> None:
    rng, robot = np.random.default_rng(0), robot_named(name)
    for _ in range(40):
        q, seed = random_configuration(robot, rng), random_configuration(robot, rng)
        T_base_tool = robot.forward(q)
        result = solve_ik(robot, T_base_tool, seed, rng)
        assert result.reason is None and result.detail == ""
        assert result.residuals[:, 0].max() < 1e-5 and result.residuals[:, 1].max() < 1e-5
        for solution in result.solutions:
            np.testing.assert_allclose(robot.forward(solution), T_base_tool, atol=2e-5)
            assert robot.within_limits(solution)
        assert np.abs(result.solutions - seed).max() <= TURN + 1e-6
        distances = np.linalg.norm(result.solutions - seed, axis=1)
        assert (np.diff(distances) >= 0.0).all()
        # The pose's own configuration is among them.
        assert np.abs(wrapped(result.solutions - q)).max(axis=1).min() < 1e-3
        # No solution twice; those of one branch differ by whole turns, those of two do not.
        assert len(np.unique(result.solutions.round(3), axis=0)) == len(result.solutions)
        for branch in np.unique(result.branches):
            own = result.solutions[result.branches == branch]
            assert np.abs(wrapped(own - own[0])).max() < 1e-6
            others = result.solutions[result.branches != branch]
            assert len(others) == 0 or np.abs(wrapped(others - own[0])).max(axis=1).min() >= 0.01


@pytest.mark.parametrize("name", ARMS)
def test_all_branches_are_found(name: str) -> None:
    """Recall of the default number of starts against a run of 4000, over reachable poses."""
    rng, robot = np.random.default_rng(1), robot_named(name)
    solve_ik(robot, robot.forward(home(robot)), home(robot), rng)
    found = total = 0
    most, times = 0, []
    for _ in range(50):
        T_base_tool, seed = robot.forward(random_configuration(robot, rng)), home(robot)
        started = perf_counter()
        short = solve_ik(robot, T_base_tool, seed, rng, windows=np.pi, max_solutions=1000)
        times.append(perf_counter() - started)
        every = solve_ik(robot, T_base_tool, seed, rng, windows=np.pi, max_solutions=1000, starts=4000)
        near = [np.abs(wrapped(short.solutions - q)).max(axis=1).min(initial=np.pi) < 0.02 for q in every.solutions]
        found, total, most = found + sum(near), total + len(near), max(most, len(near))
    recall = f"{found} of {total} solutions ({found / total:.2%}), up to {most} a pose"
    print(f"{name}: {DEFAULT_STARTS} starts find {recall}, in {1e3 * np.median(times):.1f} ms")
    assert found / total >= 0.95
    assert most >= 8


def test_every_turn_within_the_window() -> None:
    rng, robot = np.random.default_rng(2), robot_named("kinova_j2s6s200")
    q = home(robot)
    result = solve_ik(robot, robot.forward(q), q, rng, max_solutions=1000)
    own = result.solutions[np.abs(wrapped(result.solutions - q)).max(axis=1) < 1e-3]
    # Joints 1, 4 and 6 turn freely: none, one turn forth and one back each; the seed's own configuration comes first.
    assert len(own) == 27
    np.testing.assert_allclose(result.solutions[0], q, atol=1e-4)
    for solution in result.solutions:
        for joint in np.flatnonzero(robot.continuous):
            for turn in (-TURN, TURN):
                other = solution.copy()
                other[joint] += turn
                if abs(other[joint] - q[joint]) <= TURN:
                    assert np.abs(result.solutions - other).max(axis=1).min() < 1e-6
    narrow = solve_ik(robot, robot.forward(q), q, rng, windows=np.array([1.0, 9, 9, 1.0, 9, 1.0]))
    assert len(narrow.solutions) and np.abs(narrow.solutions - q)[:, [0, 3, 5]].max() <= 1.0 + 1e-6
    assert len(solve_ik(robot, robot.forward(q), q, rng, max_solutions=3).solutions) == 3


def test_seed_of_several_turns() -> None:
    rng, robot = np.random.default_rng(3), robot_named("kinova_j2n6s300")
    q = home(robot) + TURN * np.array([3, 0, 0, -2, 1, 5])
    result = solve_ik(robot, robot.forward(q), q, rng)
    np.testing.assert_allclose(result.solutions[0], q, atol=1e-4)
    assert np.abs(result.solutions - q).max() <= TURN + 1e-6


def test_unreachable_and_out_of_limits_are_told_apart() -> None:
    rng, robot = np.random.default_rng(4), robot_named("kinova_j2s6s200")
    far = np.eye(4)
    far[:3, 3] = [1.5, 0.0, 0.4]
    result = solve_ik(robot, far, home(robot), rng)
    assert (result.reason, result.solutions.shape, result.residuals.shape) == ("unreachable", (0, 6), (0, 2))
    assert "m and" in result.detail
    # The elbow folded more tightly than its limit of 19 degrees; the wrist's distance from the shoulder asks for it in all solutions.
    q = home(robot)
    q[2] = 0.15
    result = solve_ik(robot, robot.forward(q), home(robot), rng)
    assert (result.reason, len(result.solutions)) == ("limits", 0)
    assert "j2s6s200_joint_3 would have to be at 0.150 rad, outside 0.332 to 5.952 rad" in result.detail


def test_same_seed_same_solutions_and_a_time_limit() -> None:
    robot = robot_named("kinova_j2s6s200")
    T_base_tool = robot.forward(home(robot))
    first, second = (solve_ik(robot, T_base_tool, home(robot), np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.solutions, second.solutions)
    hurried = solve_ik(robot, T_base_tool, home(robot), np.random.default_rng(5), starts=1_000_000, time_s=0.02)
    assert hurried.starts < 1_000_000
    assert len(hurried.solutions)


def test_arms_with_other_numbers_of_joints() -> None:
    def urdf(n: int) -> str:
        text = '<robot name="r"><link name="l0"/>'
        for i in range(n):
            text += f'<link name="l{i + 1}"><collision><geometry><sphere radius="0.05"/></geometry></collision></link><joint name="j{i}" '
            text += f'type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0 0 {0.2 if i % 2 else 0.1}"/>'
            text += f'<axis xyz="{"0 1 0" if i % 2 else "0 0 1"}"/><limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>'
        return text + "</robot>"

    rng = np.random.default_rng(6)
    seven, four = robot_from_urdf(urdf(7)), robot_from_urdf(urdf(4))
    q = np.array([0.3, 0.8, -0.4, 1.2, 0.5, -0.9, 1.0])
    result = solve_ik(seven, seven.forward(q), np.zeros(7), rng)
    assert len(result.solutions) > 20
    assert all(seven.within_limits(solution) for solution in result.solutions)
    assert result.residuals.max() < 1e-5
    assert len(solve_ik(four, four.forward(q[:4]), np.zeros(4), rng).solutions)
    other = four.forward(q[:4])
    other[:3, 3] += [0.0, 0.0, 0.05]  # four joints cannot also keep the rotation
    assert solve_ik(four, other, np.zeros(4), rng).reason == "unreachable"


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.floats(0.0, np.pi))
def test_rotation_error_is_the_logarithm(axis: list[float], angle: float) -> None:
    from scipy.spatial.transform import Rotation

    length = float(np.linalg.norm(axis))
    if length < 1e-3:
        return
    turn = Rotation.from_rotvec(np.array(axis) / length * angle).as_matrix()
    start = Rotation.from_euler("xyz", [0.3, 1.0, -2.0]).as_matrix()
    target, pose, error = np.zeros((3, 4)), np.zeros((3, 4)), np.empty(6)
    pose[:, :3], target[:, :3], target[:, 3] = start, turn @ start, [0.3, -0.6, 0.0]
    total = pose_error(target, pose, error)
    np.testing.assert_allclose(error[:3], [1.0, -2.0, 0.0])
    assert np.linalg.norm(error[3:]) == pytest.approx(angle, abs=1e-6)
    assert total == pytest.approx(5.0 + angle**2, abs=1e-5)
    if angle < 3.1:
        np.testing.assert_allclose(error[3:], np.array(axis) / length * angle, atol=1e-6)


def test_mistakes_are_named() -> None:
    robot, rng = robot_named("kinova_j2s6s200"), np.random.default_rng(0)
    with pytest.raises(ProblemError, match="T_base_tool"):
        solve_ik(robot, np.eye(3), home(robot), rng)
    with pytest.raises(ProblemError, match="not a rotation"):
        solve_ik(robot, 2.0 * np.eye(4), home(robot), rng)
    with pytest.raises(ProblemError, match="q_seed"):
        solve_ik(robot, np.eye(4), [0.0] * 5, rng)
    with pytest.raises(ProblemError, match="q_seed"):
        solve_ik(robot, np.eye(4), [np.nan] * 6, rng)
    with pytest.raises(ProblemError, match="at least 1"):
        solve_ik(robot, np.eye(4), home(robot), rng, starts=0)
