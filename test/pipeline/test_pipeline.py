"""The pipeline end to end: plans on a plant and on real scans, checked again by other means, and what callers rely on."""

from __future__ import annotations

import dataclasses
import json
import time
from functools import cache
from typing import Any

import numpy as np
import pytest
from arm_helpers import near_configurations, pipeline_of, plant, robot_named, scan, scene_of, settings

from benchmarks.node.acceptance_scans import contacts, end_errors, independent_checker
from lime_planner.core.errors import ProblemError
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import Settings
from lime_planner.core.status import Status
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline import PlanResult
from lime_planner.pipeline.certify import contract_violations
from lime_planner.robot.model import home
from lime_planner.scene.plants.grasp_targets import canopy_targets, lime_targets
from lime_planner.scene.scene import Scene

J2S, J2N = "kinova_j2s6s200", "kinova_j2n6s300"
QUICK = {"iterations": 600, "ik_starts": 128}


def plan(scene: Scene, T: Any, q: Any = None, arm: str = J2S, *, seed: int = 1, deadline_s: float | None = None, **values: Any) -> Any:
    start = home(robot_named(arm)) if q is None else q
    return pipeline_of(arm).plan(scene, T, start, settings(**(QUICK | values)), seed=seed, deadline_s=deadline_s)


@cache
def problem(name: str) -> tuple[Scene, np.ndarray]:
    """A scene and a target pose that can be reached."""
    if name == "plant":
        scene = plant()
        poses = [scene.target_pose, *lime_targets(scene, np.random.default_rng(0))]
    else:
        scene = scan(name)
        poses = canopy_targets(scene, np.random.default_rng(0), 8)
    for pose in poses:
        result = plan(scene, pose_to_matrix(pose))
        if result.status is Status.SUCCEEDED:
            return scene, pose_to_matrix(pose)
    raise AssertionError(f"none of the targets of {name} is reached")


def examine(result: PlanResult, scene: Scene, T: np.ndarray, q: np.ndarray, used: Settings, arm: str = J2S) -> None:
    """Everything that is promised of a plan that succeeded."""
    assert result.status is Status.SUCCEEDED, result.message
    assert result.message.startswith("SUCCEEDED: ")
    robot = robot_named(arm)
    assert isinstance(result.trajectory, Trajectory)
    np.testing.assert_array_equal(result.waypoints[0], q)
    np.testing.assert_allclose(result.trajectory.positions[0], q, atol=1e-9)
    np.testing.assert_allclose(result.trajectory.positions[-1], result.waypoints[-1], atol=1e-6)
    assert contract_violations(robot, result.trajectory, q, used) == []
    assert result.goal_error_m < 1e-4 and result.goal_error_rad < 1e-3
    # Every stem point, at 0.01 rad, by a checker that the pipeline did not make.
    assert contacts(independent_checker(robot, scene, T[:3, 3], used), result) == []
    for name, error in end_errors(robot, result.trajectory, T).items():
        assert error < 0.005, name
    assert (np.abs(result.waypoints - q) <= 2.0 * np.pi + 1e-6).all()
    for row in result.waypoints:
        assert robot.limit_violation(row, 1e-6) is None
    # The figures fit together.
    assert result.path_length_rad == pytest.approx(np.linalg.norm(np.diff(result.waypoints, axis=0), axis=1).sum(), rel=1e-9)
    assert result.cost == pytest.approx(result.path_length_rad + result.collision_cost, rel=1e-9)
    assert 0.0 <= result.leaf_contact_rad <= result.path_length_rad + 1e-9
    assert 0.0 <= result.tool_leaf_contact_m <= result.tool_path_length_m + 1e-9
    tool = pose_to_matrix(result.tool_path[-1])
    np.testing.assert_allclose(tool, T, atol=1e-3)
    np.testing.assert_allclose(pose_to_matrix(result.tool_path[0]), robot.forward(q), atol=1e-6)
    assert len(result.tool_leaf) == len(result.tool_path)
    if used.leaf_cost == "binary" and used.leaf_policy == "permeable" and result.cost_metric == "integral":
        assert result.collision_cost == pytest.approx(used.weight * result.leaf_contact_rad, rel=1e-6)
    assert {"fields", "inverse_kinematics", "search", "certificate", "timing", "figures"} <= set(result.phases_s)
    assert sum(v for k, v in result.phases_s.items() if k != "first_path") <= result.planning_time_s + 1e-6


