"""How a motion is stopped, by the controller that plays it.

The Kinova driver halts at once on a single point of zero velocity (and forgets the point index it would otherwise keep).

A joint trajectory controller goes from wherever it is to the first point of what it is sent, by a cubic that begins with its own
position and velocity. A hold at a state measured a tenth of a second ago whips the arm back, and a first point a few hundredths of a
second ahead turns every millimetre by which the arm is not where it was taken to be into an acceleration of 6 e / h². So it is sent the
rest of the running motion, slowed down to a stand, of which the first part is left to the controller: it is so long (`blend_time_s`)
that what the estimate may be off costs about one acceleration limit more. The arm brakes from the first moment all the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.jit import copy_row, kernel
from lime_planner.core.types import Array
from lime_planner.motion.trajectory import Trajectory

_BLEND_SHARE = 1.2  # of the acceleration limits, for what the estimate of the arm is off
_SAME_PACE = 0.03  # paces this close to the planned one are not told apart from it
_REACH = 0.6  # of the time to brake from full speed: half for a straight path, more where it bends
_REACH_SLACK_RAD = 0.02
_SLACK = 1e-3  # the running motion's own cubics may exceed the limits by rounding
_CHOICES = 17  # of the next pace

STOP_TIME_S = 0.2  #: time of the single point of a Kinova stop


@kernel
def _sample(t_s: float, first_time_s: float, dt_s: float, positions: Array, velocities: Array, q: Array, v: Array) -> None:
    """Write the motion's configuration and velocity at t_s to q, v (n,): cubics between the points, at rest outside."""
    last = positions.shape[0] - 1
    u = (t_s - first_time_s) / dt_s
    index = min(max(int(np.floor(u)), 0), last - 1)
    x = min(max(u - index, 0.0), 1.0)
    moving = 0.0 <= u <= last
    for j in range(q.shape[0]):
        p0, p1 = positions[index, j], positions[index + 1, j]
        v0, v1 = velocities[index, j] * dt_s, velocities[index + 1, j] * dt_s
        c2 = 3.0 * (p1 - p0) - 2.0 * v0 - v1
        c3 = 2.0 * (p0 - p1) + v0 + v1
        q[j] = p0 + x * (v0 + x * (c2 + x * c3))
        v[j] = (v0 + x * (2.0 * c2 + x * 3.0 * c3)) / dt_s if moving else 0.0


@kernel
def brake(
    begin_s: float,
    first_time_s: float,
    duration_s: float,
    dt_s: float,
    positions: Array,
    velocities: Array,
    limits: Array,
    out_positions: Array,
    out_velocities: Array,
) -> int:
    """Slow a motion's clock down to a stand as fast as the limits allow; see `braking`, whose loop this is: a stop must be on its way
    within milliseconds, whatever else runs.

    Args:
        begin_s: the motion's time at the first point [s].
        first_time_s: time of the motion's first point [s].
        duration_s: time of its last one [s].
        dt_s: its grid [s].
        positions: (K, n) [rad], K > 1.
        velocities: (K, n) [rad/s].
        limits: (n,) accelerations [rad/s²].
        out_positions: (R, n), filled; R is at least the points from `begin_s` to the end at the slowest allowed pace.
        out_velocities: (R, n), filled.

    Returns:
        How many rows were filled; the last velocity is zero. Fewer than needed to come to a stand if R was too small.
    """
    n = positions.shape[1]
    q, v = np.empty(n), np.empty(n)
    best_q, best_v = np.empty(n), np.empty(n)
    clock, pace = begin_s, 1.0
    _sample(clock, first_time_s, dt_s, positions, velocities, out_positions[0], out_velocities[0])
    rows = 1
    while pace > 0.0 and clock < duration_s and rows < out_positions.shape[0]:
        low, high = 0.0, pace
        chosen = clock
        for _ in range(2):  # coarse, then finer between the first pace allowed and the one below it
            low_s, high_s = low, high
            for choice in range(_CHOICES):
                tried = low_s + (high_s - low_s) * choice / (_CHOICES - 1)
                at = min(clock + 0.5 * dt_s * (pace + tried), duration_s)
                _sample(at, first_time_s, dt_s, positions, velocities, q, v)
                allowed = True
                for j in range(n):
                    speed = v[j] * tried
                    slope = (q[j] - out_positions[rows - 1, j]) / dt_s
                    before = out_velocities[rows - 1, j]
                    bound = limits[j] * (1.0 + _SLACK) * dt_s
                    if abs(6.0 * slope - 4.0 * before - 2.0 * speed) > bound or abs(2.0 * before + 4.0 * speed - 6.0 * slope) > bound:
                        allowed = False
                        break
                if allowed or choice == _CHOICES - 1:  # going on at the old pace is always allowed
                    low = low_s + (high_s - low_s) * max(choice - 1, 0) / (_CHOICES - 1)
                    high = tried
                    chosen = at
                    for j in range(n):
                        best_q[j], best_v[j] = q[j], v[j] * tried
                    break
        clock, pace = chosen, high
        copy_row(best_q, out_positions[rows])
        copy_row(best_v, out_velocities[rows])
        rows += 1
    for j in range(n):
        out_velocities[rows - 1, j] = 0.0
    return rows


