"""Grasps that slide while the path is polished, and what a grasp costs for the leaves that the hand lies in."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from arm_helpers import pipeline_of, robot_named, settings
from test_targets import fruit_scene

from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.goals import Goals
from lime_planner.pipeline.grasps import search as grasp_search
from lime_planner.pipeline.grasps.goals import goals_of
from lime_planner.pipeline.grasps.search import Trials
from lime_planner.pipeline.grasps.slide import Slid, slide, worth_sliding
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.search import search
from lime_planner.pipeline.targets import Target, candidates_target, fruit_target, pose_target
from lime_planner.planning.space import line
from lime_planner.scene.scene import Scene

ARM = "kinova_j2s6s200"
CENTRE = np.asarray(fruit_scene()[1], dtype=np.float64)
USED = settings(iterations=400, max_grasps=100)


def _scene() -> Scene:
    """A fruit under a branch, in the midst of so many leaves that every grasp touches some."""
    scene, _ = fruit_scene()
    leaves = np.random.default_rng(2).normal(CENTRE, 0.07, (1500, 3))
    points = np.concatenate([scene.fruit_points, scene.stem_points, leaves])
    return Scene.from_points(points, [2] * len(scene.fruit_points) + [1] * len(scene.stem_points) + [0] * len(leaves))


SCENE = _scene()


def _searched(target: Target) -> tuple[Obstacles, Goals, np.ndarray]:
    robot = robot_named(ARM)
    obstacles = pipeline_of(ARM).obstacles(SCENE, target.spot(SCENE, USED), USED)
    goals = goals_of(obstacles, obstacles.exact_checker(), target, robot.home, np.random.default_rng(1))
    assert goals.status is None, goals.sentence
    obstacles = obstacles.with_anchors(goals.anchors, goals.needs)
    found, goals, obstacles = search(obstacles, robot.home, goals, USED, seed=1, budget_s=None, should_stop=lambda: False)
    assert found.path is not None
    return obstacles, goals, found.path


def _slid(target: Target, parts: tuple[Obstacles, Goals, np.ndarray], trials: int = 60) -> Slid:
    obstacles, goals, path = parts
    home = robot_named(ARM).home
    return slide(obstacles, target, goals, path, home, seed=3, trials=trials, budget_s=None, should_stop=lambda: False)


def _cost(obstacles: Obstacles, path: np.ndarray, stretch: np.ndarray) -> float:
    space = obstacles.space(path.min(axis=0) - 10.0, path.max(axis=0) + 10.0).handle()
    way = np.concatenate([path, stretch[1:]])
    return sum(line(space, a, b, USED.weight, np.inf) for a, b in itertools.pairwise(way))


@pytest.mark.parametrize("freedom", ["fruit", "roll", "cone"])
def test_a_grasp_slides_where_that_costs_less(freedom: str) -> None:
    fruit = fruit_target(CENTRE)
    parts = _searched(fruit)
    target = fruit
    if freedom != "fruit":
        which, _ = parts[1].behind(parts[2][-1])
        target = pose_target(parts[1].poses[which], freedom)
        parts = _searched(target)
    obstacles, goals, path = parts
    which, stretch = goals.behind(path[-1])
    assert worth_sliding(goals, target, USED)
    slid, robot = _slid(target, parts), robot_named(ARM)
    assert slid.trials == 60
    before = _cost(obstacles, path, path[-1:]) + goals.costs[which]
    assert slid.cost < before - 1.0, "nothing was gained"
    # What it says it costs is what it costs: never less than its own edges.
    assert slid.cost >= _cost(obstacles, slid.path, slid.stretch) - 1e-6
    np.testing.assert_allclose(slid.path[0], path[0])
    np.testing.assert_array_equal(slid.path[-1], slid.stretch[0])
    np.testing.assert_allclose(robot.forward(slid.stretch[-1]), slid.pose, atol=1e-5)
    np.testing.assert_allclose(slid.pose[:3, 3], CENTRE, atol=1e-9)
    assert len(slid.stretch) >= len(stretch)
    z = slid.pose[:3, 2]
    for row in sample_path(slid.stretch, 0.01)[0]:
        tool = robot.forward(row)
        offset = tool[:3, 3] - CENTRE
        assert np.linalg.norm(offset - (offset @ z) * z) < 0.002
        assert np.arccos(np.clip((np.trace(tool[:3, :3].T @ slid.pose[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)) < np.radians(2.0)
        assert obstacles.exact_checker().stem_hit(row) is None
    axis = CENTRE / np.linalg.norm(CENTRE) if freedom == "fruit" else target.poses[0, :3, 2]
    turned = float(np.arccos(np.clip(z @ axis, -1.0, 1.0)))
    assert turned < 1e-5 if freedom == "roll" else turned <= USED.approach_cone_rad + 1e-6
    again = _slid(target, parts)
    np.testing.assert_array_equal(again.stretch, slid.stretch)
    np.testing.assert_array_equal(again.path, slid.path)


def test_only_a_target_that_leaves_something_open_slides() -> None:
    none = np.zeros((0, 6))
    goals = Goals(none, none, np.zeros(0), None, "", 1, costs=np.array([80.0, 20.0]))
    pose = [*CENTRE, 0.0, 0.7071, 0.0, 0.7071]
    for target, changed, worth in (
        (fruit_target(CENTRE), {}, True),
        (pose_target(pose, "roll"), {}, True),
        (pose_target(pose), {}, False),
        (candidates_target([pose]), {}, False),
        (fruit_target(CENTRE), {"planner": "rrt_star", "paper": True}, False),  # another metric
    ):
        assert worth_sliding(goals, target, settings(**changed)) is worth
    free = Goals(none, none, np.zeros(0), None, "", 1, costs=np.array([0.4, 20.0]))
    assert not worth_sliding(free, fruit_target(CENTRE), settings())


def test_of_grasps_alike_in_contact_the_one_in_fewer_leaves_is_cheaper(monkeypatch: Any) -> None:
    robot = robot_named(ARM)
    target = fruit_target(CENTRE)
    obstacles = pipeline_of(ARM).obstacles(SCENE, target.spot(SCENE, USED), USED)

    def found() -> tuple[float, float]:
        """Area at the cheapest grasp [m²], and its price."""
        grasps = grasp_search.find_grasps(obstacles, target, robot.home, np.random.default_rng(1), 24)
        trials = Trials.for_target(obstacles, target, robot.home, np.random.default_rng(1), lambda: False)
        best = int(grasps.costs.argmin())
        return trials._touched_m2(grasps.stretches[best, 0]), float(grasps.costs[best])

    area_m2, price = found()
    assert price > USED.weight * grasp_search._AREA_RAD_PER_M2 * area_m2 > 0.0
    monkeypatch.setattr(grasp_search, "_AREA_RAD_PER_M2", 0.0)
    without_m2, without = found()
    assert area_m2 < without_m2 and without < price
