"""The planner as a ROS 2 node: topics, services and timers, wired to the parts that do the work.

Threads: the executor's (callbacks, all short), the worker's (one request at a time), the model loader's (loading and compiling) and
the stem watch's. Services are coroutines: they hand a request to the worker and wait for its answer without holding the executor.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

import lime_planner.motion.profile  # noqa: F401 (now, while there are no threads yet: later it would import Matplotlib as well)
from lime_planner.collision.arm_filter import make_arm_filter
from lime_planner.core.errors import LimePlannerError, Refusal
from lime_planner.core.status import Status
from lime_planner.robot.model import Robot
from lime_planner.ros import qos
from lime_planner.ros.convert import TargetMessage
from lime_planner.ros.display.displays import Displays
from lime_planner.ros.display.marker_publisher import MarkerPublisher
from lime_planner.ros.display.viewer_backend import Viewer, serve_page
from lime_planner.ros.execution.execution import Execution
from lime_planner.ros.execution.motion import Ended, Motion
from lime_planner.ros.execution.output import Output
from lime_planner.ros.execution.stem_watch import StemWatch, make_look
from lime_planner.ros.inputs.arm_camera import ArmCamera
from lime_planner.ros.inputs.frames import make_frames
from lime_planner.ros.inputs.latest import TARGETS, Inputs
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.model_loader import FROM_TOPIC, Builder, Loaded, ModelLoader, build
from lime_planner.ros.parameters import NodeParameters, Snapshot
from lime_planner.ros.programs import answered
from lime_planner.ros.requests.jobs import Requests
from lime_planner.ros.requests.parts import NodeParts
from lime_planner.ros.requests.services import Services
from lime_planner.ros.requests.status_board import Phase, StatusBoard, health_message, severity_of
from lime_planner.ros.requests.worker import Answer, RequestContext, Ticket, Worker
from lime_planner.ros.runtime import Severity, Throttle, give_back, run_node
from lime_planner.scene.from_clouds import CLOUDS, unfiltered

#: Python hands the interpreter from one thread to another this often [s]: callbacks wait less for the worker's Python.
_SWITCH_INTERVAL_S = 0.0003
_WATCH_PERIOD_S = 0.02
_OFFERS_PERIOD_S = 0.5
_WARNING_PERIOD_S = 5.0


class PlannerNode(Node):
    """The node `lime_planner`."""

    def __init__(self, builder: Builder = build, **options: Any) -> None:
        """Declare parameters, open topics and services, start the threads.

        Args:
            builder: makes robot and pipeline; tests put their own here.
            **options: of `rclpy.node.Node`: its context, parameter overrides.

        Raises:
            ParameterError: a parameter given at start is not allowed.
        """
        super().__init__("lime_planner", **options)
        self.threads_ended = False
        self.viewer: Viewer | None = None
        self.params = NodeParameters(self)
        settings = self.params.snapshot
        self._warn = Throttle(self.get_logger().warning, _WARNING_PERIOD_S)
        self.inputs = Inputs(self._ros_now_s, self._warn)
        self.frames = make_frames(self, settings.node.static_transforms)
        self.get_logger().info(f"frames from {self.frames.source}")
        self.source = SceneSource(self.inputs, self.frames, "", unfiltered, fixed_frame=settings.node.fixed_frame)  # of no arm yet
        self.source.memory_s = settings.node.view_memory_s
        self.output = Output(self, settings.node.trajectory_action)
        self.output.use(settings.node.controller)
        self._open_outputs()
        self._diagnosed_as = self.get_fully_qualified_name().lstrip("/")
        self.board = StatusBoard(self._diagnosed_as, self._now, self._status.publish)
        self.execution = Execution(self.inputs.joints, self.output, self)
        self.worker = Worker(self.get_logger().error, give_back)
        self.loader = ModelLoader(
            builder,
            settings.plan,
            may_exchange=lambda: not self.execution.active,
            on_loaded=self._on_loaded,
            report=self._log,
        )
        self.watch = StemWatch(self.execution, make_look(self.source, self.loader, self.execution), self._warn)
        self.markers = MarkerPublisher(self._markers, self.loader, self.worker, self._now, self._warn)
        display = Displays(self._tool_path, self._target, self.markers, self._now)
        parts = NodeParts(
            node=self,
            parameters=self.params,
            loader=self.loader,
            inputs=self.inputs,
            frames=self.frames,
            source=self.source,
            execution=self.execution,
            watch=self.watch,
            worker=self.worker,
            board=self.board,
            display=display,
        )
        self.requests = Requests(parts)
        self.params.on_change = self._on_parameters
        self._open_inputs(settings.plan.robot)
        self.request_services = Services(parts, self.requests, self._log)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # the watch goes on where simulated time stands still
        self._motion_timer = self.create_timer(_WATCH_PERIOD_S, self._safely(self._watch_motion), clock=steady)
        self._motion_timer.cancel()  # runs while there is a motion to watch
        self.create_timer(_OFFERS_PERIOD_S, self._safely(self._check_offers), clock=steady)
        self.create_timer(1.0, self._safely(self._publish_health), clock=steady)
        self.viewer = serve_page(parts, self.requests, self.request_services)
        display.page = None if self.viewer is None else self.viewer.backend
        motion = "enabled" if settings.node.motion_enabled else "disabled"
        self.get_logger().info(f"serving; motion is {motion}, robot {settings.plan.robot}")

    def shut_down(self) -> None:
        """Stop a motion, answer everyone and end the threads."""
        moving = self.execution.stop(Status.CANCELLED, "the planner node shuts down")
        self.worker.refuse()
        # A request that passed its point of no return in between has sent its motion by now, or holds the lock to do so.
        if self.execution.stop(Status.CANCELLED, "the planner node shuts down") or moving:
            self.output.flush(0.2)
        if self.viewer is not None:
            self.viewer.page.close()
        ended = [self.worker.close(), self.watch.close(), self.markers.close(), self.loader.close(0.5)]
        self.request_services.drain(0.5)
        self.threads_ended = all(ended)

    def _open_outputs(self) -> None:
        self._status = self.create_publisher(DiagnosticArray, "~/status", qos.LATCHED)
        self._target = self.create_publisher(PoseStamped, "~/target", qos.LATCHED)
        self._tool_path = self.create_publisher(Path, "~/tool_path", qos.LATCHED)
        self._markers = self.create_publisher(MarkerArray, "~/markers", qos.LATCHED)
        self._health = self.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def _open_inputs(self, robot: str) -> None:
        self._subscriptions_by_offer = [
            qos.AdaptiveSubscription(self, PointCloud2, name, qos.CLOUDS, self._safely(partial(self._on_cloud, name))) for name in CLOUDS
        ]
        self._subscriptions_by_offer += [
            qos.AdaptiveSubscription(self, kind, name, qos.NEWEST, self._safely(self._on_target)) for name, kind in TARGETS.items()
        ]
        self.create_subscription(JointState, "joint_states", self._safely(self._on_joint_state), qos.JOINT_STATES)
        if robot == FROM_TOPIC:
            self.create_subscription(String, "robot_description", self._safely(lambda msg: self.loader.offer(msg.data)), qos.LATCHED)

    def robot(self) -> Robot | None:
        """Return the model in use."""
        loaded = self.loader.loaded
        return None if loaded is None else loaded.robot

    def may_move(self) -> bool:
        """Whether motions are allowed now."""
        return self.params.snapshot.node.motion_enabled

    def simulated_s(self) -> float | None:
        """Return a simulation's time now [s], None without one."""
        return self._ros_now_s() if self.get_clock().ros_time_is_active else None

    def on_stop(self, motion: Motion) -> None:
        """Show that a motion is being stopped."""
        self.board.show(motion.plan_id, Phase.STOPPING)

    def on_end(self, ended: Ended) -> None:
        """Tell how a motion ended, and plan again where that is asked for."""
        motion = ended.motion
        message = ended.status.message(ended.sentence)
        if motion.look:
            self.get_logger().info(f"motion on the way of request {motion.plan_id}: {message}")
            if not self.requests.look_ended(ended):
                self.board.show(motion.plan_id, Phase.DONE)
            return
        self.board.show(motion.plan_id, Phase.DONE, execution_code=ended.status.name, execution_message=message)
        self.get_logger().info(f"motion of plan {motion.plan_id}: {message}")
        self.request_services.ended(ended)
        if self.viewer is not None:
            self.viewer.backend.on_end(message)
        aborted = ended.status in (Status.EXECUTION_DEVIATED, Status.STEM_APPEARED)
        if aborted and motion.replans_left > 0 and not self.worker.busy:

            def replan(ticket: Ticket) -> Answer:
                if self.execution.cancels != ended.cancels:
                    raise Refusal(Status.CANCELLED, "the arm was stopped before the motion could be planned again")
                return self.requests.plan(ticket)

            self.worker.submit("replan", replan, self.request_services.finish, RequestContext(motion.target, motion.replans_left - 1))

    def _on_parameters(self, snapshot: Snapshot) -> None:
        self.source.memory_s = snapshot.node.view_memory_s
        self.output.use(snapshot.node.controller)
        if not snapshot.node.motion_enabled:  # that holds for the motion that runs, too
            self.execution.stop(Status.CANCELLED, "motion_enabled was set to false")

    def _on_loaded(self, loaded: Loaded) -> None:
        robot = loaded.robot
        self.board.robot = robot.name
        self.inputs.set_joints(tuple(robot.joint_names), robot.held_joints, robot.continuous)
        self.execution.way_out.clear()
        frame = self.params.snapshot.node.camera_frame
        camera = ArmCamera(robot, frame, self.frames) if frame else None
        self.source.use_arm(robot.planning_frame, make_arm_filter(robot), camera)

    def _on_cloud(self, name: str, msg: PointCloud2) -> None:
        self.inputs.on_cloud(name, msg)
        self.source.arrived(name)
        if name != "leaf_cloud" and self.execution.motion is not None:
            self.watch.notice()

    def _on_target(self, msg: TargetMessage) -> None:
        if self.inputs.on_target(msg):
            self.source.arrived(self.inputs.newest_target)
            if isinstance(msg, PoseStamped):
                self._target.publish(msg)  # of others the grasp that is chosen for them

    def _on_joint_state(self, msg: JointState) -> None:
        state = self.inputs.on_joint_state(msg)
        if state is not None:
            self.execution.on_state(state)
            self._notice_motion()

    def _watch_motion(self) -> None:
        self.execution.tick()
        if not self.execution.watched:
            self._motion_timer.cancel()

    def _notice_motion(self) -> None:
        """Begin to watch a motion that was sent since the last look; for the executor's thread, which alone sets the timer."""
        if self._motion_timer.is_canceled() and self.execution.watched:
            self._motion_timer.reset()

    def _check_offers(self) -> None:
        self._notice_motion()
        for subscription in self._subscriptions_by_offer:
            subscription.check()
        self.markers.check()

    def _publish_health(self) -> None:
        ticket, motion = self.worker.current, self.execution.motion
        values = {
            **self.inputs.figures(),
            **{f"{subscription.topic}.lost": subscription.lost for subscription in self._subscriptions_by_offer},
            "last_status": self.board.last_message,
            "phase": self.board.phase.name,
            "worker": f"{ticket.kind} {ticket.plan_id}" if ticket is not None else "idle",
            "engine": self.loader.state,
            "motion": f"plan {motion.plan_id}" if motion is not None else "none",
            "motion_enabled": self.params.snapshot.node.motion_enabled,
            "controllers": self.output.listeners(self.params.snapshot.node.controller),
        }
        self._health.publish(health_message(self._now(), self._diagnosed_as, self.board.robot, self._trouble(), values))

    def _trouble(self) -> list[tuple[Severity, str]]:
        trouble = []
        if self.loader.failure:
            trouble.append((Severity.WARN if self.loader.ready else Severity.ERROR, self.loader.failure))
        elif not self.loader.ready:
            trouble.append((Severity.WARN, self.loader.state))
        for sentence in self.inputs.trouble(self.params.snapshot.node.max_joint_state_age_s):
            trouble.append((Severity.WARN, sentence))
        severity = severity_of(self.board.last_code)
        if severity is not Severity.OK:
            trouble.append((severity, f"the last request: {self.board.last_message}"))
        return trouble

    def _now(self) -> Time:
        return self.get_clock().now().to_msg()

    def _ros_now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _log(self, severity: Severity, sentence: str) -> None:
        if severity is Severity.ERROR:  # three calls: rclpy holds one place in the source to one severity
            self.get_logger().error(sentence)
        elif severity is Severity.WARN:
            self.get_logger().warning(sentence)
        else:
            self.get_logger().info(sentence)

    def _safely(self, callback: Callable[..., Any]) -> Callable[..., None]:
        """Wrap a callback: a defect in one message's handling is logged, and the node goes on serving."""

        def guarded(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except Exception:
                self.get_logger().error(traceback.format_exc())

        return guarded


def main() -> int:
    """Run the node until a signal."""
    code = answered("planner_node", sys.argv[1:])
    if code is not None:
        return code
    sys.setswitchinterval(_SWITCH_INTERVAL_S)

    nodes: list[PlannerNode] = []

    def factory() -> PlannerNode:
        try:
            nodes.append(PlannerNode())
            return nodes[0]
        except LimePlannerError as error:
            rclpy.try_shutdown()
            print(f"planner_node: {error}", file=sys.stderr)
            raise SystemExit(2) from None

    code = run_node(factory)
    if nodes and not nodes[0].threads_ended:
        # A compilation cannot be interrupted, and the interpreter must not be taken down under it.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(main())
