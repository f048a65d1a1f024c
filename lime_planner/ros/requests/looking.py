"""Moving the camera that the arm carries to where it shows what is unseen on the way to the target, and taking in what it sees there."""

from __future__ import annotations

import dataclasses
import threading
import time
from dataclasses import dataclass, field

import numpy as np

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.looks import Look, plan_look
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.ros.execution.motion import Ended, moves
from lime_planner.ros.execution.retreat import Path
from lime_planner.ros.model_loader import Loaded
from lime_planner.ros.parameters import Snapshot
from lime_planner.ros.requests.parts import PlannedRequest
from lime_planner.ros.requests.status_board import Phase
from lime_planner.ros.requests.steps import RequestSteps
from lime_planner.ros.requests.worker import Left, Ticket
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.seen_map import UNSEEN

#: How long is waited at a view for a cloud that was taken there [s].
NEWER_CLOUDS_S = 5.0
_POLL_S = 0.01

#: Outcomes of a plan that seeing more can change, besides success.
_SEEING_HELPS = (Status.UNSEEN, Status.NO_PATH, Status.GOAL_IN_STEM, Status.LEAF_BUDGET_EXCEEDED, Status.PATH_INVALID)


@dataclass(frozen=True)
class Looked:
    """What a look showed.

    Attributes:
        look: the motion.
        before_m3, after_m3: unseen space that the best way passed before, and what is left of it [m³].
        all_before_m3, all_after_m3: the whole unseen space [m³].
    """

    look: Look
    before_m3: float
    after_m3: float
    all_before_m3: float
    all_after_m3: float

    @property
    def sentence(self) -> str:
        """What changed, in words."""
        x, y, z = (float(v) for v in self.look.T_base_camera[:3, 3])
        way = f"{1e3 * self.before_m3:.2f} dm³ of the way were unseen, {1e3 * self.after_m3:.2f} are left"
        around = f"around the plant {1e3 * self.all_before_m3:.1f} dm³, now {1e3 * self.all_after_m3:.1f}"
        return f"the camera looked from {x:.2f} {y:.2f} {z:.2f}: {way}; {around}"

    def figures(self) -> dict[str, float]:
        """The volumes for the status."""
        return {"look_unseen_before_m3": self.before_m3, "look_unseen_after_m3": self.after_m3, "unseen_m3": self.all_after_m3}


@dataclass
class _Awaited:
    """The motion to a view of a request, and its end."""

    plan_id: int
    ended: Ended | None = None
    done: threading.Event = field(default_factory=threading.Event)