@pytest.mark.parametrize("name", ["plant", "seedling", "h01p179", "h01p429"])
def test_plans_hold_what_they_promise(name: str) -> None:
    scene, T = problem(name)
    for seed, values in ((1, {}), (2, {"leaf_cost": "graded"}), (3, {"velocity_scaling": 0.5, "leaf_speed_scale": 0.4})):
        result = plan(scene, T, seed=seed, **values)
        examine(result, scene, T, home(robot_named()), settings(**(QUICK | values)))


def test_the_other_arm() -> None:
    scene, robot = plant(), robot_named(J2N)
    done = 0
    for q in near_configurations(robot, np.random.default_rng(1), 60, np.median(scene.leaf_points, axis=0), 0.2):
        T = robot.forward(q)
        result = plan(scene, T, arm=J2N)
        if result.status is Status.SUCCEEDED:
            examine(result, scene, T, home(robot), settings(**QUICK), J2N)
            done += 1
        else:
            assert result.status is Status.GOAL_IN_STEM, result.message
        if done == 3:
            return
    raise AssertionError("fewer than three poses among the leaves are reached")


@pytest.mark.parametrize("planner", ["apf_rrt_star", "rrt_star", "p_rrt_star"])
def test_the_papers_planners_go_the_same_way(planner: str) -> None:
    scene, T = problem("seedling")
    for seed in range(1, 6):
        result = plan(scene, T, seed=seed, planner=planner, paper=True, iterations=8000, leaf_policy="permeable")
        assert result.cost_metric == "node" and result.planner == planner
        if result.status is Status.SUCCEEDED:
            examine(result, scene, T, home(robot_named()), settings(planner=planner, paper=True))
            return
        assert result.status in (Status.NO_PATH, Status.PATH_INVALID), result.message
    raise AssertionError("no seed found a path")


@pytest.mark.parametrize("planner", ["apf_rrt_star", "rrt_star", "p_rrt_star"])
def test_their_trees_reach_what_the_default_reaches(planner: str) -> None:
    for name in ("seedling", "plant", "h01p429"):
        scene, T = problem(name)
        values = {"planner": planner, "iterations": 1500, "leaf_policy": "permeable"}
        result, default = plan(scene, T, **values), plan(scene, T, **(values | {"planner": "lime_star"}))
        assert result.cost_metric == "integral" and result.status is default.status is Status.SUCCEEDED, (name, result.message)
        examine(result, scene, T, home(robot_named()), settings(**values))
        assert result.cost < 5.0 * default.cost, name


def test_clearance_is_the_meshes_own() -> None:
    """`min_stem_clearance_m` against the exact distances along the path."""
    from lime_planner.pipeline.figures import MEASURED_STEP_RAD, sample_path

    for name in ("plant", "h01p429"):
        scene, T = problem(name)
        result = plan(scene, T)
        checker = pipeline_of().obstacles(scene, T[:3, 3], settings(**QUICK)).exact_checker()
        exact = min(checker.stem_distance(q) for q in sample_path(result.waypoints, MEASURED_STEP_RAD)[0])
        assert result.min_stem_clearance_m == pytest.approx(exact, abs=0.0015)


def test_leaf_policies() -> None:
    scene, T = problem("h01p429")
    results = {policy: plan(scene, T, leaf_policy=policy, iterations=3000) for policy in ("permeable", "ignored", "solid")}
    for policy, result in results.items():
        if policy == "solid" and result.status is not Status.SUCCEEDED:
            assert result.status in (Status.GOAL_IN_STEM, Status.NO_PATH)
            continue
        examine(result, scene, T, home(robot_named()), settings(**(QUICK | {"leaf_policy": policy})))
    permeable, ignored = results["permeable"], results["ignored"]
    assert ignored.path_length_rad <= permeable.path_length_rad + 1e-9
    assert permeable.cost <= 1.02 * ignored.cost  # weighed alike
    assert permeable.leaf_contact_rad <= ignored.leaf_contact_rad + 0.05


