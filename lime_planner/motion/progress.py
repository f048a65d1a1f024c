"""How far on its plan an arm is, by what was measured: a controller may be late, or its clock slower than ours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lime_planner.motion.trajectory import Trajectory

Array = npt.NDArray[np.float64]

_STEP_S = 0.005  #: between two moments of the plan that are compared with the measurement
_MOST_MOMENTS = 400


def best_fit(trajectory: Trajectory, q: Array, elapsed_s: float, lag_s: float) -> tuple[float, Array]:
    """Find the moment among the last `lag_s` seconds of the plan that a measurement fits best.

    Args:
        trajectory: the plan.
        q: measured configuration, (n,) [rad], turns kept.
        elapsed_s: how long the plan had run at the measurement [s].
        lag_s: how far the arm may be late [s].

    Returns:
        The moment [s], and how far the arm is from where the plan has it then, (n,) [rad]: the largest of them is least there.
    """
    latest_s = max(elapsed_s, 0.0)
    earliest_s = max(latest_s - lag_s, 0.0)
    moments = np.linspace(earliest_s, latest_s, min(int(np.ceil((latest_s - earliest_s) / _STEP_S)) + 1, _MOST_MOMENTS))
    off = q - trajectory.sample(moments)
    best = int(np.abs(off).max(axis=1).argmin())
    return float(moments[best]), off[best]
