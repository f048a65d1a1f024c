"""From certified waypoints to a timed motion: smooth corners, joint limits, a uniform grid, and at rest at both ends.

The way of a path: waypoints that matter (`blend.thin`), a C2 curve within `corner_tolerance_rad` of them (`blend.BlendedPath`), the
fastest run within the limits (`profile.fastest`, toppra), and a moving average of that run over a few points of the grid. The last
step is what makes the points faithful to both controllers:

- the acceleration becomes continuous and starts and ends at 0, so that the cubic between two points (a joint trajectory controller's)
  has the acceleration of the motion, where a jump of it between two points would come out up to half again as large;
- the sum of the velocities times the grid (what the Kinova driver carries out) telescopes to the coordinate's end exactly, and
  to the goal's joint angles up to the corners' curvature, about 1e-5 rad.

What the average adds at corners is taken back by a lower speed there, found in a few rounds; what those leave, about two per cent, by
slowing the whole run until the cubics respect the limits. The run is slowed as well where the grid is too coarse for it: the cubics
must stay at the curve, and the sum must end at the goal.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import LimePlannerError, ProblemError
from lime_planner.core.types import Array, Int64
from lime_planner.motion.blend import BlendedPath, thin
from lime_planner.motion.trajectory import Trajectory

if TYPE_CHECKING:
    from lime_planner.motion.profile import Profile

SpeedScale = Callable[[Array], Array]

MINIMUM_DT_S = 0.01  #: the Kinova driver moves on by at most one point in 10 ms and overshoots with denser ones
LIMIT_SLACK = 1e-6  #: part by which the cubics may exceed a velocity or acceleration limit: rounding
HOLD_TOLERANCE_RAD = 1e-3  #: every joint's angle between the goal and the sum of velocities times the grid
_CUBIC_SHARE = 0.1  # of the tolerance: for the cubics' distance from the curve; the rest is the curve's
_WINDOW_S = 0.08  # of the moving average, in whole steps of the grid and at least three of them
_STILL_RAD = 1e-9  # waypoints closer than this are one
_CORNER_NODES = 8
_STRAIGHT_NODES = 100  # on the whole path's length
_CAPPED_NODES = 400  # the same where the speed is capped along the path
_ATTEMPTS = 60
_EASINGS = 6  # of the speed at corners, as long as each makes the motion shorter


def time_path(
    waypoints: npt.ArrayLike,
    velocity_limits: npt.ArrayLike,
    acceleration_limits: npt.ArrayLike,
    *,
    joint_names: Sequence[str],
    dt_s: float = 0.02,
    velocity_scaling: float = 1.0,
    acceleration_scaling: float = 1.0,
    corner_tolerance_rad: npt.ArrayLike = 0.01,
    speed_scale: SpeedScale | None = None,
) -> Trajectory:
    """Time a path.

    Args:
        waypoints: corners of the certified polyline in joint space, (M, n), M >= 1 [rad], turns kept.
        velocity_limits: largest |velocity| of every joint [rad/s], (n,), > 0.
        acceleration_limits: largest |acceleration| of every joint [rad/s²], (n,), > 0.
        joint_names: names of the n joints.
        dt_s: spacing of the points [s], at least 0.01.
        velocity_scaling: part of the velocity limits to use, in (0, 1].
        acceleration_scaling: part of the acceleration limits to use, in (0, 1].
        corner_tolerance_rad: largest distance in joint space (Euclidean, hence of any joint) between the motion and the polyline,
            either way [rad], > 0; one number, or one for each waypoint (M,): a part of the path between two waypoints has the
            smaller one of theirs.
        speed_scale: part of the velocity limits to use along the path, in (0, 1]: called with an array of lengths along the
            polyline from its start [rad] and returning an array of that shape. Kept at every length, not only at the waypoints.

    Returns:
        The motion: first and last point are the first and last waypoint, at rest. A path without length gives two equal points.

    Raises:
        ProblemError: an argument outside its range, or not finite; the text names it.
        LimePlannerError: no timing was found (a defect).
    """
    corners = np.array(waypoints, dtype=np.float64)
    names = tuple(joint_names)
    if corners.ndim != 2 or len(corners) < 1 or corners.shape[1] != len(names):
        raise ProblemError(f"waypoints must have shape (M >= 1, {len(names)} joints), got {corners.shape}")
    if not np.isfinite(corners).all():
        raise ProblemError(f"waypoint {int(np.argmin(np.isfinite(corners).all(axis=1)))} is not finite")
    if not (np.isfinite(dt_s) and dt_s >= MINIMUM_DT_S):
        raise ProblemError(f"dt_s must be at least {MINIMUM_DT_S} s, got {dt_s}")
    tolerances = np.array(corner_tolerance_rad, dtype=np.float64)
    if tolerances.shape not in ((), (len(corners),)) or not (np.isfinite(tolerances).all() and (tolerances > 0.0).all()):
        raise ProblemError(f"corner_tolerance_rad must be above 0, one number or one for each waypoint, got {tolerances.tolist()}")
    tolerances = np.broadcast_to(tolerances, len(corners))
    velocities = _limits("velocity", velocity_limits, velocity_scaling, names)
    accelerations = _limits("acceleration", acceleration_limits, acceleration_scaling, names)
    kept, deviations = _thin_parts(corners, tolerances)
    chosen = _apart(corners, kept)
    if len(chosen) < 2:
        still = np.stack([corners[0], corners[-1]])
        return Trajectory(names, dt_s, still, np.zeros_like(still))
    path = BlendedPath(corners[chosen], ((1.0 - _CUBIC_SHARE) * tolerances - deviations)[chosen])
    # The curve's coordinate is the length along the chosen waypoints; callers count along the given ones.
    scale = None if speed_scale is None else _along(speed_scale, _lengths(corners[chosen]), _lengths(corners)[chosen])
    ends = corners[0], corners[-1]
    return _Run(path, ends, names, dt_s, velocities, accelerations, _CUBIC_SHARE * float(tolerances.max()), scale).trajectory()


def _thin_parts(corners: Array, tolerances: Array) -> tuple[Int64, Array]:
    """Leave waypoints out within half their tolerance, each part of one tolerance by itself.

    Returns:
        The indices kept, and for every waypoint (M,) how far the parts that it belongs to deviate at most [rad].
    """
    between = np.minimum(tolerances[1:], tolerances[:-1])
    borders = [0, *(np.flatnonzero(np.diff(between)) + 1).tolist(), len(corners) - 1]
    kept: list[int] = [0]
    deviations = np.zeros(len(corners))
    for first, last in itertools.pairwise(borders):
        if last > first:
            part, deviation = thin(corners[first : last + 1], float(between[first]) / 2.0)
            kept += [first + int(i) for i in part[1:]]
            deviations[first : last + 1] = np.maximum(deviations[first : last + 1], deviation)
    # A corner between two parts turns within the smaller tolerance; its own waypoint is kept.
    for border in borders[1:-1]:
        deviations[border] = 0.0
    return np.array(kept, dtype=np.int64), deviations


def _limits(kind: str, limits: npt.ArrayLike, scaling: float, names: tuple[str, ...]) -> Array:
    values = np.array(limits, dtype=np.float64)
    if values.shape != (len(names),):
        raise ProblemError(f"{kind}_limits must have shape ({len(names)},), got {values.shape}")
    if not (np.isfinite(scaling) and 0.0 < scaling <= 1.0):
        raise ProblemError(f"{kind}_scaling must be above 0 and at most 1, got {scaling}")
    if not (np.isfinite(values).all() and (values > 0.0).all()):
        worst = int(np.argmin(np.where(np.isfinite(values), values, -np.inf)))
        raise ProblemError(f"the {kind} limit of {names[worst]} must be finite and above 0, got {values[worst]}")
    return values * scaling


def _lengths(corners: Array) -> Array:
    """Return every corner's length along its polyline [rad]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])


