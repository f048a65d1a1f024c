"""Grasps to choose from: approaches, continuation, straight stretches, refusals, and plans that end along the palm's axis."""

from __future__ import annotations

import dataclasses
import itertools
from functools import cache
from typing import Any

import numpy as np
import pytest
from arm_helpers import near_configurations, pipeline_of, plant, robot_named, scene_of, settings
from test_targets import fruit_scene

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.pipeline import PlanResult
from lime_planner.pipeline import pipeline as core
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.goals import DEARER, FREE, HAND_BLOCKED, Goals
from lime_planner.pipeline.grasps import kernels
from lime_planner.pipeline.grasps.approaches import around, in_cone, nearest_earlier, spread
from lime_planner.pipeline.grasps.goals import goals_of
from lime_planner.pipeline.grasps.search import Trials
from lime_planner.pipeline.targets import candidates_target, fruit_target, pose_target
from lime_planner.robot.ik import solve_ik
from lime_planner.scene.scene import Scene

J2S, J2N = "kinova_j2s6s200", "kinova_j2n6s300"


def ball(centre: Any, radius: float, count: int = 300) -> np.ndarray:
    ways = np.random.default_rng(1).normal(size=(count, 3))
    return np.asarray(centre) + radius * ways / np.linalg.norm(ways, axis=1, keepdims=True)


def goals(scene: Scene, target: Any, arm: str = J2S, seed: int = 1, **values: Any) -> Goals:
    used, pipeline, robot = settings(**values), pipeline_of(arm), robot_named(arm)
    obstacles = pipeline.obstacles(scene, target.spot(scene, used), used)
    return goals_of(obstacles, obstacles.exact_checker(), target, robot.home, np.random.default_rng(seed))


@cache
def picked(arm: str) -> tuple[PlanResult, Scene]:
    """A plan to the fruit of `fruit_scene`, leaves around it."""
    scene, centre = fruit_scene()
    leaves = np.random.default_rng(2).normal(centre, 0.08, (300, 3))
    points = np.concatenate([scene.fruit_points, scene.stem_points, leaves])
    labels = [2] * len(scene.fruit_points) + [1] * len(scene.stem_points) + [0] * len(leaves)
    scene = Scene.from_points(points, labels)
    return pipeline_of(arm).plan(scene, fruit_target(centre), robot_named(arm).home, settings(iterations=1500), seed=1), scene


def test_approaches_are_spread_over_the_cone() -> None:
    rng = np.random.default_rng(0)
    axis = np.array([0.6, -0.48, 0.64])
    turned = in_cone(axis, 1.2, spread(400, rng))
    np.testing.assert_allclose(turned @ turned.transpose(0, 2, 1), np.tile(np.eye(3), (400, 1, 1)), atol=1e-12)
    heights = turned[:, :, 2] @ axis
    assert heights.min() >= np.cos(1.2) - 1e-9
    # As many in each tenth of the cap's area, in every prefix.
    for count in (100, 400):
        tenths = np.floor((1.0 - heights[:count]) / (1.0 - np.cos(1.2)) * 10.0 - 1e-9)
        assert np.bincount(tenths.astype(int), minlength=10).min() >= 0.7 * count / 10
    near = around(turned, axis, 1.2, 0.2, rng)
    assert (near[:, :, 2] @ axis).min() >= np.cos(1.2) - 1e-6
    assert 0.05 < np.mean(np.arccos(np.clip((near[:, :, 2] * turned[:, :, 2]).sum(axis=1), -1.0, 1.0))) < 0.4
    parents = nearest_earlier(turned, 2)
    assert (parents[0] == -1).all() and (parents < np.arange(400)[:, None]).all()


@pytest.mark.parametrize("arm", [J2S, J2N])
def test_continuation_finds_what_random_starts_find(arm: str) -> None:
    robot, rng = robot_named(arm), np.random.default_rng(3)
    T = robot.forward(near_configurations(robot, rng, 1, [0.5, 0.1, 0.5], 0.05)[0])
    turned = around(np.tile(T[:3, :3], (40, 1, 1)), T[:3, 2], 1.0, 0.25, rng)
    targets = np.ascontiguousarray(np.concatenate([turned, np.tile(T[:3, 3:], (40, 1, 1))], axis=2))
    starts = rng.uniform(-np.pi, np.pi, (96, robot.n))
    solutions, counts = np.zeros((40, kernels.MAX_BRANCHES, robot.n)), np.zeros(40, np.int64)
    kernels.solve_poses(robot.chain, targets, 0, 40, nearest_earlier(turned, 2), starts, 2, solutions, counts, kernels.make_memory(robot.n))
    found = wanted = 0
    for target, rows, count in zip(targets, solutions, counts, strict=True):
        for q in rows[:count]:
            np.testing.assert_allclose(robot.forward(q)[:3], target, atol=1e-5)
        expected = solve_ik(robot, target, robot.home, rng, windows=np.pi)
        for branch in np.unique(expected.branches):
            q = expected.solutions[expected.branches == branch][0]
            apart = np.abs((rows[:count] - q + np.pi) % (2 * np.pi) - np.pi).max(axis=1) if count else np.array([9.0])
            wanted, found = wanted + 1, found + bool(apart.min() < 0.02)
    assert wanted > 40 and found >= 0.95 * wanted


