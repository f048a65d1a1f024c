"""The rules a motion command must keep before it may leave, as one pure function.

They are what both a Kinova Gen2 driver and a ROS 2 joint trajectory controller carry out faithfully: the driver follows velocities
by position in the message, holds each until its point's time has passed, keeps the last one, and checks nothing; the controller
plays the cubic between two points and refuses a last velocity that is not zero. What the message adds to the arrays (a stamp of
zero, no accelerations, no effort) is for the code that makes the message; collision is for the exact checker.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array, Bool
from lime_planner.motion.timing import MINIMUM_DT_S
from lime_planner.motion.trajectory import Trajectory

START_TOLERANCE_RAD = 0.01  #: between point 0 and the measured configuration, turns counted
POSITION_TOLERANCE_RAD = 1e-6  #: beyond a joint limit: rounding
LIMIT_TOLERANCE = 1e-3  #: part by which a velocity or acceleration limit may be exceeded: rounding, and decimals in files


def violations(
    trajectory: Trajectory,
    *,
    q_measured: npt.ArrayLike,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    velocity_limits: npt.ArrayLike,
    acceleration_limits: npt.ArrayLike,
    velocity_scaling: float = 1.0,
    acceleration_scaling: float = 1.0,
    joint_names: Sequence[str] | None = None,
    start_tolerance_rad: float = START_TOLERANCE_RAD,
    limit_tolerance_rad: float = 0.0,
) -> list[str]:
    """List every rule of the trajectory message that a motion breaks, each joint at its worst point.

    Velocities and accelerations are judged between the points too, on the cubic of every interval.

    Args:
        trajectory: the motion.
        q_measured: the configuration the arm reports now [rad], (n,), turns kept.
        lower: lower joint limits [rad], (n,), -inf for continuous joints.
        upper: upper joint limits [rad], (n,), inf for continuous joints.
        velocity_limits: [rad/s], (n,), before scaling.
        acceleration_limits: [rad/s²], (n,), before scaling.
        velocity_scaling: part of the velocity limits that may be used.
        acceleration_scaling: part of the acceleration limits that may be used.
        joint_names: the configured arm joints in the driver's order; the motion's own by default.
        start_tolerance_rad: largest distance of point 0 from `q_measured` in any joint [rad].
        limit_tolerance_rad: how far beyond a joint limit point 0 may be [rad]; from there the motion must lead back, never farther out.

    Returns:
        Sentences that name joint, point, value and limit; empty when the motion may be sent.

    Raises:
        ProblemError: a limit or `q_measured` of the wrong shape.
    """
    n = len(trajectory.joint_names)
    arrays = {"q_measured": q_measured, "lower": lower, "upper": upper, "velocity_limits": velocity_limits}
    arrays["acceleration_limits"] = acceleration_limits
    given = {name: np.asarray(value, dtype=np.float64) for name, value in arrays.items()}
    for name, value in given.items():
        if value.shape != (n,):
            raise ProblemError(f"{name} must have shape ({n},), got {value.shape}")
    found: list[str] = []
    if joint_names is not None and tuple(joint_names) != trajectory.joint_names:
        found.append(f"the joints are {', '.join(trajectory.joint_names)}; they must be {', '.join(joint_names)}, in this order")
    found += _grid(trajectory)
    with np.errstate(invalid="ignore", over="ignore"):
        found += _finite(trajectory)
        found += _start(trajectory, given["q_measured"], start_tolerance_rad)
        found += _ends(trajectory)
        found += _positions(trajectory, given["lower"], given["upper"], limit_tolerance_rad)
        if len(trajectory) > 1:
            found += _motion(trajectory, given["velocity_limits"] * velocity_scaling, given["acceleration_limits"] * acceleration_scaling)
    return found


def stop_violations(stop: Trajectory, *, q_measured: npt.ArrayLike, reach_rad: npt.ArrayLike) -> list[str]:
    """List every rule that a stop breaks: it is finite, ends at rest, and takes no joint farther than braking needs.

    Args:
        stop: what is about to be sent.
        q_measured: the configuration the arm was measured at last [rad], (n,), on the turns of the stop.
        reach_rad: how far from there each joint may be commanded [rad], (n,): its braking distance and the measured error.

    Returns:
        Sentences that name joint, point, value and limit; empty when the stop may be sent.

    Raises:
        ProblemError: `q_measured` or `reach_rad` of the wrong shape.
    """
    n = len(stop.joint_names)
    q, reach = (np.asarray(values, dtype=np.float64) for values in (q_measured, reach_rad))
    if q.shape != (n,) or reach.shape != (n,):
        raise ProblemError(f"q_measured and reach_rad must have shape ({n},), got {q.shape} and {reach.shape}")
    found = _finite(stop)
    found += [sentence for sentence in _ends(stop) if sentence.startswith("the last")]
    with np.errstate(invalid="ignore"):
        off = np.abs(stop.positions - q)
        for joint, point in _worst(~(off <= reach), off):
            found.append(
                f"the stop takes {stop.joint_names[joint]} {off[point, joint]:.4f} rad from where it was measured (point {point}); "
                f"braking needs at most {reach[joint]:.4f} rad"
            )
    return found


def _grid(trajectory: Trajectory) -> list[str]:
    found = []
    if len(trajectory) < 2:
        found.append("the motion has 1 point; it needs at least 2")
    if trajectory.dt_s < MINIMUM_DT_S:
        found.append(f"the points are {trajectory.dt_s:g} s apart; at least {MINIMUM_DT_S:g} s is needed")
    if trajectory.first_time_s != 0.0:
        found.append(f"point 0 is at {trajectory.first_time_s:g} s; it must be at 0 s")
    return found


def _finite(trajectory: Trajectory) -> list[str]:
    found = []
    for what, array in (("position", trajectory.positions), ("velocity", trajectory.velocities)):
        for joint in np.flatnonzero(~np.isfinite(array).all(axis=0)):
            point = int(np.argmin(np.isfinite(array[:, joint])))
            found.append(f"the {what} of {trajectory.joint_names[joint]} at point {point} is {array[point, joint]}; it must be finite")
    return found


def _start(trajectory: Trajectory, q_measured: Array, tolerance: float) -> list[str]:
    found = []
    difference = trajectory.positions[0] - q_measured
    for joint in np.flatnonzero(~(np.abs(difference) <= tolerance)):
        name, value = trajectory.joint_names[joint], difference[joint]
        sentence = (
            f"point 0 has {name} at {trajectory.positions[0, joint]:.4f} rad, {abs(value):.4f} rad from the measured "
            f"{q_measured[joint]:.4f} rad; at most {tolerance:g} rad is allowed"
        )
        turns = round(value / (2.0 * np.pi)) if np.isfinite(value) else 0
        if turns and abs(value - 2.0 * np.pi * turns) <= tolerance:
            sentence += f" (it is {turns:+d} turns off the measured branch)"
        found.append(sentence)
    return found


def _ends(trajectory: Trajectory) -> list[str]:
    found = []
    for word, point in (("first", 0), ("last", len(trajectory) - 1)):
        velocity = trajectory.velocities[point]
        for joint in np.flatnonzero(velocity != 0.0):
            name = trajectory.joint_names[joint]
            found.append(f"the {word} velocity of {name} (point {point}) is {velocity[joint]:g} rad/s; it must be exactly 0")
    return found


def _positions(trajectory: Trajectory, lower: Array, upper: Array, tolerance_rad: float) -> list[str]:
    below, above = lower - trajectory.positions, trajectory.positions - upper
    found = []
    for word, excess, limit in (("below", below, lower), ("above", above, upper)):
        # A joint that starts beyond its limit comes nearer to it with every point, and stays inside once it is.
        nearest = np.maximum(np.minimum.accumulate(excess, axis=0), 0.0)
        allowed = np.where(excess[0] <= tolerance_rad + POSITION_TOLERANCE_RAD, nearest, 0.0)
        for joint, point in _worst(excess > allowed + POSITION_TOLERANCE_RAD, excess):
            found.append(
                f"{trajectory.joint_names[joint]} is at {trajectory.positions[point, joint]:.4f} rad at point {point}, "
                f"{word} its limit of {limit[joint]:.4f} rad"
            )
    return found


def _motion(trajectory: Trajectory, velocity_limits: Array, acceleration_limits: Array) -> list[str]:
    names, h = trajectory.joint_names, trajectory.dt_s
    q, v = trajectory.positions, trajectory.velocities
    found = []
    step = np.abs(np.diff(q, axis=0))
    jump = step > np.pi
    for joint, point in _worst(jump, step):
        found.append(
            f"{names[joint]} jumps by {q[point + 1, joint] - q[point, joint]:.4f} rad from point {point} to {point + 1}; "
            "angles must be unwrapped, without jumps of a turn"
        )
    # What a change of position and the mean of both velocities may differ by, within the acceleration limit, is a h² / 4.
    gap = np.abs(np.diff(q, axis=0) / h - 0.5 * (v[1:] + v[:-1]))
    allowed = 0.25 * acceleration_limits * h * (1.0 + LIMIT_TOLERANCE) + 1e-9
    own_speed = np.maximum(np.abs(v[:-1]), np.abs(v[1:]))
    finite = np.isfinite(gap)  # what is not finite has its own sentence
    inconsistent = (gap > allowed) & ~jump & finite
    for joint, point in _worst(inconsistent, gap):
        found.append(
            f"the velocities of {names[joint]} at points {point} and {point + 1} differ by {gap[point, joint]:.4f} rad/s from the change "
            f"of its position; at most {allowed[joint]:.4f} rad/s is allowed, they must be the derivatives"
        )
    # Where the two disagree the cubic means nothing, but a velocity in the message is a command all the same.
    speed = np.where(finite, np.where(jump | inconsistent, own_speed, trajectory.peak_velocities()), 0.0)
    for joint, point in _worst(speed > velocity_limits * (1.0 + LIMIT_TOLERANCE), speed):
        found.append(
            f"{names[joint]} moves at {speed[point, joint]:.4f} rad/s between points {point} and {point + 1}; "
            f"its limit is {velocity_limits[joint]:.4f} rad/s"
        )
    start, end = trajectory.end_accelerations()
    acceleration = np.maximum(np.abs(start), np.abs(end))
    too_hard = (acceleration > acceleration_limits * (1.0 + LIMIT_TOLERANCE)) & finite & ~(jump | inconsistent).any(axis=0)
    for joint, point in _worst(too_hard, acceleration):
        found.append(
            f"{names[joint]} accelerates at {acceleration[point, joint]:.4f} rad/s² between points {point} and {point + 1}; "
            f"its limit is {acceleration_limits[joint]:.4f} rad/s²"
        )
    return found


def _worst(bad: Bool, value: Array) -> list[tuple[int, int]]:
    """Return (joint, row) of the largest value marked bad, for every joint that has one."""
    marked = np.where(bad, value, -np.inf)
    return [(int(joint), int(np.argmax(marked[:, joint]))) for joint in np.flatnonzero(bad.any(axis=0))]