def _apart(corners: Array, kept: Int64) -> list[int]:
    """Return the indices of `kept` without those at the place of the one before; fewer than two where there is no motion."""
    chosen = [int(kept[0])]
    for index in kept[1:]:
        if np.linalg.norm(corners[index] - corners[chosen[-1]]) > _STILL_RAD:
            chosen.append(int(index))
    return chosen


def _along(speed_scale: SpeedScale, chosen_at: Array, given_at: Array) -> SpeedScale:
    def scale(p: Array) -> Array:
        values = np.asarray(speed_scale(np.interp(p, chosen_at, given_at)), dtype=np.float64)
        if values.shape != p.shape or not ((values > 0.0) & (values <= 1.0)).all():
            raise ProblemError("speed_scale must return one number above 0 and at most 1 for every length it is given")
        return values

    return scale


@dataclass(frozen=True)
class _Run:
    """One timing problem: the path and its limits."""

    path: BlendedPath
    ends: tuple[Array, Array]
    names: tuple[str, ...]
    dt_s: float
    velocities: Array
    accelerations: Array
    cubic_tolerance: float
    scale: SpeedScale | None

    @property
    def window_s(self) -> float:
        """Width of the moving average [s], whole steps of the grid."""
        return self.dt_s * max(3, round(_WINDOW_S / self.dt_s))

    def trajectory(self) -> Trajectory:
        """Time the path, lower its speed where the points would break a limit, and slow the whole by what is left of that."""
        from lime_planner.motion.profile import fastest  # toppra takes a second to import

        nodes = self._nodes()
        limits = self._speed_limits(nodes)
        profile = fastest(self.path, nodes, limits, self.accelerations)
        best = self._slowed(profile)
        for _ in range(_EASINGS):
            eased = self._eased(profile, nodes)
            if not np.isfinite(eased).any():
                break
            limits = np.minimum(limits, eased)
            profile = fastest(self.path, nodes, limits, self.accelerations)
            result = self._slowed(profile)
            if len(result) >= len(best):
                break
            best = result
        return best

    def _points(self, run: Profile, steps: int) -> tuple[Trajectory, Array]:
        """Return the points of a smoothed run, from rest to rest, and their coordinates (steps + 1,)."""
        coordinates, speeds = run.smoothed(self.dt_s * np.arange(steps + 1, dtype=np.float64), self.window_s)
        positions = self.path(coordinates)
        velocities = self.path(coordinates, 1) * speeds[:, None]
        positions[0], positions[-1] = self.ends
        velocities[0] = velocities[-1] = 0.0
        return Trajectory(self.names, self.dt_s, positions, velocities), coordinates

    def _eased(self, run: Profile, nodes: Array) -> Array:
        """Return the run's own speed at every node (N + 1,), lower where its points would break a limit, infinite elsewhere."""
        steps = int(np.ceil((run.times_s[-1] + self.window_s) / self.dt_s - 1e-9))
        result, coordinates = self._points(run, steps)
        # The points come late by half a window, and each is an average over a whole one.
        excess = self._excess(result, coordinates)
        early_s = self.dt_s * np.arange(steps, dtype=np.float64) - self.window_s
        factors = np.ones(len(nodes))
        for i in np.flatnonzero(excess > 1.0 + LIMIT_SLACK):
            near = (run.times_s >= early_s[i]) & (run.times_s <= early_s[i] + self.window_s + self.dt_s)
            factors[near] = np.maximum(factors[near], excess[i])
        return np.where(factors > 1.0, run.speeds / factors, np.inf)

    def _slowed(self, profile: Profile) -> Trajectory:
        """Slow a run until the points carry it out within the limits and tolerances."""
        run_s = float(profile.times_s[-1])
        wanted_s = run_s
        for attempt in range(_ATTEMPTS):
            steps = int(np.ceil((wanted_s + self.window_s) / self.dt_s - 1e-9))
            wanted_s = steps * self.dt_s - self.window_s
            slowed = profile.stretched(wanted_s / run_s)
            result, coordinates = self._points(slowed, steps)
            excess = max(float(self._excess(result, coordinates).max()), self._coarseness(result, slowed))
            if excess <= 1.0 + LIMIT_SLACK:
                return result
            # The average does not slow down quite as the run does; a little more each time ends that.
            wanted_s *= excess * (1.0 + 1e-4 * 2.0 ** min(attempt, 10))
        raise LimePlannerError(f"no timing of {self.path.length:.3g} rad keeps the limits; the last is {excess:.3f} times too fast")

    def _nodes(self) -> Array:
        """Coordinates where toppra imposes the limits."""
        spacing = self.path.length / (_STRAIGHT_NODES if self.scale is None else _CAPPED_NODES)
        counts = np.maximum(np.ceil(np.diff(self.path.knots) / spacing), np.where(self.path.is_corner, _CORNER_NODES, 4)).astype(np.int64)
        piece = np.repeat(np.arange(len(counts)), counts)
        part = (np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[piece]
        return np.append(self.path.knots[piece] + part * np.diff(self.path.knots)[piece], self.path.length)

    def _speed_limits(self, nodes: Array) -> Array:
        """Return the largest dp/dt at every node [rad/s]."""
        with np.errstate(divide="ignore"):
            limits = np.asarray((self.velocities / np.abs(self.path(nodes, 1))).min(axis=1), dtype=np.float64)
        if self.scale is None:
            return limits
        # A cap begins where it begins, not at the next node, and not half a window late because of the moving average: every
        # node takes the lowest cap between its neighbours and as far beyond as the arm comes in half a window at a capped speed.
        fine = np.linspace(0.0, self.path.length, 10 * _CAPPED_NODES + 1)
        caps = self.scale(fine)
        capped = caps < 1.0
        reach = 0.5 * self.window_s * float((caps * np.interp(fine, nodes, np.minimum(limits, 1e3)))[capped].max(initial=0.0))
        low = np.searchsorted(fine, np.concatenate([nodes[:1], nodes[:-1]]) - reach)
        high = np.searchsorted(fine, np.concatenate([nodes[1:], nodes[-1:]]) + reach, side="right")
        lowest = np.array([caps[max(i - 1, 0) : j + 1].min() for i, j in zip(low, high, strict=True)], dtype=np.float64)
        return np.asarray(limits * lowest, dtype=np.float64)

    def _excess(self, result: Trajectory, coordinates: Array) -> Array:
        """Return by what factor each interval (K - 1,) must be slowed so that its cubic respects the limits; at most 1 where it does."""
        speed = result.peak_velocities() / self.velocities
        if self.scale is not None:
            caps = self.scale(coordinates)
            speed = speed / np.maximum(caps[1:], caps[:-1])[:, None]
        start, end = result.end_accelerations()
        acceleration = np.maximum(np.abs(start), np.abs(end)) / self.accelerations
        return np.asarray(np.maximum(speed.max(axis=1), np.sqrt(acceleration.max(axis=1))), dtype=np.float64)

    def _coarseness(self, result: Trajectory, run: Profile) -> float:
        """Return the factor by which the run must be slowed for the grid to carry it; at most 1 when it does."""
        t_s = self.dt_s * np.arange(1, 4 * (len(result) - 1), dtype=np.float64) / 4.0
        coordinates, _ = run.smoothed(t_s, self.window_s)
        cubic = np.abs(result.sample(t_s) - self.path(coordinates)).max() / self.cubic_tolerance
        hold = np.abs(result.velocities.sum(axis=0) * self.dt_s - (result.positions[-1] - result.positions[0])).max() / HOLD_TOLERANCE_RAD
        worst = float(max(cubic, hold))
        # Neither error is a simple power of the speed once corners fall between two points: go in steps.
        return worst if worst <= 1.0 else min(1.02 * worst**0.25, 1.5)
