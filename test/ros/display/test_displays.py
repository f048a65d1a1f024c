"""RViz's and Foxglove's files name what the nodes really publish; markers are drawn while somebody looks, and hold what they promise."""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from arm_helpers import robot_named
from builtin_interfaces.msg import Time
from domains import DOMAIN
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from ros_fakes import FakeRobot, build_fake, result

from lime_planner.core.parameters import settings_from
from lime_planner.pipeline.result import PlanRecord
from lime_planner.robot.convex_hulls import arm_hull
from lime_planner.robot.model import home
from lime_planner.ros.display.marker_publisher import MarkerPublisher
from lime_planner.ros.display.markers import Extras, markers
from lime_planner.ros.nodes import planner_node
from lime_planner.ros.nodes.mock_arm_node import MockArmNode
from lime_planner.ros.nodes.scene_node import SceneNode
from lime_planner.ros.parameters import snapshot_from
from lime_planner.ros.requests.parts import PlannedRequest
from lime_planner.scene.scene import Scene

ROOT = Path(__file__).resolve().parents[3]

#: What RViz's displays and Foxglove's panels show.
RVIZ_TYPES = {
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "Path": "nav_msgs/msg/Path",
    "Pose": "geometry_msgs/msg/PoseStamped",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
}
FOXGLOVE_3D = set(RVIZ_TYPES.values())
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


@pytest.fixture(scope="module")
def nodes() -> Iterator[list[Node]]:
    """The three nodes as they are at start, in this process; nothing is spun."""
    rclpy.init(args=[], domain_id=DOMAIN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner_node, "make_arm_filter", lambda robot: lambda scene, q, padding_m: scene)
        made = [planner_node.PlannerNode(build_fake), SceneNode(), MockArmNode()]
        yield made
        made[0].shut_down()
        for node in made:
            node.destroy_node()
        rclpy.shutdown()


def published(nodes: list[Node]) -> dict[str, tuple[str, QoSProfile]]:
    """Type and quality of service of every topic that the nodes publish."""
    found = {}
    for node in nodes:
        for topic, types in node.get_publisher_names_and_types_by_node(node.get_name(), node.get_namespace()):
            found[topic] = (types[0], node.get_publishers_info_by_topic(topic)[0].qos_profile)
    return found


#: Beside the simulated arm, and beside a real Kinova.
RVIZ_FILES = ("lime_planner.rviz", "kinova.rviz")


def rviz(name: str) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((ROOT / "rviz" / name).read_text())["Visualization Manager"]
    return content


def rviz_displays(name: str = "lime_planner.rviz") -> list[dict[str, Any]]:
    return [display for display in rviz(name)["Displays"] if "Topic" in display]


def test_there_are_no_other_rviz_files() -> None:
    assert {path.name for path in (ROOT / "rviz").iterdir()} == set(RVIZ_FILES)


@pytest.mark.parametrize("name", RVIZ_FILES)
def test_rviz_displays_what_is_published(nodes: list[Node], name: str) -> None:
    there = published(nodes)
    displays = rviz_displays(name)
    assert len(displays) == 5
    for display in displays:
        topic = display["Topic"]
        kind, offered = there[topic["Value"]]
        assert RVIZ_TYPES[display["Class"].removeprefix("rviz_default_plugins/")] == kind, display["Name"]
        wanted = QoSProfile(
            depth=topic["Depth"],
            history=HistoryPolicy.KEEP_LAST,
            reliability=ReliabilityPolicy[topic["Reliability Policy"].upper().replace(" ", "_")],
            durability=DurabilityPolicy[topic["Durability Policy"].upper().replace(" ", "_")],
        )
        assert qos_check_compatible(offered, wanted)[0] != QoSCompatibility.ERROR, display["Name"]
        # Cameras publish best effort; their clouds must be seen too.
        if kind == RVIZ_TYPES["PointCloud2"]:
            camera = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
            assert qos_check_compatible(camera, wanted)[0] != QoSCompatibility.ERROR


