"""An arm behind the action of a joint trajectory controller, in a process of its own: it plays goals as the controller does.

The parameter `fault` says what is to go wrong: `reject`, `reject_stops`, `violate`, `silent`. What happens is printed, a line each.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from typing import Any

import numpy as np
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from ros_fakes import JOINTS, START
from sensor_msgs.msg import JointState

from lime_planner.motion.trajectory import Trajectory

ACTION = "joint_trajectory_controller/follow_joint_trajectory"


class Arm(Node):
    """Joint states at 100 Hz, and the action."""

    def __init__(self) -> None:
        super().__init__("action_arm")
        self.lock = threading.Lock()
        self.q = np.array(START, dtype=float)
        self.active: Any = None
        self.declare_parameter("fault", "")
        self.publisher = self.create_publisher(JointState, "joint_states", 10)
        self.create_timer(0.01, self.publish, callback_group=ReentrantCallbackGroup())
        self.server = ActionServer(
            self,
            FollowJointTrajectory,
            ACTION,
            self.play,
            goal_callback=self.judge,
            handle_accepted_callback=self.begin,
            cancel_callback=self.cancel,
            callback_group=MutuallyExclusiveCallbackGroup(),  # no cancellation is heard between a goal's acceptance and its begin
        )

    @property
    def fault(self) -> str:
        return str(self.get_parameter("fault").value)

    def publish(self) -> None:
        msg = JointState(name=list(JOINTS), position=[float(angle) for angle in self.q])
        msg.header.stamp = self.get_clock().now().to_msg()
        self.publisher.publish(msg)

    def judge(self, goal: Any) -> GoalResponse:
        stops = len(goal.trajectory.points) < 2 or self.active is not None
        if self.fault == "reject" or (self.fault == "reject_stops" and stops):
            print("rejected", flush=True)
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def cancel(self, handle: Any) -> CancelResponse:
        print("cancel of the active goal" if handle is self.active else "cancel of another goal", flush=True)
        return CancelResponse.ACCEPT

    def begin(self, handle: Any) -> None:
        print(f"goal of {len(handle.request.trajectory.points)} points", flush=True)
        with self.lock:
            self.active = handle  # the one before is let go, as the controller does
        handle.execute()

    def play(self, handle: Any) -> Any:
        msg = handle.request.trajectory
        times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in msg.points]
        rows, speeds = (np.array([getattr(point, what) for point in msg.points]) for what in ("positions", "velocities"))
        motion = Trajectory.from_samples(tuple(msg.joint_names), times, rows, speeds)
        began, result = time.monotonic(), FollowJointTrajectory.Result()
        while (elapsed := time.monotonic() - began) < motion.duration_s:
            if self.active is not handle:
                print("another goal took over", flush=True)
                handle.abort() if not handle.is_cancel_requested else handle.canceled()
                return result
            if handle.is_cancel_requested:
                self.active = None
                handle.canceled()
                return result
            if self.fault == "violate" and elapsed > 0.5 * motion.duration_s:
                self.active = None
                result.error_code, result.error_string = FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, "j1 is 0.3 rad off"
                handle.abort()
                return result
            self.q = motion.sample(elapsed)
            time.sleep(0.005)
        self.q = motion.sample(motion.duration_s)
        self.active = None
        if self.fault == "silent":
            time.sleep(20.0)
        result.error_code = FollowJointTrajectory.Result.SUCCESSFUL
        handle.succeed()
        return result


def main() -> int:
    rclpy.init()
    executor = MultiThreadedExecutor(6)
    executor.add_node(Arm())
    print("the action is served", flush=True)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()
    return 0


if __name__ == "__main__":
    sys.exit(main())
