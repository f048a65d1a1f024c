"""The one place from which a motion leaves, and the watch over it until the arm rests.

`send` checks everything that must hold at that moment; `stop` may come from any thread at any time; `on_state` and `tick` are
called by the executor while a motion runs. A motion is never sent while another runs.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.result import PlanResult
from lime_planner.robot.model import Robot
from lime_planner.ros.execution.motion import Ended, Motion
from lime_planner.ros.execution.output import ACTION, MotionOutput, Verdict
from lime_planner.ros.execution.retreat import WayOut
from lime_planner.ros.execution.stopping import make_stop
from lime_planner.ros.inputs.joint_states import ArmState, JointHistory
from lime_planner.ros.inputs.latest import Target
from lime_planner.ros.parameters import Snapshot

#: Joint states must be silent for at least this long to stop a motion, whatever age a plan may start from [s]: a machine under
#: load holds them up for some tenths of a second, and the motion that was checked does not become wrong by that.
SILENCE_S = 0.5


@dataclass(frozen=True)
class _Stop:
    """A stop that was sent.

    Attributes:
        motion, status, sentence: what was stopped, as what, and why.
        sent_s: when, on the monotonic clock.
        over_s: when it should be over.
    """

    motion: Motion
    status: Status
    sentence: str
    sent_s: float
    over_s: float


#: How long a controller may take to begin with a stop [s].
_STOP_BEGINS_S = 0.2
#: A controller this slow is waited for as if it were no slower, and no longer than that [s].
_SLOWEST_PACE, _LONGEST_STILLNESS_S = 0.1, 2.5
#: Within so many goal tolerances of the path's end an arm that comes on no more is taken to have ended its motion.
_NEAR_END = 3.0


class Surroundings(Protocol):
    """What an execution asks of the node around it, and tells it."""

    def robot(self) -> Robot | None:
        """Return the model in use."""

    def may_move(self) -> bool:
        """Whether motions are allowed now, whatever was allowed when the plan was asked for."""

    def simulated_s(self) -> float | None:
        """Return a simulation's time now [s], None without one."""

    def on_stop(self, motion: Motion) -> None:
        """Hear of a motion that is being stopped."""

    def on_end(self, ended: Ended) -> None:
        """Hear of a motion's end, once, from whichever thread notices."""


