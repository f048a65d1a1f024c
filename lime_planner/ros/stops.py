"""The way to stop, by the controller that carries the motion out."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.motion.stop import braking, one_point_stop
from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros.execution import Motion

Array = npt.NDArray[np.float64]


def make_stop(robot: Any, motion: Motion | None, q: Array | None, on_path: bool) -> Trajectory | None:
    """Return what stops a motion.

    A joint trajectory controller is slowed down along the planned path: a hold at a state measured a moment ago would whip the arm
    back. Where the arm has left the path, or nothing is known of it, the hold is the better of the two.

    Args:
        robot: the model in use.
        motion: what runs, None for a motion that is not ours.
        q: the newest measured configuration (n,), None when there is none.
        on_path: whether the arm is where the plan has it, as far as is known.
    """
    if motion is None:
        return None if q is None or robot is None else one_point_stop(robot.joint_names, q)
    trajectory, elapsed_s = motion.trajectory, motion.elapsed_s()
    if motion.snapshot.node.controller == "jtc" and on_path:
        return braking(trajectory, elapsed_s, robot.acceleration_limits)
    return one_point_stop(trajectory.joint_names, trajectory.sample(elapsed_s) if q is None else q)
