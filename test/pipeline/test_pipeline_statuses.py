"""Every outcome of the pipeline, reached by a scene or a setting that deserves it, with the numbers in the sentence."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from arm_helpers import box_of, near_configurations, pipeline_of, plant, robot_named, scene_of, settings

from lime_planner.core.errors import ProblemError
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.pipeline import PlanResult
from lime_planner.pipeline import certify as follow
from lime_planner.pipeline import pipeline as core
from lime_planner.pipeline.goals import find_goals
from lime_planner.robot.ik import solve_ik
from lime_planner.robot.model import home
from lime_planner.scene.scene import Scene

QUICK = {"iterations": 400, "ik_starts": 128}
FAR = [[0.0, 0.0, 1.8]]  # a stem out of everyone's way


def plan(scene: Any, T: Any, q: Any = None, *, should_stop: Any = None, deadline_s: float | None = None, **values: Any) -> PlanResult:
    start = home(robot_named()) if q is None else q
    more = {} if should_stop is None else {"should_stop": should_stop}
    return pipeline_of().plan(scene, T, start, settings(**(QUICK | values)), seed=1, deadline_s=deadline_s, **more)


def goal(*moves: float) -> np.ndarray:
    """Where the tool is after the joints have moved from home."""
    return robot_named().forward(home(robot_named()) + np.array([*moves, *[0.0] * (6 - len(moves))]))


def refused(result: PlanResult, status: Status, *words: str) -> None:
    """The status, the form of its message, and that nothing may be sent."""
    assert result.status is status, result.message
    assert result.message.startswith(f"{status.name}: ")
    for word in words:
        assert word in result.message, result.message
    assert result.trajectory is None
    assert result.T_base_tool is not None and result.seed == 1 and result.planning_time_s > 0.0
    assert result.figures()["trajectory"] is None


def test_start_out_of_limits() -> None:
    q = home(robot_named())
    q[1] = 0.5
    refused(plan(scene_of(FAR), goal(0.5), q), Status.START_INVALID, "j2s6s200_joint_2", "0.5000 rad", "0.8203 to 5.4629")


def test_start_in_collision_with_itself_or_a_keep_out() -> None:
    robot = robot_named()
    checker = pipeline_of().obstacles(scene_of(FAR), None, settings()).exact_checker()
    rows = np.random.default_rng(0).uniform(*box_of(robot), (3000, 6))
    folded = next(q for q in rows if (hit := checker.stem_hit(q)) is not None and hit.what == "self")
    refused(plan(scene_of(FAR), goal(0.5), folded), Status.START_INVALID, "where the arm stands", "touches j2s6s200")
    tool = goal()[:3, 3]
    box = [*(tool - 0.05), *(tool + 0.05)]
    refused(plan(scene_of(FAR), goal(1.5), keep_out_boxes=box), Status.START_INVALID, "keep-out box 0")
    refused(plan(scene_of(FAR), goal(0.5), floor_z_m=float(tool[2]) + 0.1), Status.START_INVALID, "below the floor at z = ")
    near = [-1.0, -1.0, -1.0, 1.0, float(tool[1]) + 0.05, 1.0]
    refused(plan(scene_of(FAR), goal(0.1), workspace_box=near), Status.START_INVALID, "outside the workspace box")


def test_a_fruit_inside_the_arm_is_called_the_fruit() -> None:
    result = plan(scene_of(FAR), [0.0, 0.0, 0.3])
    assert result.status is Status.START_IN_STEM
    assert "touches the fruit itself, whose centre is 0.000 0.000 0.300" in result.message and "stem" not in result.message


def hand_surface(q: np.ndarray) -> np.ndarray:
    """Points on hand and fingers (V, 3), the one with the largest x last."""
    robot = robot_named()
    pose = robot.link_poses(q)[robot.n]
    surface = np.concatenate([link.vertices for link in robot.links if link.joint == robot.n]) @ pose[:3, :3].T + pose[:3, 3]
    return surface[surface[:, 0].argsort()]


def test_start_close_to_a_keep_out_is_no_error() -> None:
    """Two millimetres beside it: less than the margin and the overhang of the fast model's spheres, and free all the same."""
    corner = hand_surface(home(robot_named()))[-1]
    box = [*(corner + [0.002, -0.05, -0.05]), *(corner + 0.05)]
    results = [plan(scene_of(FAR), goal(turn), keep_out_boxes=box) for turn in (0.6, -0.6)]
    assert [r.status for r in results] == [Status.SUCCEEDED] * 2, [r.message for r in results]


