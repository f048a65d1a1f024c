"""`lime-planner doctor` on a running robot: a healthy one, and every planted fault found and named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from doctor_helpers import DOMAIN, Doctor, assert_named, doctor_fixture, surroundings  # noqa: F401  (fixtures)
from geometry_msgs.msg import PoseStamped
from live_robot import JOINTS, Robot
from rclpy.node import Node
from ros_fakes import cloud

from lime_planner.ros.inputs.latest import Inputs
from lime_planner.ros.parameters import snapshot_from
from lime_planner.ros.requests.status_board import health_message
from lime_planner.ros.tools import live_checks
from lime_planner.ros.tools.listener import Listener

pytestmark = pytest.mark.timed


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    robot = Robot(DOMAIN)
    yield robot
    robot.close()


class SharedListener:
    """Stands in for the listener that each run of the doctor would make: with many in one process, discovery takes seconds."""

    def __init__(self, listener: Listener, robot: Robot) -> None:
        self.listener = listener
        self.robot = robot

    def __call__(self, *_: Any, **__: Any) -> SharedListener:
        return self

    def __enter__(self) -> Listener:
        self.robot.wait_cycles(3)  # what was sent before the fault was planted is not waiting any more
        self.listener.inputs = Inputs(self.listener._ros_now_s, lambda _: None)
        self.listener.inputs.set_joints(JOINTS)
        self.listener.joint_state = None
        return self.listener

    def __exit__(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def shared(robot: Robot) -> Iterator[SharedListener]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
        with Listener(snapshot_from({}), JOINTS) as listener:
            yield SharedListener(listener, robot)


def test_a_healthy_robot(robot: Robot, doctor: Doctor) -> None:
    robot.heal()
    code, findings = doctor("--only", "live", "--wait", 5)
    assert {name: f for name, f in findings.items() if f["level"] != "ok"}.keys() == {"controller"}, findings
    assert code == 0
    assert "all 6 joints of kinova_j2s6s200" in findings["joint_states"]["sentence"]
    assert "200 points in 'base', 0.0 s old" in findings["stem_cloud"]["sentence"]


def silent(robot: Robot) -> None:
    robot.names = None


def other_joints(robot: Robot) -> None:
    robot.names = ("panda_joint1", "panda_joint2")


def joint_missing(robot: Robot) -> None:
    robot.names = JOINTS[:5]


def late_joints(robot: Robot) -> None:
    robot.age_s["joint_states"] = 4.0


def no_stems(robot: Robot) -> None:
    del robot.clouds["stem_cloud"]


def old_leaves(robot: Robot) -> None:
    robot.age_s["leaf_cloud"] = 30.0


def clock_ahead(robot: Robot) -> None:
    robot.age_s["stem_cloud"] = -60.0


def camera_frame(robot: Robot) -> None:
    robot.clouds["stem_cloud"] = cloud(50, frame_id="camera_optical")


def no_height(robot: Robot) -> None:
    robot.clouds["leaf_cloud"].fields = robot.clouds["leaf_cloud"].fields[:2]


def bad_target(robot: Robot) -> None:
    robot.pose = PoseStamped(pose=robot.pose.pose)


LIVE_FAULTS = [
    (silent, (), "joint_states", ["no message came within"]),
    (other_joints, (), "joint_states", ["names no joint of kinova_j2s6s200", "panda_joint1"]),
    (joint_missing, (), "joint_states", ["no joint j2s6s200_joint_6"]),
    (late_joints, (), "joint_states", ["4.", "s old", "limit is 0.3"]),
    (no_stems, (), "stem_cloud", ["no cloud came within"]),
    (old_leaves, ("--set", "max_cloud_age_s=2"), "leaf_cloud", ["30.", "s old", "limit is 2"]),
    (clock_ahead, (), "stem_cloud", ["in the future"]),
    (camera_frame, (), "stem_cloud", ["no transform from 'camera_optical' to 'base'"]),
    (no_height, (), "leaf_cloud", ["no field 'z'"]),
    (bad_target, (), "grasp_target", ["empty frame_id"]),
]


@pytest.mark.parametrize(("plant", "options", "check", "words"), LIVE_FAULTS, ids=[row[0].__name__ for row in LIVE_FAULTS])
def test_a_planted_fault_of_the_robot(
    robot: Robot,
    shared: SharedListener,
    monkeypatch: pytest.MonkeyPatch,
    doctor: Doctor,
    plant: Callable[[Robot], None],
    options: tuple[str, ...],
    check: str,
    words: list[str],
) -> None:
    monkeypatch.setattr("lime_planner.ros.tools.listener.Listener", shared)
    robot.heal()
    plant(robot)
    code, findings = doctor("--only", "live", "--wait", 0.7, *options)
    assert code == 1, findings
    assert_named(findings, check, *words)
    faults = [name for name, finding in findings.items() if finding["level"] == "fault"]
    assert faults == [check]


def test_a_running_planner(robot: Robot, shared: SharedListener, monkeypatch: pytest.MonkeyPatch, doctor: Doctor) -> None:
    """Its readiness and what it refuses; that it is silent; that there are two."""
    monkeypatch.setattr("lime_planner.ros.tools.listener.Listener", shared)
    monkeypatch.setattr(live_checks, "_HEALTH_S", 0.5)
    robot.heal()
    planner = Node("lime_planner", context=robot.context)
    try:
        shared.listener.wait(lambda: len(shared.listener.planners()) == 1, 10.0)
        _, findings = doctor("--only", "live", "--wait", 1)
        assert_named(findings, "planner", "/lime_planner runs, but tells nothing on /diagnostics")
        assert_named(findings, "controller", "has no subscriber")  # where a planner runs, silence is a fault
        values = {"engine": "ready", "motion_enabled": False, "last_status": "", "leaf_cloud.refusal": "leaf_cloud has no field 'x'"}
        health = planner.create_publisher(DiagnosticArray, "/diagnostics", 10)
        shared.listener.wait(lambda: health.get_subscription_count() > 0, 10.0)
        health.publish(health_message(planner.get_clock().now().to_msg(), "lime_planner", "fake", [], values))
        shared.listener.wait(lambda: bool(shared.listener.health), 10.0)
        _, findings = doctor("--only", "live", "--wait", 1)
        words = ("/lime_planner: ready, motion is disabled, last answer none yet", "it refuses: leaf_cloud has no field 'x'")
        assert_named(findings, "planner", *words, level="warning")
        second = Node("lime_planner", context=robot.context)
        shared.listener.wait(lambda: len(shared.listener.planners()) == 2, 10.0)
        _, findings = doctor("--only", "live", "--wait", 1)
        assert_named(findings, "planner", "2 nodes are named /lime_planner")
        second.destroy_node()
    finally:
        planner.destroy_node()
        shared.listener.health.clear()


def test_planted_faults_of_the_graph(robot: Robot, doctor: Doctor, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Another domain, topics elsewhere, a clock without a publisher."""
    robot.heal()
    code, findings = doctor("--only", "live", "--live", "--wait", 0.3, "--namespace", "/left")
    assert code == 1
    assert_named(findings, "joint_states", "/left/joint_states has no publisher")
    assert "/joint_states: --joint-states TOPIC" in findings["joint_states"]["cure"]
    assert "/leaf_cloud, /stem_cloud: --stem TOPIC" in findings["stem_cloud"]["cure"]
    parameters = tmp_path / "simulated.yaml"
    parameters.write_text("/**:\n  ros__parameters: {use_sim_time: true}\n")
    _, findings = doctor("--only", "live", "--wait", 0.3, "--params", parameters)
    assert_named(findings, "clock", "/clock has no publisher")
    monkeypatch.setattr(live_checks, "_DISCOVERY_S", 0.2)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN + 1))
    code, findings = doctor("--only", "live", "--live", "--wait", 0.3)
    assert code == 1
    assert_named(findings, "domains", f"nothing is heard in domain {DOMAIN + 1}", f"{DOMAIN} (")


def test_what_came_before_anyone_asked_is_told(robot: Robot, shared: SharedListener) -> None:
    with shared as listener:
        listener.wait(lambda: all(listener.inputs.slots[name].newest for name in ("leaf_cloud", "stem_cloud")), 10.0)
        told: list[str] = []
        listener.tell_arrivals(told.append)
        assert {"leaf_cloud", "stem_cloud", "grasp_target"} <= set(told[:3]), told
        count = len(told)
        assert listener.wait(lambda: len(told) > count, 10.0)
        listener.tell_arrivals(lambda _name: None)
