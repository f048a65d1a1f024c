"""The loop of `lime_planner.motion.stop.braking`, compiled: a stop must be on its way within milliseconds, whatever else runs."""

from __future__ import annotations

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array

_SLACK = 1e-3  # the running motion's own cubics may exceed the limits by rounding
_CHOICES = 17  # of the next pace


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
    """Slow a motion's clock down to a stand as fast as the limits allow; see `lime_planner.motion.stop.braking`.

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
                    best_q[:] = q
                    best_v[:] = v * tried
                    break
        clock, pace = chosen, high
        out_positions[rows] = best_q
        out_velocities[rows] = best_v
        rows += 1
    out_velocities[rows - 1] = 0.0
    return rows
