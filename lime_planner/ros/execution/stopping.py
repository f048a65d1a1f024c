"""The way to stop, by the controller that carries the motion out."""

from __future__ import annotations

import time

import numpy as np

from lime_planner.core.types import Array
from lime_planner.motion.contract import stop_violations
from lime_planner.motion.stop import blend_time_s, braking, braking_reach, one_point_stop, speeds_ahead, straight_stop
from lime_planner.motion.trajectory import Trajectory
from lime_planner.robot.model import Robot
from lime_planner.ros.execution.motion import Motion
from lime_planner.ros.inputs.joint_states import ArmState

#: How well the time of a measurement, and of the stop's arrival at the controller, are known [s].
_TIME_ERROR_S = 0.02
#: How well positions are measured [rad], and the share of an offset from the path that may be along it.
_POSITION_ERROR_RAD, _OFF_SHARE = 0.001, 0.5
#: How long a stop takes to be carried out [s]: the arm is so much farther then, and rather a little less than farther than assumed.
_ON_THE_WAY_S = 0.01


def make_stop(robot: Robot | None, motion: Motion | None, state: ArmState | None, on_path: bool, controller: str) -> Trajectory | None:
    """Return what stops a motion.

    Kinova's driver gets a single point at rest. A joint trajectory controller is slowed down along the planned path, or in parallel to
    it, from where the arm is by what was measured and at the pace that was measured: not where the clock has it, for a controller that
    is slowed down would be whipped ahead. Where the arm has left the path, every joint brakes by itself.

    Args:
        robot: the model in use.
        motion: what runs, None for a motion that is not ours.
        state: what was measured last, None when there is nothing.
        on_path: whether the arm is where the plan has it, as far as is known.
        controller: what carries the motion out, `kinova` or a joint trajectory controller.
    """
    if robot is None or (motion is None and state is None):
        return None
    if motion is None:
        assert state is not None
        if controller == "kinova":
            return one_point_stop(robot.joint_names, state.q)
        return _off_path(robot, state, state.age_s(time.monotonic()) + _ON_THE_WAY_S)
    trajectory, limits = motion.trajectory, robot.acceleration_limits
    if state is None:
        elapsed_s = max(motion.elapsed_s(), 0.0)
        if controller == "kinova":
            return one_point_stop(trajectory.joint_names, trajectory.sample(elapsed_s))
        return braking(trajectory, elapsed_s, limits, lead_s=_blend_s(trajectory.sample_velocity(elapsed_s), limits))
    motion.follow(state)
    follower, late_s = motion.follower, state.age_s(time.monotonic()) + _ON_THE_WAY_S
    speeds = speeds_ahead(trajectory, follower.moment_s, limits, late_s)
    if controller == "kinova":
        stop = one_point_stop(trajectory.joint_names, state.q)
    elif on_path:
        # Not farther than its clock has it, unless the arm is seen to be.
        moment_s = min(follower.moment_s + follower.pace * late_s, max(*motion.clocks_s(), follower.moment_s) + _ON_THE_WAY_S)
        lead_s = _blend_s(follower.pace * trajectory.sample_velocity(moment_s), limits, follower.off)
        stop = braking(trajectory, moment_s, limits, lead_s=lead_s, pace=follower.pace, off=follower.off)
    else:
        stop = _off_path(robot, state, late_s)
        speeds = np.maximum(speeds, np.abs(_velocity(robot, state)))
    reach = braking_reach(speeds, limits, late_s + _TIME_ERROR_S) + np.abs(follower.off)
    if stop_violations(stop, q_measured=state.q, reach_rad=reach):
        return one_point_stop(robot.joint_names, state.q)  # a defect; where the arm was measured is the best that is known
    return stop


def _blend_s(velocity: Array, limits: Array, off: Array | None = None) -> float:
    beside = 0.0 if off is None else _OFF_SHARE * np.abs(off)
    return blend_time_s(np.abs(velocity) * _TIME_ERROR_S + _POSITION_ERROR_RAD + beside, limits)


def _velocity(robot: Robot, state: ArmState) -> Array:
    """Return how fast the arm is, as far as its limits allow: a glitch of one measurement must not make a stop go far."""
    if state.velocity is None:
        return np.zeros(len(robot.joint_names))
    return np.asarray(np.clip(state.velocity, -robot.velocity_limits, robot.velocity_limits), dtype=np.float64)


def _off_path(robot: Robot, state: ArmState, late_s: float) -> Trajectory:
    velocity = _velocity(robot, state)
    return straight_stop(robot.joint_names, state.q + velocity * late_s, velocity, robot.lower, robot.upper, robot.acceleration_limits)
