"""Joint states, poses, paths, trajectories and statuses as messages."""

from __future__ import annotations

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped, PoseArray, PoseStamped
from ros_fakes import JOINTS, trajectory
from sensor_msgs.msg import JointState

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.ros.convert import (
    JointReader,
    read_target,
    stamp_text,
    to_duration,
    to_joint_trajectory,
    to_path,
    to_pose,
    to_pose_stamped,
)
from lime_planner.ros.requests.status_board import Phase, health_message, read_status, status_message, text
from lime_planner.ros.runtime import Severity


def state(names: list[str], positions: list[float]) -> JointState:
    return JointState(name=names, position=positions)


def test_joints_are_found_by_name_in_any_order_among_others() -> None:
    reader = JointReader(JOINTS)
    assert reader.configuration(state(["f1", "j3", "j1", "f2", "j2"], [9.0, 3.0, 1.0, 9.0, 2.0])).tolist() == [1.0, 2.0, 3.0]
    assert reader.configuration(state(["j2", "j1", "j3"], [2.0, 1.0, 3.0])).tolist() == [1.0, 2.0, 3.0]


def test_a_joint_that_carries_the_arm_must_stay_where_plans_take_it_to_be() -> None:
    reader = JointReader(JOINTS, (("lift", 0.2), ("slide", 0.0)))
    arm = state([*JOINTS], [1.0, 2.0, 3.0])

    def refusal() -> str:
        with pytest.raises(Refusal) as caught:
            reader.configuration(arm)
        assert caught.value.status is Status.BAD_INPUT
        return str(caught.value)

    assert reader.configuration(arm).tolist() == [1.0, 2.0, 3.0], "nobody has said anything of it"
    reader.look_at_held(state(["lift"], [0.195]))
    assert reader.configuration(arm).tolist() == [1.0, 2.0, 3.0]
    reader.look_at_held(state(["wheel", "lift"], [0.0, 0.5]))
    assert refusal().startswith("the joint lift is at 0.500, but every plan takes it to stay at 0.200")
    reader.look_at_held(state(["slide"], [math.nan]))
    assert "lift" in refusal() and "the joint slide is at nan" in refusal()
    reader.look_at_held(state(["slide", "lift"], [0.0, 0.2]))
    assert reader.configuration(arm).tolist() == [1.0, 2.0, 3.0]


def test_turns_are_kept() -> None:
    assert JointReader(JOINTS).configuration(state([*JOINTS], [20.0, -30.0, 0.0])).tolist() == [20.0, -30.0, 0.0]


@pytest.mark.parametrize(
    ("names", "positions", "words"),
    [
        (["j1", "j2"], [1.0, 2.0], "no joint j3; it has j1, j2"),
        ([], [], "no joint j1, j2, j3; it has none"),
        (["j1", "j2", "j3", "j2"], [1.0] * 4, "j2 more than once"),
        (["j1", "j2", "j3"], [1.0, 2.0], "3 names but 2 positions"),
        (["j1", "j2", "j3"], [1.0, math.nan, 2.0], "j2 = nan"),
        (["j1", "j2", "j3"], [1.0, 2.0, math.inf], "j3 = inf"),
    ],
)
def test_bad_joint_states_are_refused(names: list[str], positions: list[float], words: str) -> None:
    with pytest.raises(Refusal) as caught:
        JointReader(JOINTS).configuration(state(names, positions))
    assert caught.value.status is Status.BAD_INPUT
    assert words in str(caught.value)


def target(pose: list[float], frame_id: str = "base") -> PoseStamped:
    msg = PoseStamped(pose=to_pose(pose))
    msg.header.frame_id = frame_id
    return msg


def test_a_quaternion_of_any_length_is_a_target() -> None:
    T = read_target(target([1.0, 2.0, 3.0, 0.0, 0.0, 2.0, 2.0])).poses[0]
    assert np.allclose(T[:3, 3], [1.0, 2.0, 3.0])
    assert np.allclose(T[:3, :3], [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("pose", "frame_id"),
    [
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "base"),
        ([math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "base"),
        ([0.0, 0.0, 0.0, math.inf, 0.0, 0.0, 1.0], "base"),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], ""),
    ],
)
def test_bad_targets_are_refused(pose: list[float], frame_id: str) -> None:
    with pytest.raises(Refusal) as caught:
        read_target(target(pose, frame_id))
    assert caught.value.status is Status.BAD_INPUT


def fruit(x: float, y: float = 0.0, z: float = 0.5, frame_id: str = "base") -> PointStamped:
    msg = PointStamped()
    msg.header.frame_id = frame_id
    msg.point.x, msg.point.y, msg.point.z = x, y, z
    return msg