def one_point_stop(joint_names: Sequence[str], q_measured: npt.ArrayLike) -> Trajectory:
    """Return the Kinova driver's stop: one point 0.2 s from now, the measured configuration, no velocity.

    Args:
        joint_names: the arm's n joints in the driver's order.
        q_measured: the configuration it reports [rad], (n,), turns kept.

    Raises:
        ProblemError: `q_measured` of the wrong shape or not finite.
    """
    q = np.asarray(q_measured, dtype=np.float64)
    if q.shape != (len(joint_names),) or not np.isfinite(q).all():
        raise ProblemError(f"q_measured must be {len(joint_names)} finite numbers, got {q.tolist()}")
    return Trajectory(tuple(joint_names), STOP_TIME_S, q[None, :], np.zeros((1, len(q))), first_time_s=STOP_TIME_S)


def blend_time_s(off_rad: npt.ArrayLike, acceleration_limits: npt.ArrayLike) -> float:
    """Return how long a controller needs to go over to a motion that it is off by so much, by about its acceleration limits [s].

    A cubic that takes up an offset e within h accelerates by 6 e / h² more at its ends.

    Args:
        off_rad: how far each joint may be from where it is taken to be, (n,) [rad].
        acceleration_limits: (n,) [rad/s²].
    """
    return float(np.sqrt(6.0 / _BLEND_SHARE * np.max(np.abs(off_rad) / np.asarray(acceleration_limits, dtype=np.float64))))


def braking(
    running: Trajectory,
    elapsed_s: float,
    acceleration_limits: npt.ArrayLike,
    *,
    lead_s: float = 0.0,
    pace: float = 1.0,
    off: Array | None = None,
) -> Trajectory:
    """Return the running motion slowed down to a stand as fast as the acceleration limits allow, along its own path.

    The motion's clock is what slows down, from now on. At every step it is slowed as much as the cubic between two points may be
    accelerated; not slowing it at all is always allowed, because the motion itself keeps the limits. The greedy choice is the shortest
    stop (the minimal-acceleration curve of time-optimal path following, Bobrow et al. 1985), but for the steps' length.

    Args:
        running: the motion being carried out.
        elapsed_s: how far on it the arm is [s].
        acceleration_limits: the arm's [rad/s²], (n,), unscaled: a stop may use all of them.
        lead_s: time of the first point [s], in whole steps of the motion and at least one; what lies before is left to the controller. A
            stop that takes no longer is one point at rest, so far ahead that the arm slows down evenly.
        pace: the arm's speed as a share of the motion's, 0 to 1.
        off: how far the arm is beside the path, (n,) [rad]: it brakes in parallel to it.

    Returns:
        A motion on the running one's grid whose last point is at rest. Its first point comes after `lead_s`.

    Raises:
        ProblemError: limits of the wrong shape or not above zero, or a lead, a pace or a time that is not finite or negative.
    """
    limits = np.asarray(acceleration_limits, dtype=np.float64)
    n = len(running.joint_names)
    if limits.shape != (n,) or not (limits > 0.0).all():
        raise ProblemError(f"acceleration_limits must be {n} numbers above 0, got {limits.tolist()}")
    if not all(np.isfinite(value) and value >= 0.0 for value in (lead_s, pace, elapsed_s)):
        raise ProblemError(f"elapsed_s, lead_s and pace must be finite and at least 0, got {elapsed_s}, {lead_s} and {pace}")
    dt_s, beside = running.dt_s, np.zeros(n) if off is None else off
    skipped = max(int(np.ceil(lead_s / dt_s - 1e-9)), 1)
    lead = skipped * dt_s
    begin = min(elapsed_s, running.duration_s)
    positions, velocities = _slowed_down(running, begin, pace, limits)
    if len(positions) <= skipped:
        place = running.sample(begin + 0.5 * pace * lead)
        return Trajectory(running.joint_names, dt_s, place[None] + beside, np.zeros((1, n)), first_time_s=lead)
    return Trajectory(running.joint_names, dt_s, positions[skipped:] + beside, velocities[skipped:], first_time_s=lead)


