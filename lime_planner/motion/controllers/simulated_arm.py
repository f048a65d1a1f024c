"""An arm that plays motion commands as a real controller would, with faults that can be changed while it runs. No ROS in here."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ParameterError
from lime_planner.core.types import Array
from lime_planner.motion.controllers.command import Command, Verdict, judge_jtc, judge_kinova
from lime_planner.motion.controllers.joint_trajectory_controller import JtcLaw
from lime_planner.motion.controllers.replay import TICK_S, KinovaLaw

CONTROLLERS = ("jtc", "kinova")
LONGEST_DELAY_S = 5.0  #: states older than this are forgotten
_DOUBLED = 0.2  # part of the Kinova driver's states whose velocities are twice the true ones


@dataclass(frozen=True)
class Faults:
    """What is wrong with the arm; the defaults are a sound one.

    Attributes:
        lag_s: time constant with which the arm follows its controller [s].
        gain_error: part by which every motion comes out too large (negative: too small).
        speed_scaling: pace at which a joint trajectory controller goes through its motions, part of the planned one.
        noise_rad: standard deviation of the reported positions [rad].
        drop_probability: part of the states that are not reported, 0 to 1.
        state_delay_s: age of the states when they are reported [s].
        stall_at_fraction: the arm stops at this part of every motion's duration; 0 for never.
        shuffle: joints are reported in another order each time.
        extra_joints: further joints to report, besides the arm's fingers.
        report_wrapped: continuous joints are reported within [-π, π), as the driver of a Gen3 does.
        wrap_offset_turns: turns added to the reported angle of each joint; one number for all, or one a joint; empty for none.
    """

    lag_s: float = 0.0
    gain_error: float = 0.0
    speed_scaling: float = 1.0
    noise_rad: float = 0.0
    drop_probability: float = 0.0
    state_delay_s: float = 0.0
    stall_at_fraction: float = 0.0
    shuffle: bool = False
    extra_joints: tuple[str, ...] = ()
    report_wrapped: bool = False
    wrap_offset_turns: tuple[int, ...] = ()


@dataclass(frozen=True)
class Reading:
    """A joint state as it is reported.

    Attributes:
        joint_names: names, in the order reported, extra joints included.
        positions: [rad], (m,).
        velocities: [rad/s], (m,).
        age_s: how long ago the arm was there [s].
    """

    joint_names: tuple[str, ...]
    positions: Array
    velocities: Array
    age_s: float


class SimulatedArm:
    """The arm: `command` it, let time pass with `step`, read its `state`."""

    def __init__(
        self,
        joint_names: Sequence[str],
        q_start: npt.ArrayLike,
        *,
        rng: np.random.Generator,
        controller: str = "jtc",
        finger_joints: Sequence[str] = (),
        continuous: npt.ArrayLike | None = None,
        faults: Faults | None = None,
    ) -> None:
        """Stand still at `q_start`.

        Args:
            joint_names: names of the n joints in the driver's order.
            q_start: configuration [rad], (n,).
            rng: source of noise, drops and orders.
            controller: `jtc` (a ROS 2 joint trajectory controller) or `kinova` (the Gen2 driver, defects included).
            finger_joints: further joints that are always reported, at 0.
            continuous: which joints turn without end, (n,); all by default.
            faults: what is wrong with it; nothing by default.

        Raises:
            ParameterError: an unknown controller, or a configuration that does not fit the joints.
        """
        if controller not in CONTROLLERS:
            raise ParameterError(f"controller is {controller!r}; it must be one of {', '.join(CONTROLLERS)}")
        q = np.array(q_start, dtype=np.float64)
        if q.shape != (len(joint_names),) or not np.isfinite(q).all():
            raise ParameterError(f"start must be {len(joint_names)} finite numbers, got {q.tolist()}")
        self.joint_names = tuple(joint_names)
        self.controller = controller
        self.finger_joints = tuple(finger_joints)
        self._rng = rng
        self._continuous = np.ones(len(q), dtype=bool) if continuous is None else np.asarray(continuous, dtype=bool)
        self._faults = Faults()
        self._offset = np.zeros(len(q))
        self.faults = faults or Faults()
        self._q = q  # where the arm is, without the offset of `wrap_offset_turns`
        self._wanted = q.copy()  # where its controller wants it, gain error included
        self._v = np.zeros(len(q))
        self._kinova = KinovaLaw(len(q))
        self._jtc: JtcLaw | None = None
        self._begun_at = q.copy()
        self._clock_s = 0.0
        self._played_s = 0.0  # how far the motion is, by the controller's own clock
        self._duration_s = 0.0
        self._stalled = False
        self._rest_s = 0.0
        self._history: deque[tuple[float, Array, Array]] = deque([(0.0, q, self._v)])

    @property
    def faults(self) -> Faults:
        """What is wrong with the arm; may be replaced at any time."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self.check(faults)
        turns = np.array(faults.wrap_offset_turns or (0,), dtype=np.float64)
        self._offset = 2.0 * np.pi * np.broadcast_to(turns, len(self.joint_names))
        self._faults = faults

    def check(self, faults: Faults) -> None:
        """Do nothing where the faults fit the arm.

        Raises:
            ParameterError: a number of turns that is not 0, 1 or n.
        """
        turns, n = len(faults.wrap_offset_turns), len(self.joint_names)
        if turns not in (0, 1, n):
            raise ParameterError(f"wrap_offset_turns needs 0, 1 or {n} numbers, got {turns}")

    @property
    def configuration(self) -> Array:
        """Where the arm really is [rad], (n,), on the branch it reports."""
        return np.asarray(self._q + self._offset, dtype=np.float64)

    @property
    def moving(self) -> bool:
        """Whether a motion is being carried out."""
        return not self._stalled and (self._kinova.running if self._jtc is None else self._played_s < self._jtc.duration_s)

    def command(self, command: Command) -> Verdict:
        """Take a motion command as the controller does.

        Returns:
            Whether it is carried out, and what is to be logged about it.
        """
        if self.controller == "kinova":
            verdict = judge_kinova(command, self.joint_names, index=self._kinova.index, running=self._kinova.running)
            if verdict.accepted:
                self._kinova.command(command.times_s, command.velocities)
        else:
            verdict = judge_jtc(command, self.joint_names, self.configuration.tolist())
            if verdict.accepted:
                self._jtc = JtcLaw(command, self.joint_names, self.configuration, self._v, self._continuous)
                # The reported angle follows the trajectory's branch; the joint itself has not moved.
                self._q = self._jtc.q_start - self._offset
        if verdict.accepted:
            self._begun_at = self._q.copy()
            self._wanted = self._q.copy()
            self._played_s = 0.0
            self._duration_s = command.times_s[-1] + max(command.start_s or 0.0, 0.0)
            self._stalled = False
        return verdict

    def step(self, dt_s: float) -> None:
        """Let time pass, in ticks of 10 ms; what is left over counts for the next call.

        Args:
            dt_s: how much [s], >= 0.
        """
        self._rest_s += dt_s
        while self._rest_s >= TICK_S - 1e-9:
            self._rest_s -= TICK_S
            self._tick()

    def _tick(self) -> None:
        faults = self._faults
        self._clock_s += TICK_S
        self._played_s += TICK_S * (faults.speed_scaling if self.controller == "jtc" else 1.0)
        if 0.0 < faults.stall_at_fraction < 1.0 and self.moving and self._played_s >= faults.stall_at_fraction * self._duration_s:
            self._stalled = True
            self._wanted = self._q.copy()
        if self.controller == "kinova":
            velocity = self._kinova.tick()  # the driver goes on even where the arm is stuck
            if not self._stalled:
                self._wanted = self._wanted + (1.0 + faults.gain_error) * velocity * TICK_S
        elif self._jtc is not None and not self._stalled:
            commanded = self._jtc.sample(self._played_s) - self._offset
            self._wanted = commanded + faults.gain_error * (commanded - self._begun_at)
        follow = 1.0 if faults.lag_s <= 0.0 else 1.0 - np.exp(-TICK_S / faults.lag_s)
        moved = follow * (self._wanted - self._q)
        self._q = self._q + moved
        self._v = moved / TICK_S
        self._history.append((self._clock_s, self._q, self._v))
        while self._history[0][0] < self._clock_s - LONGEST_DELAY_S:
            self._history.popleft()

    def state(self) -> Reading | None:
        """Return what the arm reports now; None where the state is dropped."""
        faults = self._faults
        if self._rng.random() < faults.drop_probability:
            return None
        wanted_s = self._clock_s - faults.state_delay_s
        time_s, q, v = self._history[0]
        for entry in reversed(self._history):
            if entry[0] <= wanted_s + 1e-9:
                time_s, q, v = entry
                break
        if self.controller == "kinova" and self._rng.random() < _DOUBLED:
            v = 2.0 * v
        extra = (*self.finger_joints, *faults.extra_joints)
        names = (*self.joint_names, *extra)
        reported = q + self._offset + faults.noise_rad * self._rng.standard_normal(len(q))
        if faults.report_wrapped:
            reported = np.where(self._continuous, (reported + np.pi) % (2.0 * np.pi) - np.pi, reported)
        positions = np.concatenate([reported, np.zeros(len(extra))])
        velocities = np.concatenate([v, np.zeros(len(extra))])
        if faults.shuffle:
            order = self._rng.permutation(len(names))
            names = tuple(names[i] for i in order)
            positions, velocities = positions[order], velocities[order]
        return Reading(names, positions, velocities, self._clock_s - time_s)
