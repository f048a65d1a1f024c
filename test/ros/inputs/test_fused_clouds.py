"""What is known from the clouds of several cameras, of one on the arm among them, and for how long."""

from __future__ import annotations

import time

import numpy as np
import pytest
from ros_fakes import never, refusal_of, stamped
from sensor_msgs.msg import JointState

from lime_planner.core.status import Status
from lime_planner.robot.model import Robot, home, load_robot
from lime_planner.ros.inputs.arm_camera import ArmCamera
from lime_planner.ros.inputs.clouds import encode_cloud
from lime_planner.ros.inputs.frames import StaticFrames
from lime_planner.ros.inputs.latest import Inputs
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.parameters import snapshot_from
from lime_planner.scene.from_clouds import Origins, unfiltered

NOW_S = 1000.0
FRAMES = StaticFrames(["base left 0 0.5 0.5 0 0 0 1", "base right 0 -0.5 0.5 0 0 0 1", "j2s6s200_end_effector wrist 0 0.07 -0.1 0 0 0 1"])


class Cameras:
    """Publishes labelled clouds of stems, in the frame of a camera each."""

    def __init__(self, robot: Robot | None = None) -> None:
        self.clock_s = NOW_S
        self.inputs = Inputs(lambda: self.clock_s, lambda _: None)
        self.source = SceneSource(self.inputs, FRAMES, "base", unfiltered)
        if robot is not None:
            self.inputs.set_joints(tuple(robot.joint_names))
            self.source.use_arm("base", unfiltered, ArmCamera(robot, "wrist", FRAMES))

    def send(self, frame: str, points: np.ndarray, label: int = 1, name: str = "labelled_cloud") -> None:
        columns = {"label": np.full(len(points), label, np.uint8)} if name == "labelled_cloud" else {}
        msg = stamped(encode_cloud(points, columns), self.clock_s)
        msg.header.frame_id = frame
        self.inputs.on_cloud(name, msg)
        self.source.arrived(name)

    def stems(self, **parameters: object) -> np.ndarray:
        return self.scene(**parameters).stem_points  # type: ignore[attr-defined, no-any-return]

    def scene(self, **parameters: object) -> object:
        return self.source.scene(snapshot_from(parameters), never)


def block(x: float) -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.02, 0.02, (50, 3)) + [x, 0.0, 0.0]


def test_what_another_camera_showed_stays() -> None:
    cameras = Cameras()
    cameras.send("left", block(0.5))
    cameras.send("right", block(0.6)[:5])
    both = cameras.scene()
    assert (len(both.stem_points), len(both.viewpoints)) == (55, 2)  # type: ignore[attr-defined]
    assert cameras.scene() is both  # nothing is made again for what is known already
    assert len(cameras.stems(fuse_views=False)) == 5


def test_what_is_older_than_the_memory_is_forgotten_and_the_newest_is_not() -> None:
    cameras = Cameras()
    cameras.send("left", block(0.5))
    cameras.send("right", block(0.6)[:5])
    assert len(cameras.stems(view_memory_s=0.1)) == 55
    time.sleep(0.15)
    assert len(cameras.stems(view_memory_s=0.1)) == 5


def test_a_cloud_of_unknown_origin_is_all_that_is_known() -> None:
    cameras = Cameras()
    cameras.send("left", block(0.5))
    cameras.send("base", block(0.6)[:5])
    scene = cameras.scene()
    assert (len(scene.stem_points), scene.viewpoints) == (5, None)  # type: ignore[attr-defined]
    cameras.send("right", block(0.6)[:7])
    assert len(cameras.stems()) == 57  # a camera of known origin: the others are known again, the one without is not


def test_an_empty_cloud_takes_no_stem_away() -> None:
    cameras = Cameras()
    cameras.send("left", block(0.5))
    cameras.send("right", np.empty((0, 3)))
    assert len(cameras.stems()) == 50


def test_a_still_camera_keeps_few_clouds() -> None:
    cameras = Cameras()
    for _ in range(40):
        cameras.send("left", block(0.5))
        cameras.send("right", block(0.5))
        cameras.scene()
    assert len(cameras.scene().viewpoints) <= 5  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("kinova_j2s6s200")


def joints(cameras: Cameras, robot: Robot, q: np.ndarray) -> None:
    cameras.inputs.on_joint_state(stamped(JointState(name=list(robot.joint_names), position=q.tolist()), cameras.clock_s))


def test_clouds_of_the_camera_on_the_arm_are_where_the_arm_carried_it(robot: Robot) -> None:
    cameras, q = Cameras(robot), home(robot)
    T_tool_camera = np.eye(4)
    T_tool_camera[:3, 3] = [0.0, 0.07, -0.1]
    origins = []
    for k in range(2):
        cameras.clock_s += 1.0
        joints(cameras, robot, q + 0.4 * k)
        T = robot.forward(q + 0.4 * k) @ T_tool_camera
        origins.append(T[:3, 3])
        cameras.send("wrist", (np.array([[0.6, 0.1, 0.5]]) - T[:3, 3]) @ T[:3, :3])
    scene = cameras.scene()
    assert np.allclose(scene.stem_points, [0.6, 0.1, 0.5], atol=1e-5)  # type: ignore[attr-defined]
    assert np.allclose(sorted(map(tuple, scene.viewpoints)), sorted(map(tuple, origins)), atol=1e-5)  # type: ignore[attr-defined]
    assert cameras.source.camera is not None and np.allclose(cameras.source.camera.T_tool_camera(), T_tool_camera)
    assert cameras.source.seen_by_arm_since(time.monotonic() - 1.0)
    assert not cameras.source.seen_by_arm_since(time.monotonic() + 1.0)