def _slowed_down(running: Trajectory, begin_s: float, pace: float, limits: Array) -> tuple[Array, Array]:
    """Return positions and velocities of the braking, from now on, on the running motion's grid."""
    dt_s, n = running.dt_s, len(running.joint_names)
    if len(running) == 1 or pace <= 0.0:
        return running.sample(begin_s)[None], np.zeros((1, n))
    first_s, duration_s, q, v = running.first_time_s, running.duration_s, running.positions, running.velocities
    if abs(pace - 1.0) > _SAME_PACE:  # the rest of the motion as the arm carries it out
        steps = max(int(np.ceil((duration_s - begin_s) / (pace * dt_s))), 1)
        moments = np.minimum(begin_s + pace * dt_s * np.arange(steps + 1), duration_s)
        q, v = running.sample(moments), pace * running.sample_velocity(moments)
        first_s, duration_s, begin_s = 0.0, steps * dt_s, 0.0
    # Every step that does not stand still moves the clock by half of the first, full pace at least once: twice the rest is plenty.
    rows = 2 * int(np.ceil((duration_s - begin_s) / dt_s)) + 1000
    positions, velocities = np.empty((rows, n)), np.empty((rows, n))
    filled = brake(begin_s, first_s, duration_s, dt_s, q, v, limits, positions, velocities)
    return positions[:filled], velocities[:filled]


def straight_stop(
    joint_names: Sequence[str], q: npt.ArrayLike, velocity: npt.ArrayLike, lower: npt.ArrayLike, upper: npt.ArrayLike, limits: npt.ArrayLike
) -> Trajectory:
    """Return one point at rest that a joint trajectory controller reaches by braking evenly: for an arm that left its path.

    Args:
        joint_names: the arm's n joints.
        q: where it is [rad], (n,).
        velocity: how fast it is [rad/s], (n,).
        lower: joint limits [rad], (n,), that it is not led beyond; an arm that is beyond them stays there.
        upper: the same.
        limits: acceleration limits [rad/s²], (n,).
    """
    here, speed = np.asarray(q, dtype=np.float64), np.asarray(velocity, dtype=np.float64)
    time_s = max(float(np.max(np.abs(speed) / np.asarray(limits, dtype=np.float64))), STOP_TIME_S)
    place = np.clip(here + 0.5 * time_s * speed, np.minimum(lower, here), np.maximum(upper, here))
    return Trajectory(tuple(joint_names), time_s, place[None], np.zeros((1, len(here))), first_time_s=time_s)


def braking_reach(speeds: npt.ArrayLike, acceleration_limits: npt.ArrayLike, lead_s: float) -> Array:
    """Bound how far a stop may take each joint from where it was measured, (n,) [rad].

    With v the speed of a joint and T the longest v / a of all joints, that is v · (lead + 0.6 T) and 0.02 rad: a joint alone would come to
    rest within v · T / 2, but all of them stay on their path together, and it bends.

    Args:
        speeds: of the joints, (n,) [rad/s]; see `speeds_ahead`.
        acceleration_limits: the arm's [rad/s²], (n,).
        lead_s: time until the arm brakes: the age of the measurement, and the message's way [s].
    """
    fastest = np.abs(np.asarray(speeds, dtype=np.float64))
    time_s = float((fastest / np.asarray(acceleration_limits, dtype=np.float64)).max())
    return np.asarray(fastest * (lead_s + _REACH * time_s) + _REACH_SLACK_RAD, dtype=np.float64)


def speeds_ahead(running: Trajectory, elapsed_s: float, acceleration_limits: npt.ArrayLike, lead_s: float) -> Array:
    """Return the largest speed of each joint in the part of a motion that a stop may still pass through, (n,) [rad/s].

    Args:
        running: the motion being carried out.
        elapsed_s: how far it is [s].
        acceleration_limits: the arm's [rad/s²], (n,).
        lead_s: see `braking_reach`.
    """
    speed = np.abs(running.velocities)
    horizon_s = lead_s + 2.0 * _REACH * float((speed.max(axis=0) / np.asarray(acceleration_limits, dtype=np.float64)).max())
    first, last = np.searchsorted(running.times(), (elapsed_s - running.dt_s, elapsed_s + horizon_s + running.dt_s))
    return np.asarray(speed[first : max(last, first + 1)].max(axis=0, initial=0.0), dtype=np.float64)


def warm_up() -> None:
    """Compile `braking`, so that the first stop is as quick as any."""
    braking(Trajectory(("joint",), 0.1, np.array([[0.0], [0.1]]), np.zeros((2, 1))), 0.0, [1.0])
