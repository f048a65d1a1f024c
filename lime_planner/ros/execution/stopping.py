"""The way to stop, by the controller that carries the motion out."""

from __future__ import annotations

import math
import time

import numpy as np

from lime_planner.core.types import Array
from lime_planner.motion.contract import stop_violations
from lime_planner.motion.stop import braking, braking_reach, one_point_stop
from lime_planner.motion.trajectory import Trajectory
from lime_planner.robot.model import Robot
from lime_planner.ros.execution.motion import Motion
from lime_planner.ros.inputs.joint_states import ArmState

#: What is off the path is brought back at this share of the velocity limits, the motion along the path not counted.
_RETURN_SHARE = 0.5
#: Braking begins this late at most [s]; what cannot be brought back by then is held where it is.
_LONGEST_LEAD_S = 0.1


def make_stop(robot: Robot | None, motion: Motion | None, state: ArmState | None, on_path: bool) -> Trajectory | None:
    """Return what stops a motion.

    A joint trajectory controller is slowed down along the planned path: a hold at a state measured a moment ago would whip the arm
    back. Braking begins where the arm is by what was measured, not where the clock has it: a controller that is slowed down, or a
    simulation that does not keep up, would whip the arm ahead. Where the arm has left the path, a hold is the better of the two.

    Args:
        robot: the model in use; None while there is none.
        motion: what runs, None for a motion that is not ours.
        state: what was measured last, None when there is nothing.
        on_path: whether the arm is where the plan has it, as far as is known.
    """
    if motion is None:
        return None if state is None or robot is None else one_point_stop(robot.joint_names, state.q)
    stop = _stop_of(robot, motion, state, on_path)
    if state is None or robot is None:
        return stop
    fitting_s, off = motion.fit(state)
    lead_s = stop.first_time_s + state.age_s(time.monotonic())
    reach = np.abs(off) + braking_reach(motion.trajectory, fitting_s, robot.acceleration_limits, lead_s)
    if stop_violations(stop, q_measured=state.q, reach_rad=reach):  # a defect; where the arm was is the best that is known
        return one_point_stop(robot.joint_names, state.q)
    return stop


def _stop_of(robot: Robot | None, motion: Motion, state: ArmState | None, on_path: bool) -> Trajectory:
    trajectory, elapsed_s = motion.trajectory, motion.elapsed_s()
    if robot is None or motion.snapshot.node.controller != "jtc" or not on_path:
        return one_point_stop(trajectory.joint_names, trajectory.sample(elapsed_s) if state is None else state.q)
    if state is None:
        return braking(trajectory, max(elapsed_s, 0.0), robot.acceleration_limits)
    fitting_s, off = motion.fit(state)
    reached_s = max(min(fitting_s + state.age_s(time.monotonic()), motion.span_s()[1]), 0.0)
    lead_s = _lead_s(np.abs(off), robot.velocity_limits, trajectory.dt_s)
    if lead_s > _LONGEST_LEAD_S:
        moved = trajectory.sample(reached_s) - trajectory.sample(fitting_s)  # since the measurement
        return one_point_stop(trajectory.joint_names, state.q + moved)
    return braking(trajectory, reached_s, robot.acceleration_limits, lead_s=lead_s)


def _lead_s(off: Array, velocity_limits: Array, dt_s: float) -> float:
    """Return how long it takes to bring the arm back to the path [s], in whole steps of the plan."""
    return dt_s * max(math.ceil(float((off / (_RETURN_SHARE * velocity_limits)).max()) / dt_s), 1)
