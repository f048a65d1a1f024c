"""What the jobs of several services do alike: inputs, rest, the plan itself, and the checks before it is sent."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from lime_planner.core.errors import LimePlannerError, Refusal
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.status import Status
from lime_planner.motion.way_back import straight_back, way_back
from lime_planner.pipeline.result import PlanRecord, PlanResult
from lime_planner.pipeline.targets import Target as Aim
from lime_planner.pipeline.targets import pose_target
from lime_planner.ros.execution.retreat import Path, nearest_turns
from lime_planner.ros.inputs.joint_states import ArmState
from lime_planner.ros.inputs.latest import Target
from lime_planner.ros.model_loader import Loaded
from lime_planner.ros.parameters import Snapshot
from lime_planner.ros.requests.parts import NodeParts, PlannedRequest
from lime_planner.ros.requests.request_text import target_values
from lime_planner.ros.requests.status_board import Phase
from lime_planner.ros.requests.worker import Left, Ticket
from lime_planner.scene.scene import Scene

Outcome = TypeVar("Outcome")


class RequestSteps:
    """The steps, in the worker's thread. A `Refusal` that one raises is the answer.

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

    def _planned(
        self, ticket: Ticket, loaded: Loaded, snapshot: Snapshot, target: Target, left_s: Left, *, looks: int = 0
    ) -> PlannedRequest:
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
        planned = self._record(scene, target, dataclasses.replace(result, looks=looks) if looks else result, snapshot, number)
        self._present(ticket, planned, inputs_s=decode_s, request_s=time.monotonic() - began_s)
        return planned

    def _planned_back(self, ticket: Ticket, loaded: Loaded, snapshot: Snapshot, path: Path) -> PlannedRequest:
        """Plan the way back along a motion that was executed, as far as the arm got.

        Raises:
            Refusal: NOTHING_TO_EXECUTE, the arm is at the beginning; START_INVALID, it is elsewhere; that of an input.
        """
        arm = self._arm_at_start(snapshot)
        waypoints = way_back(nearest_turns(path.waypoints, arm.q, loaded.robot.continuous), arm.q)
        number = self._source.newest_stem_number()
        scene = self._source.scene(snapshot, ticket.should_stop)
        self._show_phase(ticket, Phase.PLANNING)
        straight, should_stop = straight_back(path.straight_from, waypoints), ticket.should_stop
        result = self._guarded(
            lambda: loaded.pipeline.follow(waypoints, scene, path.aim, snapshot.plan, straight=straight, should_stop=should_stop)
        )
        return self._record(scene, None, result, snapshot, number)

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
            self._board.note(ticket.plan_id, **figures_of(planned.record.result), **figures)
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


def figures_of(result: PlanResult) -> dict[str, object]:
    """Return the figures of `--json`, without those that the status carries itself."""
    figures = dict(result.figures())
    for name in ("status", "message"):
        figures.pop(name, None)
    return figures