def test_beside_a_real_kinova_rviz_shows_its_arm_in_its_frame() -> None:
    """The driver's TF is world, root, <name>_link_base and on; its robot_state_publisher latches the description."""
    simulated, real = rviz("lime_planner.rviz"), rviz("kinova.rviz")
    assert simulated["Global Options"]["Fixed Frame"] == "base"
    assert real["Global Options"]["Fixed Frame"] == "root"
    [arm] = [display for display in real["Displays"] if display["Class"] == "rviz_default_plugins/RobotModel"]
    assert arm["Enabled"] and arm["Visual Enabled"] and arm["TF Prefix"] == "" and arm["Description Source"] == "Topic"
    assert arm["Description Topic"]["Value"] == "/robot_description"
    assert arm["Description Topic"]["Durability Policy"] == "Transient Local"
    assert arm["Description Topic"]["Reliability Policy"] == "Reliable"
    assert [display for display in real["Displays"] if display is not arm] == simulated["Displays"]


def panels_of(layout: Any) -> set[str]:
    return {layout} if isinstance(layout, str) else panels_of(layout["first"]) | panels_of(layout["second"])


def test_foxglove_shows_what_is_published_and_calls_what_is_served(nodes: list[Node]) -> None:
    there = {topic: kind for topic, (kind, _) in published(nodes).items()}
    planner = nodes[0]
    services = dict(planner.get_service_names_and_types_by_node(planner.get_name(), planner.get_namespace()))
    content = json.loads((ROOT / "foxglove" / "lime_planner.json").read_text())
    assert panels_of(content["layout"]) == set(content["configById"])
    for name, panel in content["configById"].items():
        kind = name.split("!")[0]
        if kind == "3D":
            assert panel["topics"] and {there[topic] for topic in panel["topics"]} <= FOXGLOVE_3D
        elif kind.startswith("Diagnostic"):
            assert there[panel["topicToRender"]] == DIAGNOSTICS
        elif kind == "Plot":
            assert {there[path["value"].split(".")[0]] for path in panel["paths"]} == {"sensor_msgs/msg/JointState"}
        else:
            assert kind == "CallService"
            assert services[panel["serviceName"]] == ["std_srvs/srv/Trigger"]
            assert panel["serviceName"].rsplit("/", 1)[1] in ("preview", "stop")  # no button here moves the arm


def test_rviz_knows_every_kind_of_marker() -> None:
    extras = Extras(np.zeros((2, 3, 3)), np.zeros((4, 3)), np.zeros((3, 2, 3)))
    scene = Scene(np.ones((3, 3)), np.ones(3), np.ones((5, 3)), np.ones((2, 3)))
    settings = settings_from({"keep_out_boxes": [0.0, 0.0, 0.0, 1.0, 2.0, 3.0]})
    extras = dataclasses.replace(extras, unseen=np.full((20_001, 3), 0.5))
    array = markers(PlanRecord(1, scene, settings, np.eye(7)[6], result(np.zeros(3), np.ones(3))), Time(), extras)  # type: ignore[arg-type]
    by_name = {marker.ns: marker for marker in array.markers if marker.ns}
    assert 5000 < len(by_name["unseen"].points) <= 10_000, "thinned to what a display can show"
    [shown] = [display for display in rviz_displays() if display["Name"] == "Plan"]
    assert set(shown["Namespaces"]) == set(by_name)
    assert len(by_name["goal_arm"].points) == 6 and len(by_name["touched_leaves"].points) == 4 and len(by_name["tree"].points) == 6


class Watched:
    """A publisher whose subscribers come and go."""

    def __init__(self) -> None:
        self.subscribers = 0
        self.sent: list[set[str]] = []
        self.new = threading.Event()

    def publish(self, msg: Any) -> None:
        self.sent.append({marker.ns for marker in msg.markers})
        self.new.set()

    def get_subscription_count(self) -> int:
        return self.subscribers


NO_MODEL = SimpleNamespace(loaded=None)
IDLE = SimpleNamespace(current=None)


