"""The planner node behind its own 3-D page: shows the node's state, and asks for what its services do."""

from __future__ import annotations

import os
import threading
import time
from typing import TYPE_CHECKING, NamedTuple

from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.parameter import Parameter as RosParameter

from lime_planner.core.errors import LimePlannerError, Refusal
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.ros.convert import TargetMessage, to_pose
from lime_planner.ros.requests.jobs import Requests
from lime_planner.ros.requests.parts import NodeParts, PlannedRequest
from lime_planner.ros.requests.services import Services
from lime_planner.ros.requests.worker import Answer, Ticket
from lime_planner.scene.scene import Scene
from lime_planner.viewer.access import Access
from lime_planner.viewer.backend import Activity, Moment, Wishes

if TYPE_CHECKING:
    from lime_planner.viewer.page import Page


#: Clouds are decoded for the page this often at most [s]: looking must not slow planning.
_SCENE_PERIOD_S = 2.0
#: What a browser on another machine must know, where `viewer_host` lets it in. No parameter: those can be read by everybody.
TOKEN_VARIABLE = "LIME_PLANNER_VIEWER_TOKEN"


class NodeBackend:
    """See `lime_planner.viewer.backend.Backend`. Called by the page's threads; touches the node only where any thread may."""

    real = True
    opens = False
    places = False

    def __init__(self, parts: NodeParts, requests: Requests, services: Services) -> None:
        """Watch a node.

        Args:
            parts: of the node.
            requests: what it can be asked for.
            services: through which it answers and stops.
        """
        self.title = parts.node.get_fully_qualified_name()
        self.watched = False
        self._parts = parts
        self._requests = requests
        self._services = services
        self._lock = threading.Lock()
        self._planned: PlannedRequest | None = None
        self._scene: Scene | None = None
        self._scene_number = -1
        self._scene_due_s = 0.0
        self._missing = ""
        self._ended = ""
        self._target_msg: TargetMessage | None = None
        self._target: Array | None = None

    def show(self, planned: PlannedRequest) -> None:
        """Take in a plan that was just made."""
        with self._lock:
            self._ended = ""
            self._planned = planned
            self._scene = planned.record.scene

    def on_end(self, message: str) -> None:
        """Take in how a motion ended, `CODE: sentence`."""
        self._ended = message

    def moment(self) -> Moment:
        """Return what there is to see now."""
        parts, loaded = self._parts, self._parts.loader.loaded
        motion, state = parts.execution.motion, parts.inputs.joints.newest
        activity = self._activity()
        if self.watched and activity is Activity.IDLE:
            self._look_at_clouds()
        target = self._newest_target()
        with self._lock:
            planned, scene, missing = self._planned, self._scene, self._missing
        shown = None if planned is None else planned.record
        follows = motion is not None and shown is not None and motion.result is shown.result
        return Moment(
            activity,
            self._message(activity)
            or ("press Plan" if target is not None else f"no target yet on {parts.node.resolve_topic_name('grasp_target')}"),
            parts.parameters.snapshot.plan,
            None if loaded is None else loaded.robot,
            None if loaded is None else loaded.pipeline,
            scene,
            target,
            None if state is None else state.q,
            shown,
            motion.elapsed_s() if motion is not None and follows else None,
            self._why_no_plan(activity),
            self._why_no_motion(activity, planned),
            self._why_no_retreat(activity),
            missing if scene is None else "",
        )

    def plan(self, wishes: Wishes) -> None:
        """Ask for a preview; the wished parameters become the node's."""
        parts = self._parts
        self._ended = ""
        if wishes.parameters:
            changed = [RosParameter(name, value=value) for name, value in wishes.parameters.items()]
            outcome = parts.node.set_parameters_atomically(changed)
            if not outcome.successful:
                parts.board.last_message = Status.BAD_INPUT.message(outcome.reason)
                return

        def job(ticket: Ticket) -> Answer:
            if wishes.target is None and wishes.fruit is None:
                return self._requests.preview(ticket)
            loaded = parts.loader.wait_loaded(parts.parameters.snapshot.node.warm_up_timeout_s, ticket.should_stop)
            goal: PoseStamped | PointStamped
            if wishes.target is not None:
                goal = PoseStamped(pose=to_pose(wishes.target))
            else:
                assert wishes.fruit is not None
                goal = PointStamped()
                goal.point.x, goal.point.y, goal.point.z = (float(v) for v in wishes.fruit)
            goal.header.frame_id = loaded.robot.planning_frame
            goal.header.stamp = parts.node.get_clock().now().to_msg()
            return self._requests.preview_to(ticket, goal)

        elsewhere = wishes.target is not None or wishes.fruit is not None
        parts.worker.submit("preview_to" if elsewhere else "preview", job, self._services.finish)

    def execute(self, number: int) -> None:
        """Ask for the execution of the plan that was confirmed, and of no other."""
        with self._lock:
            planned = self._planned if self._planned is not None and self._planned.record.number == number else None

        def job(ticket: Ticket) -> Answer:
            previewed = self._requests.previewed
            if planned is None or previewed is None or previewed[1] is not planned:
                raise Refusal(Status.NOTHING_TO_EXECUTE, "the plan that was confirmed is no longer the newest one")
            return self._requests.execute(ticket)

        self._parts.worker.submit("execute", job, self._services.finish)

    def retreat(self) -> None:
        """Do what `~/retreat` does."""
        self._parts.worker.submit("retreat", self._requests.retreat, self._services.finish)

    def place(self, q: Array) -> None:
        """The arm is where it is measured to be.

        Raises:
            LimePlannerError: always.
        """
        raise LimePlannerError("the planner node takes the arm's configuration from its joint states")

    def stop(self) -> None:
        """Do what `~/stop` does."""
        self._services.stop_everything()

    def open(self, scene: Scene, title: str) -> None:
        """Scenes come from the cameras here.

        Raises:
            LimePlannerError: always.
        """
        raise LimePlannerError(f"{title}: the planner node takes its scenes from {self._parts.node.resolve_topic_name('stem_cloud')}")

    def _message(self, activity: Activity) -> str:
        motion = self._parts.execution.motion
        if activity is Activity.LOADING:
            return self._parts.loader.state
        if motion is not None:
            return f"{motion.elapsed_s():.0f} of {motion.trajectory.duration_s:.0f} s of the motion"
        return self._ended or self._parts.board.last_message

    def _activity(self) -> Activity:
        parts = self._parts
        if parts.execution.stopping:
            return Activity.STOPPING
        if parts.execution.motion is not None:
            return Activity.MOVING
        if not parts.loader.ready:
            return Activity.LOADING
        return Activity.PLANNING if parts.worker.busy else Activity.IDLE

    def _why_no_plan(self, activity: Activity) -> str:
        if activity is Activity.LOADING:
            return "the planner is still getting ready"
        return "the arm moves; press Stop first" if activity in (Activity.MOVING, Activity.STOPPING) else ""

    def _why_no_motion(self, activity: Activity, planned: PlannedRequest | None) -> str:
        if not self._parts.parameters.snapshot.node.motion_enabled:
            return "motion is disabled by the parameter motion_enabled"
        if activity in (Activity.MOVING, Activity.STOPPING):
            return "the arm moves already"
        previewed = self._requests.previewed
        if planned is None or previewed is None or previewed[1] is not planned:
            return "there is no plan to carry out; press Plan first"
        return ""

    def _why_no_retreat(self, activity: Activity) -> str:
        if not self._parts.parameters.snapshot.node.motion_enabled:
            return "motion is disabled by the parameter motion_enabled"
        if activity in (Activity.MOVING, Activity.STOPPING):
            return "the arm moves already"
        return "" if self._parts.execution.way_out.path is not None else "nothing has been executed yet"

    def _look_at_clouds(self) -> None:
        """Take in the newest clouds while nothing else is going on, now and then."""
        if time.monotonic() < self._scene_due_s:
            return
        self._scene_due_s = time.monotonic() + _SCENE_PERIOD_S
        parts = self._parts
        number = sum(slot.received for slot in parts.inputs.slots.values())
        if number == self._scene_number or parts.loader.loaded is None:
            return
        try:
            scene = parts.source.scene(parts.parameters.snapshot, lambda: parts.worker.busy)
        except Refusal as refusal:
            topics = " and ".join(parts.node.resolve_topic_name(name) for name in ("leaf_cloud", "stem_cloud"))
            with self._lock:
                self._missing = f"**Nothing to show yet.** {str(refusal)[:1].upper()}{str(refusal)[1:]}. Publish point clouds on {topics}."
            return
        with self._lock:
            self._scene, self._scene_number, self._missing = scene, number, ""

    def _newest_target(self) -> Array | None:
        """The target in the planning frame; the same object as long as it is the same message."""
        parts, loaded = self._parts, self._parts.loader.loaded
        if loaded is None:
            return None
        try:
            target = parts.inputs.target(0.0, 0.0)
            if target.msg is not self._target_msg:
                aim = parts.source.goal(target, parts.parameters.snapshot, lambda: True)  # nothing is waited for
                self._target, self._target_msg = aim.shown_pose(), target.msg
        except Refusal:
            self._target, self._target_msg = None, None
        return self._target


class Viewer(NamedTuple):
    """A node's page and what it shows."""

    backend: NodeBackend
    page: Page


def serve_page(parts: NodeParts, requests: Requests, services: Services) -> Viewer | None:
    """Serve the node's page where its parameters ask for one; a page that cannot be served is no reason not to plan."""
    settings, logger = parts.parameters.snapshot.node, parts.node.get_logger()
    if settings.viewer_port == 0:
        return None
    try:
        from lime_planner.viewer.page import Page

        backend = NodeBackend(parts, requests, services)
        page = Page(backend, Access(settings.viewer_host, os.environ.get(TOKEN_VARIABLE, "")), settings.viewer_port)
    except LimePlannerError as error:
        logger.error(f"no 3-D page: {error}")
        return None
    except ModuleNotFoundError as error:
        logger.error(f"no 3-D page: the library {error.name!r} is not installed; pip install 'lime_planner[viewer]' brings it")
        return None
    logger.info(f"the 3-D page is at {page.url.partition('?')[0]}")
    return Viewer(backend, page)