def test_solid_leaves_are_not_touched() -> None:
    leaf = np.array([0.3, -0.5, 0.5]) + np.random.default_rng(0).uniform(-0.1, 0.1, (300, 3))
    robot = robot_named()
    q = home(robot)
    T = robot.forward(q + np.array([0.8, 0.0, 0.0, 0.0, 0.0, 0.0]))
    scene = scene_of([[0.0, 0.0, 1.6]], leaf)
    result = plan(scene, T, leaf_policy="solid")
    examine(result, scene, T, q, settings(**(QUICK | {"leaf_policy": "solid"})))
    assert result.leaf_contact_rad == 0.0
    assert result.min_stem_clearance_m > 0.004  # to leaves as well


@pytest.mark.parametrize("arm", [J2S, J2N])
def test_a_start_several_turns_away(arm: str) -> None:
    """Continuous joints keep the turns they were measured with, and no joint goes further than one turn."""
    robot = robot_named(arm)
    turns = np.where(robot.continuous, 2.0 * np.pi * np.array([3, 0, 0, -4, 2, -2]), 0.0)
    q = home(robot) + turns
    T = robot.forward(home(robot) + np.array([0.6, 0.2, -0.3, 0.5, 0.1, 2.0]))
    scene = scene_of([[0.0, 0.0, 1.8]])
    result = plan(scene, T, q, arm)
    examine(result, scene, T, q, settings(**QUICK), arm)
    plain = plan(scene, T, home(robot), arm)
    assert result.path_length_rad == pytest.approx(plain.path_length_rad, rel=0.3)


def test_a_start_inside_the_margin_is_left_towards_more_clearance() -> None:
    robot = robot_named()
    q = home(robot)
    hand = next(link for link in robot.links if link.name.endswith("link_6"))
    pose = robot.link_poses(q)[hand.joint]
    surface = hand.vertices @ pose[:3, :3].T + pose[:3, 3]
    outward = surface[surface[:, 0].argmax()]
    place = outward + np.array([0.004 + 0.002, 0.0, 0.0])  # 2 mm from the ball's surface
    scene = scene_of(place + np.linspace(0.0, 0.2, 50)[:, None] * [1.0, 0.0, 0.0])
    T = robot.forward(q + np.array([1.0, 0.3, 0.0, 0.0, 0.2, 0.0]))
    checker = independent_checker(robot, scene, T[:3, 3], settings())
    before = checker.stem_distance(q)
    assert 0.0 < before < settings().stem_margin_m
    result = plan(scene, T, target_exclusion_radius_m=0.0)
    examine(result, scene, T, q, settings(**(QUICK | {"target_exclusion_radius_m": 0.0})))
    # As close as where it stands, never closer by more than the model's error, and away within a few steps.
    clearance = [checker.stem_distance(row) for row in result.trajectory.configurations(0.01)[:120]]
    assert min(clearance) > before - 0.001
    assert clearance[-1] > settings().stem_margin_m


def test_same_seed_same_motion() -> None:
    scene, T = problem("plant")
    one, two, other = plan(scene, T, seed=7), plan(scene, T, seed=7), plan(scene, T, seed=8)
    np.testing.assert_array_equal(one.waypoints, two.waypoints)
    np.testing.assert_array_equal(one.trajectory.positions, two.trajectory.positions)
    assert one.cost == two.cost and one.iterations == two.iterations == other.iterations
    assert not np.array_equal(one.waypoints, other.waypoints)
    drawn = plan(scene, T, seed=0)
    assert drawn.seed > 0 and plan(scene, T, seed=0).seed != drawn.seed
    np.testing.assert_array_equal(plan(scene, T, seed=drawn.seed).waypoints, drawn.waypoints)
    named = pipeline_of().plan(scene, T, home(robot_named()), settings(**(QUICK | {"seed": 5})))
    assert named.seed == 5


