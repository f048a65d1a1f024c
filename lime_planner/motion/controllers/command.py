"""A motion command as it arrives at a controller, good or bad, and what each controller would refuse about it.

The rules are those of the Kinova Gen2 driver's command callback and of the ROS 2 joint trajectory controller (Jazzy).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lime_planner.motion.trajectory import Trajectory

Row = tuple[float, ...]

_FLOAT_EPSILON = 1.1920929e-07  # what the joint trajectory controller takes for zero
_TICK_S = 0.01
_JUMP_RAD = 0.02


@dataclass(frozen=True)
class Command:
    """A trajectory message as it is: rows may be missing or of any length.

    Attributes:
        joint_names: names in the message's order.
        times_s: time of every point after the start [s].
        positions: [rad], a row a point.
        velocities: [rad/s], a row a point, empty rows where the message has none.
        accelerations: [rad/s²], the same.
        start_s: when the motion begins, counted from now [s]; negative for a stamp in the past; None for a stamp of zero (now).
    """

    joint_names: tuple[str, ...]
    times_s: Row
    positions: tuple[Row, ...]
    velocities: tuple[Row, ...]
    accelerations: tuple[Row, ...] = ()
    start_s: float | None = None

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory) -> Command:
        """Return what a planned motion is on arrival."""
        positions = tuple(tuple(row) for row in trajectory.positions.tolist())
        velocities = tuple(tuple(row) for row in trajectory.velocities.tolist())
        return cls(trajectory.joint_names, tuple(trajectory.times().tolist()), positions, velocities)


@dataclass(frozen=True)
class Verdict:
    """Whether a command is carried out, and what is to be said about it (empty when nothing is)."""

    accepted: bool
    sentence: str = ""


def judge_kinova(command: Command, joint_names: Sequence[str], *, index: int, running: bool) -> Verdict:
    """Judge a command as the Gen2 driver does, or would if it checked what it then reads.

    Args:
        command: the command.
        joint_names: the arm's joints.
        index: the driver's point index on arrival.
        running: whether its velocity timer runs.
    """
    n = len(joint_names)
    missing = [name for name in joint_names if name not in command.joint_names]
    if missing:
        return Verdict(False, f"rejected: joint {', '.join(missing)} is not in the message")
    if not command.times_s:
        return Verdict(False, "rejected: no points; the real driver reads the first one all the same, results undefined")
    for point, row in enumerate(command.positions):
        if len(row) != n:
            return Verdict(False, f"rejected: point {point} has {len(row)} positions for {n} joints")
    for point, row in enumerate(command.velocities):
        if not row:
            return Verdict(False, f"rejected: point {point} has no velocities; the real driver reads them all the same, results undefined")
        if len(row) != n:
            return Verdict(False, f"rejected: point {point} has {len(row)} velocities for {n} joints")
    if not _finite(command):
        return Verdict(False, "rejected: a number in the message is not finite; the real driver would pass it to the motors")
    remarks = []
    if command.joint_names != tuple(joint_names):
        remarks.append(f"the velocities are read by position as {', '.join(joint_names)}, whatever names the message gives them")
    if running and index > 0:
        remarks.append(f"the driver was at point {index} of another motion and goes on with that index")
    if any(velocity != 0.0 for velocity in command.velocities[-1]):
        remarks.append("the last velocities are not zero and the arm keeps them")
    closest_s = float(np.min(np.diff(command.times_s), initial=np.inf))
    if closest_s < _TICK_S - 1e-9:
        remarks.append(f"points {1e3 * closest_s:g} ms apart take 10 ms each")
    return Verdict(True, "; ".join(remarks))


def judge_jtc(command: Command, joint_names: Sequence[str], q_now: Sequence[float]) -> Verdict:
    """Judge a command as a ROS 2 joint trajectory controller does.

    Args:
        command: the command.
        joint_names: the arm's joints.
        q_now: the configuration on arrival [rad], (n,), for the remark about a start elsewhere.
    """
    n = len(joint_names)
    unknown = [name for name in command.joint_names if name not in joint_names]
    if unknown:
        return Verdict(False, f"rejected: joint {', '.join(unknown)} is not one of the controller's")
    missing = [name for name in joint_names if command.joint_names.count(name) != 1]
    if missing:
        return Verdict(False, f"rejected: joint {', '.join(missing)} must be in the message exactly once")
    if not command.times_s:
        return Verdict(False, "rejected: the message has no points")
    if command.start_s is not None and command.start_s + command.times_s[-1] < 0.0:
        return Verdict(False, f"rejected: by its stamp the motion ended {-(command.start_s + command.times_s[-1]):.3f} s ago")
    for point, step in enumerate(np.diff(command.times_s)):
        if step <= 0.0:
            return Verdict(False, f"rejected: the times of points {point} and {point + 1} do not increase ({step:g} s)")
    for what, rows in (("positions", command.positions), ("velocities", command.velocities), ("accelerations", command.accelerations)):
        for point, row in enumerate(rows):
            if len(row) != n and (row or what == "positions"):
                return Verdict(False, f"rejected: point {point} has {len(row)} {what} for {n} joints")
    if not _finite(command):
        return Verdict(False, "rejected: a number in the message is not finite")
    if command.velocities and any(abs(velocity) > _FLOAT_EPSILON for velocity in command.velocities[-1]):
        return Verdict(False, "rejected: the velocities of the last point must be zero")
    if command.times_s[0] == 0.0 and not command.start_s:
        order = [command.joint_names.index(name) for name in joint_names]
        jump = np.asarray(command.positions[0])[order] - np.asarray(q_now)
        jump -= 2.0 * np.pi * np.round(jump / (2.0 * np.pi))
        worst = int(np.argmax(np.abs(jump)))
        if abs(jump[worst]) > _JUMP_RAD:
            return Verdict(True, f"the arm jumps: the first point, at 0 s, has {joint_names[worst]} {jump[worst]:+.4f} rad off")
    return Verdict(True)


def _finite(command: Command) -> bool:
    rows = (*command.positions, *command.velocities, *command.accelerations, command.times_s)
    return bool(np.isfinite(np.concatenate([np.asarray(row, dtype=np.float64) for row in rows])).all())
