"""A motion touches no more leaves than the path whose figures it is sent with."""

from __future__ import annotations

import itertools

import numpy as np
from arm_helpers import obstacles_of, robot_named, scene_of

from lime_planner.collision.arm_filter import ArmSurface
from lime_planner.collision.exact import ExactChecker
from lime_planner.core.parameters import settings_from
from lime_planner.pipeline.certify import CERTIFIED_STEP_RAD, make_trajectory, timed_motion
from lime_planner.pipeline.context import Clock
from lime_planner.pipeline.figures import leaf_profile
from lime_planner.robot.model import Robot

RADIUS_M = 0.004


def touched_points(robot: Robot, points: np.ndarray, rows: np.ndarray, more_m: float = 0.0) -> np.ndarray:
    """Which points lie within a leaf point's radius of the arm's meshes in any of the rows."""
    surface, found = ArmSurface(robot), np.zeros(len(points), dtype=bool)
    for q in rows:
        found |= surface.distance(points.astype(np.float32), q, within_m=0.02) < RADIUS_M + more_m
    return found


def test_a_corner_is_not_cut_through_a_leaf() -> None:
    robot, settings = robot_named(), settings_from({"corner_tolerance_rad": 0.1})
    corner = robot.home + np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    path = np.array([robot.home, corner, corner + np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])])
    free = obstacles_of(scene_of())
    cut = make_trajectory(robot, path, free, settings).configurations(CERTIFIED_STEP_RAD)
    inside = cut[np.linalg.norm(cut - corner, axis=1).argmin()]  # where the rounded corner is nearest to the path's
    on_path = np.concatenate([np.linspace(a, b, 80) for a, b in itertools.pairwise(path)])
    hand, rng = robot.forward(inside)[:3, 3], np.random.default_rng(5)
    leaves = hand + rng.uniform(-0.15, 0.15, (12000, 3))
    # Leaves that the rounded corner alone meets, found in a crowd of them: those that no row of the path touches.
    met = touched_points(robot, leaves, cut) & ~touched_points(robot, leaves, on_path, more_m=0.001)
    obstacles = obstacles_of(scene_of(leaves=leaves[met]))
    assert met.sum() > 2 and leaf_profile(obstacles, cut)[0].any() and not leaf_profile(obstacles, on_path)[0].any()
    checker = ExactChecker(robot, np.zeros((0, 3), np.float32), point_radius_m=RADIUS_M)
    motion = timed_motion(obstacles, checker, path, path[0], settings, Clock(), lambda: False, 0.0)
    assert not leaf_profile(obstacles, motion.configurations(CERTIFIED_STEP_RAD))[0].any()