class Execution:
    """Sends motions, watches the one that runs, stops it."""

    def __init__(self, joints: JointHistory, output: MotionOutput, node: Surroundings) -> None:
        """Make an execution at rest.

        Args:
            joints: the measured states.
            output: what motions go through.
            node: what surrounds it.
        """
        self._joints = joints
        self._output = output
        self._node = node
        self._lock = threading.RLock()
        self._motion: Motion | None = None
        self._stopping: _Stop | None = None
        self._reported: Motion | None = None  # the motion whose controller reported success
        self._restless: Motion | None = None  # a motion that could not be seen to rest after its stop, until the arm is seen to
        #: What a retreat goes back along.
        self.way_out = WayOut()
        #: How often the arm was told to stop and to stay: what would move it again unasked must look at this.
        self.cancels = 0

    @property
    def motion(self) -> Motion | None:
        """The motion that runs (not one that is being stopped)."""
        return self._motion

    @property
    def active(self) -> bool:
        """Whether a motion runs or has not come to rest after its stop."""
        with self._lock:
            return self._motion is not None or self._stopping is not None

    @property
    def watched(self) -> bool:
        """Whether `tick` has anything to notice: a motion, a stop, or an arm that was not seen to rest after one."""
        with self._lock:
            return self._motion is not None or self._stopping is not None or self._restless is not None

    @property
    def ending(self) -> Motion | None:
        """The motion that is being stopped."""
        stopping = self._stopping
        return None if stopping is None else stopping.motion

    @property
    def stopping(self) -> bool:
        """Whether a stop was sent and the arm does not rest yet."""
        return self.ending is not None

    def send(
        self,
        plan_id: int,
        result: PlanResult,
        trajectory: Trajectory,
        snapshot: Snapshot,
        commit: Callable[[], bool],
        *,
        T_base_tool: Array | None = None,
        target: Target | None = None,
        replans_left: int = 0,
        look: bool = False,
    ) -> Motion | None:
        """Check once more and send.

        Args:
            plan_id: the request.
            result: its plan.
            trajectory: what to send; its first point is where planning began.
            snapshot: the parameters of the plan.
            commit: the request's point of no return; False when it was answered meanwhile, then nothing is sent.
            T_base_tool, target, replans_left, look: see `Motion`.

        Returns:
            The motion, or None when the request was answered meanwhile.

        Raises:
            Refusal: MOTION_DISABLED, ARM_MOVING, STALE_INPUT and its kin, NO_CONTROLLER.
        """
        node = snapshot.node
        message = self._output.prepare(trajectory)  # outside the lock: a stop must not wait for it
        with self._lock:
            if not (node.motion_enabled and self._node.may_move()):
                raise Refusal(Status.MOTION_DISABLED, "planned and published, but not sent, because motion_enabled is false")
            if self._motion is not None or self._stopping is not None:
                raise Refusal(Status.ARM_MOVING, "another motion has not ended")
            state = self._joints.fresh(node.max_joint_state_age_s, node.max_clock_skew_s)
            self._check_start(state.q, trajectory, node.start_tolerance_rad)
            trouble = self._output.trouble(node.controller)
            if trouble:
                raise Refusal(Status.NO_CONTROLLER, trouble)
            if not commit():
                return None
            motion = Motion(
                plan_id,
                result,
                trajectory,
                time.monotonic(),
                snapshot,
                T_base_tool=T_base_tool,
                replans_left=replans_left,
                target=target,
                look=look,
                simulated=self._node.simulated_s,
                simulated_start_s=self._node.simulated_s(),
            )
            self._output.send(message, node.controller, partial(self._on_verdict, motion))
            self._motion, self._restless = motion, None
            return motion

    def _check_start(self, q: Array, trajectory: Trajectory, tolerance_rad: float) -> None:
        off = np.abs(q - trajectory.positions[0])  # without turns removed: the controller takes the angles literally
        worst = int(off.argmax())
        if off[worst] > tolerance_rad:
            raise Refusal(
                Status.ARM_MOVING,
                f"{trajectory.joint_names[worst]} is {off[worst]:.3f} rad from where planning began, the limit is {tolerance_rad:g} rad",
            )

    def stop(self, status: Status, sentence: str) -> bool:
        """Stop what runs; the command is on the wire on return. False when nothing of ours runs.

        Somebody who stops an arm again that should stand by now, and does not, gets a hold sent.

        Args:
            status: the motion's `execution_code`.
            sentence: why.
        """
        with self._lock:
            cancelled = status is Status.CANCELLED
            self.cancels += cancelled
            motion = self._motion
            if motion is None:
                if cancelled and self._stopping is not None:
                    self._stop_again(self._stopping, sentence)
                return self._stopping is not None
            controller = motion.snapshot.node.controller
            command = make_stop(self._node.robot(), motion, self._joints.newest, status is not Status.EXECUTION_DEVIATED, controller)
            now_s = time.monotonic()
            over_s = now_s + _STOP_BEGINS_S
            if command is not None:
                over_s += command.duration_s
            self._output.stop(None if command is None else self._output.prepare(command), controller)
            self._motion = None
            self._stopping = _Stop(motion, status, sentence, now_s, over_s)
        self._node.on_stop(motion)
        return True

    def stop_motion(self, motion: Motion, status: Status, sentence: str) -> None:
        """Stop one motion if it is the one that runs; see `stop`."""
        with self._lock:
            if self._motion is motion:
                self.stop(status, sentence)

    def _on_verdict(self, motion: Motion, verdict: Verdict) -> None:
        """Take in what the controller says of a motion: it took none of it, ended it early, or has carried it out."""
        with self._lock:
            if self._motion is not motion:
                return
            if verdict.status is Status.SUCCEEDED:
                self._reported = motion  # the arm is still seen to rest at the end (`tick`)
                return
            self._motion = None
            ended = Ended(motion, verdict.status, verdict.sentence, self.cancels) if verdict.status is Status.NO_CONTROLLER else None
            if ended is None:  # the controller holds the arm itself: another command would only disturb it
                now_s = time.monotonic()
                self._stopping = _Stop(motion, verdict.status, verdict.sentence, now_s, now_s + _STOP_BEGINS_S)
        if ended is None:
            self._node.on_stop(motion)
        else:
            self._node.on_end(ended)

    def _stop_again(self, stop: _Stop, sentence: str) -> None:
        """Take in that an arm that is being stopped already is to stay."""
        node = stop.motion.snapshot.node
        if time.monotonic() > stop.over_s and self._joints.moving(node.stillness_time_s, node.stillness_rad):
            self._hold(node.controller)
        # A motion that is aborted may be planned again; a cancelled one may not.
        self._stopping = dataclasses.replace(stop, status=Status.CANCELLED, sentence=sentence)

    def _hold(self, controller: str) -> bool:
        command = make_stop(self._node.robot(), None, self._joints.newest, False, controller)
        if command is not None:
            self._output.stop(self._output.prepare(command), controller)
        return command is not None

    def hold_foreign_motion(self, snapshot: Snapshot) -> str:
        """Send a hold when the arm moves although nothing of ours runs: a motion from before a restart, say, or one that did not end.

        Returns:
            What was found and done, in words; empty when the arm rests, as far as is known.
        """
        node = snapshot.node
        with self._lock:
            state = self._joints.newest
            if self.active or state is None or state.age_s(time.monotonic()) > SILENCE_S:
                return ""
            if not self._joints.moving(node.stillness_time_s, node.stillness_rad):
                return ""
            if self._restless is not None:
                return (
                    f"the arm has not come to rest since plan {self._restless.plan_id}: a hold was sent"
                    if self._hold(node.controller)
                    else ""
                )
            if not node.motion_enabled:  # where motions are forbidden, the arm is moved by other means, or must be stopped by them
                return "the arm moves, but not by this node, and no hold was sent, because motion_enabled is false"
            return "the arm moved, but not by this node: a hold was sent" if self._hold(node.controller) else ""

    @staticmethod
    def reached_s(motion: Motion) -> float:
        """Return how far on a motion's plan the arm was when it was measured last [s]; it is not behind that now."""
        return motion.follower.moment_s

    def on_state(self, state: ArmState) -> None:
        """Compare a new measurement with the path."""
        with self._lock:
            motion = self._motion
            if motion is None:
                return
            motion.follow(state)
            off = np.abs(motion.follower.off)
            joint = int(off.argmax())
            limit = motion.snapshot.node.execution_tolerance_rad
            if off[joint] > limit:
                name = motion.trajectory.joint_names[joint]
                sentence = f"{name} is {off[joint]:.3f} rad from the path at {motion.elapsed_s():.2f} s, the limit is {limit:g} rad"
                self.stop(Status.EXECUTION_DEVIATED, sentence)

    def tick(self) -> None:
        """Notice silence, the end, and rest after a stop; to be called some 20 times a second while `watched`."""
        ended: Ended | None = None
        with self._lock:
            if self._stopping is not None:
                ended = self._rest_after_stop()
            elif self._motion is not None:
                ended = self._look_at(self._motion)
            elif self._restless is not None:
                node = self._restless.snapshot.node
                if self._joints.still(node.stillness_time_s, node.stillness_rad):
                    self._restless = None
        if ended is not None:
            self._node.on_end(ended)

    def _rest_after_stop(self) -> Ended | None:
        assert self._stopping is not None
        stop = self._stopping
        node = stop.motion.snapshot.node
        waited_s = time.monotonic() - stop.sent_s
        rests = waited_s >= node.stillness_time_s and self._joints.still(node.stillness_time_s, node.stillness_rad)
        if not rests and waited_s < node.stillness_timeout_s:
            return None
        self._stopping = None
        self._restless = None if rests else stop.motion
        more = "" if rests else f"; it could not be seen to rest within {node.stillness_timeout_s:g} s"
        return Ended(stop.motion, stop.status, stop.sentence + more, self.cancels)

    def _look_at(self, motion: Motion) -> Ended | None:
        node = motion.snapshot.node
        state = self._joints.newest
        limit_s = max(node.max_joint_state_age_s, SILENCE_S)
        silent_s = motion.elapsed_s() if state is None else min(state.age_s(time.monotonic()), motion.elapsed_s() + limit_s)
        if silent_s > limit_s:
            sentence = f"the joint states fell silent for {silent_s:.2f} s during the motion, the limit is {limit_s:g} s"
            self.stop(Status.STALE_INPUT, sentence)
            return None
        if state is None or max(motion.clocks_s()) < motion.trajectory.duration_s:
            self._stop_if_stuck(motion, node.progress_timeout_s)
            return None
        follower = motion.follower
        off = float(np.abs(state.q - motion.trajectory.positions[-1]).max())
        # A slow controller creeps into its last point: it must be seen to rest for longer.
        still_s = min(node.stillness_time_s / max(follower.moving_pace, _SLOWEST_PACE), _LONGEST_STILLNESS_S)
        near = follower.remaining_rad() <= _NEAR_END * node.goal_tolerance_rad
        if near and off <= node.goal_tolerance_rad and self._joints.still(still_s, node.stillness_rad):
            silent = node.controller == ACTION and self._reported is not motion
            if silent and motion.waited_s() <= node.goal_time_s:
                return None  # its verdict is awaited
            self._motion = None
            sentence = f"the arm rests {off:.4f} rad from the planned end after {motion.elapsed_s():.2f} s"
            sentence += "; its controller has not said so" if silent else ""
            return Ended(motion, Status.SUCCEEDED, sentence, self.cancels)
        self._stop_if_stuck(motion, node.goal_time_s if near else node.progress_timeout_s)
        return None

    def _stop_if_stuck(self, motion: Motion, timeout_s: float) -> None:
        """Stop a motion that has not come on along its path for too long."""
        waited_s = motion.waited_s()
        if waited_s <= timeout_s:
            return
        state = self._joints.newest
        off = 0.0 if state is None else float(np.abs(state.q - motion.trajectory.positions[-1]).max())
        self.stop(
            Status.EXECUTION_DEVIATED,
            f"the arm has not come on along its path for {waited_s:.2f} s, {off:.3f} rad from its last point; the limits are "
            f"{timeout_s:g} s and {motion.snapshot.node.goal_tolerance_rad:g} rad, at rest",
        )