def test_start_in_a_stem() -> None:
    scene = scene_of(hand_surface(home(robot_named()))[-1] + np.linspace(-0.3, 0.3, 200)[:, None] * [0.0, 0.0, 1.0])
    refused(plan(scene, goal(1.5)), Status.START_IN_STEM, "where the arm stands", "touches the stem point (")


def test_out_of_reach_and_out_of_limits_are_told_apart() -> None:
    far = goal()
    far[:3, 3] = [2.0, 0.0, 0.5]
    result = plan(scene_of(FAR), far)
    refused(result, Status.NO_IK_SOLUTION, "the nearest that the arm gets to the pose is ", " m and ", " rad off")
    assert float(result.message.split("pose is ")[1].split(" m")[0]) > 0.8
    robot = robot_named()
    rng = np.random.default_rng(1)
    low, high = box_of(robot)
    for _ in range(500):
        q = rng.uniform(low, high)
        q[2] = rng.uniform(-0.2, 0.2)  # joint 3 folded beyond its limit of 19 degrees
        T = robot.forward(q)
        if solve_ik(robot, T, home(robot), rng, starts=128).reason == "limits":
            refused(plan(scene_of(FAR), T), Status.NO_IK_SOLUTION, "would have to be at", "outside", "rad")
            return
    raise AssertionError("no pose that only the limits forbid")


def test_goal_in_a_stem() -> None:
    T = goal(1.0)
    stem = hand_surface(home(robot_named()) + np.array([1.0, 0, 0, 0, 0, 0]))[-1] + np.linspace(0.0, 0.1, 80)[:, None] * [1.0, 0.0, 0.0]
    blocked = plan(scene_of(stem), T, target_exclusion_radius_m=0.0)
    refused(blocked, Status.GOAL_IN_STEM, "configurations that reach the target are blocked", "in a stem")
    assert blocked.counts["ik_solutions"] > 0
    box = [*(stem[0] - 0.03), *(stem[0] + 0.03)]
    refused(plan(scene_of(FAR), T, keep_out_boxes=box), Status.GOAL_IN_STEM, "in a keep-out box")
    # With the sphere the same stem is spared by the hand, and what is hidden is counted.
    spared = plan(scene_of(T[:3, 3] + np.linspace(-0.02, 0.02, 20)[:, None] * [0.0, 0.0, 1.0]), T)
    assert spared.status is Status.SUCCEEDED, spared.message
    assert spared.counts["stem_points_hidden"] == 20


def walls() -> tuple[Any, np.ndarray, np.ndarray]:
    """Stems all around the sector in which the arm stands, and a target outside it; nothing can pass.

    The upper arm starts at the shoulder (z 0.28 m), leaves it sideways by more than 0.1 m or upwards, and both ways out of the sector
    are closed: at more than 0.1 m from the axis everywhere, above 0.36 m on the axis too.
    """
    robot = robot_named()
    q = home(robot)
    q[1:3] = 4.2
    tool = robot.forward(q)[:3, 3]
    angle = np.arctan2(tool[1], tool[0])
    r, z = (g.ravel() for g in np.meshgrid(np.arange(0.0, 1.3, 0.015), np.arange(-1.0, 1.5, 0.015)))
    closed = (r > 0.1) | (z > 0.36)
    r, z = r[closed], z[closed]
    sides = [np.column_stack([r * np.cos(angle + s), r * np.sin(angle + s), z]) for s in (1.2, -1.2)]
    return scene_of(np.concatenate(sides)), robot.forward(q + np.array([2.5, 0, 0, 0, 0, 0])), q


def test_no_path_and_timed_out() -> None:
    scene, T, q = walls()
    none = plan(scene, T, q)
    refused(none, Status.NO_PATH, "no path to any of ", "goal configurations within 400 iterations")
    assert none.iterations == 400
    late = plan(scene, T, q, iterations=0, time_budget_s=0.2)
    refused(late, Status.TIMED_OUT, "no path to any of ", "within 0.20 s (")
    assert late.iterations > 0
    began = time.monotonic()
    refused(plan(scene, T, q, iterations=0, time_budget_s=30.0, deadline_s=0.8), Status.TIMED_OUT, "no path to any of ")
    assert time.monotonic() - began < 10.0  # the deadline, not the budget


