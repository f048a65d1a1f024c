"""The front door for Python: friendly, typed, and the same pipeline behind it."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from arm_helpers import plant, robot_named

import lime_planner
from lime_planner import LimePlannerError, PlanResult, PlantOptions, PlausibilityWarning, Robot, Scene, Status, draw, generate_plant, plan
from lime_planner.api import _warm_pipeline
from lime_planner.core.errors import ParameterError, ProblemError, SceneError
from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.robot.model import load_robot


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_named()


@pytest.fixture(scope="module")
def result(robot: Robot) -> PlanResult:
    return plan(plant(15), robot, seed=2, iterations=400)


def test_a_plan_in_one_call(robot: Robot, result: PlanResult) -> None:
    assert result.succeeded and result.status is Status.SUCCEEDED, result.message
    pose = plant(15).target_pose
    assert pose is not None and result.target is not None and result.target.kind == "fruit" and result.T_base_tool is not None
    assert result.T_base_tool[:3, 3] == pytest.approx(pose[:3], abs=1e-3)  # at the lime, from wherever is best
    again = plan(plant(15), robot, target=result.target, start=robot.home, seed=2, iterations=400)
    assert np.array_equal(again.waypoints, result.waypoints)
    assert result.q_start == pytest.approx(robot.home)
    exact = plan(plant(15), robot, target=pose_to_matrix(pose), seed=2, iterations=400)
    assert exact.T_base_tool == pytest.approx(pose_to_matrix(pose))
    one_of = plan(plant(15), robot, candidates=result.T_base_tool[None], seed=2, iterations=400)
    assert one_of.succeeded and one_of.grasps_tried == 1 and one_of.T_base_tool == pytest.approx(result.T_base_tool)
    assert _warm_pipeline(robot)[0] is _warm_pipeline(robot)[0]


def test_a_result_is_easy_to_look_at(result: PlanResult) -> None:
    assert repr(result) == f"<PlanResult {result.message}>"
    table = result._repr_html_()
    assert "<b>SUCCEEDED</b>" in table and f"{result.path_length_rad:.2f}" in table and table.count("<tr>") == 8
    refused = PlanResult(Status.NO_PATH, "NO_PATH: <none>", "lime_star", 1)
    assert "&lt;none&gt;" in refused._repr_html_() and refused._repr_html_().count("<tr>") == 2
    assert not refused.succeeded


def test_a_result_is_saved_as_the_command_line_saves_it(result: PlanResult, tmp_path: Path) -> None:
    path = result.save(tmp_path / "deep" / "plan.json")
    kept = json.loads(path.read_text())
    assert kept.items() >= json.loads(json.dumps(result.figures())).items()
    assert kept["parameters"] == {
        **{"seed": 2, "iterations": 400, "robot": "kinova_j2s6s200", "planning_frame": "base", "tool_frame": "j2s6s200_end_effector"},
        "arm_joints": list(robot_named().joint_names),
    }
    assert kept["start"] == pytest.approx(robot_named().home) and kept["target_pose"] == pytest.approx(matrix_to_pose(result.T_base_tool))
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterError, match="cannot be written"):
        result.save(tmp_path / "file" / "plan.json")


def test_found_and_refused_plans_are_drawn(robot: Robot, result: PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = {}
    monkeypatch.setattr("lime_planner.output.picture.draw_picture", lambda *args, **options: given.update(options) or args[0])
    assert draw(result, plant(15), robot, tmp_path / "a.png") == tmp_path / "a.png"
    assert given["q_goal"] == pytest.approx(result.waypoints[-1]) and "leaf contact" in given["title"]
    start = robot.home + 0.1
    refused = PlanResult(Status.NO_PATH, "NO_PATH: none", "lime_star", 1, q_start=start)
    draw(refused, plant(15), robot, tmp_path / "b.png")
    assert given["q_goal"] is None and given["q_start"] is start and given["title"] == "NO_PATH"


def test_callers_mistakes_are_named(robot: Robot) -> None:
    scene = plant(15)
    with pytest.raises(ParameterError, match="did you mean time_budget_s"):
        plan(scene, robot, time_budget=1.0)
    for slip, meant in (("tagret", "target"), ("candidate", "candidates"), ("max_leaf_contact", "max_leaf_contact_rad")):
        with pytest.raises(ParameterError, match=f"there is no parameter '{slip}'; did you mean {meant}"):
            plan("is not even looked for.npz", "nor this", **{slip: 1})  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="motion_enabled: only the node"):
        plan(scene, robot, motion_enabled=True)
    with pytest.raises(ParameterError, match="tool_frame: the robot is loaded already"):
        plan(scene, robot, tool_frame="hand")
    with pytest.raises(ProblemError, match="7 numbers x y z qx qy qz qw"):
        plan(scene, robot, target=[0.5, 0.0, 0.5, 0.0])
    with pytest.raises(ProblemError, match="give one of them"):
        plan(scene, robot, fruit=0, candidates=[scene.target_pose])
    with pytest.raises(ProblemError, match="fruit 99 is not there"):
        plan(scene, robot, fruit=99)
    with pytest.raises(ProblemError, match="empty list"):
        plan(scene, robot, candidates=[])
    for arguments, words in (
        ({"target": "abc"}, "target must be numbers, got 'abc'"),
        ({"target": np.full((4, 4), np.nan)}, "target: the target needs a finite 4 x 4 pose"),
        ({"target": [0.5, 0, 0.5, 0, 0, 0, 0]}, "target: the quaternion has length 0.0e"),
        ({"start": "home"}, "the start must be numbers, got 'home'"),
        ({"start": [0.0, 1.0]}, "the start needs 6 finite joint angles, got [0.0, 1.0]"),
        ({"deadline_s": "1"}, "deadline_s must be a time in seconds or None, got '1'"),
        ({"deadline_s": float("nan")}, "deadline_s must be a time in seconds or None, got nan"),
    ):
        with pytest.raises(ProblemError) as refused:
            plan(scene, robot, **arguments)
        assert str(refused.value).startswith(words)
    bare = Scene.from_points(scene.stem_points, np.ones(len(scene.stem_points), int))
    with pytest.raises(SceneError, match="no target_pose"):
        plan(bare, robot)
    foreign = Scene.from_points(scene.stem_points, np.ones(len(scene.stem_points), int), frame_id="camera")
    with pytest.raises(SceneError, match="in the frame 'camera'"):
        plan(foreign, robot, target=[0.5, 0, 0.5, 0, 0, 0, 1])


def test_scenes_and_robots_load_by_their_class(tmp_path: Path) -> None:
    options = PlantOptions(density="sparse", n_limes=2)
    scene = generate_plant(3, options)
    assert np.array_equal(scene.leaf_points, generate_plant(np.random.default_rng(3), options).leaf_points)
    scene.save(tmp_path / "a.npz")
    again = Scene.load(tmp_path / "a.npz", offset=(0.1, 0.0, 0.0))
    assert again.frame_id == "base"
    assert again.stem_points == pytest.approx(scene.stem_points + np.float32([0.1, 0.0, 0.0]), abs=1e-6)
    scene.save(tmp_path / "a.ply")
    assert Scene.load(tmp_path / "a.ply").frame_id == "" and Scene.load(tmp_path / "a.ply", frame_id="base").frame_id == "base"
    assert "no target" in repr(Scene.load(tmp_path / "a.ply")) and "with a target" in repr(scene)
    robot = Robot.load("kinova_j2n6s300")
    assert robot.joint_names == load_robot("kinova_j2n6s300").joint_names
    assert repr(robot) == "<Robot kinova_j2n6s300: 6 joints, from base to j2n6s300_end_effector>"


def test_names_and_files_will_do(tmp_path: Path) -> None:
    path = tmp_path / "plant.npz"
    plant(15).save(path)
    result = plan(str(path), "kinova_j2s6s200", seed=2, iterations=400)
    again = plan(path, robot_named(), seed=2, iterations=400)
    assert result and np.array_equal(result.waypoints, again.waypoints)
    assert draw(result, path, "kinova_j2s6s200", tmp_path / "plan.png").stat().st_size > 20_000
    refused = plan(path, "kinova_j2s6s200", target=(9.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0), iterations=10)
    assert not refused and refused.status is Status.NO_IK_SOLUTION


@pytest.mark.parametrize(
    ("arguments", "keywords", "sentence"),
    [
        ((5, "kinova_j2s6s200"), {}, "scene must be a Scene or the path of a scene file, got 5"),
        (("missing.npz", "kinova_j2s6s200"), {}, "missing.npz"),
        ((None, None), {}, "robot must be a Robot, the name of a built-in arm or a URDF file, got None"),
        ((None, "kinova_j2s6s20"), {}, "'kinova_j2s6s20' is neither a built-in arm"),
        ((plant(15), "kinova_j2s6s200"), {"time_budget_s": "long"}, "time_budget_s must be a number, got 'long'"),
        ((plant(15), "kinova_j2s6s200"), {"planner": "rrt"}, "planner is 'rrt'"),
        ((plant(15), "kinova_j2s6s200"), {"seed": 1.5}, "seed must be a whole number, got 1.5"),
    ],
)
def test_a_wrong_argument_is_named(arguments: tuple[object, object], keywords: dict[str, object], sentence: str) -> None:
    with pytest.raises(LimePlannerError, match=re.escape(sentence)):
        plan(*arguments, **keywords)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: Scene.load(3), "a scene is loaded from the path of a file, got 3"),  # type: ignore[arg-type]
        (lambda: Robot.load(None), "the path of a URDF file, got None"),  # type: ignore[arg-type]
        (lambda: Scene("a", 1, 2, 3), "leaf_points: one number or text"),  # type: ignore[arg-type]
        (lambda: generate_plant("x"), "rng must be a seed, a whole number of at least 0, or a NumPy generator, got 'x'"),  # type: ignore[arg-type]
        (lambda: generate_plant(-1), "rng must be a seed, a whole number of at least 0, or a NumPy generator, got -1"),
        (lambda: generate_plant(1, "dense"), "options must be PlantOptions, got 'dense'"),  # type: ignore[arg-type]
        (lambda: generate_plant(1, PlantOptions(position_m=(float("nan"), 0.0, 0.0))), "position_m: nan 0 0 is outside"),
    ],
)
def test_what_makes_no_scene_or_robot_is_named(call: Callable[[], object], sentence: str) -> None:
    with pytest.raises(LimePlannerError, match=re.escape(sentence)):
        call()


def test_what_is_hardly_meant_is_a_warning(robot: Robot) -> None:
    scene, pose = plant(15), plant(15).target_pose
    assert pose is not None
    with pytest.warns(PlausibilityWarning, match="the quaternion 0 90 0 1 has the length 90") as given:
        result = plan(scene, robot, target=(*pose[:3], 0.0, 90.0, 0.0, 1.0), iterations=10)
    assert [Path(warning.filename).name for warning in given] == ["test_api.py"]
    assert len(result.warnings) == 1 and repr(result).endswith(f"; warning: {result.warnings[0]}>")
    assert f"<p>warning: {result.warnings[0]}</p>" in result._repr_html_()
    points, labels, _ = scene.labelled_points()
    with pytest.warns(PlausibilityWarning, match="is that in millimetres"):
        plan(Scene.from_points(1000.0 * points, labels), robot, target=pose[:3], iterations=10)
    crooked = dataclasses.replace(scene, target_pose=pose * [1, 1, 1, 3, 3, 3, 3], fruit_centres=None, fruit_radii=None)
    with pytest.warns(PlausibilityWarning, match="has the length 3, not 1"):
        plan(crooked, robot, iterations=10)
    with pytest.warns(PlausibilityWarning, match="grasp candidate 2 of 2: the quaternion"):
        plan(scene, robot, candidates=[pose, pose * [1, 1, 1, 3, 3, 3, 3]], iterations=10)


def test_dir_shows_the_public_names_alone() -> None:
    assert set(dir(lime_planner)) == {*lime_planner.__all__, "__version__"}