@pytest.mark.parametrize("arm", [J2S, J2N])
def test_grasps_come_from_where_nothing_is_in_the_way(arm: str) -> None:
    scene, centre = fruit_scene()
    found = goals(scene, fruit_target(centre), arm)
    assert found.status is None and found.approaches is not None
    assert 0 < found.free == int((found.approaches.outcomes == FREE).sum()) < found.tried == 600
    assert (found.approaches.outcomes == HAND_BLOCKED).any()  # by the branch over it
    robot, used = robot_named(arm), settings()
    obstacles = pipeline_of(arm).obstacles(scene, fruit_target(centre).spot(scene, used), used)
    checker = obstacles.exact_checker()
    everything = ExactChecker(robot, scene.fruit_points, point_radius_m=used.stem_point_radius_m)
    for stretch, T, q, cost in zip(found.stretches, found.poses, found.configurations, found.costs, strict=True):
        np.testing.assert_array_equal(stretch[0], q)
        assert cost >= np.linalg.norm(np.diff(stretch, axis=0), axis=1).sum() - 1e-9
        np.testing.assert_allclose(robot.forward(stretch[-1]), T, atol=1e-5)
        np.testing.assert_allclose(T[:3, 3], centre)
        for row in sample_path(stretch, 0.01)[0]:
            assert checker.stem_hit(row) is None
            assert everything.stem_hit(row) is None  # the open hand takes the fruit between its fingers
            tool = robot.forward(row)
            offset = tool[:3, 3] - centre
            assert np.linalg.norm(offset - (offset @ T[:3, 2]) * T[:3, 2]) < 0.002
            assert np.arccos(np.clip((np.trace(tool[:3, :3].T @ T[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)) < np.radians(2.0)
        assert np.linalg.norm(robot.forward(q)[:3, 3] - centre) == pytest.approx(0.08, abs=1e-5)
    again = goals(scene, fruit_target(centre), arm)
    np.testing.assert_array_equal(again.configurations, found.configurations)
    # Goals that are the same grasp but for whole turns are goals of their own; others are apart from each other.
    assert all(np.abs(a - b).max() > 0.1 for a, b in itertools.combinations(found.configurations, 2))


def test_what_is_not_looked_at_could_not_have_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = plant(5)
    target = fruit_target(scene.fruit_centres[1])
    found = goals(scene, target)
    monkeypatch.setattr(Trials, "leave_dearer", lambda self, wanted: None)
    whole = goals(scene, target)
    assert found.approaches is not None and whole.approaches is not None
    np.testing.assert_array_equal(found.configurations, whole.configurations)
    np.testing.assert_array_equal(found.costs, whole.costs)
    np.testing.assert_array_equal(found.approaches.poses, whole.approaches.poses)
    spared = found.approaches.outcomes == DEARER
    assert spared.sum() > 50 and not (whole.approaches.outcomes == DEARER).any()
    np.testing.assert_array_equal(found.approaches.outcomes[~spared], whole.approaches.outcomes[~spared])
    # Of candidates each is looked at.
    monkeypatch.undo()
    named = goals(scene, candidates_target(found.approaches.poses[spared]))
    assert named.approaches is not None and not (named.approaches.outcomes == DEARER).any() and named.free > 20


def test_refusals_count_what_became_of_the_approaches() -> None:
    scene, centre = fruit_scene()
    far = goals(scene, fruit_target([2.0, 0.0, 0.5]))
    assert far.status is Status.NO_IK_SOLUTION and "360 approaches tried: 360 out of reach" in far.sentence
    caged = Scene.from_points(np.concatenate([scene.fruit_points, ball(centre, 0.05)]), [2] * len(scene.fruit_points) + [1] * 300)
    refused = goals(caged, fruit_target(centre))
    assert refused.status is Status.GOAL_IN_STEM and refused.free == 0
    assert "approaches tried" in refused.sentence and "blocked, most often through the branch at" in refused.sentence
    exact = goals(caged, pose_target([*centre, 0.0, 0.7071, 0.0, 0.7071]), target_exclusion_radius_m=0.0)
    assert exact.status is not None and "the fruit itself as the target, leaves the approach open" in exact.sentence


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (lambda c: {"keep_out_boxes": [9.0, 9.0, 9.0, 9.5, 9.5, 9.5, *(c - 0.1), *(c + 0.1)]}, "through keep-out box 1"),
        (lambda c: {"floor_z_m": float(c[2]) + 0.05}, "through the floor"),
        (lambda c: {"workspace_box": [-2.0, -2.0, -2.0, float(c[0]) - 0.05, 2.0, 2.0]}, "out of the workspace box"),
        (lambda c: {}, "through the branch at"),
    ],
)
def test_the_commonest_obstacle_is_named_whatever_it_is(values: Any, words: str) -> None:
    scene, centre = fruit_scene()
    parts = [scene.fruit_points, scene.stem_points, ball(centre, 0.05) if not values(centre) else ball(centre + [0.0, 0.0, 0.3], 0.01)]
    labels = np.repeat([2, 1, 1], [len(part) for part in parts])
    refused = goals(Scene.from_points(np.concatenate(parts), labels), fruit_target(centre), **values(centre))
    assert refused.status is Status.GOAL_IN_STEM and words in refused.sentence, refused.sentence


def test_where_nothing_is_free_it_looks_around_what_lacks_least() -> None:
    scene = plant(10, "dense")
    assert scene.fruit_centres is not None
    target = fruit_target(scene.fruit_centres[0])
    even = goals(scene, target, seed=1, max_grasps=1)
    assert even.status is Status.GOAL_IN_STEM and even.tried == 1
    tried = [goals(scene, target, seed=seed) for seed in range(1, 7)]
    assert all(found.status is None for found in tried), [found.sentence for found in tried]
    # Some needed more than the approaches that are spread evenly: then no more are tried than allowed.
    assert max(found.tried for found in tried) > 360 and all(found.tried <= 1000 for found in tried)


def test_where_no_way_leads_to_the_cheapest_grasps_dearer_ones_are_searched_for(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = plant(67)
    assert scene.fruit_centres is not None and scene.target_pose is not None
    centre = scene.fruit_centres[np.linalg.norm(scene.fruit_centres - scene.target_pose[:3], axis=1).argmin()]
    used, target, robot = settings(iterations=16_000), fruit_target(centre), robot_named(J2S)
    few = goals(scene, target, seed=1)
    assert few.status is None and few.more is not None
    more = few.more()
    assert more.status is None and more.more is None
    distinct = [len(np.unique(found.poses.round(9), axis=0)) for found in (few, more)]
    assert distinct[0] < distinct[1] <= used.max_goals
    assert more.costs.max() > few.costs.max()
    result = pipeline_of(J2S).plan(scene, target, robot.home, used, seed=1)
    assert result.succeeded, result.message
    assert result.iterations <= 16_500
    # A search that finds a path at once never asks for them.
    asked = []
    easy = dataclasses.replace(few, more=lambda: asked.append(1))
    monkeypatch.setattr(core, "goals_of", lambda *_: easy)
    free = scene_of([[0.0, 0.0, 1.8]])
    assert pipeline_of(J2S).plan(free, target, robot.home, settings(iterations=300), seed=1).succeeded and not asked


def test_candidates_and_freedom() -> None:
    scene, centre = fruit_scene()
    free = goals(scene, fruit_target(centre))
    outcomes = free.approaches
    assert outcomes is not None
    blocked = outcomes.poses[outcomes.outcomes == HAND_BLOCKED][:20]
    assert goals(scene, candidates_target(blocked)).status is Status.GOAL_IN_STEM
    one = goals(scene, candidates_target(np.concatenate([blocked, free.poses[:1]])))
    assert one.status is None and one.tried == 21 and one.free == 1
    np.testing.assert_allclose(one.poses, np.tile(free.poses[0], (len(one.poses), 1, 1)), atol=1e-9)
    for freedom in ("roll", "cone"):
        chosen = goals(scene, pose_target(free.poses[0], freedom))
        assert chosen.status is None and len(chosen.poses) > 1
        turned = np.arccos(np.clip(chosen.poses[:, :3, 2] @ free.poses[0][:3, 2], -1.0, 1.0))
        assert turned.max() < 1e-5 if freedom == "roll" else 0.1 < turned.max() <= np.pi / 2 + 1e-6


def test_an_exact_pose_takes_the_stretch_that_there_is() -> None:
    robot = robot_named(J2S)
    T = robot.forward(robot.home + [0.3, 0.2, -0.2, 0.1, 0.2, 0.0])
    behind_the_fingers = T[:3, 3] + np.array([[0.1, 0.0, -0.085], [-0.1, 0.0, -0.085]]) @ T[:3, :3].T
    for points, least_m, most_m in (((), 0.0799, 0.0801), (behind_the_fingers, 0.015, 0.075)):
        result = pipeline_of(J2S).plan(scene_of(points), T, robot.home, settings(iterations=400), seed=1)
        assert result.succeeded, result.message
        assert least_m <= result.straight_approach_m <= most_m
        assert ("are straight" in result.message) == (most_m < 0.08)
        np.testing.assert_allclose(robot.forward(result.waypoints[-1]), T, atol=1e-5)


@pytest.mark.parametrize("arm", [J2S, J2N])
def test_a_plan_ends_along_the_palms_axis(arm: str) -> None:
    result, scene = picked(arm)
    assert result.succeeded, result.message
    robot = robot_named(arm)
    figures = result.figures()
    assert figures["target_kind"] == "fruit" and figures["grasps_tried"] in (600, 800, 1000) and 0 < figures["grasps_free"] < 1000
    assert result.T_base_tool is not None and result.trajectory is not None
    rows = result.trajectory.configurations(0.002)
    tools = np.array([robot.forward(q) for q in rows])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tools[:, :3, 3], axis=0), axis=1))])
    last = tools[along > along[-1] - figures["straight_approach_m"]]
    offset = last[:, :3, 3] - result.T_base_tool[:3, 3]
    z = result.T_base_tool[:3, 2]
    assert np.linalg.norm(offset - (offset @ z)[:, None] * z, axis=1).max() < 0.002
    assert (np.diff(offset @ z) > -1e-6).all()  # it only goes forward
    for tool in last:
        assert np.arccos(np.clip((np.trace(tool[:3, :3].T @ result.T_base_tool[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)) < np.radians(2.0)
    # One motion: the arm does not stop where the straight stretch begins.
    speeds = np.abs(result.trajectory.velocities).max(axis=1)
    assert speeds[1:-1].min() > 0.0
    # No link touches the fruit, not even the hand around it.
    checker = ExactChecker(robot, scene.fruit_points, point_radius_m=0.001)
    assert checker.certify(rows).ok


@pytest.mark.parametrize("leaf_speed_scale", [1.0, 0.3])
def test_where_asked_for_the_arm_rests_before_the_straight_stretch_and_after_it_on_the_way_back(leaf_speed_scale: float) -> None:
    result, scene = picked(J2S)
    assert result.trajectory is not None and result.straight_from is not None
    pipeline, begin = pipeline_of(J2S), result.waypoints[result.straight_from]
    last = len(result.waypoints) - 1
    assert 0 < result.straight_from < last
    out = slice(result.straight_from, last + 1)
    back = slice(0, last - result.straight_from + 1)
    for waypoints, straight in ((result.waypoints, out), (result.waypoints[::-1], back)):
        moved = {}
        for stop in (False, True):
            used = settings(stop_before_approach=stop, leaf_speed_scale=leaf_speed_scale)
            again = pipeline.follow(waypoints, scene, result.target, used, straight=straight)
            assert again.succeeded, again.message
            assert again.trajectory is not None
            moved[stop] = again.trajectory
        at_rest = np.flatnonzero(~moved[True].velocities.any(axis=1))
        assert len(at_rest) == 3 and moved[False].velocities[1:-1].any(axis=1).all()
        np.testing.assert_allclose(moved[True].positions[at_rest], [waypoints[0], begin, waypoints[-1]], atol=1e-9)
        assert moved[True].duration_s > moved[False].duration_s
        # On either side of the rest the arm is as slow among leaves as without it.
        assert np.abs(moved[True].velocities).max() <= np.abs(moved[False].velocities).max() * 1.3
    # Without a stretch, or with nothing but one, there is nowhere to rest.
    used = settings(stop_before_approach=True)
    for waypoints, straight in ((result.waypoints[:2], None), (result.waypoints[out], slice(0, last - result.straight_from + 1))):
        motion = pipeline.follow(waypoints, scene, result.target, used, straight=straight).trajectory
        assert motion is not None and motion.velocities[1:-1].any(axis=1).all()


def test_a_stop_is_heard_while_grasps_are_looked_for() -> None:
    scene, centre = fruit_scene()
    used = settings()
    obstacles = pipeline_of(J2S).obstacles(scene, fruit_target(centre).spot(scene, used), used)
    asked = itertools.count()
    with pytest.raises(Refusal) as stopped:
        goals_of(
            obstacles,
            obstacles.exact_checker(),
            fruit_target(centre),
            robot_named(J2S).home,
            np.random.default_rng(1),
            lambda: next(asked) > 5,
        )
    assert stopped.value.status is Status.CANCELLED
