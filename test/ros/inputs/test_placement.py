"""A base that drives: where clouds and targets are then, what makes them stale, and scenes that outlive every history of transforms."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from ros_fakes import JOINTS, encode_at, never, refusal_of, stamped, tf_message
from sensor_msgs.msg import JointState

from lime_planner.core.status import Status
from lime_planner.ros.inputs.frames import StaticFrames, TfFrames
from lime_planner.ros.inputs.latest import Inputs
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.parameters import snapshot_from
from lime_planner.scene.scene import Scene

SEEN_S = 101.0  #: when the plant was seen: the base stood at x 0.2 in `map` then, the plant at 2.0
SPEED = 0.2


class Rig:
    """A base that drives at 0.2 m/s in `map`, a camera 0.5 m before it, a gripper camera that moves on the arm."""

    def __init__(self, fixed_frame: str = "", **values: Any) -> None:
        self.frames = TfFrames(StaticFrames())
        self.inputs = Inputs(lambda: SEEN_S, lambda _: None)
        self.inputs.set_joints(JOINTS)
        self.asked: list[tuple[list[float], list[float] | None]] = []
        self.source = SceneSource(self.inputs, self.frames, "base", self.keep, fixed_frame=fixed_frame)
        self.snapshot = snapshot_from({"tf_timeout_s": 0.05, **values})
        self.frames.take(tf_message("base", "camera", 0.5, 0.0), static=True)

    def keep(self, scene: Scene, q: Any, padding_m: float, /, *, base_position: Any = None) -> Scene:
        self.asked.append((scene.stem_points[0].tolist(), None if base_position is None else base_position.tolist()))
        return scene

    def drive(self, begin_s: float, end_s: float, speed: float = SPEED) -> None:
        for t in np.arange(begin_s, end_s + 0.01, 0.1):
            self.frames.take(tf_message("map", "base", speed * (t - 100.0), float(t)), static=False)
            self.frames.take(tf_message("base", "gripper", 0.1 * (t - 100.0), float(t)), static=False)

    def see(self, frame: str) -> None:
        x = {"map": 2.0, "base": 1.8, "camera": 1.3, "gripper": 1.7}[frame]
        msg = stamped(encode_at(x, 5), SEEN_S)
        msg.header.frame_id = frame
        self.inputs.on_cloud("stem_cloud", msg)
        self.source.arrived("stem_cloud")
        target = stamped(PoseStamped(), SEEN_S)
        target.header.frame_id, target.pose.position.x, target.pose.orientation.w = frame, x, 1.0
        self.inputs.on_target(target)
        self.source.arrived("grasp_target")

    def stem_x(self) -> float:
        return float(self.source.scene(self.snapshot, never).stem_points[0, 0])

    def goal_x(self) -> float:
        return float(self.source.goal(self.inputs.target(0.0, 0.0), self.snapshot, never).centre[0])


@pytest.mark.parametrize("frame", ["map", "base", "camera", "gripper"])
def test_with_a_fixed_frame_the_plant_stays_where_it_was(frame: str) -> None:
    rig = Rig("map")
    rig.drive(100.0, 101.5)
    rig.see(frame)
    rig.drive(101.6, 104.0)
    assert rig.stem_x() == pytest.approx(2.0 - 0.8)
    assert rig.goal_x() == pytest.approx(2.0 - 0.8)
    assert rig.asked == [(pytest.approx([1.8, 0.0, 0.0]), pytest.approx([0.6, 0.0, 0.0]))], "the arm is looked for where it stood then"
    rig.drive(104.1, 105.0)
    assert rig.stem_x() == pytest.approx(2.0 - 1.0)
    assert rig.goal_x() == pytest.approx(2.0 - 1.0)


@pytest.mark.parametrize("frame", ["map", "base", "camera", "gripper"])
def test_without_one_a_base_that_moved_makes_it_stale(frame: str) -> None:
    rig = Rig()
    rig.drive(100.0, 101.0)
    rig.see(frame)
    assert (rig.stem_x(), rig.goal_x()) == pytest.approx((1.8, 1.8))
    rig.drive(101.1, 104.0)
    for ask, name in ((rig.stem_x, "stem_cloud"), (rig.goal_x, "grasp_target")):
        status, sentence = refusal_of(ask)
        assert status is Status.STALE_INPUT
        assert sentence == (
            f"'base' has moved by 0.600 m in 'map' since the stamp of {name}, "
            "the limit is 0.01 m; fixed_frame: map keeps the data where it was there"
        )
    rig.snapshot = snapshot_from({"max_base_motion_m": 1.0})
    assert rig.stem_x() == pytest.approx(1.8)


def test_an_arm_that_moves_its_camera_has_not_moved_its_base() -> None:
    rig = Rig()
    rig.drive(100.0, 101.0, speed=0.0)
    rig.see("gripper")
    rig.drive(101.1, 104.0, speed=0.0)
    assert rig.stem_x() == pytest.approx(1.8)
    viewpoints = rig.source.scene(rig.snapshot, never).viewpoints
    assert viewpoints == pytest.approx(np.array([[0.1, 0.0, 0.0]])), "where the camera was at the stamp"


def test_a_scene_that_is_seen_once_outlives_the_history_of_transforms() -> None:
    for fixed_frame in ("", "map"):
        rig = Rig(fixed_frame)
        rig.drive(100.0, 101.5, speed=0.0)
        rig.see("gripper")
        rig.drive(101.6, 140.0, speed=0.0)
        assert rig.stem_x() == pytest.approx(1.8)
        rig.snapshot = snapshot_from({"self_filter_padding_m": 0.02})
        assert rig.stem_x() == pytest.approx(1.8), "made again with other settings"
        assert rig.goal_x() == pytest.approx(1.8)


def test_transforms_that_come_after_their_cloud_are_noted_when_they_come() -> None:
    rig = Rig("map")
    rig.drive(100.0, 100.5)
    rig.see("gripper")
    status, sentence = refusal_of(rig.stem_x)
    assert status is Status.TF_ERROR and "within 0.05 s: 'gripper' in 'base' is known up to 0.500 s before the stamp" in sentence
    rig.drive(100.6, 130.0)
    assert rig.stem_x() == pytest.approx(2.0 - SPEED * 30.0)


def test_a_plan_waits_for_the_transform_of_its_cloud() -> None:
    rig = Rig("map", tf_timeout_s=5.0)
    rig.drive(100.0, 100.5)
    rig.see("gripper")
    later = threading.Timer(0.1, rig.drive, (100.6, 101.0))
    later.start()
    assert rig.stem_x() == pytest.approx(1.8)
    later.join()


def test_data_in_the_base_frame_needs_no_transform_at_all() -> None:
    rig = Rig()
    rig.see("base")
    assert (rig.stem_x(), rig.goal_x()) == pytest.approx((1.8, 1.8))
    rig.drive(90.0, 95.0)  # a localisation that fell silent before the stamp: it tells nothing
    assert rig.stem_x() == pytest.approx(1.8)


def test_a_fixed_frame_that_is_not_known_is_named() -> None:
    rig = Rig("map")
    rig.see("base")
    status, sentence = refusal_of(rig.stem_x)
    assert status is Status.TF_ERROR
    assert "'map' is not known; known frames: base, camera" in sentence


def test_another_arm_has_another_planning_frame() -> None:
    rig = Rig("map")
    rig.drive(100.0, 101.5)
    rig.see("camera")
    rig.source.use_arm("gripper", rig.keep)
    assert rig.stem_x() == pytest.approx(1.8 - 0.1 - 0.05 - SPEED * 0.5), "the gripper rode on the base and moved on the arm"


def test_turning_counts_as_moving() -> None:
    rig = Rig()
    rig.drive(100.0, 101.0, speed=0.0)
    rig.see("base")
    rig.frames.take(tf_message("map", "base", 0.0, 102.0, yaw=0.05), static=False)
    status, sentence = refusal_of(rig.stem_x)
    assert status is Status.STALE_INPUT and "moved by 0.050 m" in sentence


def test_points_of_a_map_keep_their_millimetres() -> None:
    """A map's coordinates in single precision are half a metre apart; the cloud's are doubles."""
    rig = Rig()
    east = 5_621_987.0
    rig.frames.take(tf_message("utm", "base", east, 0.0), static=True)
    points = np.array([[east + 0.6, 0.0, 0.1], [east + 0.6005, 0.0, 0.2]])
    msg = stamped(encode_at(0.0, 2, doubles=points), SEEN_S)
    msg.header.frame_id = "utm"
    rig.inputs.on_cloud("stem_cloud", msg)
    scene = rig.source.scene(rig.snapshot, never)
    assert scene.stem_points[:, 0] == pytest.approx([0.6, 0.6005], abs=1e-6)


def test_the_joint_state_of_the_stamp_is_used_with_a_moving_base() -> None:
    rig = Rig("map")
    rig.drive(100.0, 101.5)
    for t, q in ((100.9, 0.9), (101.1, 1.1)):
        rig.inputs.on_joint_state(stamped(JointState(name=list(JOINTS), position=[q, 0.0, 0.0]), t))
    seen: list[Any] = []

    def note(scene: Scene, q: Any, padding_m: float, /, *, base_position: Any = None) -> Scene:
        seen.append(q)
        return scene

    rig.source.use_arm("base", note)
    rig.see("camera")
    rig.drive(101.6, 104.0)
    rig.stem_x()
    assert seen[-1][0] == pytest.approx(1.0)
