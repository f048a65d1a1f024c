"""The demo's own node: asks for the plan, follows the motion, and keeps what the arm's joint states said."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from lime_planner.core.types import Array
from lime_planner.ros import qos
from lime_planner.ros.demo.processes import Corner, DemoError
from lime_planner.ros.requests.status_board import read_status
from lime_planner.ros.runtime import Spinning

_PLANNER = "lime_planner"


class DemoClient:
    """A client of the planner and a reader of the arm; callbacks run in a thread of its own. A context manager."""

    def __init__(self, corner: Corner, joint_names: tuple[str, ...], check: Callable[[], None]) -> None:
        """Join the demo's corner of the graph.

        Args:
            corner: where the nodes meet.
            joint_names: the arm's joints, in the order of the arrays returned here.
            check: called while waiting; raises when waiting has become senseless.
        """
        os.environ.update(ROS_DOMAIN_ID=str(corner.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        self._names = joint_names
        self._check = check
        self._states: list[Array] = []
        self._status: dict[str, str] = {}
        self._health: dict[str, str] = {}
        rclpy.init(args=[], domain_id=corner.domain, signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node("demo", namespace=corner.namespace)
        node.create_subscription(JointState, "joint_states", self._on_joint_state, qos.JOINT_STATES)
        node.create_subscription(DiagnosticArray, f"{_PLANNER}/status", self._on_status, qos.EVERY_STATUS)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        self._plan = node.create_client(Trigger, f"{_PLANNER}/plan", qos_profile=qos.SERVICE)
        self._spinning = Spinning(node)

    @property
    def node(self) -> Node:
        """The node, for more subscriptions and clients."""
        return self._spinning.node

    @property
    def states(self) -> Array:
        """Every configuration measured so far, (S, n) [rad]."""
        return np.array(self._states).reshape(-1, len(self._names))

    @property
    def status(self) -> dict[str, str]:
        """The pairs of the planner's newest status message."""
        return self._status

    @property
    def engine(self) -> str:
        """What the planner's health message says about its readiness; empty before the first one."""
        return self._health.get("engine", "")

    def wait(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        """Wait until a condition holds.

        Raises:
            DemoError: it does not in time; the text names what was waited for.
        """
        deadline = time.monotonic() + timeout_s
        while not condition():
            self._check()
            if time.monotonic() > deadline:
                raise DemoError(f"waited {timeout_s:g} s in vain for {what}")
            time.sleep(0.02)

    def planner_serves(self) -> bool:
        """Tell whether the planner's service and the first joint state are there."""
        return bool(self._plan.service_is_ready()) and bool(self._states)

    def plan(self, timeout_s: float) -> tuple[bool, str]:
        """Call `~/plan`, and again while an input has not arrived yet; return success and message."""
        early = ("NOT_READY", "NO_CLOUD", "NO_TARGET", "NO_JOINT_STATE", "NO_CONTROLLER")
        deadline = time.monotonic() + timeout_s
        while True:
            answer = self._plan.call_async(Trigger.Request())
            self.wait(answer.done, max(1.0, deadline - time.monotonic()), "an answer of ~/plan")
            response: Any = answer.result()
            if response.success or not response.message.startswith(early) or time.monotonic() > deadline:
                return bool(response.success), str(response.message)
            time.sleep(0.3)

    def still(self, tolerance_rad: float = 1e-4, states: int = 3) -> bool:
        """Tell whether the arm rests, by its positions."""
        newest = self._states[-states:]
        return len(newest) == states and float(np.ptp(newest, axis=0).max()) < tolerance_rad

    def __enter__(self) -> DemoClient:
        """Nothing to do."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph."""
        self._spinning.close()

    def _on_joint_state(self, msg: JointState) -> None:
        positions = dict(zip(msg.name, msg.position, strict=False))
        if all(name in positions for name in self._names):
            self._states.append(np.array([positions[name] for name in self._names]))

    def _on_status(self, msg: DiagnosticArray) -> None:
        self._status = {**read_status(msg), "message": msg.status[0].message if msg.status else ""}

    def _on_health(self, msg: DiagnosticArray) -> None:
        pairs = read_status(msg)
        if "engine" in pairs:
            self._health = pairs
