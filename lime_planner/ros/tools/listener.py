"""Hears what the planner node would hear, without being one: for `lime-planner doctor` and `lime-planner record`."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState, PointCloud2

from lime_planner.ros import qos
from lime_planner.ros.convert import TargetMessage
from lime_planner.ros.inputs.frames import Frames, make_frames
from lime_planner.ros.inputs.latest import TARGETS, Inputs
from lime_planner.ros.parameters import Snapshot
from lime_planner.ros.requests.status_board import read_status
from lime_planner.ros.runtime import Spinning
from lime_planner.scene.from_clouds import CLOUDS

#: The inputs, under the names that the planner node has for them.
INPUTS = ("joint_states", *CLOUDS, *TARGETS)
_PLANNER = "lime_planner"
_CHECK_PERIOD_S = 0.2


class Listener:
    """A node that only listens; callbacks run in a thread of its own. A context manager.

    Attributes:
        inputs: what has arrived.
        frames: where frames are.
        topics: full names of the inputs' topics.
        joint_state: the newest message.
        health: what the planner last said in `/diagnostics`.
    """

    def __init__(
        self,
        snapshot: Snapshot,
        joint_names: Sequence[str],
        *,
        topics: Mapping[str, str] | None = None,
        namespace: str = "",
        use_sim_time: bool = False,
    ) -> None:
        """Join the graph and subscribe.

        Args:
            snapshot: parameters; the static transforms are taken from it.
            joint_names: the arm's joints; empty where they are not known.
            topics: topics of inputs (`INPUTS`) that are not at their own names.
            namespace: of the node, and so of the relative topics.
            use_sim_time: take the time from `/clock`; otherwise that is done as soon as something publishes there.

        Raises:
            ParameterError: static transforms that cannot be read.
        """
        context = rclpy.Context()
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        simulated = [Parameter("use_sim_time", value=use_sim_time)]
        self.node = Node(f"lime_planner_listener_{os.getpid()}", context=context, namespace=namespace, parameter_overrides=simulated)
        self._simulated = use_sim_time
        names = {name: (topics or {}).get(name, name) for name in INPUTS}
        self.topics = {name: self.node.resolve_topic_name(topic) for name, topic in names.items()}
        self.inputs = Inputs(self._ros_now_s, lambda _sentence: None)
        if joint_names:
            self.inputs.set_joints(tuple(joint_names))
        self.frames: Frames = make_frames(self.node, snapshot.node.static_transforms)
        self._on_arrival: Callable[[str], None] = lambda _name: None
        self._arrivals = threading.Lock()
        self.joint_state: JointState | None = None
        self.health: dict[str, str] = {}
        self._subscriptions = [
            qos.AdaptiveSubscription(self.node, PointCloud2, names[name], qos.NEWEST, partial(self._on_cloud, name)) for name in CLOUDS
        ]
        self._subscriptions += [
            qos.AdaptiveSubscription(self.node, kind, names[name], qos.NEWEST, self._on_target) for name, kind in TARGETS.items()
        ]
        self.node.create_subscription(JointState, names["joint_states"], self._on_joint_state, qos.JOINT_STATES)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        self.node.create_timer(_CHECK_PERIOD_S, self._check_offers)
        self.node.get_logger().set_level(rclpy.logging.LoggingSeverity.WARN)  # what it subscribes to is no news
        self._spinning = Spinning(self.node)

    def publishers(self, name: str) -> int:
        """Count the publishers of an input."""
        return int(self.node.count_publishers(self.topics[name]))

    def offers(self, name: str) -> list[QoSProfile]:
        """Return what the publishers of an input offer."""
        return [info.qos_profile for info in self.node.get_publishers_info_by_topic(self.topics[name])]

    def topics_of(self, message_type: str) -> list[str]:
        """Return the topics with publishers of a type, such as `sensor_msgs/msg/JointState`."""
        known = self.node.get_topic_names_and_types()
        return sorted(topic for topic, types in known if message_type in types and self.node.count_publishers(topic))

    def planners(self) -> list[str]:
        """Return the full names of the planner nodes in sight."""
        return sorted(f"{space.rstrip('/')}/{name}" for name, space in self.node.get_node_names_and_namespaces() if name == _PLANNER)

    def tell_arrivals(self, on_arrival: Callable[[str], None]) -> None:
        """Have a function called with the name of each input that comes, a cloud's or a target's; at once for what has come already.

        Args:
            on_arrival: called in the thread of the callbacks from then on.
        """
        with self._arrivals:
            self._on_arrival = on_arrival
            for name in (*CLOUDS, *TARGETS):
                if self.inputs.slots[name].newest is not None:
                    on_arrival(name)

    def wait(self, condition: Callable[[], bool], timeout_s: float, *, poll_s: float = 0.01) -> bool:
        """Wait until a condition holds, looked at every `poll_s`; False if it does not in time."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= deadline:
                return False
            time.sleep(poll_s)
        return True

    def __enter__(self) -> Listener:
        """Nothing to do: it listens since it was made."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph."""
        self._spinning.close()

    def _on_cloud(self, name: str, msg: PointCloud2) -> None:
        self.inputs.on_cloud(name, msg)
        self._arrive(name)

    def _on_target(self, msg: TargetMessage) -> None:
        if self.inputs.on_target(msg):
            self._arrive(self.inputs.newest_target)

    def _arrive(self, name: str) -> None:
        with self._arrivals:
            self._on_arrival(name)

    def _on_joint_state(self, msg: JointState) -> None:
        self.joint_state = msg
        self.inputs.on_joint_state(msg)

    def _on_health(self, msg: DiagnosticArray) -> None:
        pairs: dict[str, Any] = read_status(msg)
        if "engine" in pairs:
            self.health = pairs

    def _check_offers(self) -> None:
        if not self._simulated and self.node.count_publishers("/clock"):
            self._simulated = True  # a simulator, or a recording that is played: its stamps are not of this machine's clock
            self.node.set_parameters([Parameter("use_sim_time", value=True)])
        for subscription in self._subscriptions:
            subscription.check()

    def _ros_now_s(self) -> float:
        return float(self.node.get_clock().now().nanoseconds) * 1e-9
