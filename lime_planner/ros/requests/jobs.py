"""What each service does, in the worker's thread: inputs, pipeline, checks, sending. No message is decoded or made here."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from typing import TypeVar

from geometry_msgs.msg import PoseStamped

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.pipeline.result import PlanResult
from lime_planner.ros.convert import TargetMessage, read_target
from lime_planner.ros.execution.motion import moves, on_turns_of
from lime_planner.ros.execution.retreat import Path
from lime_planner.ros.inputs.latest import Target
from lime_planner.ros.model_loader import Loaded
from lime_planner.ros.parameters import Snapshot
from lime_planner.ros.requests.looking import Looked, LookSteps
from lime_planner.ros.requests.parts import PlannedRequest
from lime_planner.ros.requests.steps import figures_of
from lime_planner.ros.requests.worker import Answer, RequestContext, Ticket, deadline

Outcome = TypeVar("Outcome")

#: How often a plan is made at most: again when the arm had moved, or a stem was seen on the path, before it could be sent.
_SENDING_ATTEMPTS = 2
#: Outcomes of a plan from where a motion was stopped that may be better from where it began.
_STUCK = (Status.NO_PATH, Status.TIMED_OUT, Status.PATH_INVALID, Status.GOAL_IN_STEM, Status.UNSEEN, Status.LEAF_BUDGET_EXCEEDED)


class Requests(LookSteps):
    """The services' jobs. Every method takes the ticket and returns its answer; a `Refusal` it raises is an answer too.

    Attributes:
        previewed: the plan that `~/execute` would send, and the model that it was made with.
    """

    def aim(self, kind: str, goal: PoseStamped | None = None) -> RequestContext:
        """Tell what a request will be about, as far as is known when it is made: it may be answered before its job begins.

        Args:
            kind: of the request.
            goal: of `preview_to`.

        Returns:
            The context of its ticket.
        """
        target: Target | None = None
        path, previewed = self._execution.way_out.path, self.previewed  # once: other threads take them away
        if kind == "retreat":
            target = None if path is None else path.target
        elif kind == "execute":
            target = None if previewed is None else previewed[1].target
        else:
            with contextlib.suppress(Refusal):  # the job will say what is wrong with it
                target = self._inputs.peek_target() if goal is None else Target(read_target(goal), goal)
        return RequestContext(target)

    def plan(self, ticket: Ticket) -> Answer:
        """Plan to the newest target from rest, and send."""
        snapshot = self._begin(ticket)
        self._target(ticket, snapshot)  # a missing or bad target is answered before anything is waited for or stopped
        with self._ready(ticket, snapshot) as loaded:
            self._come_to_rest(ticket, snapshot)
            looks: list[Looked | None] = []
            may_back_out = ticket.kind == "replan"
            with deadline(ticket, snapshot.node.deadline_s) as left_s:
                for attempt in range(1, _SENDING_ATTEMPTS + 1):
                    planned = self._planned(ticket, loaded, snapshot, self._target(ticket, snapshot), left_s, looks=len(looks))
                    if may_back_out and planned.record.result.status in _STUCK and self._back_out(ticket, loaded, snapshot):
                        may_back_out = False
                        planned = self._planned(ticket, loaded, snapshot, self._target(ticket, snapshot), left_s, looks=len(looks))
                    planned = self._look_until_enough(ticket, loaded, snapshot, planned, left_s, looks)
                    if planned.record.result.status is not Status.SUCCEEDED:
                        return _answer_of(planned.record.result)
                    try:
                        return self._send(ticket, loaded, planned)
                    except Refusal as refusal:
                        if refusal.status not in (Status.ARM_MOVING, Status.STEM_APPEARED) or attempt == _SENDING_ATTEMPTS:
                            raise
                    self._come_to_rest(ticket, snapshot)
        raise AssertionError("unreachable")

    def look(self, ticket: Ticket) -> Answer:
        """Move the arm's camera to where it shows most of what is unseen on the best way to the newest target."""
        snapshot = self._begin(ticket)
        self._target(ticket, snapshot)
        if not snapshot.node.camera_frame:
            self._check_camera(snapshot)
        if not (snapshot.node.motion_enabled and self._parameters.snapshot.node.motion_enabled):
            raise Refusal(Status.MOTION_DISABLED, "a look moves the arm, and motion_enabled is false")
        with self._ready(ticket, snapshot) as loaded:
            T_tool_camera = self._check_camera(snapshot)
            self._come_to_rest(ticket, snapshot)
            with deadline(ticket, snapshot.node.deadline_s) as left_s:
                planned = self._planned(ticket, loaded, snapshot, self._target(ticket, snapshot), left_s)
                if not planned.record.result.views:
                    raise Refusal(Status.NO_CLOUD, "it is not known where any cloud was seen from, so that everything counts as seen")
                if not self._worth_a_look(planned, 0.0):
                    result = planned.record.result
                    if not result.succeeded:
                        return _answer_of(result)
                    return Answer(
                        Status.SUCCEEDED,
                        f"nothing unseen lies on the best way to the target, seen from {result.views} views; the arm stays",
                    )
                looked = self._look(ticket, loaded, snapshot, planned, T_tool_camera)
                if looked is None:
                    sentence = "no view that shows enough of what is unseen on the way can be reached through seen space"
                    raise Refusal(Status.NO_PATH, sentence)
                self._board.note(ticket.plan_id, looks=1, **looked.figures())
        return Answer(Status.SUCCEEDED, looked.sentence)

    def preview(self, ticket: Ticket) -> Answer:
        """Plan to the newest target and show it."""
        snapshot = self._begin(ticket)
        return self._preview(ticket, snapshot, lambda: self._target(ticket, snapshot))

    def preview_to(self, ticket: Ticket, goal: TargetMessage) -> Answer:
        """Plan to a pose, or a fruit, and show it; the stored target stays."""
        snapshot = self._begin(ticket)
        target = Target(read_target(goal), goal)
        self._note_target(ticket, target)
        return self._preview(ticket, snapshot, lambda: target)

    def execute(self, ticket: Ticket) -> Answer:
        """Check the previewed plan against the newest inputs and send it."""
        snapshot = self._begin(ticket)
        previewed = self.previewed
        if previewed is None:
            raise Refusal(Status.NOTHING_TO_EXECUTE, "there is no previewed plan; call ~/preview first")
        if self._execution.active:
            raise Refusal(Status.ARM_MOVING, "a motion is being executed; wait for its end or call ~/stop first")
        with self._ready(ticket, snapshot) as loaded:
            model, planned = previewed
            result = planned.record.result
            if planned.target is not None:
                self._note_target(ticket, planned.target)
            if model is not loaded:
                raise Refusal(Status.NOTHING_TO_EXECUTE, "the robot model has changed since the preview")
            self._board.note(ticket.plan_id, **figures_of(result))
            self._come_to_rest(ticket, snapshot)
            with deadline(ticket, snapshot.node.deadline_s):
                arm = self._arm_at_start(snapshot)
                turned = on_turns_of(result, arm.q, loaded.robot.continuous)
                if turned is not result:
                    result = turned
                    planned = dataclasses.replace(planned, record=dataclasses.replace(planned.record, result=result))
                    self._board.note(ticket.plan_id, **figures_of(result))
                number = self._source.newest_stem_number()
                scene = self._source.scene(snapshot, ticket.should_stop)
                status, sentence = loaded.pipeline.recheck(result, scene, arm.q, snapshot.plan, should_stop=ticket.should_stop)
                if status is not Status.SUCCEEDED:
                    return Answer(status, _bare(status, sentence))
                return self._send(ticket, loaded, dataclasses.replace(planned, snapshot=snapshot, stem_number=number))

    def retreat(self, ticket: Ticket) -> Answer:
        """Go back along the motion executed last, as far as the arm got."""
        snapshot = self._begin(ticket)
        nothing = Refusal(Status.NOTHING_TO_EXECUTE, "no motion has been executed that could be gone back along")
        if self._execution.way_out.path is None:
            raise nothing
        with self._ready(ticket, snapshot) as loaded:
            self._come_to_rest(ticket, snapshot)
            path = self._execution.way_out.path
            if path is None:  # another arm was taken in meanwhile
                raise nothing
            if path.target is not None:
                self._note_target(ticket, path.target)
            with deadline(ticket, snapshot.node.deadline_s):
                planned = self._planned_back(ticket, loaded, snapshot, path)
                result = planned.record.result
                self._present(ticket, planned)
                if result.status is not Status.SUCCEEDED:
                    return _answer_of(result)
                return self._send(ticket, loaded, planned, retreat=True)

    def _preview(self, ticket: Ticket, snapshot: Snapshot, target: Callable[[], Target]) -> Answer:
        target()
        with self._ready(ticket, snapshot) as loaded:
            with deadline(ticket, snapshot.node.deadline_s) as left_s:
                planned = self._planned(ticket, loaded, snapshot, target(), left_s)
            # Only a plan whose caller hears that it was made may be carried out later.
            if planned.record.result.status is Status.SUCCEEDED and ticket.commit():
                self.previewed = (loaded, planned)
            return _answer_of(planned.record.result)

    def _send(self, ticket: Ticket, loaded: Loaded, planned: PlannedRequest, *, retreat: bool = False) -> Answer:
        result, snapshot = planned.record.result, planned.snapshot
        enabled = snapshot.node.motion_enabled and self._parameters.snapshot.node.motion_enabled  # else `send` refuses
        number = self._look_again(ticket, loaded, planned) if enabled else 0
        assert result.trajectory is not None  # every plan that succeeded has one
        if enabled and not moves(result.trajectory):
            return self._stay(ticket, result)
        left = ticket.context.replans_left
        if left is None:
            left = snapshot.node.replan_attempts if ticket.kind == "plan" else 0
        motion = self._execution.send(
            ticket.plan_id,
            result,
            result.trajectory,
            snapshot,
            ticket.commit,
            T_base_tool=planned.record.result.T_base_tool,
            replans_left=left,
            target=ticket.context.target,
        )
        if motion is None:
            return Answer(Status.CANCELLED, "answered before it could be sent")  # never heard: the ticket has its answer
        self.previewed = None
        if not retreat:
            straight = result.waypoints[result.straight_from] if result.straight_from < len(result.waypoints) - 1 else None
            path = Path(result.waypoints, result.target, straight, ticket.context.target)
            self._execution.way_out.went(path, loaded.robot.continuous)
        if self._source.newest_stem_number() != number:
            self._watch.notice()
        return dataclasses.replace(_answer_of(result), moves=True)

    def _stay(self, ticket: Ticket, result: PlanResult) -> Answer:
        """Answer for a plan that leads nowhere: the arm rests at its end already, which is as good as a motion that ended there."""
        if not ticket.commit():
            return Answer(Status.CANCELLED, "answered before it could be sent")
        self.previewed = None
        sentence = "the arm rests at the planned end already; no motion was sent"
        self._board.note(ticket.plan_id, execution_code=Status.SUCCEEDED.name, execution_message=Status.SUCCEEDED.message(sentence))
        return Answer(result.status, sentence, result.tool_path)


def _bare(status: Status, message: str) -> str:
    """Return a message without its code, where it begins with one."""
    return message.removeprefix(f"{status.name}: ")


def _answer_of(result: PlanResult) -> Answer:
    return Answer(result.status, _bare(result.status, result.message), result.tool_path)