def plan_of(count: int) -> PlannedRequest:
    scene = Scene(np.ones((count, 3)), np.ones(count), np.ones((5, 3)), np.empty((0, 3)))
    target = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    record = PlanRecord(1, scene, settings_from({}), target, result(np.zeros(3), np.ones(3)))  # type: ignore[arg-type]
    return PlannedRequest(record, None, snapshot_from({}), 1)


def test_markers_are_drawn_only_while_somebody_subscribes() -> None:
    publisher, warnings = Watched(), []
    drawer = MarkerPublisher(publisher, NO_MODEL, IDLE, Time, warnings.append)
    try:
        drawer.show(plan_of(3))
        drawer.check()
        time.sleep(0.1)
        assert publisher.sent == []
        publisher.subscribers = 1  # who comes late gets the plan that is there
        deadline = time.monotonic() + 5.0
        while not publisher.sent and time.monotonic() < deadline:
            drawer.check()
            time.sleep(0.01)
        assert publisher.sent == [{"", "leaves", "stems", "target", "excluded_sphere", "tool_path"}]
        drawer.check()
        time.sleep(0.05)
        assert len(publisher.sent) == 1  # once
    finally:
        assert drawer.close()
    assert warnings == []


def test_the_desk_closes_at_once_while_it_draws() -> None:
    publisher, drawing, go_on = Watched(), threading.Event(), threading.Event()
    publisher.subscribers = 1

    def publish(msg: object) -> None:
        drawing.set()
        go_on.wait(5.0)

    publisher.publish = publish  # type: ignore[method-assign]
    drawer = MarkerPublisher(publisher, NO_MODEL, IDLE, Time, lambda text: None)
    drawer.show(plan_of(3))
    assert drawing.wait(5.0)
    threading.Timer(0.2, go_on.set).start()
    began_s = time.monotonic()
    assert drawer.close()
    assert time.monotonic() - began_s < 1.0


def test_a_plan_that_comes_while_another_is_drawn_is_drawn_next() -> None:
    publisher, drawing, go_on, drawn = Watched(), threading.Event(), threading.Event(), threading.Semaphore(0)
    publisher.subscribers = 1

    def publish(msg: object) -> None:
        drawing.set()
        go_on.wait(5.0)
        drawn.release()

    publisher.publish = publish  # type: ignore[method-assign]
    drawer = MarkerPublisher(publisher, NO_MODEL, IDLE, Time, lambda text: None)
    drawer.show(plan_of(3))
    assert drawing.wait(5.0)
    drawer.show(plan_of(4))
    go_on.set()
    assert drawn.acquire(timeout=5.0) and drawn.acquire(timeout=5.0), "without another check"
    assert drawer.close()


def test_a_picture_that_fails_is_a_warning() -> None:
    publisher, warned = Watched(), threading.Event()
    publisher.subscribers = 1
    publisher.publish = lambda msg: 1 / 0  # type: ignore[method-assign]
    drawer = MarkerPublisher(publisher, NO_MODEL, IDLE, Time, lambda text: warned.set() if "ZeroDivisionError" in text else None)
    try:
        deadline = time.monotonic() + 5.0
        while not warned.is_set() and time.monotonic() < deadline:
            drawer.show(plan_of(3))
            time.sleep(0.01)
        assert warned.is_set()
    finally:
        assert drawer.close()


def test_the_arm_as_a_hull_stands_where_the_arm_stands() -> None:
    robot = robot_named()
    q = home(robot)
    triangles = arm_hull(robot, q)
    assert triangles.shape[1:] == (3, 3) and 300 < len(triangles) < 2000
    poses = robot.link_poses(q)
    everything = np.concatenate([link.vertices @ poses[link.joint][:3, :3].T + poses[link.joint][:3, 3] for link in robot.links])
    corners = triangles.reshape(-1, 3)
    assert np.abs(corners.min(axis=0) - everything.min(axis=0)).max() < 0.02
    assert np.abs(corners.max(axis=0) - everything.max(axis=0)).max() < 0.02
    assert arm_hull(FakeRobot(), np.zeros(3)).shape == (0, 3, 3)  # type: ignore[arg-type]