def test_cancelled_in_every_phase() -> None:
    scene = plant(5)
    T = pose_to_matrix(scene.target_pose)
    plan(scene, T)
    seen = set()
    for ask in (1, 2, 3, 5, 10, 20, 40, 80, 160, 320, 640):
        asks, stopped = [0], []

        def should_stop(limit: int = ask, asks: list[int] = asks, stopped: list[tuple[float, float]] = stopped) -> bool:
            asks[0] += 1
            if asks[0] >= limit and not stopped:
                stopped.append((time.thread_time(), time.monotonic()))
            return asks[0] >= limit

        result = plan(scene, T, should_stop=should_stop)
        if not stopped:
            assert result.status is Status.SUCCEEDED
            continue
        refused(result, Status.CANCELLED, "stopped")
        assert time.thread_time() - stopped[0][0] < 0.05
        seen.add(next(reversed(result.phases_s), ""))
    assert {"fields", "search"} <= seen or {"fields", "certificate"} <= seen
    assert len(seen) >= 3


def test_it_can_be_stopped_while_the_fields_are_built() -> None:
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (40_000, 3))
    points = points[np.linalg.norm(points[:, :2], axis=1) > 0.6]  # the whole reach: as large as fields become
    scene = Scene.from_points(points, np.arange(len(points)) % 2, frame_id="base")
    asks = [0]

    def should_stop(limit: int) -> bool:
        asks[0] += 1
        return asks[0] >= limit

    refused(plan(scene, goal(0.5), should_stop=lambda: should_stop(20)), Status.CANCELLED, "stopped")
    assert asks[0] <= 21  # at once, and long before the fields are there
    result = plan(scene, goal(0.5), deadline_s=0.001)
    refused(result, Status.TIMED_OUT, "the deadline, 0.00 s after planning began, passed")
    assert not result.phases_s  # not even the fields were finished


def test_a_scene_out_of_reach_is_said_to_be() -> None:
    """A scan in millimetres: nothing is in the way, because nothing of it is here."""
    near = plant(5)
    scene = near.placed(1000.0, (0.0, 0.0, 0.0))
    result = plan(scene, pose_to_matrix(near.target_pose))
    assert result.status is Status.SUCCEEDED
    (warning,) = result.warnings
    assert warning.startswith(f"none of the scene's {scene.n_points} points is within the arm's reach of ")
    assert warning.endswith(": is that in millimetres?") and result.figures()["warnings"] == [warning]
    assert plan(near, pose_to_matrix(near.target_pose)).warnings == ()
    assert plan(scene_of(), goal(0.3)).warnings == ()


def test_leaf_budget() -> None:
    scene = plant(5)
    T = pose_to_matrix(scene.target_pose)
    result = plan(scene, T, max_leaf_contact_rad=0.0)
    refused(result, Status.LEAF_BUDGET_EXCEEDED, "the least leaf contact found is ", "allowed are 0.000 rad")
    assert result.leaf_contact_rad > 0.0 and len(result.waypoints) >= 2
    assert f"{result.leaf_contact_rad:.3f} rad" in result.message
    assert plan(scene, T, max_leaf_contact_rad=result.leaf_contact_rad + 0.01).status is Status.SUCCEEDED


def test_a_path_that_the_exact_check_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    margins = []
    search = core.search
    monkeypatch.setattr(core, "search", lambda obstacles, *a, **k: margins.append(obstacles.world.margin) or search(obstacles, *a, **k))
    monkeypatch.setattr(core, "hit_of", lambda *_: "j2s6s200_link_6 touches the stem point (0.1, 0.2, 0.3) at sample 3 of 9")
    directly = {"approach_distance_m": 0.0}
    refused(plan(scene_of(FAR), goal(0.5), **directly), Status.PATH_INVALID, "the exact check refuses the path", "link_6", "sample 3 of 9")
    assert len(margins) == 2 and margins[1] > margins[0]  # tried again, farther from the stems
    answers = iter(["touches", None])
    monkeypatch.setattr(core, "hit_of", lambda *_: next(answers))
    assert plan(scene_of(FAR), goal(0.5), **directly).status is Status.SUCCEEDED
    # A goal whose straight stretch is refused is left out, and the next one taken.
    answers = iter(["touches", None, None])
    monkeypatch.setattr(core, "hit_of", lambda *_: next(answers))
    assert plan(scene_of(FAR), goal(0.5)).status is Status.SUCCEEDED


