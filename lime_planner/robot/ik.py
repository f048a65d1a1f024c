"""Inverse kinematics: every way the arm can hold its tool at a pose.

Levenberg-Marquardt from random starts, joint limits ignored on the way: a six-joint arm has a finite set of solutions (at most 16),
each with a basin of several per cent of all starts, so that a few hundred starts find them all, and those that the limits forbid
tell an unreachable pose from one that is only out of limits.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from time import monotonic
from typing import Literal

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.jit import kernel
from lime_planner.core.types import Array, Int64
from lime_planner.robot.kinematics import Chain, forward_kinematics, tool_jacobian, tool_pose
from lime_planner.robot.model import Robot

LENGTH_M = 0.3  # position errors are divided by this, so that they weigh like angles on an arm of about a metre
_MAX_STEP_RAD = 1.0
_CONVERGED = 1e-13  # root of the sum of squared errors [rad, or 0.3 m]


@kernel
def pose_error(target: Array, pose: Array, error: Array) -> float:
    """Write position error / 0.3 m and rotation vector from `pose` to `target` (3, 4), base axes; return the sum of squares.

    The rotation vector is the logarithm of R_target R_poseᵀ, any axis of the two where the angle is π.
    """
    for r in range(3):
        error[r] = (target[r, 3] - pose[r, 3]) / LENGTH_M
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
def solve_damped(normal: Array, damping: float, gradient: Array, factor: Array, step: Array) -> bool:
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
                        jacobian[r, i] /= LENGTH_M
                    gradient[i] = 0.0
                    for r in range(6):
                        gradient[i] += jacobian[r, i] * error[r]
                    for j in range(i + 1):
                        total = 0.0
                        for r in range(6):
                            total += jacobian[r, i] * jacobian[r, j]
                        normal[i, j] = total
            solved = solve_damped(normal, damping, gradient, factor, step)
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
        residuals[s, 0] = LENGTH_M * math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
        residuals[s, 1] = math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)


TURN = 2.0 * np.pi
POSITION_TOLERANCE_M = 1e-5
ROTATION_TOLERANCE_RAD = 1e-5
DEFAULT_STARTS = 256  # the rarest branch of the built-in arms has 4 % of all starts: missed once in 30 000 poses
_SAME_RAD = 0.01  # solutions nearer than this in every joint, turns removed, are one
_ITERATIONS = 60
_CHUNK = 64  # starts between two looks at the clock: half a millisecond
_LIMIT_SLACK_RAD = 1e-7


@dataclass(frozen=True, eq=False)
class IkResult:
    """Configurations that hold the tool at a pose.

    Attributes:
        solutions: (K, n) within the limits and the window around the seed, nearest to the seed first [rad].
        branches: (K,) which distinct solution each is; those of one branch differ by whole turns.
        residuals: (K, 2) position error [m] and rotation error [rad].
        reason: None if there are solutions; `unreachable` if none was found even without joint limits; `limits` if all lie outside
            the limits or the window.
        detail: why there is none, in words; empty if there are.
        starts: number of starts used.
    """

    solutions: Array
    branches: Int64
    residuals: Array
    reason: Literal["unreachable", "limits"] | None
    detail: str
    starts: int


def solve_ik(
    robot: Robot,
    T_base_tool: npt.ArrayLike,
    q_seed: npt.ArrayLike,
    rng: np.random.Generator,
    *,
    max_solutions: int = 128,
    starts: int = DEFAULT_STARTS,
    time_s: float | None = None,
    windows: npt.ArrayLike = TURN,
) -> IkResult:
    """Find the configurations that hold the tool at a pose.

    Every solution appears with all whole turns of its joints that stay within the limits and the window, as a way of its own for
    the arm to go.

    Args:
        robot: the arm.
        T_base_tool: (4, 4) or (3, 4), the pose.
        q_seed: (n,), where the arm is: solutions are unwrapped from here [rad].
        rng: source of the random starts.
        max_solutions: only so many are returned, the nearest.
        starts: number of starts, the seed itself among them.
        time_s: stop earlier after this long, at least half a millisecond's starts done.
        windows: (n,) or one number: no joint is farther from the seed [rad].

    Returns:
        The solutions, or why there is none.

    Raises:
        ProblemError: an argument of the wrong shape, not finite, or not a pose.
    """
    target = _checked_pose(T_base_tool)
    seed = np.asarray(q_seed, dtype=np.float64)
    if seed.shape != (robot.n,) or not np.isfinite(seed).all():
        raise ProblemError(f"q_seed needs {robot.n} finite numbers, got {seed.tolist()}")
    window = np.broadcast_to(np.asarray(windows, dtype=np.float64), (robot.n,))
    if starts < 1 or max_solutions < 1 or not (window >= 0.0).all():
        raise ProblemError("starts and max_solutions must be at least 1, windows not negative")

    deadline = None if time_s is None else monotonic() + time_s
    free = np.full(robot.n, np.inf)
    found, used, nearest = _run(robot, target, seed, rng, -free, free, starts, deadline)
    reachable = len(found) > 0
    branches = [variants for q in found if len(variants := _variants(robot, q, seed, window))]
    # An arm with a joint to spare has solutions everywhere between the limits, too; there steps are cut back to them.
    bounded = not (np.isinf(robot.lower) & np.isinf(robot.upper)).all()
    if bounded and (robot.n > 6 or (reachable and not branches)):
        inside, more, _ = _run(robot, target, np.clip(seed, robot.lower, robot.upper), rng, robot.lower, robot.upper, starts, deadline)
        used += more
        branches += [variants for q in inside if len(variants := _variants(robot, q, seed, window))]
    if not branches:
        reason: Literal["unreachable", "limits"] = "limits" if reachable else "unreachable"
        detail = _limits_detail(robot, found, seed, window) if reachable else _miss_detail(nearest)
        empty = np.zeros((0, robot.n))
        return IkResult(empty, np.zeros(0, dtype=np.int64), np.zeros((0, 2)), reason, detail, used)
    solutions = np.concatenate(branches)
    owner = np.repeat(np.arange(len(branches)), [len(b) for b in branches])
    order = np.argsort(np.linalg.norm(solutions - seed, axis=1), kind="stable")[:max_solutions]
    solutions = np.ascontiguousarray(solutions[order])
    return IkResult(solutions, owner[order], _residuals(robot, target, solutions), None, "", used)


def _checked_pose(T_base_tool: npt.ArrayLike) -> Array:
    matrix = np.asarray(T_base_tool, dtype=np.float64)
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise ProblemError(f"T_base_tool needs the shape (4, 4) or (3, 4) and finite numbers, got shape {matrix.shape}")
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0.0:
        raise ProblemError("the upper left 3 x 3 of T_base_tool is not a rotation")
    return np.ascontiguousarray(matrix[:3])


def _run(
    robot: Robot, target: Array, seed: Array, rng: np.random.Generator, lower: Array, upper: Array, starts: int, deadline: float | None
) -> tuple[Array, int, Array]:
    """Solve from the seed and random starts; return distinct solutions (B, n), starts used, and the smallest residual (2,)."""
    low = np.where(np.isfinite(robot.lower), np.maximum(robot.lower, -TURN), -np.pi)
    high = np.where(np.isfinite(robot.upper), np.minimum(robot.upper, TURN), np.pi)
    ends, residuals = [], []
    used = 0
    while used < starts and (used == 0 or deadline is None or monotonic() < deadline):
        chunk = rng.uniform(low, high, (min(_CHUNK, starts - used), robot.n))
        if used == 0:
            chunk[0] = seed
        residual = np.empty((len(chunk), 2))
        solve_many(robot.chain, target, chunk, lower, upper, _ITERATIONS, residual)
        ends.append(chunk)
        residuals.append(residual)
        used += len(chunk)
    q, residual = np.concatenate(ends), np.concatenate(residuals)
    nearest = residual[np.argmin((residual[:, 0] / 0.3) ** 2 + residual[:, 1] ** 2)]
    solved = q[(residual[:, 0] < POSITION_TOLERANCE_M) & (residual[:, 1] < ROTATION_TOLERANCE_RAD)]
    return _distinct(solved), used, nearest


def _distinct(solved: Array) -> Array:
    """Keep one of every group of solutions that differ by less than 0.01 rad in every joint, turns removed; order kept."""
    kept = []
    while len(solved):
        kept.append(solved[0])
        apart = np.abs((solved - solved[0] + np.pi) % TURN - np.pi).max(axis=1)
        solved = solved[apart >= _SAME_RAD]
    return np.array(kept) if kept else solved


def _variants(robot: Robot, q: Array, seed: Array, window: Array) -> Array:
    """Return q with all whole turns of its joints within limits and window, (V, n); V may be 0."""
    choices = []
    for i in range(robot.n):
        low = max(robot.lower[i] - _LIMIT_SLACK_RAD, seed[i] - window[i] - 1e-9)
        high = min(robot.upper[i] + _LIMIT_SLACK_RAD, seed[i] + window[i] + 1e-9)
        turns = np.arange(np.ceil((low - q[i]) / TURN), np.floor((high - q[i]) / TURN) + 1.0)
        choices.append(np.clip(q[i] + TURN * turns, robot.lower[i], robot.upper[i]))
    return np.array(list(itertools.product(*choices))).reshape(-1, robot.n)


def _residuals(robot: Robot, target: Array, solutions: Array) -> Array:
    error = np.empty(6)
    residuals = np.empty((len(solutions), 2))
    for row, q in zip(residuals, solutions, strict=True):
        tool = robot.forward(q)[:3]
        pose_error(target, tool, error)
        row[:] = np.linalg.norm(target[:, 3] - tool[:, 3]), np.linalg.norm(error[3:])
    return residuals


def _miss_detail(nearest: Array) -> str:
    return f"the nearest that the arm gets to the pose is {nearest[0]:.3f} m and {nearest[1]:.2f} rad off"


def _limits_detail(robot: Robot, found: Array, seed: Array, window: Array) -> str:
    """Name the joint that stands in the way of the solution that is nearest to being allowed."""
    low, high = np.maximum(robot.lower, seed - window), np.minimum(robot.upper, seed + window)
    middle = 0.5 * (low + high)
    nearest = found + TURN * np.round((middle - found) / TURN)
    violation = np.maximum(np.maximum(low - nearest, nearest - high), 0.0)
    best = int(violation.sum(axis=1).argmin())
    joint = int(violation[best].argmax())
    return (
        f"{robot.joint_names[joint]} would have to be at {nearest[best, joint]:.3f} rad, outside "
        f"{low[joint]:.3f} to {high[joint]:.3f} rad, in the nearest of {len(found)} solutions"
    )