def candidates(count: int, bad: int | None = None) -> PoseArray:
    poses = [to_pose([0.5, 0.0, 0.4, 0.0, math.nan if number == bad else 0.0, 0.0, 1.0]) for number in range(1, count + 1)]
    msg = PoseArray(poses=poses)
    msg.header.frame_id = "base"
    return msg


def test_fruit_and_candidates_are_targets() -> None:
    aim = read_target(fruit(0.6))
    assert aim.kind == "fruit" and aim.centre == pytest.approx([0.6, 0.0, 0.5])
    aim = read_target(candidates(3))
    assert aim.kind == "candidates" and len(aim.poses) == 3


@pytest.mark.parametrize(
    ("msg", "words"),
    [
        (fruit(math.nan), "3 finite numbers"),
        (fruit(0.5, frame_id=""), "empty frame_id"),
        (candidates(0), "empty list"),
        (candidates(5000), "5000 grasp candidates; at most 2000"),
        (candidates(20, bad=10), "grasp candidate 10 of 20"),
    ],
)
def test_bad_fruit_and_candidates_are_refused(msg: PointStamped | PoseArray, words: str) -> None:
    with pytest.raises(Refusal, match=words) as caught:
        read_target(msg)
    assert caught.value.status is Status.BAD_INPUT


def test_the_motion_command_keeps_the_message_contract() -> None:
    planned = trajectory(np.array([0.1, 0.2, 0.3]), np.array([0.5, -0.2, 0.3]), 1.0)
    msg = to_joint_trajectory(planned)
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec) == (0, 0)
    assert msg.joint_names == list(JOINTS)
    nanoseconds = [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in msg.points]
    assert nanoseconds == [20_000_000 * k for k in range(len(planned))]
    assert np.array_equal([p.positions for p in msg.points], planned.positions)
    assert np.array_equal([p.velocities for p in msg.points], planned.velocities)
    assert all(len(p.accelerations) == 0 and len(p.effort) == 0 for p in msg.points)
    assert list(msg.points[0].velocities) == [0.0] * 3
    assert list(msg.points[-1].velocities) == [0.0] * 3


def test_durations_are_whole_nanoseconds() -> None:
    assert (to_duration(0.58).sec, to_duration(0.58).nanosec) == (0, 580_000_000)
    assert (to_duration(2.9999999999).sec, to_duration(2.9999999999).nanosec) == (3, 0)


def test_paths_and_poses() -> None:
    stamp = Time(sec=5, nanosec=7)
    path = to_path(np.array([[1, 2, 3, 0, 0, 0, 1], [4, 5, 6, 0, 0, 1, 0]]), "base", stamp)
    assert [p.pose.position.y for p in path.poses] == [2.0, 5.0]
    assert to_path(np.empty((0, 7)), "base", stamp).poses == []
    T = np.eye(4)
    T[:3, 3] = [1, 2, 3]
    assert to_pose_stamped(T, "base", stamp).pose.position.z == 3.0
    assert stamp_text(stamp) == "5.000000007"


def test_status_messages_hold_text_only() -> None:
    values = {
        "plan_id": 3,
        "cost": np.float32(1.5),
        "ok": np.bool_(True),
        "waypoints": np.eye(2),
        "none": None,
        "trajectory": {"dt_s": 0.02},
    }
    msg = status_message(Time(), "lime_planner", "arm", Phase.DONE, Status.SUCCEEDED, "SUCCEEDED: it is", values)
    pairs = read_status(msg)
    assert pairs["phase"] == "DONE"
    assert pairs["code"] == "SUCCEEDED"
    assert pairs["cost"] == "1.5"
    assert pairs["ok"] == "true"
    assert pairs["waypoints"] == "[[1.0,0.0],[0.0,1.0]]"
    assert pairs["none"] == ""
    assert pairs["trajectory"] == '{"dt_s":0.02}'
    assert text(0.1) == "0.1"
    assert text(123456.789) == "123456.8"


def test_levels_tell_trouble_from_defects() -> None:
    level = {
        code: status_message(Time(), "n", "r", Phase.DONE, code, "", {}).status[0].level
        for code in (None, Status.SUCCEEDED, Status.PREEMPTED, Status.NO_PATH, Status.INTERNAL_ERROR)
    }
    assert [level[code] for code in level] == [b"\x00", b"\x00", b"\x00", b"\x01", b"\x02"]
    assert health_message(Time(), "n", "r", [], {}).status[0].level == b"\x00"
    late, lost = (Severity.WARN, "compiling"), (Severity.ERROR, "no robot")
    assert health_message(Time(), "n", "r", [late], {}).status[0].level == b"\x01"
    worst = health_message(Time(), "left/n", "r", [late, lost, late], {}).status[0]
    assert worst.level == b"\x02" and worst.message == "compiling; no robot; compiling" and worst.name == "left/n: health"
