"""`lime-planner plan`: the same pipeline, its outcomes as exit status and one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.cli import main as cli
from lime_planner.cli.arguments import label_options, read_parameters
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.motion.contract import violations
from lime_planner.motion.trajectory import Trajectory
from lime_planner.output.saved_plan import read_plan
from lime_planner.robot.model import home, load_robot
from lime_planner.scene.plants.generator import generate_plant
from lime_planner.scene.scene import Scene

#: What --json holds at least.
KEYS = {
    *("status", "message", "planner", "seed", "iterations", "planning_time_s", "cost", "cost_metric", "path_length_rad", "collision_cost"),
    *("n_collision_nodes", "leaf_contact_rad", "tool_path_length_m", "tool_leaf_contact_m", "min_stem_clearance_m", "waypoints"),
    "trajectory",
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A trunk, a sheet of leaves in front of it, and a target behind the sheet that the arm can reach."""
    rng = np.random.default_rng(5)
    robot = load_robot("kinova_j2s6s200")
    T = robot.forward(home(robot) + [0.9, 0.2, 0.2, 0.0, 0.1, 0.0])
    centre = T[:3, 3] - 0.03 * T[:3, 2]
    sheet = centre + 0.08 * (rng.uniform(-1, 1, (4000, 1)) * T[:3, 0] + rng.uniform(-1, 1, (4000, 1)) * T[:3, 1])
    trunk = T[:3, 3] + [0.0, 0.0, -0.25] + 0.18 * T[:3, 2] + rng.uniform([-0.01, -0.01, -0.3], [0.01, 0.01, 0.3], (800, 3))
    from lime_planner.core.geometry import matrix_to_pose

    points = np.concatenate([sheet, trunk])
    return Scene.from_points(points, np.repeat([0, 1], [4000, 800]), target_pose=matrix_to_pose(T))


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory: pytest.TempPathFactory, scene: Scene) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.npz"
    scene.save(path)
    return path


def run(*arguments: Any) -> int:
    return cli.main(["plan", *map(str, arguments)])


