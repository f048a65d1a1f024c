"""The potential field and the biased extension, against the paper's equations written out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lime_planner.planning.rrt_star.kernels import NEIGHBOUR_SLACK, neighbour_radius
from lime_planner.planning.rrt_star.planner import PaperOptions
from lime_planner.planning.rrt_star.potential_field import (
    Field,
    biased_direction,
    exploration_weight,
    farthest_corner,
    shift_sample,
    total_force,
)
from lime_planner.planning.space import SpaceHandle
from lime_planner.planning.spaces.plane import wall_g

SPACE: SpaceHandle = wall_g().space().handle()
GOALS = np.array([[90.0, 50.0]])
LOWER, UPPER = np.zeros(2), np.full(2, 100.0)


def field(beta: float = 1.0, explore: bool = False, k_att: float = 50.0, k_rep: float = 500.0) -> Field:
    return Field(k_att, k_rep, k_rep, 5.0, beta, explore, 2.0 * k_att * farthest_corner(LOWER, UPPER, GOALS))


def test_farthest_corner() -> None:
    assert farthest_corner(LOWER, UPPER, GOALS)[0] == pytest.approx(np.hypot(90, 50))
    assert farthest_corner(np.array([-1.0, -2.0]), np.array([1.0, 2.0]), np.array([[0.5, -1.0]]))[0] == pytest.approx(np.hypot(1.5, 3.0))


@given(st.floats(0, 100), st.floats(0, 100), st.floats(0, 3))
@settings(max_examples=100, deadline=None)
def test_equations_3_to_6(x: float, y: float, beta: float) -> None:
    q, force, direction = np.array([x, y]), np.zeros(2), np.zeros(2)
    f = field(beta)
    goal, clearance, f_total = total_force(SPACE, f, GOALS, q, force)
    to_goal = GOALS[0] - q
    distance = np.linalg.norm(to_goal)
    if distance < 1e-6:
        return
    attraction = 2.0 * 50.0 * to_goal  # -∇(K_att d²)
    repulsion = force - attraction
    if clearance > 5.0 or clearance <= 0.0:
        np.testing.assert_allclose(repulsion, 0.0, atol=1e-9)
    else:
        size = 500.0 * (1.0 / clearance - 1.0 / 5.0) / clearance**2
        assert np.linalg.norm(repulsion) == pytest.approx(size, rel=1e-6, abs=1e-6)
    assert f_total == pytest.approx(force @ to_goal / distance, rel=1e-9, abs=1e-6)
    weight = exploration_weight(f, goal, clearance, f_total)
    assert weight == pytest.approx(1.0 / (beta * max(0.0, f_total) / (100.0 * np.hypot(90, 50)) + 1.0))
    q_rand = np.array([100.0 - y, x])
    if np.linalg.norm(q_rand - q) > 1e-6 and biased_direction(SPACE, f, GOALS, q, q_rand, force, direction):
        v = weight * (q_rand - q) / np.linalg.norm(q_rand - q) + (1 - weight) * force / np.linalg.norm(force)
        if np.linalg.norm(v) > 1e-6:
            np.testing.assert_allclose(direction, v / np.linalg.norm(v), atol=1e-7)


def test_inside_leaves_both_readings() -> None:
    q, force = np.array([50.0, 50.0]), np.zeros(2)
    goal, clearance, f_total = total_force(SPACE, field(), GOALS, q, force)
    assert clearance == 0.0
    assert exploration_weight(field(explore=True), goal, clearance, f_total) == 1.0
    assert exploration_weight(field(explore=False), goal, clearance, f_total) == pytest.approx(1.0 / (40.0 / np.hypot(90, 50) + 1.0))


def test_close_to_a_wall_the_random_direction_is_followed() -> None:
    q, force, direction = np.array([39.75 - 0.05, 50.0]), np.zeros(2), np.zeros(2)
    f = field()
    goal, clearance, f_total = total_force(SPACE, f, GOALS, q, force)
    assert f_total < 0.0
    assert exploration_weight(f, goal, clearance, f_total) == 1.0
    biased_direction(SPACE, f, GOALS, q, np.array([39.7, 90.0]), force, direction)
    np.testing.assert_allclose(direction, [0.0, 1.0], atol=1e-12)


def test_degenerate_directions() -> None:
    force, direction = np.zeros(2), np.zeros(2)
    q = np.array([20.0, 50.0])
    assert not biased_direction(SPACE, field(k_att=0.0), GOALS, q, q, force, direction)
    assert biased_direction(SPACE, field(), GOALS, q, q, force, direction)  # no random direction: along the field
    np.testing.assert_allclose(direction, [1.0, 0.0])
    _, _, f_total = total_force(SPACE, field(), GOALS, GOALS[0].copy(), force)
    assert f_total == 0.0


def test_nearest_goal_attracts() -> None:
    goals = np.array([[90.0, 50.0], [10.0, 10.0]])
    force = np.zeros(2)
    f = field()._replace(force_max=np.array([1.0, 1.0]))
    assert total_force(SPACE, f, goals, np.array([12.0, 20.0]), force)[0] == 1
    np.testing.assert_allclose(force, 100.0 * np.array([-2.0, -10.0]))


def test_p_rrt_star_shifts_samples_k_times_and_clips_them() -> None:
    force = np.zeros(2)
    q = np.array([10.0, 50.0])
    shift_sample(SPACE, field(), GOALS, q, 0.5, 10, force)
    np.testing.assert_allclose(q, [15.0, 50.0])
    q = np.array([50.0, 80.0])  # inside the leaf the attraction alone acts
    shift_sample(SPACE, field(), GOALS, q, 0.5, 1, force)
    np.testing.assert_allclose(q, np.array([50.0, 80.0]) + 0.5 * np.array([0.8, -0.6]))
    q = np.array([99.0, 50.0])
    shift_sample(SPACE._replace(lower=np.array([95.0, 0.0])), field(), GOALS, q, 0.5, 10, force)
    np.testing.assert_allclose(q, [95.0, 50.0])


@pytest.mark.parametrize(("size", "expected"), [(1, 3.0), (1000, 138.0 * np.sqrt(np.log(1000) / 1000)), (10**7, 3.0)])
def test_neighbour_radius(size: int, expected: Any) -> None:
    assert neighbour_radius(PaperOptions(radius="rrg").rules(), size, 2) == pytest.approx(expected)
    assert neighbour_radius(PaperOptions().rules(), size, 2) == 3.0
    assert NEIGHBOUR_SLACK == 1e-9


def test_wall_and_arm_parameters_are_the_papers() -> None:
    wall = PaperOptions.wall("apf_rrt_star")
    assert (wall.k_att, wall.k_rep_permeable, wall.d_star, wall.delta, wall.c_perm, wall.beta) == (50.0, 500.0, 5.0, 3.0, 100.0, 1.0)
    assert (wall.shift, wall.shift_steps, wall.rules().goal_radius, wall.leaf_weight) == (0.5, 10, 5.0, 100.0 / 3.0)
    assert wall.rules().full_step
    assert not PaperOptions.wall("rrt_star").rules().full_step
    arm = PaperOptions.arm("p_rrt_star", beta=2.0)
    assert (arm.delta, arm.c_perm, arm.shift, arm.shift_steps, arm.beta, arm.leaf_weight) == (0.1, 100.0, 0.1, 2, 2.0, 1000.0)
