"""Levenberg-Marquardt from many starts, compiled."""

from __future__ import annotations

import math

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array
from lime_planner.robot.kinematics import Chain, forward_kinematics, tool_jacobian, tool_pose

_LENGTH_M = 0.3  # position errors are divided by this, so that they weigh like angles on an arm of about a metre
_MAX_STEP_RAD = 1.0
_CONVERGED = 1e-13  # root of the sum of squared errors [rad, or 0.3 m]


@kernel
def pose_error(target: Array, pose: Array, error: Array) -> float:
    """Write position error / 0.3 m and rotation vector from `pose` to `target` (3, 4), base axes; return the sum of squares.

    The rotation vector is the logarithm of R_target R_poseᵀ, any axis of the two where the angle is π.
    """
    for r in range(3):
        error[r] = (target[r, 3] - pose[r, 3]) / _LENGTH_M
    e00 = target[0, 0] * pose[0, 0] + target[0, 1] * pose[0, 1] + target[0, 2] * pose[0, 2]
    e01 = target[0, 0] * pose[1, 0] + target[0, 1] * pose[1, 1] + target[0, 2] * pose[1, 2]
    e02 = target[0, 0] * pose[2, 0] + target[0, 1] * pose[2, 1] + target[0, 2] * pose[2, 2]
    e10 = target[1, 0] * pose[0, 0] + target[1, 1] * pose[0, 1] + target[1, 2] * pose[0, 2]
    e11 = target[1, 0] * pose[1, 0] + target[1, 1] * pose[1, 1] + target[1, 2] * pose[1, 2]
    e12 = target[1, 0] * pose[2, 0] + target[1, 1] * pose[2, 1] + target[1, 2] * pose[2, 2]
    e20 = target[2, 0] * pose[0, 0] + target[2, 1] * pose[0, 1] + target[2, 2] * pose[0, 2]
    e21 = target[2, 0] * pose[1, 0] + target[2, 1] * pose[1, 1] + target[2, 2] * pose[1, 2]
    e22 = target[2, 0] * pose[2, 0] + target[2, 1] * pose[2, 1] + target[2, 2] * pose[2, 2]
    x, y, z = 0.5 * (e21 - e12), 0.5 * (e02 - e20), 0.5 * (e10 - e01)
    sine, cosine = math.sqrt(x * x + y * y + z * z), 0.5 * (e00 + e11 + e22 - 1.0)
    if sine > 1e-7:
        scale = math.atan2(sine, cosine) / sine
    elif cosine > 0.0:
        scale = 1.0
    else:  # half a turn: the axis from the diagonal, signs do not matter
        x, y, z = math.sqrt(max(0.5 * (e00 + 1.0), 0.0)), math.sqrt(max(0.5 * (e11 + 1.0), 0.0)), math.sqrt(max(0.5 * (e22 + 1.0), 0.0))
        scale = math.pi
    error[3], error[4], error[5] = scale * x, scale * y, scale * z
    total = 0.0
    for r in range(6):
        total += error[r] * error[r]
    return total


@kernel
def _solve_damped(normal: Array, damping: float, gradient: Array, factor: Array, step: Array) -> bool:
    """Solve (normal + damping · I) step = gradient by Cholesky's factorisation; False if it breaks down."""
    n = gradient.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = normal[i, j]
            if i == j:
                total += damping
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(n):
        total = gradient[i]
        for k in range(i):
            total -= factor[i, k] * step[k]
        step[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * step[k]
        step[i] = total / factor[i, i]
    return True


@kernel
def solve_many(chain: Chain, target: Array, starts: Array, lower: Array, upper: Array, iterations: int, residuals: Array) -> None:
    """Solve from every start in place.

    Args:
        chain: the arm.
        target: T_base_tool, (3, 4).
        starts: (S, n), overwritten by where the iterations end [rad].
        lower: (n,) limits that every step is cut back to; -inf to ignore them.
        upper: (n,) likewise.
        iterations: at most this many steps for each start.
        residuals: written, (S, 2): position error [m] and rotation error [rad].
    """
    n = starts.shape[1]
    poses, tool, jacobian = np.empty((n + 1, 3, 4)), np.empty((3, 4)), np.empty((6, n))
    error, trial_error = np.empty(6), np.empty(6)
    normal, factor = np.empty((n, n)), np.empty((n, n))
    gradient, step, trial = np.empty(n), np.empty(n), np.empty(n)
    for s in range(starts.shape[0]):
        q = starts[s]
        forward_kinematics(chain, q, poses)
        tool_pose(chain, poses, tool)
        cost = pose_error(target, tool, error)
        damping = 1e-2
        fresh = True
        for _ in range(iterations):
            if cost < _CONVERGED * _CONVERGED or damping > 1e8:
                break
            if fresh:
                tool_jacobian(chain, poses, jacobian)
                for i in range(n):
                    for r in range(3):
                        jacobian[r, i] /= _LENGTH_M
                    gradient[i] = 0.0
                    for r in range(6):
                        gradient[i] += jacobian[r, i] * error[r]
                    for j in range(i + 1):
                        total = 0.0
                        for r in range(6):
                            total += jacobian[r, i] * jacobian[r, j]
                        normal[i, j] = total
            solved = _solve_damped(normal, damping, gradient, factor, step)
            if solved:
                longest = 0.0
                for i in range(n):
                    longest = max(longest, abs(step[i]))
                scale = min(1.0, _MAX_STEP_RAD / longest) if longest > 0.0 else 0.0
                for i in range(n):
                    trial[i] = min(max(q[i] + scale * step[i], lower[i]), upper[i])
                forward_kinematics(chain, trial, poses)
                tool_pose(chain, poses, tool)
                trial_cost = pose_error(target, tool, trial_error)
            if solved and trial_cost < cost:
                # A step that gains next to nothing far from a solution is a local minimum.
                stuck = trial_cost > 1e-6 and trial_cost > (1.0 - 1e-4) * cost
                for i in range(n):
                    q[i] = trial[i]
                for r in range(6):
                    error[r] = trial_error[r]
                cost = trial_cost
                damping = max(0.2 * damping, 1e-12)
                fresh = True
                if stuck:
                    break
            else:
                damping *= 8.0
                fresh = False
        residuals[s, 0] = _LENGTH_M * math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
        residuals[s, 1] = math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
