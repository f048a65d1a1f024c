"""An arm and its cameras for the tests of the commands that listen to a running system."""

from __future__ import annotations

import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_fakes import cloud
from sensor_msgs.msg import JointState, PointCloud2

from lime_planner.robot.builtin import BUILTIN_ARMS
from lime_planner.ros import qos
from lime_planner.ros.convert import to_pose

JOINTS = BUILTIN_ARMS["kinova_j2s6s200"].joint_names
HOME = BUILTIN_ARMS["kinova_j2s6s200"].home


class Robot:
    """Arm and cameras, in a thread of this process; what they publish can be changed at any time."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("robot", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.names: tuple[str, ...] | None = JOINTS
        self.age_s = {"joint_states": 0.0, "leaf_cloud": 0.0, "stem_cloud": 0.0}
        self.clouds: dict[str, PointCloud2] = {}
        self.joints = self.node.create_publisher(JointState, "joint_states", 10)
        self.publishers = {name: self.node.create_publisher(PointCloud2, name, qos.NEWEST) for name in ("leaf_cloud", "stem_cloud")}
        self.target = self.node.create_publisher(PoseStamped, "grasp_target", qos.LATCHED)
        self.node.create_timer(0.05, self.publish)
        self.cycles = 0
        self.done = threading.Event()
        self.thread = threading.Thread(target=self.spin, daemon=True)
        self.heal()
        self.thread.start()

    def heal(self) -> None:
        self.names = JOINTS
        self.age_s = dict.fromkeys(self.age_s, 0.0)
        self.clouds = {"leaf_cloud": cloud(300), "stem_cloud": cloud(200)}
        self.cameras: tuple[str, ...] = ()  #: frames of cameras that take turns
        msg = PoseStamped(pose=to_pose([0.5, 0.1, 0.4, 0.0, 0.0, 0.0, 1.0]))
        msg.header.frame_id = "base"
        self.pose = msg

    def publish(self) -> None:
        self.cycles += 1
        self.target.publish(self.pose)
        if self.names is not None:
            msg = JointState(name=list(self.names), position=[*HOME, *[0.0] * len(self.names)][: len(self.names)])
            msg.header.stamp = self.stamp("joint_states")
            self.joints.publish(msg)
        for name, msg in list(self.clouds.items()):
            msg.header.stamp = self.stamp(name)
            if self.cameras:
                msg.header.frame_id = self.cameras[self.cycles % len(self.cameras)]
            self.publishers[name].publish(msg)

    def stamp(self, name: str) -> Any:
        return (self.node.get_clock().now() - Duration(seconds=self.age_s[name])).to_msg()

    def spin(self) -> None:
        while not self.done.is_set():
            self.executor.spin_once(timeout_sec=0.1)

    def wait_cycles(self, count: int) -> None:
        wanted, deadline = self.cycles + count, time.monotonic() + 10.0
        while self.cycles < wanted and time.monotonic() < deadline:
            time.sleep(0.01)

    def close(self) -> None:
        self.done.set()
        self.thread.join(5.0)
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
