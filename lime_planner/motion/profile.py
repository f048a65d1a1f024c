"""The fastest run of a smooth path within joint limits, by toppra (Pham and Pham 2018).

Import it only where it is used: toppra takes a good part of a second to import.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import LimePlannerError
from lime_planner.core.types import Array
from lime_planner.motion.blend import BlendedPath


@contextlib.contextmanager
def _without_plots() -> Iterator[None]:
    """Spare the import of Matplotlib, half of toppra's own, which it needs for one debugging plot that is never drawn here.

    Not where other threads might import it meanwhile.
    """
    names = ("matplotlib", "matplotlib.pyplot")
    if any(name in sys.modules for name in names) or threading.active_count() > 1:
        yield
        return
    sys.modules.update({name: ModuleType(name) for name in names})
    sys.modules[names[0]].pyplot = sys.modules[names[1]]  # type: ignore[attr-defined]
    try:
        yield
    finally:
        for name in names:
            del sys.modules[name]


with _without_plots():
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint

# It reports every numerical retry as a warning; what matters of that is checked on its result below.
logging.getLogger("toppra").setLevel(logging.CRITICAL)

_LARGEST_SPEED = 1e3  # in the scaled units below, where 1 is ordinary; keeps short moves' never binding limits within the solver's range


@dataclass(frozen=True)
class Profile:
    """Coordinate of the path over time: constant acceleration between the nodes, at rest before the first and after the last.

    Attributes:
        times_s: time of every node [s], (N + 1,), from 0.
        coordinates: path coordinate [rad], (N + 1,).
        speeds: [rad/s], (N + 1,).
    """

    times_s: Array
    coordinates: Array
    speeds: Array

    def stretched(self, factor: float) -> Profile:
        """Return the same run, `factor` times slower."""
        return Profile(self.times_s * factor, self.coordinates, self.speeds / factor)

    def smoothed(self, t_s: Array, window_s: float) -> tuple[Array, Array]:
        """Return coordinate and speed at the times t_s of this run's moving average over `window_s`, begun when the window touches it.

        The average begins at t = 0 and ends `window_s` after the run; its acceleration is continuous and 0 at both ends.
        """
        late, late_sum = self._run_and_integral(t_s)
        early, early_sum = self._run_and_integral(t_s - window_s)
        return (late_sum - early_sum) / window_s, (late - early) / window_s

    def _run_and_integral(self, t_s: Array) -> tuple[Array, Array]:
        durations = np.diff(self.times_s)
        rates = np.diff(self.speeds) / durations
        areas = durations * (self.coordinates[:-1] + durations * (self.speeds[:-1] / 2.0 + durations * rates / 6.0))
        sums = np.concatenate([[0.0], np.cumsum(areas)])
        t = np.clip(t_s, 0.0, self.times_s[-1])
        i = np.clip(np.searchsorted(self.times_s, t, side="right") - 1, 0, len(durations) - 1)
        x = t - self.times_s[i]
        run = self.coordinates[i] + x * (self.speeds[i] + x * rates[i] / 2.0)
        integral = sums[i] + x * (self.coordinates[i] + x * (self.speeds[i] / 2.0 + x * rates[i] / 6.0))
        return run, integral + np.maximum(t_s - self.times_s[-1], 0.0) * self.coordinates[-1]


class _SpeedLimit(LinearConstraint):
    """A limit of the path's own speed at every node, which joint velocity limits and speed caps both come to."""

    def __init__(self, limits: Array, dof: int) -> None:
        super().__init__()
        self.dof = dof
        self._limits = limits

    def compute_constraint_params(self, path: object, gridpoints: Array, *args: object, **kwargs: object) -> tuple[Array | None, ...]:
        squares = np.minimum(self._limits, _LARGEST_SPEED) ** 2
        return None, None, None, None, None, None, np.stack([np.zeros_like(squares), squares], axis=1)


class _Scaled:
    """The path with its length as the unit of angle, so that a move of a microradian is solved as well as one of ten radians."""

    def __init__(self, path: BlendedPath) -> None:
        self.dof = path.dof
        self.path_interval = np.array([0.0, 1.0])
        self._path = path

    def __call__(self, x: npt.ArrayLike, order: int = 0) -> Array:
        length = self._path.length
        return np.asarray(self._path(np.asarray(x) * length, order) * length ** (order - 1), dtype=np.float64)


def fastest(path: BlendedPath, nodes: Array, speed_limits: Array, acceleration_limits: Array) -> Profile:
    """Time the path.

    Args:
        path: the path.
        nodes: its coordinates at which the limits are imposed, ascending, both ends included, (N + 1,) [rad].
        speed_limits: largest dp/dt at every node [rad/s], (N + 1,), inf where there is none.
        acceleration_limits: largest |acceleration| of every joint [rad/s²], (n,).

    Raises:
        LimePlannerError: the solver found no timing, which limits above zero and a start and an end at rest always have.
    """
    unit_s = float(np.sqrt(path.length / acceleration_limits.min()))
    scaled_nodes = nodes / path.length
    scaled_nodes[-1] = 1.0
    limits = acceleration_limits * unit_s**2 / path.length
    with np.errstate(invalid="ignore", divide="ignore"):
        constraints = [
            _SpeedLimit(speed_limits * unit_s / path.length, path.dof),
            JointAccelerationConstraint(np.stack([-limits, limits], axis=1), discretization_scheme=DiscretizationType.Interpolation),
        ]
        instance = TOPPRA(constraints, _Scaled(path), gridpoints=scaled_nodes, solver_wrapper="seidel")
        _, speeds, _ = instance.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.isfinite(speeds).all():
        raise LimePlannerError(f"toppra found no timing of a path of {path.length:.3g} rad with {len(nodes)} nodes")
    speeds = np.maximum(np.asarray(speeds, dtype=np.float64), 0.0)
    speeds[0] = speeds[-1] = 0.0
    sums = speeds[1:] + speeds[:-1]
    steps = np.diff(scaled_nodes)
    if not (sums > 0.0).all():
        raise LimePlannerError(f"toppra's timing of a path of {path.length:.3g} rad stands still inside it")
    times_s = np.concatenate([[0.0], np.cumsum(2.0 * steps / sums)]) * unit_s
    return Profile(times_s, nodes, speeds * path.length / unit_s)
