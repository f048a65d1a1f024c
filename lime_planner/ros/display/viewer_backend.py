"""The planner node behind its own 3-D page: shows the node's state, and asks for what its services do."""

from __future__ import annotations

import os
import threading
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter as RosParameter

from lime_planner.core.errors import LimePlannerError
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.refusal import Refusal
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.plan_record import PlanRecord
from lime_planner.ros.convert import to_pose
from lime_planner.ros.requests.jobs import Shown as Planned
from lime_planner.ros.requests.worker import Answer, Ticket
from lime_planner.scene.scene import Scene
from lime_planner.viewer.access import Access
from lime_planner.viewer.backend import Activity, Moment, Wishes

if TYPE_CHECKING:
    from lime_planner.ros.nodes.planner_node import PlannerNode
    from lime_planner.viewer.page import Page


#: Clouds are decoded for the page this often at most [s]: looking must not slow planning.
_SCENE_PERIOD_S = 2.0
#: What a browser on another machine must know, where `viewer_host` lets it in. No parameter: those can be read by everybody.
TOKEN_VARIABLE = "LIME_PLANNER_VIEWER_TOKEN"


class NodeBackend:
    """See `lime_planner.viewer.backend.Backend`. Called by the page's threads; touches the node only where any thread may."""

    real = True
    opens = False

    def __init__(self, node: PlannerNode) -> None:
        """Watch a node.

        Args:
            node: the node, wired up.
        """
        self.title = node.get_fully_qualified_name()
        self.watched = False
        self._node = node
        self._lock = threading.Lock()
        self._count = 0
        self._planned: Planned | None = None
        self._shown: PlanRecord | None = None
        self._scene: Scene | None = None
        self._scene_number = -1
        self._scene_due_s = 0.0
        self._missing = ""
        self._ended = ""
        self._target_msg: Any = None
        self._target: Array | None = None

    def on_shown(self, planned: Planned) -> None:
        """Take in a plan that was just made."""
        target = None if planned.T_base_tool is None else matrix_to_pose(planned.T_base_tool)
        with self._lock:
            self._ended = ""
            self._count += 1
            self._planned = planned
            self._shown = PlanRecord(self._count, planned.scene, planned.snapshot.plan, target, planned.result)
            self._scene = planned.scene

    def on_end(self, message: str) -> None:
        """Take in how a motion ended, `CODE: sentence`."""
        self._ended = message

    def moment(self) -> Moment:
        """Return what there is to see now."""
        node, loaded = self._node, self._node.engine.loaded
        motion, state = node.execution.motion, node.inputs.joints.newest
        activity = self._activity()
        if self.watched and activity is Activity.IDLE:
            self._look_at_clouds()
        target = self._newest_target()
        with self._lock:
            shown, scene, missing = self._shown, self._scene, self._missing
        follows = motion is not None and shown is not None and motion.result is shown.result
        return Moment(
            activity,
            self._message(activity)
            or ("press Plan" if target is not None else f"no target yet on {node.resolve_topic_name('grasp_target')}"),
            node.params.snapshot.plan,
            None if loaded is None else loaded.robot,
            None if loaded is None else loaded.pipeline,
            scene,
            target,
            None if state is None else state.q,
            shown,
            motion.elapsed_s() if motion is not None and follows else None,
            self._why_no_plan(activity),
            self._why_no_motion(activity, shown),
            missing if scene is None else "",
        )

    def plan(self, wishes: Wishes) -> None:
        """Ask for a preview; the wished parameters become the node's."""
        node = self._node
        self._ended = ""
        if wishes.parameters:
            changed = [RosParameter(name, value=value) for name, value in wishes.parameters.items()]
            outcome = node.set_parameters_atomically(changed)
            if not outcome.successful:
                node.board.last_message = Status.BAD_INPUT.message(outcome.reason)
                return

        def job(ticket: Ticket) -> Answer:
            if wishes.target is None:
                return node.requests.preview(ticket)
            loaded = node.engine.wait_loaded(node.params.snapshot.node.warm_up_timeout_s, ticket.should_stop)
            goal = PoseStamped()
            goal.header.frame_id = loaded.robot.planning_frame
            goal.header.stamp = node.get_clock().now().to_msg()
            goal.pose = to_pose(wishes.target)
            return node.requests.preview_to(ticket, goal)

        node.worker.submit("preview" if wishes.target is None else "preview_to", job, node.desk.finish)

    def execute(self, number: int) -> None:
        """Ask for the execution of the plan that was confirmed, and of no other."""
        with self._lock:
            planned = self._planned if self._shown is not None and self._shown.number == number else None

        def job(ticket: Ticket) -> Answer:
            previewed = self._node.requests.previewed
            if planned is None or previewed is None or previewed[1] is not planned:
                raise Refusal(Status.NOTHING_TO_EXECUTE, "the plan that was confirmed is no longer the newest one")
            return self._node.requests.execute(ticket)

        self._node.worker.submit("execute", job, self._node.desk.finish)

    def stop(self) -> None:
        """Do what `~/stop` does."""
        self._node.desk.stop_everything()

    def open(self, scene: Scene, title: str) -> None:
        """Scenes come from the cameras here.

        Raises:
            LimePlannerError: always.
        """
        raise LimePlannerError(f"{title}: the planner node takes its scenes from {self._node.resolve_topic_name('stem_cloud')}")

    def _message(self, activity: Activity) -> str:
        node, motion = self._node, self._node.execution.motion
        if activity is Activity.LOADING:
            return str(node.engine.state)
        if motion is not None:
            return f"{motion.elapsed_s():.0f} of {motion.trajectory.duration_s:.0f} s of the motion"
        return self._ended or str(node.board.last_message)

    def _activity(self) -> Activity:
        node = self._node
        if node.execution.stopping:
            return Activity.STOPPING
        if node.execution.motion is not None:
            return Activity.MOVING
        if not node.engine.ready:
            return Activity.LOADING
        return Activity.PLANNING if node.worker.busy else Activity.IDLE

    def _why_no_plan(self, activity: Activity) -> str:
        if activity is Activity.LOADING:
            return "the planner is still getting ready"
        return "the arm moves; press Stop first" if activity in (Activity.MOVING, Activity.STOPPING) else ""

    def _why_no_motion(self, activity: Activity, shown: PlanRecord | None) -> str:
        if not self._node.params.snapshot.node.motion_enabled:
            return "motion is disabled by the parameter motion_enabled"
        if activity in (Activity.MOVING, Activity.STOPPING):
            return "the arm moves already"
        previewed = self._node.requests.previewed
        if shown is None or previewed is None or previewed[1] is not self._planned:
            return "there is no plan to carry out; press Plan first"
        return ""

    def _look_at_clouds(self) -> None:
        """Take in the newest clouds while nothing else is going on, now and then."""
        if time.monotonic() < self._scene_due_s:
            return
        self._scene_due_s = time.monotonic() + _SCENE_PERIOD_S
        node = self._node
        number = sum(slot.received for slot in node.inputs.slots.values())
        if number == self._scene_number or node.engine.loaded is None:
            return
        try:
            scene = node.source.scene(node.params.snapshot, lambda: node.worker.busy)
        except Refusal as refusal:
            topics = " and ".join(node.resolve_topic_name(name) for name in ("leaf_cloud", "stem_cloud"))
            with self._lock:
                self._missing = f"**Nothing to show yet.** {str(refusal).capitalize()}. Publish point clouds on {topics}."
            return
        with self._lock:
            self._scene, self._scene_number, self._missing = scene, number, ""

    def _newest_target(self) -> Array | None:
        """The target in the planning frame; the same object as long as it is the same message."""
        node, loaded = self._node, self._node.engine.loaded
        if loaded is None:
            return None
        try:
            target = node.inputs.target(0.0, 0.0)
            if target.msg is not self._target_msg:
                header, T = target.msg.header, target.T_frame_tool
                frame = header.frame_id.strip().lstrip("/")
                if frame != loaded.robot.planning_frame:
                    T = node.frames.lookup(loaded.robot.planning_frame, frame, header.stamp, 0.0, lambda: False) @ T
                self._target, self._target_msg = matrix_to_pose(T), target.msg
        except Refusal:
            self._target, self._target_msg = None, None
        return self._target


class Viewer(NamedTuple):
    """A node's page and what it shows."""

    backend: NodeBackend
    page: Page


def serve_page(node: PlannerNode) -> Viewer | None:
    """Serve the node's page where its parameters ask for one; a page that cannot be served is no reason not to plan."""
    settings = node.params.snapshot.node
    if settings.viewer_port == 0:
        return None
    try:
        from lime_planner.viewer.page import Page

        backend = NodeBackend(node)
        page = Page(backend, Access(settings.viewer_host, os.environ.get(TOKEN_VARIABLE, "")), settings.viewer_port)
    except LimePlannerError as error:
        node.get_logger().error(f"no 3-D page: {error}")
        return None
    except ModuleNotFoundError as error:
        node.get_logger().error(f"no 3-D page: the library {error.name!r} is not installed; pip install 'lime_planner[viewer]' brings it")
        return None
    node.get_logger().info(f"the 3-D page is at {page.url.partition('?')[0]}")
    return Viewer(backend, page)
