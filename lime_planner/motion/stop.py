"""How a motion is stopped, by the controller that plays it.

The Kinova driver halts at once on a single point of zero velocity (and forgets the point index it would otherwise keep). A joint
trajectory controller would be whipped back by a hold at a state measured a tenth of a second ago, so it is sent the rest of the
running motion, slowed down to a stand: the arm never leaves its path.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array
from lime_planner.motion.braking_kernel import brake
from lime_planner.motion.trajectory import Trajectory

_REACH = 0.6  # of the time to brake from full speed: half for a straight path, more where it bends
_REACH_SLACK_RAD = 0.02

STOP_TIME_S = 0.2  #: time of the single point of a Kinova stop


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


def braking(running: Trajectory, elapsed_s: float, acceleration_limits: npt.ArrayLike, *, lead_s: float | None = None) -> Trajectory:
    """Return the running motion slowed down to a stand as fast as the acceleration limits allow, along its own path.

    The motion's clock is what slows down. At every step it is slowed as much as the cubic between two points may be accelerated;
    not slowing it at all is always allowed, because the motion itself keeps the limits. The greedy choice is the shortest stop
    (the minimal-acceleration curve of time-optimal path following, Bobrow et al. 1985), but for the steps' length.

    Args:
        running: the motion being carried out.
        elapsed_s: how long ago it was begun [s].
        acceleration_limits: the arm's [rad/s²], (n,), unscaled: a stop may use all of them.
        lead_s: time of the first point [s], when the arm will still be on the running motion; its dt_s by default. The controller
            goes there from wherever it is when the message arrives.

    Returns:
        A motion on the running one's grid whose last point is at rest. Its first point, moving, comes after `lead_s`.

    Raises:
        ProblemError: limits of the wrong shape or not above zero, or a lead or a time that is not finite or negative.
    """
    limits = np.asarray(acceleration_limits, dtype=np.float64)
    n = len(running.joint_names)
    if limits.shape != (n,) or not (limits > 0.0).all():
        raise ProblemError(f"acceleration_limits must be {n} numbers above 0, got {limits.tolist()}")
    dt_s = running.dt_s
    lead = dt_s if lead_s is None else float(lead_s)
    if not (np.isfinite(lead) and lead >= 0.0 and np.isfinite(elapsed_s) and elapsed_s >= 0.0):
        raise ProblemError(f"elapsed_s and lead_s must be finite and at least 0, got {elapsed_s} and {lead}")
    begin = min(elapsed_s + lead, running.duration_s)
    if len(running) == 1:
        return Trajectory(running.joint_names, dt_s, running.positions, np.zeros((1, n)), first_time_s=lead)
    # Every step that does not stand still moves the clock by half of the first, full pace at least once: twice the rest is plenty.
    rows = 2 * int(np.ceil((running.duration_s - begin) / dt_s)) + 1000
    positions, velocities = np.empty((rows, n)), np.empty((rows, n))
    filled = brake(
        begin, running.first_time_s, running.duration_s, dt_s, running.positions, running.velocities, limits, positions, velocities
    )
    return Trajectory(running.joint_names, dt_s, positions[:filled], velocities[:filled], first_time_s=lead)


def braking_reach(running: Trajectory, elapsed_s: float, acceleration_limits: npt.ArrayLike, lead_s: float) -> Array:
    """Bound how far a stop of a motion may take each joint from where it is, (n,) [rad].

    With v the largest speed of a joint in the motion's next T seconds and T the longest v / a of all joints, that is
    v · (lead + 0.6 T) and 0.02 rad: a joint alone would come to rest within v · T / 2, but all of them stay on their path together.

    Args:
        running: the motion being carried out.
        elapsed_s: how far it is [s].
        acceleration_limits: the arm's [rad/s²], (n,).
        lead_s: time until the braking begins, and the age of what is known of the arm [s].
    """
    limits = np.asarray(acceleration_limits, dtype=np.float64)
    speed = np.abs(running.velocities)
    horizon_s = lead_s + float((speed.max(axis=0) / limits).max())
    first, last = np.searchsorted(running.times(), (elapsed_s - running.dt_s, elapsed_s + horizon_s + running.dt_s))
    fastest = speed[first : max(last, first + 1)].max(axis=0, initial=0.0)
    return np.asarray(fastest * (lead_s + _REACH * float((fastest / limits).max())) + _REACH_SLACK_RAD, dtype=np.float64)


def warm_up() -> None:
    """Compile `braking`, so that the first stop is as quick as any."""
    braking(Trajectory(("joint",), 0.1, np.array([[0.0], [0.1]]), np.zeros((2, 1))), 0.0, [1.0])