def test_leaf_and_stem_cloud_of_a_look_are_both_waited_for(robot: Robot) -> None:
    cameras = Cameras(robot)
    joints(cameras, robot, home(robot))
    cameras.send("wrist", block(0.5), name="leaf_cloud")
    cameras.send("wrist", block(0.5), name="stem_cloud")
    before_s = time.monotonic()
    cameras.send("wrist", block(0.5), name="stem_cloud")
    assert not cameras.source.seen_by_arm_since(before_s)
    cameras.send("wrist", block(0.5), name="leaf_cloud")
    assert cameras.source.seen_by_arm_since(before_s)


def test_a_camera_that_nothing_carries_is_named(robot: Robot) -> None:
    nowhere = ArmCamera(robot, "nowhere", FRAMES)
    status, sentence = refusal_of(nowhere.T_tool_camera)
    assert status is Status.TF_ERROR and "'j2s6s200_end_effector nowhere x y z qx qy qz qw'" in sentence
    forearm = ArmCamera(robot, "elbow", StaticFrames(["j2s6s200_link_3 elbow 0 0 0.1 0 0 0 1"]))
    status, sentence = refusal_of(forearm.T_tool_camera)
    assert status is Status.TF_ERROR and "on j2s6s200_link_3, against which j2s6s200_joint_6 moves the tool" in sentence
    assert forearm.carries("elbow") is not None  # its clouds are placed all the same


def test_a_cloud_from_before_the_joints_are_known_is_no_view(robot: Robot) -> None:
    cameras = Cameras(robot)
    cameras.send("wrist", block(0.5))
    status, sentence = refusal_of(cameras.scene)
    assert status is Status.TF_ERROR and "where the arm carried 'wrist'" in sentence


def test_clouds_in_frames_without_a_camera_were_seen_from_the_given_places() -> None:
    cameras = Cameras()
    wall = np.stack(np.meshgrid([0.5], np.arange(-0.1, 0.1, 0.004), np.arange(0.3, 0.5, 0.004)), axis=-1).reshape(-1, 3)
    behind = block(0.7) + [0.0, 0.0, 0.4]
    cameras.send("base", np.concatenate([wall, behind]))
    assert cameras.scene().viewpoints is None  # type: ignore[attr-defined]
    front, back = [0.0, 0.0, 0.4], [1.5, 0.0, 0.4]
    one = cameras.scene(viewpoints=front)
    assert one.viewpoints.tolist() == [pytest.approx(front)] and (one.stem_view_ids == 0).all()  # type: ignore[attr-defined]
    both = cameras.scene(viewpoints=[*front, *back])
    hits = both.hits_by_view()  # type: ignore[attr-defined]
    assert len(hits[0]) == len(wall) and (hits[0][:, 0] < 0.6).all(), "the wall hides the block from the front"
    assert (hits[1][:, 0] > 0.6).any() and (hits[1][:, 0] < 0.6).any(), "from the back both are seen, but for what the block hides"
    cameras.send("left", block(0.5))
    scene = cameras.scene(viewpoints=front, fuse_views=False)
    assert scene.viewpoints[0].tolist() == [0.0, 0.5, 0.5], "a camera's own frame says where it stands"  # type: ignore[attr-defined]


def test_leaves_of_one_cloud_hide_stems_of_the_other() -> None:
    cameras = Cameras()
    leaf = np.stack(np.meshgrid([0.5], np.arange(-0.1, 0.1, 0.004), np.arange(0.3, 0.5, 0.004)), axis=-1).reshape(-1, 3)
    for name, points in (("leaf_cloud", leaf), ("stem_cloud", block(0.7) + [0.0, 0.0, 0.4])):
        cameras.send("base", points, name=name)
    scene = cameras.scene(viewpoints=[0.0, 0.0, 0.4, 1.5, 0.0, 0.4])
    front, back = scene.hits_by_view()  # type: ignore[attr-defined]
    assert (front[:, 0] < 0.6).all() and (back[:, 0] > 0.6).any()
    assert len(scene.stem_points) == 50  # type: ignore[attr-defined]


@pytest.mark.parametrize("frame", ["map", "odom", "/base_link", "robot_1/base_footprint"])
def test_no_camera_stands_at_the_origin_of_a_map(frame: str) -> None:
    assert Origins().of_frame(frame, "base", np.eye(4)) is None
    assert Origins((1.0, 2.0, 3.0)).of_frame(frame, "base", np.eye(4)) == pytest.approx(np.array([[1.0, 2.0, 3.0]]))
    assert Origins(fixed_frame="field").of_frame("field", "base", np.eye(4)) is None
