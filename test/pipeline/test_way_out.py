"""Starts that almost touch a stem: the first move leads off it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from arm_helpers import pipeline_of, plant, robot_named, scene_of, settings

from lime_planner.collision.arm_filter import ArmSurface
from lime_planner.collision.exact import ExactChecker
from lime_planner.core.errors import Refusal
from lime_planner.pipeline import PlanResult
from lime_planner.pipeline.scene_targets import own_target
from lime_planner.pipeline.way_out import way_out

RADIUS_M = 0.004
HOME = robot_named().home


@cache
def close_places() -> np.ndarray:
    """Places (K, 3) whose balls are 0.005 to 0.1 mm off the arm at home, at the hand and the links before it."""
    robot, rng = robot_named(), np.random.default_rng(4)
    middles = [*(pose[:3, 3] for pose in robot.link_poses(HOME)[-3:]), robot.forward(HOME)[:3, 3]]
    points = np.concatenate([rng.normal(middle, 0.06, (60_000, 3)) for middle in middles])
    gaps = ArmSurface(robot).distance(points, HOME, within_m=0.02) - RADIUS_M
    return points[(gaps > 5e-6) & (gaps < 1e-4)]


def assert_clear(result: PlanResult, stems: np.ndarray) -> None:
    assert result.succeeded, result.message
    assert result.trajectory is not None
    np.testing.assert_allclose(result.trajectory.positions[0], HOME, atol=1e-12)
    checker = ExactChecker(robot_named(), stems, point_radius_m=RADIUS_M)
    assert checker.certify(result.trajectory.configurations(5e-4)).ok


@pytest.mark.parametrize("seed", range(8))
def test_a_motion_leads_off_what_the_arm_almost_touches(seed: int) -> None:
    places = np.random.default_rng(seed).choice(close_places(), 1 + seed % 2, replace=False)
    for move in (0.5, -0.5):
        T = robot_named().forward(HOME + np.array([move, 0.2, 0.3, 0.0, 0.0, 0.0]))
        result = pipeline_of().plan(scene_of(places), T, HOME, settings(iterations=300, approach_distance_m=0.0), seed=1)
        assert_clear(result, places)


def test_a_plant_whose_twig_almost_touches_the_finger() -> None:
    scene = plant(45, "dense")
    target = own_target(scene, "exact", robot_named().forward(HOME)[:3, 3])
    assert target is not None
    result = pipeline_of().plan(scene, target, HOME, settings(iterations=600), seed=1)
    assert_clear(result, scene.stem_points)


def test_only_where_it_is_needed() -> None:
    rng = np.random.default_rng(1)
    for scene in (scene_of(), scene_of([[0.0, 0.0, 1.8]])):
        obstacles = pipeline_of().obstacles(scene, None, settings())
        assert way_out(obstacles, obstacles.exact_checker(), HOME, rng, lambda: False) is None
    obstacles = pipeline_of().obstacles(scene_of([close_places()[0]]), None, settings())
    end = way_out(obstacles, obstacles.exact_checker(), HOME, rng, lambda: False)
    assert end is not None and 0.0 < np.linalg.norm(end - HOME) <= 0.25
    with pytest.raises(Refusal, match="stopped"):
        way_out(obstacles, obstacles.exact_checker(), HOME, rng, lambda: True)