def test_a_timed_motion_that_touches_is_timed_closer_to_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    tolerances = []
    make = follow.make_trajectory
    monkeypatch.setattr(follow, "make_trajectory", lambda *a: tolerances.append(a[3].corner_tolerance_rad) or make(*a))
    answers = iter(["finger touches", None])
    monkeypatch.setattr(follow, "hit_of", lambda *_: next(answers))
    assert plan(scene_of(FAR), goal(0.5)).status is Status.SUCCEEDED
    assert tolerances == [0.01, 0.001]
    monkeypatch.setattr(follow, "hit_of", lambda *_: "finger touches")
    refused(plan(scene_of(FAR), goal(0.5)), Status.PATH_INVALID, "the exact check refuses the timed motion: finger touches")


def test_the_target_is_where_the_arm_stands() -> None:
    for move in (0.0, 1e-7, 1e-4):
        result = plan(scene_of(FAR), goal(move))
        assert result.status is Status.SUCCEEDED, result.message
        assert result.trajectory.duration_s < 1.0
        assert len(result.trajectory) >= 2 and (result.trajectory.velocities[[0, -1]] == 0.0).all()


def test_scenes_with_nothing_in_them() -> None:
    for scene in (scene_of(), scene_of([[50.0, 0.0, 0.0]], [[40.0, 0.0, 0.0]]), scene_of([], [[0.0, 0.0, 1.5]])):
        result = plan(scene, goal(0.5, 0.2), approach_distance_m=0.0)
        assert result.status is Status.SUCCEEDED, result.message
        assert result.cost == pytest.approx(np.hypot(0.5, 0.2), rel=1e-4)  # straight
        assert result.leaf_contact_rad == 0.0 and result.min_stem_clearance_m == 0.5


def test_mistakes_are_exceptions() -> None:
    scene, T = scene_of(FAR), goal(0.5)
    reflected = T.copy()
    reflected[:3, 0] *= -1.0
    for bad, words in (
        (np.full((4, 4), np.nan), "finite 4 x 4"),
        (np.eye(3), "4 x 4"),
        (2.0 * T, "not a rotation"),
        (reflected, "not a rotation"),
    ):
        with pytest.raises(ProblemError, match=words):
            plan(scene, bad)
    with pytest.raises(ProblemError, match="the target must be numbers, got 'there'"):
        plan(scene, "there")
    for q in (np.zeros(5), np.full(6, np.inf), np.zeros((1, 6))):
        with pytest.raises(ProblemError, match="6 finite joint angles"):
            plan(scene, T, q)


def test_what_reaches_the_search_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start and goals as the search gets them are free by the exact meshes, whatever the margin there."""
    scene = plant(5)
    given = []
    search = core.search
    monkeypatch.setattr(core, "search", lambda o, q, goals, *a, **k: given.append((o, goals)) or search(o, q, goals, *a, **k))
    plan(scene, pose_to_matrix(scene.target_pose))
    obstacles, goals = given[0]
    checker = obstacles.exact_checker()
    assert len(goals.configurations) >= 1
    for q in goals.configurations:
        assert checker.stem_hit(q) is None
        np.testing.assert_allclose(robot_named().forward(goals.behind(q)[1][-1]), pose_to_matrix(scene.target_pose), atol=1e-4)


def test_no_goal_that_clears_stems_is_lost() -> None:
    """Of the solutions that the meshes find free by 3 mm or more, all are goals."""
    scene = plant(5)
    robot = robot_named()
    centre = np.median(scene.leaf_points, axis=0)
    reached = 0
    for q in near_configurations(robot, np.random.default_rng(9), 25, centre, 0.2):
        T = robot.forward(q)
        obstacles = pipeline_of().obstacles(scene, T[:3, 3], settings(max_goals=1000, **QUICK))
        checker = obstacles.exact_checker()
        solutions = solve_ik(robot, T, home(robot), np.random.default_rng(1), starts=128).solutions
        clear = [s for s in solutions if checker.stem_hit(s) is None and checker.stem_distance(s) >= 0.003]
        found = find_goals(obstacles, checker, T, home(robot), np.random.default_rng(1)).configurations
        lost = [s for s in clear if not (np.abs(found - s).max(axis=1) < 1e-4).any()] if len(found) else clear
        own = [s for s in lost if not self_is_tight(obstacles, s)]
        assert own == []
        reached += len(clear)
    assert reached > 30


def self_is_tight(obstacles: Any, q: np.ndarray) -> bool:
    from lime_planner.collision.self_contact import SELF_CLEARANCE_M
    from lime_planner.pipeline.goals import measure

    return measure(obstacles.measuring_space(), q)[1] < SELF_CLEARANCE_M