class LookSteps(RequestSteps):
    """The steps of a look, on top of those that every job has."""

    _awaited: _Awaited | None = None

    def look_ended(self, ended: Ended) -> bool:
        """Take in that a motion to a view has ended, from whichever thread notices; tell whether a job waited for it."""
        awaited = self._awaited
        if awaited is None or awaited.plan_id != ended.motion.plan_id:
            return False
        awaited.ended = ended
        awaited.done.set()
        return True

    def _check_camera(self, snapshot: Snapshot) -> Array:
        """Return T_tool_camera (4, 4).

        Raises:
            Refusal: BAD_INPUT, no camera is named; TF_ERROR, nothing tells where it is; NO_CLOUD, it has sent nothing.
        """
        name, camera = snapshot.node.camera_frame, self._source.camera
        if not name or camera is None:
            raise Refusal(Status.BAD_INPUT, "there is no camera to look with: camera_frame names the frame of one that the arm carries")
        T_tool_camera = camera.T_tool_camera()
        if not self._source.seen_by_arm_since(-np.inf):
            raise Refusal(Status.NO_CLOUD, f"no cloud with stems has come from the arm's camera, camera_frame {name!r}")
        return T_tool_camera

    def _look_until_enough(
        self, ticket: Ticket, loaded: Loaded, snapshot: Snapshot, planned: PlannedRequest, left_s: Left, looks: list[Looked | None]
    ) -> PlannedRequest:
        """Look and plan again until little of the way is unseen, no view shows more, or the looks are used up.

        Args:
            ticket, loaded, snapshot, left_s: of the request.
            planned: its plan so far.
            looks: those taken so far, to which more are added; None for one that a stem on the way ended.

        Returns:
            The plan with what is known then.
        """
        node = snapshot.node
        if not (node.look_first and node.motion_enabled and self._parameters.snapshot.node.motion_enabled):
            return planned
        T_tool_camera = self._check_camera(snapshot)
        while len(looks) < node.max_looks and self._worth_a_look(planned, node.unseen_enough):
            try:
                looked = self._look(ticket, loaded, snapshot, planned, T_tool_camera)
            except Refusal as refusal:
                if refusal.status is not Status.STEM_APPEARED or ticket.answered:
                    raise
                looked = None  # what stopped it is known now
                self._come_to_rest(ticket, snapshot)
            else:
                if looked is None:
                    self._board.note(ticket.plan_id, looks_ended="no further view of what is unseen on the way can be reached")
                    break
            looks.append(looked)
            self._board.note(ticket.plan_id, looks=len(looks), **({} if looked is None else looked.figures()))
            planned = self._planned(ticket, loaded, snapshot, self._target(ticket, snapshot), left_s, looks=len(looks))
        return planned

    @staticmethod
    def _worth_a_look(planned: PlannedRequest, enough_rad: float) -> bool:
        result = planned.record.result
        if not result.views:
            return False
        return result.unseen_contact_rad > enough_rad if result.succeeded else result.status in _SEEING_HELPS

    def _look(self, ticket: Ticket, loaded: Loaded, snapshot: Snapshot, planned: PlannedRequest, T_tool_camera: Array) -> Looked | None:
        """Choose a view, go there, and wait for what is seen there.

        Returns:
            What it showed; None where nothing unseen is in the way, or no view of it can be reached.

        Raises:
            Refusal: how the motion ended if not at the view; STALE_INPUT, nothing newer came; CANCELLED; see `Execution.send`.
        """
        scene, result, pipeline = planned.record.scene, planned.record.result, loaded.pipeline
        target = result.target
        assert target is not None  # every plan of a request has one
        seed = snapshot.plan.seed or int(np.random.default_rng().integers(1, 2**31 - 1))
        q = self._arm_at_start(snapshot).q
        look = self._guarded(
            lambda: plan_look(
                pipeline, scene, target, result, q, snapshot.plan, T_tool_camera=T_tool_camera, should_stop=ticket.should_stop, seed=seed
            )
        )
        if ticket.answered:
            raise Refusal(Status.CANCELLED, "the request was stopped")
        if look is None:
            return None
        record = dataclasses.replace(planned.record, number=next(self._numbers), target=None, result=look.plan)
        since_s = self._go_and_rest(ticket, loaded, snapshot, dataclasses.replace(planned, record=record), "to a view")
        self._await_clouds(ticket, snapshot, since_s)
        return _judged(pipeline, look, scene, self._source.scene(snapshot, ticket.should_stop))

    def _back_out(self, ticket: Ticket, loaded: Loaded, snapshot: Snapshot) -> bool:
        """Go back along the motion executed last, as far as the arm got, because no plan leads on from here; tell whether that was done.

        Raises:
            Refusal: how the motion ended if not where that one began.
        """
        path = self._execution.way_out.path
        if path is None or not (snapshot.node.motion_enabled and self._parameters.snapshot.node.motion_enabled):
            return False
        try:
            planned = self._planned_back(ticket, loaded, snapshot, path)
        except Refusal as refusal:
            if refusal.status in (Status.NOTHING_TO_EXECUTE, Status.START_INVALID):  # it is at the beginning already, or elsewhere
                return False
            raise
        if planned.record.result.status is not Status.SUCCEEDED:
            return False
        self._go_and_rest(ticket, loaded, snapshot, planned, "back out", out=True)
        return True

    def _go_and_rest(
        self, ticket: Ticket, loaded: Loaded, snapshot: Snapshot, planned: PlannedRequest, where: str, *, out: bool = False
    ) -> float:
        """Carry out a motion from which the request goes on; return since when the arm has rested at its end [s, monotonic].

        Args:
            ticket, loaded, snapshot: of the request.
            planned: the motion.
            where: it leads to, for sentences.
            out: whether it goes back along the one before.

        Raises:
            Refusal: how it ended if not there; CANCELLED; see `Execution.send`.
        """
        plan = planned.record.result
        assert plan.trajectory is not None  # every plan that succeeded has one
        if not moves(plan.trajectory):
            return time.monotonic() - snapshot.node.stillness_time_s
        number = self._look_again(ticket, loaded, planned)
        if not ticket.answered:
            self._display.show(planned)
        awaited = self._awaited = _Awaited(ticket.plan_id)
        motion = self._execution.send(
            ticket.plan_id, plan, plan.trajectory, snapshot, ticket.is_open, T_base_tool=plan.T_base_tool, look=True
        )
        if motion is None:
            raise Refusal(Status.CANCELLED, f"the request was answered before the motion {where} could be sent")
        self.previewed = None
        if not out:
            self._execution.way_out.went(Path(plan.waypoints, None, None, None), loaded.robot.continuous)
        if self._source.newest_stem_number() != number:
            self._watch.notice()
        self._show_phase(ticket, Phase.EXECUTING)
        while not awaited.done.wait(_POLL_S):
            answer = ticket.given
            if answer is not None:
                self._execution.stop_motion(motion, answer.status, f"its request is over: {answer.sentence}")
                raise Refusal(Status.CANCELLED, "the request was stopped")
        self._show_phase(ticket, Phase.PLANNING)
        ended = awaited.ended
        assert ended is not None
        if ended.status is not Status.SUCCEEDED:
            raise Refusal(ended.status, f"on the way {where}, {ended.sentence}")
        return time.monotonic() - snapshot.node.stillness_time_s

    def _await_clouds(self, ticket: Ticket, snapshot: Snapshot, since_s: float) -> None:
        deadline_s = time.monotonic() + NEWER_CLOUDS_S
        while not self._source.seen_by_arm_since(since_s):
            if ticket.answered:
                raise Refusal(Status.CANCELLED, "the request was stopped")
            if time.monotonic() > deadline_s:
                camera = snapshot.node.camera_frame
                sentence = f"the arm rests at the view, but no cloud that was taken there came from camera_frame {camera!r}"
                raise Refusal(Status.STALE_INPUT, f"{sentence} within {NEWER_CLOUDS_S:g} s")
            time.sleep(_POLL_S)


def _judged(pipeline: Pipeline, look: Look, before: Scene, after: Scene) -> Looked:
    """Compare what was unseen before and after a look."""
    old, new = pipeline.seen_map(before), pipeline.seen_map(after)
    left = int((new.classify(look.matter) == UNSEEN).sum())
    voxel_m3 = old.voxel_m**3
    return Looked(look, look.voxels * voxel_m3, left * voxel_m3, old.unseen_volume_m3, new.unseen_volume_m3)