def test_figures_are_plain_json() -> None:
    scene, T = problem("seedling")
    for result in (plan(scene, T), plan(scene, T, iterations=0, time_budget_s=0.05), plan(scene, np.eye(4) + 3.0 * np.eye(4, k=3))):
        figures = result.figures()
        again = json.loads(json.dumps(figures, allow_nan=False))
        assert again == figures
        names = "status message planner seed iterations planning_time_s cost cost_metric path_length_rad collision_cost n_collision_nodes"
        names += " leaf_contact_rad tool_path_length_m tool_leaf_contact_m min_stem_clearance_m waypoints trajectory"
        assert set(names.split()) <= set(figures)
        assert (figures["trajectory"] is not None) == (result.status is Status.SUCCEEDED)
        if figures["trajectory"]:
            assert set(figures["trajectory"]) == {"joint_names", "dt_s", "positions", "velocities"}


@pytest.mark.timed
def test_deadline_is_kept() -> None:
    scene, T = problem("h01p429")
    for deadline_s in (0.8, 1.6):
        over = []
        for seed in range(1, 5):
            began = time.monotonic()
            result = plan(scene, T, seed=seed, iterations=0, time_budget_s=10.0, deadline_s=deadline_s)
            over.append(time.monotonic() - began - deadline_s)
            assert result.status in (Status.SUCCEEDED, Status.TIMED_OUT), result.message
            if over[-1] < 0.1 * deadline_s:
                break
        assert min(over) < 0.1 * deadline_s, over


# ---- plans that exist already ----


@cache
def made() -> tuple[Scene, np.ndarray, PlanResult]:
    scene, T = problem("plant")
    return scene, T, plan(scene, T)


def with_stem(scene: Scene, place: np.ndarray) -> Scene:
    """The scene and a cluster of stem points around a place."""
    more = place + np.random.default_rng(0).uniform(-0.003, 0.003, (30, 3))
    return dataclasses.replace(scene, stem_points=np.concatenate([scene.stem_points, more.astype(np.float32)]))


