"""The planner node as a process, with a pipeline that costs nothing: what it says to every bad input, and that it goes on serving.

Each case is followed by a good request that succeeds; the arm must not have moved in between.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from nav_msgs.srv import GetPlan
from ros_fakes import JOINTS, START, cloud
from ros_harness import Bench, program
from sensor_msgs.msg import JointState, PointCloud2

from lime_planner.ros.convert import to_pose

DOMAIN = 20 + os.getpid() % 40
GOOD = [0.05, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]
BACK = [-0.05, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    arguments = ["test/fake_planner.py", "--ros-args", "-p", "static_transforms:=['base mast 0 0 1 0 0 0 1']"]
    with program(arguments, DOMAIN, "ready to plan", defects=2):
        bench = Bench(JOINTS, START, domain=DOMAIN)
        bench.call("stop")
        bench.wait(lambda: bench.health, 10.0, "diagnostics")
        yield bench
        bench.close()


def message_of(bench: Bench, service: str = "plan") -> str:
    response = bench.call(service)
    assert response.success == response.message.startswith("SUCCEEDED:"), response.message
    return str(response.message)


def make_good(bench: Bench) -> None:
    bench.publish_states = True
    bench.send_clouds(cloud(200), cloud(100))
    bench.send_target(GOOD)


def settle() -> None:
    time.sleep(0.18)


def bad_cloud(change: Callable[[PointCloud2], None]) -> PointCloud2:
    msg = cloud(50, label=np.zeros(50, np.uint8))
    change(msg)
    return msg


def fields(*names: str) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        msg.fields = [field for field in msg.fields if field.name in names]

    return change


def attribute(**values: object) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        for name, value in values.items():
            setattr(msg, name, value)

    return change


def field_attribute(**values: object) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        for name, value in values.items():
            setattr(msg.fields[1], name, value)

    return change


def frame(name: str) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        msg.header.frame_id = name

    return change


def coordinates(value: float) -> Callable[[PointCloud2], None]:
    def change(msg: PointCloud2) -> None:
        table = np.frombuffer(msg.data, np.uint8).reshape(50, msg.point_step).copy()
        table[:, :12] = np.frombuffer(np.full(3, value, np.float32).tobytes(), np.uint8)
        msg.data = type(msg.data)("B", table.tobytes())

    return change


def cut(msg: PointCloud2) -> None:
    msg.data = msg.data[:-1]


def drop_all(msg: PointCloud2) -> None:
    msg.width = 0
    msg.data = msg.data[:0]


CLOUDS = {
    "no x": (fields("y", "z"), "BAD_INPUT", "no field 'x'"),
    "no z": (fields("x", "y"), "BAD_INPUT", "no field 'z'"),
    "no fields at all": (fields(), "BAD_INPUT", "its fields are none"),
    "unknown datatype": (field_attribute(datatype=17), "BAD_INPUT", "datatype 17"),
    "count of three": (field_attribute(count=3), "BAD_INPUT", "count 3"),
    "offset beyond the point": (field_attribute(offset=999), "BAD_INPUT", "beyond point_step"),
    "point_step zero": (attribute(point_step=0), "BAD_INPUT", "point_step 0"),
    "data too short": (cut, "BAD_INPUT", "announces 50 points"),
    "width too large": (attribute(width=4_000_000_000), "BAD_INPUT", "announces 4000000000 points"),
    "height too large": (attribute(height=4_000_000_000), "BAD_INPUT", "announces 200000000000 points"),
    "empty frame": (frame(""), "BAD_INPUT", "empty frame_id"),
    "unknown frame": (frame("moon"), "TF_ERROR", "'moon' to 'base'"),
    "all NaN": (coordinates(math.nan), "NO_CLOUD", "(50 not finite)"),
    "all infinite": (coordinates(math.inf), "NO_CLOUD", "(50 not finite)"),
    "suddenly empty": (drop_all, "NO_CLOUD", "no stem point"),
    "thirteen points (the pipeline refuses)": (None, "BAD_INPUT", "thirteen stems"),
    "666 points (a defect)": (None, "INTERNAL_ERROR", "ZeroDivisionError"),
}


@pytest.mark.parametrize("case", CLOUDS)
def test_a_bad_stem_cloud(bench: Bench, case: str) -> None:
    change, code, words = CLOUDS[case]
    make_good(bench)
    settle()
    before = len(bench.commands)
    msg = bad_cloud(change) if change is not None else cloud(13 if "thirteen" in case else 666)
    bench.send_clouds(None, msg)
    settle()
    message = message_of(bench, "preview")
    assert message.startswith(f"{code}: "), message
    assert words in message
    assert message_of(bench, "plan").startswith(f"{code}: ")
    assert len(bench.commands) == before
    bench.send_clouds(None, cloud(100))
    settle()
    assert message_of(bench, "preview").startswith("SUCCEEDED")


LEAF_CLOUDS = {
    "no y": (fields("x", "z"), "BAD_INPUT", "leaf_cloud has no field 'y'"),
    "empty frame": (frame("/"), "BAD_INPUT", "empty frame_id"),
    "unknown frame": (frame("moon"), "TF_ERROR", "'moon' to 'base'"),
    "empty": (drop_all, "SUCCEEDED", ""),
    "all NaN": (coordinates(math.nan), "SUCCEEDED", ""),
    "known other frame": (frame("/mast"), "SUCCEEDED", ""),
}


@pytest.mark.parametrize("case", LEAF_CLOUDS)
def test_leaf_clouds(bench: Bench, case: str) -> None:
    change, code, words = LEAF_CLOUDS[case]
    make_good(bench)
    bench.send_clouds(bad_cloud(change), None)
    settle()
    message = message_of(bench, "preview")
    assert message.startswith(f"{code}: "), message
    assert words in message
    make_good(bench)
    settle()
    assert message_of(bench, "preview").startswith("SUCCEEDED")


def test_stamps_in_the_future_and_the_past(bench: Bench) -> None:
    make_good(bench)
    now = bench.node.get_clock().now().nanoseconds // 10**9
    for offset, settings, words in (
        (30, {}, "BAD_INPUT: the stamp of stem_cloud lies"),
        (-30, {"max_cloud_age_s": 5.0}, "STALE_INPUT: the newest stem_cloud is 3"),
        (-30, {"max_cloud_skew_s": 5.0}, "STALE_INPUT: leaf and stem cloud are 3"),
    ):
        msg = cloud(100)
        msg.header.stamp = Time(sec=int(now + offset))
        bench.stem.publish(msg)
        assert bench.set(**settings) == [""] * len(settings)
        settle()
        message = message_of(bench, "preview")
        assert message.startswith(words), message
        bench.set(**dict.fromkeys(settings, 0.0))
    make_good(bench)
    settle()
    assert message_of(bench, "preview").startswith("SUCCEEDED")


TARGETS = {
    "NaN position": ([math.nan, *GOOD[1:]], "base", "BAD_INPUT", "not finite"),
    "infinite position": ([math.inf, *GOOD[1:]], "base", "BAD_INPUT", "not finite"),
    "NaN rotation": ([*GOOD[:6], math.nan], "base", "BAD_INPUT", "not finite"),
    "zero quaternion": ([*GOOD[:3], 0.0, 0.0, 0.0, 0.0], "base", "BAD_INPUT", "quaternion has length"),
    "empty frame": (GOOD, "", "BAD_INPUT", "empty frame_id"),
    "unknown frame": (GOOD, "moon", "TF_ERROR", "'moon' to 'base'"),
    "out of reach": ([0.05, 0.0, -1.0, *GOOD[3:]], "base", "NO_IK_SOLUTION", "out of reach"),
    "long quaternion": ([*GOOD[:3], 0.0, 0.0, 0.0, 40.0], "base", "SUCCEEDED", ""),
    "known other frame": ([0.05, 0.0, -0.6, *GOOD[3:]], "mast", "SUCCEEDED", ""),
}


@pytest.mark.parametrize("case", TARGETS)
def test_targets(bench: Bench, case: str) -> None:
    pose, frame_id, code, words = TARGETS[case]
    make_good(bench)
    settle()
    before = len(bench.commands)
    bench.send_target(pose, frame_id)
    settle()
    services = ("preview",) if code == "SUCCEEDED" else ("preview", "plan")
    for service in services:
        message = message_of(bench, service)
        assert message.startswith(f"{code}: "), message
        assert words in message
    assert len(bench.commands) == before
    bench.send_target(GOOD)
    settle()
    assert message_of(bench, "preview").startswith("SUCCEEDED")


def test_an_old_target_is_stale(bench: Bench) -> None:
    make_good(bench)
    assert bench.set(max_target_age_s=0.3) == [""]
    time.sleep(0.5)
    assert message_of(bench).startswith("STALE_INPUT: the newest grasp_target is ")
    bench.send_target(GOOD)
    settle()
    assert message_of(bench, "preview").startswith("SUCCEEDED")
    bench.set(max_target_age_s=0.0)


def state(names: list[str], positions: list[float]) -> JointState:
    return JointState(name=names, position=positions)


STATES: dict[str, tuple[JointState | None, str, str]] = {
    "a joint missing": (state(["j1", "j2"], [0.0, 0.0]), "BAD_INPUT", "no joint j3"),
    "a joint twice": (state(["j1", "j2", "j3", "j3"], [0.0] * 4), "BAD_INPUT", "j3 more than once"),
    "NaN": (state(list(JOINTS), [0.0, math.nan, 0.0]), "BAD_INPUT", "j2 = nan"),
    "infinite": (state(list(JOINTS), [0.0, math.inf, 0.0]), "BAD_INPUT", "j2 = inf"),
    "fewer positions than names": (state(list(JOINTS), [0.0, 0.0]), "BAD_INPUT", "3 names but 2 positions"),
    "fingers only": (state(["finger"], [0.0]), "STALE_INPUT", "the newest joint state is"),
    "silence": (None, "STALE_INPUT", "the limit is 0.3 s"),
}


@pytest.mark.parametrize("case", STATES)
def test_joint_states(bench: Bench, case: str) -> None:
    msg, code, words = STATES[case]
    make_good(bench)
    settle()
    before = len(bench.commands)
    bench.publish_states = False
    deadline = time.monotonic() + 0.5
    while time.monotonic() < deadline:
        if msg is not None:
            msg.header.stamp = bench.node.get_clock().now().to_msg()
            bench.joints.publish(msg)
        time.sleep(0.02)
    message = message_of(bench)
    assert message.startswith(f"{code}: "), message
    assert words in message
    assert len(bench.commands) == before
    bench.publish_states = True
    settle()
    assert message_of(bench, "preview").startswith("SUCCEEDED")


@pytest.mark.parametrize(
    ("names", "positions"),
    [
        (["j3", "j1", "j2"], [START[2], START[0], START[1]]),
        (["finger", *JOINTS, "finger_2"], [9.0, *START, 9.0]),
    ],
)
def test_any_order_and_more_joints_are_normal(bench: Bench, names: list[str], positions: list[float]) -> None:
    make_good(bench)
    bench.publish_states = False
    for _ in range(40):
        msg = state(names, [float(v) for v in positions])
        msg.header.stamp = bench.node.get_clock().now().to_msg()
        bench.joints.publish(msg)
        time.sleep(0.01)
    assert message_of(bench, "preview").startswith("SUCCEEDED")
    bench.publish_states = True


def test_joint_states_with_stamps_of_another_clock(bench: Bench) -> None:
    make_good(bench)
    bench.publish_states = False
    now = bench.node.get_clock().now().nanoseconds // 10**9
    for offset, words in ((-10, "STALE_INPUT: the newest joint state is "), (30, "BAD_INPUT: the joint states' stamps lie ")):
        for _ in range(10):
            msg = state(list(JOINTS), [float(v) for v in START])
            msg.header.stamp = Time(sec=int(now + offset))
            bench.joints.publish(msg)
            time.sleep(0.02)
        message = message_of(bench)
        assert message.startswith(words), message
    bench.publish_states = True
    settle()
    assert message_of(bench, "preview").startswith("SUCCEEDED")


GOALS = {
    "NaN": ([math.nan, *GOOD[1:]], "base", "BAD_INPUT"),
    "zero quaternion": ([*GOOD[:3], 0.0, 0.0, 0.0, 0.0], "base", "BAD_INPUT"),
    "empty frame": (GOOD, "", "BAD_INPUT"),
    "unknown frame": (GOOD, "moon", "TF_ERROR"),
    "out of reach": ([0.05, 0.0, -1.0, *GOOD[3:]], "base", "NO_IK_SOLUTION"),
}


@pytest.mark.parametrize("case", GOALS)
def test_goals_of_preview_to(bench: Bench, case: str) -> None:
    pose, frame_id, code = GOALS[case]
    make_good(bench)
    settle()
    request = GetPlan.Request()
    request.goal.header.frame_id = frame_id
    request.goal.pose = to_pose(pose)
    count = len(bench.statuses)
    response = bench.call("preview_to", request)
    assert list(response.plan.poses) == []
    bench.wait(lambda: any(status["code"] == code for status in bench.statuses[count:]), 2.0, code)
    assert message_of(bench, "execute").startswith("NOTHING_TO_EXECUTE")
    request.goal.header.frame_id, request.goal.pose = "base", to_pose(BACK)
    assert len(bench.call("preview_to", request).plan.poses) == 5


def test_the_counts_add_up(bench: Bench) -> None:
    make_good(bench)
    settle()
    message_of(bench, "preview")
    time.sleep(1.2)
    for name in ("leaf_cloud", "stem_cloud", "grasp_target"):
        counts = {key: int(bench.health[f"{name}.{key}"]) for key in ("received", "used", "superseded", "refused")}
        assert counts["received"] == counts["used"] + counts["superseded"] + counts["refused"], (name, counts)
        assert counts["used"] > 0