def test_plan_writes_figures_picture_and_table(scene_file: Path, scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures_file, picture = tmp_path / "deep" / "plan.json", tmp_path / "plan.png"
    assert run(scene_file, "--seed", 3, "--json", figures_file, "--picture", picture) == 0
    out, err = capsys.readouterr()
    assert err == f"made the folder {figures_file.parent}\n"
    assert "SUCCEEDED: " in out
    table = out[out.index("lime_star in") :]
    assert max(map(len, table.splitlines())) <= 80
    assert picture.stat().st_size > 10_000
    figures = json.loads(figures_file.read_text())
    assert figures.keys() >= KEYS
    assert figures["status"] == "SUCCEEDED" and figures["seed"] == 3

    robot = load_robot("kinova_j2s6s200")
    assert scene.target_pose is not None
    T_base_target = pose_to_matrix(scene.target_pose)
    assert robot.forward(figures["waypoints"][-1]) == pytest.approx(T_base_target, abs=2e-3)
    assert figures["waypoints"][0] == pytest.approx(home(robot))
    timed = figures["trajectory"]
    trajectory = Trajectory(tuple(timed["joint_names"]), timed["dt_s"], np.array(timed["positions"]), np.array(timed["velocities"]))
    assert trajectory.joint_names == robot.joint_names
    assert robot.forward(trajectory.positions[-1]) == pytest.approx(T_base_target, abs=2e-3)
    broken = violations(
        trajectory,
        q_measured=home(robot),
        lower=robot.lower,
        upper=robot.upper,
        velocity_limits=robot.velocity_limits,
        acceleration_limits=robot.acceleration_limits,
    )
    assert broken == []


def test_same_seed_and_iterations_give_the_same_path(scene_file: Path, tmp_path: Path) -> None:
    plans = []
    for name in ("a", "b"):
        assert run(scene_file, "--seed", 4, "--iterations", 300, "--json", tmp_path / name) == 0
        plans.append(json.loads((tmp_path / name).read_text()))
    assert plans[0]["waypoints"] == plans[1]["waypoints"]
    assert plans[0]["cost"] == plans[1]["cost"]


@pytest.mark.parametrize("planner", ["rrt_star", "apf_rrt_star", "p_rrt_star"])
def test_planners_by_name(scene_file: Path, tmp_path: Path, planner: str) -> None:
    """They plan; whether they find a path in few iterations as the paper has them is theirs to say."""
    choice = ("--planner", planner, "--iterations", 400, "--seed", 1, "--json", tmp_path / "a.json")
    assert run(scene_file, *choice) == 0
    figures = json.loads((tmp_path / "a.json").read_text())
    assert (figures["planner"], figures["cost_metric"]) == (planner, "integral")
    code = run(scene_file, *choice, "--set", "paper=true")
    figures = json.loads((tmp_path / "a.json").read_text())
    assert figures["planner"] == planner
    assert (code == 0) is (figures["status"] == "SUCCEEDED")
    assert figures["status"] in ("SUCCEEDED", "NO_PATH")


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--target", 3, 0, 0.5, 0, 0, 0, 1], "NO_IK_SOLUTION"),
        (["--target", 0.5, 0, 0.5, 0, 0, 0, 0], "BAD_INPUT"),
        (["--target", "nan", 0, 0.5, 0, 0, 0, 1], "BAD_INPUT"),
        (["--start", 1, 2, 3], "BAD_INPUT"),
        (["--start", 0, 0, 0, 0, 0, 0], "START_INVALID"),
        (["--set", "robot=no_such.urdf"], "BAD_INPUT"),
        (["--set", "robot=topic"], "BAD_INPUT"),
        (["--time", 0], "BAD_INPUT"),
        (["--picture", "x.bmp"], "BAD_INPUT"),
        (["--scale", 0], "BAD_INPUT"),
        (["--offset", "inf", 0, 0], "BAD_INPUT"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, list) else value,
)
def test_outcomes(scene_file: Path, arguments: list[Any], code: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(scene_file, *arguments) == 1
    out, err = capsys.readouterr()
    refused, *advice = err.splitlines()
    assert refused.startswith(f"{code}: ") and all(line.startswith("try: lime-planner ") for line in advice) and len(advice) < 2, err
    assert "picture" not in out


def test_goal_in_a_keep_out(scene_file: Path, scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    assert scene.target_pose is not None
    box = [*(scene.target_pose[:3] - 0.1).round(3).tolist(), *(scene.target_pose[:3] + 0.1).round(3).tolist()]
    assert run(scene_file, "--set", f"keep_out_boxes={box}") == 1
    assert capsys.readouterr().err.startswith("GOAL_IN_STEM: ")


def test_no_target_and_foreign_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points, labels = np.random.default_rng(1).uniform(0.5, 0.6, (50, 3)), np.ones(50, dtype=int)
    Scene.from_points(points, labels).save(tmp_path / "a.npz")
    assert run(tmp_path / "a.npz", "--json", tmp_path / "a.json") == 1
    assert capsys.readouterr().err.startswith("NO_TARGET: ")
    assert json.loads((tmp_path / "a.json").read_text())["status"] == "NO_TARGET"
    Scene.from_points(points, labels, frame_id="camera").save(tmp_path / "b.npz")
    assert run(tmp_path / "b.npz", "--target", 0.5, 0, 0.5, 0, 0, 0, 1) == 1
    assert capsys.readouterr().err.startswith("TF_ERROR: the scene is in the frame 'camera'")


def test_files_that_are_no_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, content in (("a.npz", b"not a zip"), ("b.ply", b"ply\n"), ("c.txt", b"")):
        (tmp_path / name).write_bytes(content)
        assert run(tmp_path / name) == 1
        err = capsys.readouterr().err
        assert err.startswith("BAD_INPUT: ") and name in err and err.count("\n") == 1


def test_labels_mean_the_same_as_to_the_node(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A scan whose leaves are 2 has no fruit by default; a label of two classes is refused."""
    points, target = np.concatenate([scene.leaf_points, scene.stem_points]), scene.target_pose
    labels = np.repeat([2, 1], [len(scene.leaf_points), len(scene.stem_points)])
    np.savez(tmp_path / "a.npz", points=points, labels=labels, target_pose=target)
    values = read_parameters(cli.build_parser(["plan"]).parse_args(["plan", "a.npz", "--set", "leaf_labels=[2]"]))
    assert label_options(values)["fruit_labels"] == ()
    assert run(tmp_path / "a.npz", "--set", "leaf_labels=[2]", "--iterations", 300, "--seed", 4, "--json", tmp_path / "a.json") == 0
    again = read_plan(tmp_path / "a.json").load_scene()
    assert len(again.leaf_points) == len(scene.leaf_points) and not len(again.fruit_points)
    capsys.readouterr()
    priced = ("--set", 'class_costs=["2: 0.5"]', "--iterations", 300, "--json", tmp_path / "b.json")
    assert run(tmp_path / "a.npz", *priced) == 0
    costs = read_plan(tmp_path / "b.json").load_scene().leaf_costs
    assert len(costs) == len(scene.leaf_points) and set(costs.tolist()) == {0.5}
    capsys.readouterr()
    assert run(tmp_path / "a.npz", "--set", "leaf_labels=[0,1]") == 1
    assert capsys.readouterr().err == "BAD_INPUT: leaf_labels and stem_labels share 1; a class has one meaning\n"


def test_unwritable_json_is_one_sentence(scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert run(scene_file, "--iterations", 50, "--json", tmp_path / "file" / "plan.json") == 1
    assert "cannot be written" in capsys.readouterr().err


def test_generated_plant_of_the_examples(tmp_path: Path) -> None:
    """The commands of the help and the README, with their default seed."""
    plant = generate_plant(np.random.default_rng(15))
    plant.save(tmp_path / "plant.npz")
    assert run(tmp_path / "plant.npz", "--seed", 1) == 0