def wrist_at(q: np.ndarray) -> np.ndarray:
    """A place inside the forearm, which no exclusion sphere spares."""
    robot = robot_named()
    link = next(link for link in robot.links if link.name.endswith("link_4"))
    pose = robot.link_poses(q)[link.joint]
    return pose[:3, :3] @ link.vertices[len(link.vertices) // 2] + pose[:3, 3]


def test_recheck() -> None:
    scene, _, result = made()
    pipeline, used, q = pipeline_of(), settings(**QUICK), result.waypoints[0]
    assert pipeline.recheck(result, scene, q, used)[0] is Status.SUCCEEDED
    assert pipeline.recheck(result, scene, q + 0.009, used)[0] is Status.SUCCEEDED
    status, sentence = pipeline.recheck(result, scene, q + np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0]), used)
    assert status is Status.PATH_INVALID and "j2s6s200_joint_2" in sentence and "0.02" in sentence
    status, _ = pipeline.recheck(result, scene, q + 2.0 * np.pi * robot_named().continuous, used)
    assert status is Status.PATH_INVALID  # the same place, but a turn away
    middle = result.trajectory.positions[len(result.trajectory) // 2]
    status, sentence = pipeline.recheck(result, with_stem(scene, wrist_at(middle)), q, used)
    assert status is Status.PATH_INVALID and "touches the stem point" in sentence
    refused = dataclasses.replace(result, trajectory=None)
    assert pipeline.recheck(refused, scene, q, used)[0] is Status.NOTHING_TO_EXECUTE
    with pytest.raises(ProblemError, match="6 finite"):
        pipeline.recheck(result, scene, q[:5], used)


def test_a_check_that_was_stopped_never_passes_for_clear() -> None:
    """Even by somebody who wants to stop only once: what remained of the motion was not looked at."""
    scene, _, result = made()
    answers = [Status.CANCELLED]
    while answers[-1] is Status.CANCELLED:
        asks = iter([False] * (len(answers) - 1) + [True])
        answers.append(
            pipeline_of().recheck(result, scene, result.waypoints[0], settings(**QUICK), should_stop=lambda it=asks: next(it, False))[0]
        )
    assert answers[-1] is Status.SUCCEEDED and len(answers) > 10  # the fields' questions, and one for every few configurations


def test_obstruction() -> None:
    scene, _, result = made()
    pipeline, used, trajectory = pipeline_of(), settings(**QUICK), result.trajectory
    assert pipeline.obstruction(result, scene, used) is None
    k = len(trajectory) // 3
    newer = with_stem(scene, wrist_at(trajectory.positions[k]))
    found = pipeline.obstruction(result, newer, used, from_time_s=0.0)
    assert found is not None and "touches the stem point" in found
    assert pipeline.obstruction(result, newer, used, from_time_s=float(trajectory.times()[k]) - 0.1) is not None
    assert pipeline.obstruction(result, newer, used, from_time_s=trajectory.duration_s + 1.0) is None
    leaves = dataclasses.replace(
        scene,
        leaf_points=np.concatenate([scene.leaf_points, newer.stem_points[-30:]]),
        leaf_costs=np.ones(len(scene.leaf_points) + 30, np.float32),
        leaf_ids=None,
    )
    assert pipeline.obstruction(result, leaves, used) is None
    assert pipeline.obstruction(dataclasses.replace(result, trajectory=None), newer, used) is None
    assert pipeline.obstruction(result, newer, used, should_stop=lambda: True) is None


def test_obstruction_beside_a_plan() -> None:
    """The watch of a running motion asks while the next plan is made: neither gets the other's obstacles."""
    from concurrent.futures import ThreadPoolExecutor

    scene, T, result = made()
    newer = with_stem(scene, wrist_at(result.trajectory.positions[len(result.trajectory) // 3]))
    used = settings(**QUICK)
    with ThreadPoolExecutor(2) as pool:
        planned = pool.submit(lambda: [plan(scene, T, seed=s).status for s in range(1, 5)])
        watched = pool.submit(lambda: [pipeline_of().obstruction(result, newer, used) is not None for _ in range(8)])
        assert watched.result() == [True] * 8
        assert planned.result() == [Status.SUCCEEDED] * 4


def test_follow_backs_out_the_same_way() -> None:
    scene, T, result = made()
    used = settings(**QUICK)
    back = pipeline_of().follow(result.waypoints[::-1], scene, T, used)
    assert back.status is Status.SUCCEEDED, back.message
    np.testing.assert_allclose(back.trajectory.positions[-1], result.waypoints[0], atol=1e-6)
    assert contract_violations(robot_named(), back.trajectory, result.waypoints[-1], used) == []
    assert contacts(independent_checker(robot_named(), scene, T[:3, 3], used), back) == []
    assert back.leaf_contact_rad == pytest.approx(result.leaf_contact_rad, abs=0.05)
    middle = result.trajectory.positions[len(result.trajectory) // 2]
    blocked = pipeline_of().follow(result.waypoints[::-1], with_stem(scene, wrist_at(middle)), T, used)
    assert blocked.status is Status.PATH_INVALID and "touches the stem point" in blocked.message
    assert blocked.trajectory is None
    stopped = pipeline_of().follow(result.waypoints[::-1], scene, T, used, should_stop=lambda: True)
    assert stopped.status is Status.CANCELLED
    without = pipeline_of().follow(result.waypoints[:1].repeat(2, axis=0) + [[0.0] * 6, [0.05] * 6], scene_of(), None, used)
    assert without.status is Status.SUCCEEDED and without.T_base_tool is None
    for bad in (result.waypoints[:1], result.waypoints[:, :5], np.full((3, 6), np.nan), np.zeros(6)):
        with pytest.raises(ProblemError, match="path"):
            pipeline_of().follow(bad, scene, T, used)


def test_threads_give_one_result_and_are_counted() -> None:
    scene, T = problem("plant")
    for threads in (2, 3):
        first, again = (plan(scene, T, threads=threads, iterations=1200) for _ in range(2))
        examine(first, scene, T, home(robot_named()), settings(**(QUICK | {"threads": threads})))
        np.testing.assert_array_equal(first.waypoints, again.waypoints)
        assert first.cost == again.cost and first.iterations == again.iterations >= 1200
        assert first.counts["configurations_checked"] == again.counts["configurations_checked"]
    alone = plan(scene, T, iterations=1200)
    assert alone.counts["configurations_checked"] < 0.7 * first.counts["configurations_checked"]
    np.testing.assert_array_equal(alone.waypoints, plan(scene, T, threads=1, iterations=1200).waypoints)
