"""The way to stop, by the controller that carries the motion out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros.execution import Motion

Array = npt.NDArray[np.float64]

#: Time of the one point of a hold [s].
HOLD_S = 0.2


def hold(joint_names: tuple[str, ...], q: Array) -> Trajectory:
    """Return the one-point stop: the measured positions at rest."""
    return Trajectory(joint_names, HOLD_S, q[None, :], np.zeros((1, len(q))), HOLD_S)


def make_stop(robot: Callable[[], Any], motion: Motion | None, elapsed_s: float, q: Array | None) -> Trajectory | None:
    """Return what stops a motion.

    Args:
        robot: the model in use.
        motion: what runs, None for a motion that is not ours.
        elapsed_s: time since it was sent [s].
        q: the newest measured configuration (n,), None when there is none.
    """
    if motion is None:
        return None if q is None else hold(tuple(robot().joint_names), q)
    trajectory = motion.trajectory
    measured = trajectory.sample(elapsed_s) if q is None else q
    return hold(trajectory.joint_names, measured)
