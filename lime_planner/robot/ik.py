"""Inverse kinematics: every way the arm can hold its tool at a pose.

Levenberg-Marquardt from random starts, joint limits ignored on the way: a six-joint arm has a finite set of solutions (at most 16),
each with a basin of several per cent of all starts, so that a few hundred starts find them all, and those that the limits forbid
tell an unreachable pose from one that is only out of limits.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from time import monotonic
from typing import Literal

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array, Int64
from lime_planner.robot.ik_kernels import pose_error, solve_many
from lime_planner.robot.model import Robot

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
