"""What each service does, in the worker's thread: inputs, pipeline, checks, sending. No message is decoded or made here."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped

from lime_planner.core.errors import LimePlannerError, Refusal
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.status import Status
from lime_planner.pipeline.plan_record import PlanRecord
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.targets import Target as Aim
from lime_planner.pipeline.targets import pose_target
from lime_planner.ros.convert import TargetMessage, read_target
from lime_planner.ros.execution.motion import moves, on_turns_of
from lime_planner.ros.execution.retreat import Path, nearest_turns, straight_back, way_back
from lime_planner.ros.inputs.joint_states import ArmState
from lime_planner.ros.inputs.latest import Target
from lime_planner.ros.model_loader import Loaded
from lime_planner.ros.parameters import Snapshot
from lime_planner.ros.requests.parts import NodeParts, PlannedRequest
from lime_planner.ros.requests.request_text import target_values
from lime_planner.ros.requests.status_board import Phase
from lime_planner.ros.requests.worker import Answer, Left, RequestContext, Ticket, deadline
from lime_planner.scene.scene import Scene

Outcome = TypeVar("Outcome")

#: How often a plan is made at most: again when the arm had moved, or a stem was seen on the path, before it could be sent.
_SENDING_ATTEMPTS = 2


class Requests:
    """The services' jobs. Every method takes the ticket and returns its answer; a `Refusal` it raises is an answer too.

    Attributes:
        previewed: the plan that `~/execute` would send, and the model that it was made with.
    """

    def __init__(self, parts: NodeParts) -> None:
        """Serve with these parts."""
        self._loader = parts.loader
        self._parameters = parts.parameters
        self._inputs = parts.inputs
        self._source = parts.source
        self._execution = parts.execution
        self._watch = parts.watch
        self._board = parts.board
        self._display = parts.display
        self._numbers = itertools.count(1)
        self.previewed: tuple[Loaded, PlannedRequest] | None = None

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
            with deadline(ticket, snapshot.node.deadline_s) as left_s:
                for attempt in range(1, _SENDING_ATTEMPTS + 1):
                    planned = self._planned(ticket, loaded, snapshot, self._target(ticket, snapshot), left_s)
                    if planned.record.result.status is not Status.SUCCEEDED:
                        return _answer_of(planned.record.result)
                    try:
                        return self._send(ticket, loaded, planned)
                    except Refusal as refusal:
                        if refusal.status not in (Status.ARM_MOVING, Status.STEM_APPEARED) or attempt == _SENDING_ATTEMPTS:
                            raise
                    self._come_to_rest(ticket, snapshot)
        raise AssertionError("unreachable")

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
            self._board.note(ticket.plan_id, **_figures(result))
            self._come_to_rest(ticket, snapshot)
            with deadline(ticket, snapshot.node.deadline_s):
                arm = self._arm_at_start(snapshot)
                turned = on_turns_of(result, arm.q, loaded.robot.continuous)
                if turned is not result:
                    result = turned
                    planned = dataclasses.replace(planned, record=dataclasses.replace(planned.record, result=result))
                    self._board.note(ticket.plan_id, **_figures(result))
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
                arm = self._arm_at_start(snapshot)
                waypoints = way_back(nearest_turns(path.waypoints, arm.q, loaded.robot.continuous), arm.q)
                number = self._source.newest_stem_number()
                scene = self._source.scene(snapshot, ticket.should_stop)
                self._show_phase(ticket, Phase.PLANNING)
                aim, should_stop = path.aim, ticket.should_stop
                straight = straight_back(path, waypoints)
                result = self._guarded(
                    lambda: loaded.pipeline.follow(waypoints, scene, aim, snapshot.plan, straight=straight, should_stop=should_stop)
                )
                planned = self._record(scene, None, result, snapshot, number)
                self._present(ticket, planned)
                if result.status is not Status.SUCCEEDED:
                    return _answer_of(result)
                return self._send(ticket, loaded, planned, retreat=True)

    def _begin(self, ticket: Ticket) -> Snapshot:
        self._board.show(ticket.plan_id, Phase.PLANNING, kind=ticket.kind)
        if ticket.kind != "execute":
            self.previewed = None  # what ~/execute sends is what was asked for last, or nothing
        return self._parameters.snapshot

    def _ready(self, ticket: Ticket, snapshot: Snapshot) -> contextlib.AbstractContextManager[Loaded]:
        """Refuse at once what cannot succeed, then wait for the kernels; returns the context that holds the model."""
        timeout_s = snapshot.node.warm_up_timeout_s
        self._loader.wait_loaded(timeout_s, ticket.should_stop)
        if not self._loader.ready:
            self._arm(snapshot)
            self._source.scene(snapshot, ticket.should_stop)
        return self._loader.use(timeout_s, ticket.should_stop)

    def _preview(self, ticket: Ticket, snapshot: Snapshot, target: Callable[[], Target]) -> Answer:
        target()
        with self._ready(ticket, snapshot) as loaded:
            with deadline(ticket, snapshot.node.deadline_s) as left_s:
                planned = self._planned(ticket, loaded, snapshot, target(), left_s)
            # Only a plan whose caller hears that it was made may be carried out later.
            if planned.record.result.status is Status.SUCCEEDED and ticket.commit():
                self.previewed = (loaded, planned)
            return _answer_of(planned.record.result)

    def _target(self, ticket: Ticket, snapshot: Snapshot) -> Target:
        target = self._inputs.target(snapshot.node.max_target_age_s, snapshot.node.max_clock_skew_s)
        self._note_target(ticket, target)
        return target

    def _note_target(self, ticket: Ticket, target: Target) -> None:
        ticket.context = dataclasses.replace(ticket.context, target=target)
        self._board.note(ticket.plan_id, **target_values(target))

    def _arm(self, snapshot: Snapshot) -> ArmState:
        return self._inputs.joints.fresh(snapshot.node.max_joint_state_age_s, snapshot.node.max_clock_skew_s)

    def _arm_at_start(self, snapshot: Snapshot) -> ArmState:
        """Return the state that a plan begins at, on the turns that the driver reports now."""
        if not self._execution.active:
            self._inputs.joints.take_reported_turns()
        return self._arm(snapshot)

    def _come_to_rest(self, ticket: Ticket, snapshot: Snapshot) -> None:
        """Stop what runs and wait until the arm is seen to rest."""
        node = snapshot.node
        self._arm(snapshot)
        if self._execution.active:
            self._source.scene(snapshot, ticket.should_stop)  # a request that cannot be served does not stop a good motion
            if ticket.answered:  # nor does one that is not waited for any more
                raise Refusal(Status.CANCELLED, "the request was answered before it began")
            self._execution.stop(Status.PREEMPTED, f"request {ticket.plan_id} ({ticket.kind}) took over")
        elif self._inputs.joints.still(node.stillness_time_s, node.stillness_rad):
            return
        self._show_phase(ticket, Phase.STOPPING)
        deadline = time.monotonic() + node.stillness_timeout_s + node.stillness_time_s
        while self._execution.active and time.monotonic() < deadline and not ticket.answered:
            time.sleep(0.005)
        remaining = max(deadline - time.monotonic(), 0.0)
        if not self._inputs.joints.wait_still(node.stillness_time_s, node.stillness_rad, remaining, ticket.should_stop):
            self._arm(snapshot)  # silence has its own code
            raise Refusal(Status.ARM_MOVING, f"the arm did not come to rest within {node.stillness_timeout_s:g} s")
        self._show_phase(ticket, Phase.PLANNING)

    def _show_phase(self, ticket: Ticket, phase: Phase) -> None:
        if not ticket.answered:  # its last phase has been shown
            self._board.show(ticket.plan_id, phase)

    def _planned(self, ticket: Ticket, loaded: Loaded, snapshot: Snapshot, target: Target, left_s: Left) -> PlannedRequest:
        began_s = time.monotonic()
        arm = self._arm_at_start(snapshot)
        aim = self._aim(self._source.goal(target, snapshot, ticket.should_stop), snapshot)
        number = self._source.newest_stem_number()
        scene = self._source.scene(snapshot, ticket.should_stop)
        decode_s = time.monotonic() - began_s
        seed = snapshot.plan.seed or int(np.random.default_rng().integers(1, 2**31 - 1))
        result = self._guarded(
            lambda: loaded.pipeline.plan(scene, aim, arm.q, snapshot.plan, should_stop=ticket.should_stop, deadline_s=left_s(), seed=seed)
        )
        planned = self._record(scene, target, result, snapshot, number)
        self._present(ticket, planned, inputs_s=decode_s, request_s=time.monotonic() - began_s)
        return planned

    @staticmethod
    def _aim(aim: Aim, snapshot: Snapshot) -> Aim:
        """What a target asks for; the parameters say what a pose leaves open."""
        return pose_target(aim.poses[0], snapshot.plan.grasp_freedom) if aim.kind == "pose" else aim

    def _record(self, scene: Scene, target: Target | None, result: PlanResult, snapshot: Snapshot, stem_number: int) -> PlannedRequest:
        pose = None if result.T_base_tool is None else matrix_to_pose(result.T_base_tool)
        record = PlanRecord(next(self._numbers), scene, snapshot.plan, pose, result)
        return PlannedRequest(record, target, snapshot, stem_number)

    def _guarded(self, call: Callable[[], Outcome]) -> Outcome:
        """Turn the pipeline's exceptions about its arguments into an answer: they came in as messages."""
        try:
            return call()
        except LimePlannerError as error:
            raise Refusal(Status.BAD_INPUT, str(error)) from None

    def _present(self, ticket: Ticket, planned: PlannedRequest, **figures: float) -> None:
        if not ticket.answered:
            self._board.note(ticket.plan_id, **_figures(planned.record.result), **figures)
            self._display.show(planned)

    def _look_again(self, ticket: Ticket, loaded: Loaded, planned: PlannedRequest) -> int:
        """Check what may have changed while the plan was made: the target, the clouds' ages, and stems that were not there before.

        Returns:
            Which stem clouds the motion was checked against.
        """
        result, snapshot = planned.record.result, planned.snapshot
        # Who looks at a preview takes his time: it is as old then as it may be.
        max_age_s = 0.0 if ticket.kind == "execute" else snapshot.node.max_target_age_s
        self._inputs.check_target(planned.target, max_age_s, snapshot.node.max_clock_skew_s)
        number = self._source.newest_stem_number()
        stems = self._source.changed_stems(planned.stem_number, snapshot, ticket.should_stop)
        if stems is not None:
            sentence = self._guarded(lambda: loaded.pipeline.obstruction(result, stems, snapshot.plan, should_stop=ticket.should_stop))
            if sentence is not None:
                raise Refusal(Status.STEM_APPEARED, f"in a stem cloud that came while planning, {sentence}; nothing was sent")
        return number

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


def _figures(result: PlanResult) -> dict[str, object]:
    """Return the figures of `--json`, without those that the status carries itself."""
    figures = dict(result.figures())
    for name in ("status", "message"):
        figures.pop(name, None)
    return figures
