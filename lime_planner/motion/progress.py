"""How far on its plan an arm is, by what was measured: a controller may be late, or its clock slower than ours."""

from __future__ import annotations

import numpy as np

from lime_planner.core.types import Array
from lime_planner.motion.trajectory import Trajectory

_STEP_S = 0.005  #: between two moments of the plan that are compared with the measurement
_MOST_MOMENTS = 1000


def best_fit(trajectory: Trajectory, q: Array, earliest_s: float, latest_s: float) -> tuple[float, Array]:
    """Find the moment of the plan that a measurement fits best, among those at which the arm may be.

    Args:
        trajectory: the plan.
        q: measured configuration, (n,) [rad], turns kept.
        earliest_s, latest_s: how far the arm may be, least and most [s]; cut off at the plan's ends.

    Returns:
        The moment [s], and how far the arm is from where the plan has it then, (n,) [rad]: the largest of them is least there.
    """
    first_s, last_s = (min(max(moment_s, 0.0), trajectory.duration_s) for moment_s in (earliest_s, latest_s))
    moments = np.linspace(first_s, last_s, min(int(np.ceil((last_s - first_s) / _STEP_S)) + 1, _MOST_MOMENTS))
    off = q - trajectory.sample(moments)
    best = int(np.abs(off).max(axis=1).argmin())
    return float(moments[best]), off[best]
