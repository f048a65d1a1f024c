"""A timed motion on a uniform grid, as arrays: what is sent to the arm, replayed, checked and drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array


@dataclass(frozen=True)
class Trajectory:
    """Positions and velocities of the arm's joints at uniformly spaced times; immutable.

    Between the points the motion is the cubic of both ends' positions and velocities, which is how a ROS 2 joint trajectory
    controller plays it. The constructor checks shapes only: whether the numbers may be sent is for `lime_planner.motion.contract`.

    Attributes:
        joint_names: names of the n joints, in the driver's order.
        dt_s: spacing of the points [s], > 0.
        positions: joint angles [rad], (K, n), K >= 1, on the branch the arm measures (no turns removed).
        velocities: joint velocities [rad/s], (K, n).
        first_time_s: time of the first point after the start [s]: 0 for a planned motion, later for a stop, whose first point the
            arm is only to reach.
    """

    joint_names: tuple[str, ...]
    dt_s: float
    positions: Array
    velocities: Array
    first_time_s: float = 0.0

    def __post_init__(self) -> None:
        """Copy the arrays, make them read-only, and check the shapes.

        Raises:
            ProblemError: shapes that do not belong together, no point at all, or a spacing that is not positive.
        """
        names = tuple(str(name) for name in self.joint_names)
        for field in ("positions", "velocities"):
            array = np.array(getattr(self, field), dtype=np.float64)
            if array.ndim != 2 or array.shape[0] < 1 or array.shape[1] != len(names):
                raise ProblemError(f"a trajectory's {field} must have shape (points >= 1, {len(names)} joints), got {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        if self.positions.shape != self.velocities.shape:
            raise ProblemError(f"a trajectory has {len(self.positions)} positions and {len(self.velocities)} velocities")
        if not (np.isfinite(self.dt_s) and self.dt_s > 0.0):
            raise ProblemError(f"a trajectory's dt_s must be above 0, got {self.dt_s}")
        if not (np.isfinite(self.first_time_s) and self.first_time_s >= 0.0):
            raise ProblemError(f"a trajectory's first_time_s must be 0 or more, got {self.first_time_s}")
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "dt_s", float(self.dt_s))
        object.__setattr__(self, "first_time_s", float(self.first_time_s))

    def __len__(self) -> int:
        """Return the number of points K."""
        return len(self.positions)

    @classmethod
    def from_samples(
        cls, joint_names: tuple[str, ...] | list[str], times_s: npt.ArrayLike, positions: npt.ArrayLike, velocities: npt.ArrayLike
    ) -> Trajectory:
        """Build a trajectory from points with times, as a message or a file holds them.

        Args:
            joint_names: names of the n joints.
            times_s: time of each point after the start [s], (K,), uniformly spaced to a microsecond.
            positions: [rad], (K, n).
            velocities: [rad/s], (K, n).

        Raises:
            ProblemError: times that are not uniformly spaced, or arrays that do not belong together.
        """
        times = np.asarray(times_s, dtype=np.float64)
        if times.ndim != 1 or len(times) < 1 or not np.isfinite(times).all():
            raise ProblemError(f"a trajectory's times must be finite, one a point, got shape {times.shape}")
        dt_s = float(times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else float(max(times[0], 1e-3))
        uneven = np.abs(np.diff(times) - dt_s) > 1e-6
        if uneven.any():
            first = int(np.argmax(uneven))
            raise ProblemError(
                f"a trajectory's points must be uniformly spaced; points {first} and {first + 1} are "
                f"{times[first + 1] - times[first]:.6f} s apart, {dt_s:.6f} s on average"
            )
        return cls(tuple(joint_names), dt_s, np.asarray(positions), np.asarray(velocities), float(times[0]))

    def then(self, other: Trajectory) -> Trajectory:
        """Return this motion followed at once by another one, which begins where this one rests.

        Raises:
            ProblemError: other joints, another spacing, or another place than this one's end.
        """
        if other.joint_names != self.joint_names or other.dt_s != self.dt_s or other.first_time_s != 0.0:
            raise ProblemError("motions are joined that have the same joints and spacing, the second from time 0 on")
        if not np.array_equal(self.positions[-1], other.positions[0]) or self.velocities[-1].any() or other.velocities[0].any():
            raise ProblemError("a motion is joined to one that ends, at rest, where it begins")
        positions = np.vstack([self.positions, other.positions[1:]])
        velocities = np.vstack([self.velocities, other.velocities[1:]])
        return Trajectory(self.joint_names, self.dt_s, positions, velocities, self.first_time_s)

    @property
    def duration_s(self) -> float:
        """Time of the last point after the start [s]."""
        return self.first_time_s + self.dt_s * (len(self.positions) - 1)

    def times(self) -> Array:
        """Return the time of every point after the start [s], (K,)."""
        return np.asarray(self.first_time_s + self.dt_s * np.arange(len(self.positions)), dtype=np.float64)

    def sample(self, t_s: npt.ArrayLike) -> Array:
        """Return the configuration at the times t_s [rad]: (n,) for one time, (R, n) for R of them.

        Cubic between the points, constant before the first and after the last.
        """
        return self._evaluate(t_s, derivative=False)

    def sample_velocity(self, t_s: npt.ArrayLike) -> Array:
        """Return the velocity at the times t_s [rad/s], of the same cubics as `sample`; zero outside the motion."""
        return self._evaluate(t_s, derivative=True)

    def _evaluate(self, t_s: npt.ArrayLike, *, derivative: bool) -> Array:
        t = np.asarray(t_s, dtype=np.float64)
        last = len(self.positions) - 1
        u = (t.reshape(-1) - self.first_time_s) / self.dt_s
        if last == 0:
            value = np.zeros_like(self.positions[0]) if derivative else self.positions[0]
            return np.broadcast_to(value, (*t.shape, len(value))).copy()
        index = np.clip(np.floor(u), 0, last - 1).astype(np.int64)
        x = np.clip(u - index, 0.0, 1.0)[:, None]
        p0, p1 = self.positions[index], self.positions[index + 1]
        v0, v1 = self.velocities[index] * self.dt_s, self.velocities[index + 1] * self.dt_s
        c2 = 3.0 * (p1 - p0) - 2.0 * v0 - v1
        c3 = 2.0 * (p0 - p1) + v0 + v1
        if derivative:
            inside = ((u >= 0.0) & (u <= last))[:, None]
            result = np.where(inside, (v0 + x * (2.0 * c2 + x * 3.0 * c3)) / self.dt_s, 0.0)
        else:
            result = p0 + x * (v0 + x * (c2 + x * c3))
        return result.reshape(*t.shape, self.positions.shape[1])

    def peak_velocities(self) -> Array:
        """Return the largest |velocity| of every joint's cubic over every interval [rad/s], (K - 1, n)."""
        h = self.dt_s
        v0, v1 = self.velocities[:-1], self.velocities[1:]
        start, end = self.end_accelerations()
        peak = np.maximum(np.abs(v0), np.abs(v1))
        # The velocity is a parabola in time; its top lies inside where the acceleration changes sign.
        inside = start * end < 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            top = np.abs(v0 + 0.5 * h * start * start / (start - end))
        return np.where(inside, np.maximum(peak, top), peak)

    def end_accelerations(self) -> tuple[Array, Array]:
        """Return the accelerations of the cubics at both ends of every interval [rad/s²], two of (K - 1, n).

        They are the extremes: a cubic's acceleration is linear in time.
        """
        h = self.dt_s
        slope = np.diff(self.positions, axis=0) / h
        v0, v1 = self.velocities[:-1], self.velocities[1:]
        return (6.0 * slope - 4.0 * v0 - 2.0 * v1) / h, (2.0 * v0 + 4.0 * v1 - 6.0 * slope) / h

    def configurations(self, step_rad: float, from_time_s: float = 0.0) -> Array:
        """Return configurations along the cubics, never more than `step_rad` apart in any joint, (R, n): for checks in space.

        Args:
            step_rad: largest change of one joint between neighbours [rad], > 0.
            from_time_s: those from this time on [s]; none of them are left after the end.

        Raises:
            ProblemError: `step_rad` is not positive.
        """
        if not step_rad > 0.0:
            raise ProblemError(f"step_rad must be above 0, got {step_rad}")
        if len(self.positions) == 1:
            return self.positions[: int(self.first_time_s >= from_time_s)].copy()
        parts = np.maximum(np.ceil(self.peak_velocities().max(axis=1) * self.dt_s / step_rad), 1.0).astype(np.int64)
        starts = np.repeat(np.arange(len(parts)), parts)
        offsets = np.arange(len(starts)) - np.repeat(np.cumsum(parts) - parts, parts)
        u = starts + offsets / parts[starts]
        times_s = np.append(self.first_time_s + self.dt_s * u, self.duration_s)
        return self.sample(times_s[times_s >= from_time_s])
