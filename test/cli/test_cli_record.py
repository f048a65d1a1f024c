"""`lime-planner record`, from live topics and from a recording, and `lime-planner plan` on what it wrote and on the recording itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_helpers import robot_named
from domains import DOMAIN
from live_robot import HOME, JOINTS, Robot
from test_from_recording import T, at_x, cloud, joints, pose, transform, write

from lime_planner.cli import arguments
from lime_planner.cli import main as cli
from lime_planner.cli import plan as cli_plan
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.robot.model import home
from lime_planner.scene.files import load_start
from lime_planner.scene.scene import Scene

pytestmark = pytest.mark.timed


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    robot = Robot(DOMAIN)
    yield robot
    robot.close()


@pytest.fixture(autouse=True)
def surroundings(monkeypatch: pytest.MonkeyPatch) -> None:
    """A domain of this test's own, and an arm that is loaded once."""
    load = arguments.load_arm
    for module in (arguments, cli_plan):
        monkeypatch.setattr(module, "load_arm", lambda settings: load(settings) if settings.robot == "topic" else robot_named())
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def run(*arguments: Any) -> int:
    return cli.main([*map(str, arguments)])


def test_live_topics(robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot.heal()
    out = tmp_path / "now.npz"
    assert run("record", out) == 0
    said, errors = capsys.readouterr()
    assert errors == ""
    for words in (
        "/leaf_cloud: message ",
        "/stem_cloud: message ",
        "/grasp_target: message ",
        "/joint_states: 6 joints",
        " leaf, 200 stem, 0 fruit points in 'base'",
    ):
        assert words in said, said
    scene, start = Scene.load(out), load_start(out)
    assert (len(scene.stem_points), scene.frame_id) == (200, "base")
    assert 0 < len(scene.leaf_points) < 300  # some stand alone
    assert scene.target_pose == pytest.approx([0.5, 0.1, 0.4, 0, 0, 0, 1])
    assert start is not None and start.joint_names == JOINTS and start.q == pytest.approx(HOME)


def test_cameras_that_take_turns_are_put_together(robot: Robot, tmp_path: Path) -> None:
    robot.heal()
    robot.cameras = ("left", "right")
    out, frames = tmp_path / "both.npz", "static_transforms=[base left 0 0.3 0.2 0 0 0 1, base right 0 -0.3 0.2 0 0 0 1]"
    assert run("record", out, "--set", frames) == 0
    scene = Scene.load(out)
    assert scene.viewpoints is not None and scene.stem_view_ids is not None
    sides = np.sign(scene.viewpoints[:, 1])
    assert {side: int((sides[scene.stem_view_ids] == side).sum()) >= 200 for side in (-1, 1)} == {-1: True, 1: True}
    assert run("record", out, "--set", frames, "--set", "fuse_views=false") == 0
    assert len(Scene.load(out).stem_points) == 200
    robot.heal()


def test_what_is_not_heard(robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot.heal()
    robot.names = None
    options = ["--wait", 3.5, "--target", "/nobodys_target", "--partial", "--json"]
    assert run("record", tmp_path / "a.npz", *options) == 0
    out, errors = capsys.readouterr()
    answer = json.loads(out)
    assert answer["target_pose"] is None and answer["start"] is None and answer["points"]["stem"] == 200
    assert [line.split(":")[0] for line in errors.splitlines()] == ["NO_TARGET", "NO_JOINT_STATE"]
    assert load_start(tmp_path / "a.npz") is None
    assert run("record", tmp_path / "b.npz", "--wait", 0.3, "--namespace", "/nowhere", "--json") == 1
    error = capsys.readouterr().err
    assert error.startswith("NO_CLOUD: ") and error.count("\n") == 1
    assert "within 0.3 s nothing came on /nowhere/leaf_cloud, /nowhere/stem_cloud, /nowhere/grasp_target" in error
    assert not (tmp_path / "b.npz").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a.ply"], "a.ply: a recorded scene ends in .npz"),
        (["a.npz", "--wait", "0"], "--wait is 0"),
        (["a.npz", "--at", "1"], "name it with --bag"),
        (["a.npz", "--set", "robot=topic"], "robot: `topic` needs ROS"),
        (["a.npz", "--bag", "nowhere"], "nowhere: there is no such recording"),
    ],
)
def test_wrong_requests(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("record", *arguments) == (2 if "--at" in arguments else 1)
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A post beside the arm, a leaf; the target is where the tool already is, a little higher at 2 s."""
    arm = robot_named()
    T_base_tool = arm.forward(home(arm))
    sent: list[tuple[float, str, Any]] = [(0.0, "/joint_states", joints(*HOME, names=JOINTS))]
    for at_s in (0.0, 2.0):
        target = pose(0.0)
        x, y, z, qx, qy, qz, qw = matrix_to_pose(T_base_tool)
        target.pose.position.x, target.pose.position.y, target.pose.position.z = x, y, z + 0.02 + 0.01 * at_s
        o = target.pose.orientation
        o.x, o.y, o.z, o.w = qx, qy, qz, qw
        sent += [(at_s, "/leaves", cloud(at_x(0.9, 80))), (at_s, "/stems", cloud(at_x(1.0, 30))), (at_s, "/goal", target)]
    return write(tmp_path_factory.mktemp("bag") / "recording", sent)


TOPICS = ("--leaf", "/leaves", "--stem", "/stems", "--target", "/goal")


def test_a_moment_of_a_recording(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "then.npz"
    assert run("record", out, "--bag", bag, "--at", 1.5, *TOPICS) == 0
    said, errors = capsys.readouterr()
    assert errors == "" and "/stems: at 0.000 s" in said and "/joint_states: at 0.000 s" in said
    scene, start = Scene.load(out), load_start(out)
    assert start is not None and start.q == pytest.approx(HOME)
    assert (len(scene.leaf_points), len(scene.stem_points)) == (80, 30)
    assert "the arm's own points" not in said
    assert run("record", out, "--bag", bag, "--stem", "/stems") == 1
    assert "NO_TARGET: the recording has no grasp_target" in capsys.readouterr().err


def test_a_fruit_is_a_target_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = pose(0.5)
    fruit = T["geometry_msgs/msg/PointStamped"](header=target.header, point=target.pose.position)
    sent = [(0.0, "/joint_states", joints(*HOME, names=JOINTS)), (0.0, "/stem_cloud", cloud(at_x(1.0, 30), "camera"))]
    sent += [(0.0, "/tf_static", transform("base", "camera", -0.2)), (0.0, "/fruit_target", fruit)]
    out = tmp_path / "then.npz"
    assert run("record", out, "--bag", write(tmp_path / "recording", sent), "--json") == 0, capsys.readouterr().err
    answer = json.loads(capsys.readouterr().out)
    assert answer["fruit_centres"] == [[0.5, 0.0, 0.0]] and answer["missing"] == []
    assert answer["viewpoints"] == [[pytest.approx(-0.2), 0.0, 0.0]]
    assert run("scene", "info", out) == 0
    said = capsys.readouterr().out
    assert "fruit by number: 0 at 0.500 0.000 0.000" in said and "seen from: 0 at -0.200 0.000 0.000" in said


def test_plans_on_a_recording_and_on_what_was_recorded(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both start where the arm was; the file gives the same plan as the recording that it was made of."""
    search = ("--iterations", 50, "--seed", 1)
    assert run("record", tmp_path / "then.npz", "--bag", bag, "--at", 2, *TOPICS) == 0
    assert run("plan", "--bag", bag, "--at", 2, *TOPICS, *search, "--json", tmp_path / "bag.json") == 0, capsys.readouterr().err
    assert run("plan", tmp_path / "then.npz", *search, "--json", tmp_path / "file.json") == 0
    of_bag, of_file = (json.loads((tmp_path / name).read_text()) for name in ("bag.json", "file.json"))
    assert of_bag["waypoints"][0] == pytest.approx(HOME)
    assert of_bag["waypoints"] == of_file["waypoints"]
    assert of_bag["goal_error_m"] < 0.005


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--bag", "BAG", "--stem", "/leafs"], "has no topic /leafs"),
        (["--bag", "BAG", "--stem", "/goal"], "/goal holds geometry_msgs/PoseStamped"),
        (["--bag", "BAG", "--stem", "/stems", "--at", "7"], "is 2.000 s long; --at 7 lies outside"),
        (["--bag", "BAG", "--stem", "/stems"], "NO_TARGET: "),
        (["--bag", "BAG", "--offset", "1", "0", "0"], "--offset"),
        (["x.npz", "--bag", "BAG"], "give a SCENE or a --bag, not both"),
        ([], "give a SCENE, or a recording with --bag"),
        (["x.npz", "--target", "/goal"], "--target /goal is a topic"),
        (["x.npz", "--target", "1", "2"], "--target needs 3 numbers x y z (a fruit), 7 numbers x y z qx qy qz qw (a pose)"),
        (["x.npz", "--stem", "/stems"], "--stem names a topic of a recording"),
    ],
)
def test_plan_says_what_is_wrong_with_a_recording(bag: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = run("plan", *(str(bag) if word == "BAG" else word for word in arguments))
    assert code == (1 if "--bag" in arguments and "--offset" not in arguments and "x.npz" not in arguments else 2)
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1, error


def test_a_start_of_another_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points, pose_ = at_x(0.5, 20), np.array([0.4, 0, 0.5, 0, 0, 0, 1])
    np.savez(tmp_path / "a.npz", points=points, labels=np.ones(20, int), target_pose=pose_, start=[0.0, 1.0], start_joints=["a", "b"])
    assert run("plan", tmp_path / "a.npz") == 1
    assert "its start is of the joints a, b; the arm has j2s6s200_joint_1" in capsys.readouterr().err
