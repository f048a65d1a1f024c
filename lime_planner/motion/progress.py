"""How far along its path an arm has come, by what was measured: a controller may be late, slowed down, or paused and resumed.

The path is followed, not the clock. Every measurement is compared with the part of the plan that can have been reached since the one
before, which keeps a path that passes a place twice apart from itself.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from lime_planner.core.types import Array
from lime_planner.motion.trajectory import Trajectory

_STEP_S = 0.005  #: between two moments of the plan that are compared with the measurement
_MOST_MOMENTS = 1000
_BACK_S = 0.1  # how far the moment that fits may fall back: measurements have noise, and a plan that begins slowly fits widely
_AHEAD = 2.0  # an arm that was late catches up at most at this pace
_AHEAD_S = 0.2  # more than it may fall back: a path that turns round fits on its way back as well at first
_PROGRESS_RAD = 0.002  # of any joint along the path: what counts as having moved on
_PACE_S = 0.25  # the pace is measured over this long


def best_fit(trajectory: Trajectory, q: Array, earliest_s: float, latest_s: float) -> tuple[float, Array]:
    """Find the moment of the plan that a measurement fits best, among those at which the arm may be.

    Args:
        trajectory: the plan.
        q: measured configuration, (n,) [rad], turns kept.
        earliest_s, latest_s: how far the arm may be, least and most [s]; cut off at the plan's ends.

    Returns:
        The moment [s], and how far the arm is from where the plan has it then, (n,) [rad]: shortest in joint space there.
    """
    first_s, last_s = (min(max(moment_s, 0.0), trajectory.duration_s) for moment_s in (earliest_s, latest_s))
    moments = np.linspace(first_s, last_s, min(int(np.ceil((last_s - first_s) / _STEP_S)) + 1, _MOST_MOMENTS))
    off = q - trajectory.sample(moments)
    best = int(np.einsum("ij,ij->i", off, off).argmin())
    velocity = trajectory.sample_velocity(moments[best])
    square = float(velocity @ velocity)
    if len(moments) == 1 or square < 1e-8:
        return float(moments[best]), off[best]
    step_s = float(moments[1] - moments[0])
    nearer_s = float(moments[best]) + min(max(float(off[best] @ velocity) / square, -step_s), step_s)
    nearer_s = min(max(nearer_s, first_s), last_s)
    return nearer_s, q - trajectory.sample(nearer_s)


class Follower:
    """Follows one motion, measurement by measurement.

    Attributes:
        moment_s: how far on its plan the arm was when it was measured last [s].
        off: how far each joint was from there, (n,) [rad].
        pace: speed along the path as a share of the planned one, 0 to 1: below it for a controller that is slowed down.
        moving_pace: the pace when the arm was seen to move on last.
        progressed_s: how long the motion ran when the arm was seen to move on last, by each of the caller's clocks [s].
        seen: the measurement that was taken in last, whatever the caller knows it by.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        """Begin at the plan's first point."""
        self._trajectory = trajectory
        self._track: deque[tuple[tuple[float, ...], float]] = deque()
        self._mark = trajectory.positions[0]
        self._latest_s = self._farthest_s = 0.0
        self.moment_s = 0.0
        self.off = np.zeros(len(trajectory.joint_names))
        self.pace = self.moving_pace = 1.0
        self.progressed_s: tuple[float, ...] = (0.0, 0.0)
        self.seen: object = None

    def update(self, q: Array, clocks_s: Sequence[float], latency_s: float = 0.0) -> None:
        """Take in a measurement.

        Args:
            q: measured configuration, (n,) [rad], on the plan's turns.
            clocks_s: how long the motion ran when that arrived, by each clock that its controller may go by [s].
            latency_s: how long it was on its way, as far as the clocks allow to tell [s]; counts for the pace alone.
        """
        latest_s = max(clocks_s)
        ahead_s = self._farthest_s + _AHEAD * max(latest_s - self._latest_s, 0.0) + _AHEAD_S
        self._latest_s = max(self._latest_s, latest_s)
        self.moment_s, self.off = best_fit(self._trajectory, q, self._farthest_s - _BACK_S, min(latest_s, ahead_s))
        self._farthest_s = max(self._farthest_s, self.moment_s)
        place = self._trajectory.sample(self.moment_s)
        measured_s = tuple(clock_s - latency_s for clock_s in clocks_s)
        self._track.append((measured_s, self.moment_s))
        while len(self._track) > 2 and self._track[1][0][0] <= measured_s[0] - _PACE_S:
            self._track.popleft()
        self.pace = self._pace()
        if float(np.abs(place - self._mark).max()) > _PROGRESS_RAD:
            self._mark, self.progressed_s, self.moving_pace = place, tuple(clocks_s), self.pace

    def _pace(self) -> float:
        (begins, first_s), (ends, last_s) = self._track[0], self._track[-1]
        if ends[0] - begins[0] < 0.5 * _PACE_S or len(begins) != len(ends):
            return self.pace
        # A simulation's controller goes by its own clock or by the real one: the pace nearest the planned one tells which.
        paces = [(last_s - first_s) / (end - begin) for begin, end in zip(begins, ends, strict=True) if end > begin]
        return min(max(min(paces, key=lambda pace: abs(pace - 1.0)), 0.0), 1.0) if paces else self.pace

    def remaining_rad(self) -> float:
        """Return how far the rest of the path leads from its end, the largest of any joint [rad]: 0 once only the end is left."""
        rest = self._trajectory.positions[self._trajectory.times() >= self.moment_s]
        return float(np.abs(rest - self._trajectory.positions[-1]).max(initial=0.0))
