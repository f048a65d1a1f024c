"""Paths that exist already: following them, checking them again, and watching them while they are carried out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.errors import ProblemError, Refusal
from lime_planner.core.parameters import Settings
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.core.validation import floats
from lime_planner.motion.contract import POSITION_TOLERANCE_RAD
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.certify import CERTIFIED_STEP_RAD, contract_violations, hit_of, timed_motion
from lime_planner.pipeline.context import Clock, never
from lime_planner.pipeline.figures import path_figures, sample_path
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.result import PlanResult


def follow(
    obstacles: Callable[[], Obstacles],
    waypoints: npt.ArrayLike,
    settings: Settings,
    should_stop: Callable[[], bool] = never,
    straight: slice | None = None,
) -> PlanResult:
    """Make a motion along given waypoints; see `Pipeline.follow`.

    Args:
        obstacles: makes the obstacles, which takes time.
        waypoints: (M, n) [rad], M at least 2.
        settings: limits and radii; should_stop: cancels.
        straight: the waypoints along which the tool keeps to a straight line.

    Raises:
        ProblemError: `waypoints` is no such array, or not finite.
    """
    clock = Clock()
    path = floats("a path", waypoints)
    if path.ndim != 2 or len(path) < 2 or not np.isfinite(path).all():
        raise ProblemError(f"a path needs at least 2 finite waypoints, got an array of shape {path.shape}")
    figures: dict[str, Any] = {}
    try:
        world = obstacles()
        if path.shape[1] != world.robot.n:
            raise ProblemError(f"a path's waypoints need {world.robot.n} joint angles each, got {path.shape[1]}")
        beyond = world.robot.limit_violation(path[0], tolerance_rad=settings.start_limit_tolerance_rad + POSITION_TOLERANCE_RAD)
        if beyond is not None:
            raise Refusal(Status.START_INVALID, beyond)
        # A way back may end where a start was beyond a limit.
        path = np.vstack([path[:1], np.clip(path[1:], world.robot.lower, world.robot.upper)])
        checker = world.exact_checker(should_stop)
        clock.lap("fields")
        hit = hit_of(checker, sample_path(path, CERTIFIED_STEP_RAD)[0], should_stop)
        clock.lap("certificate")
        if hit is not None:
            raise Refusal(Status.PATH_INVALID, f"the exact check refuses the path: {hit}")
        figures = path_figures(world, path, None)
        clock.lap("figures")
        contact_rad = figures["leaf_contact_rad"]
        figures["trajectory"] = timed_motion(world, checker, path, path[0], settings, clock, should_stop, contact_rad, straight)
        status, sentence = Status.SUCCEEDED, f"{figures['path_length_rad']:.2f} rad, {figures['trajectory'].duration_s:.1f} s of motion"
    except Refusal as refusal:
        status, sentence = refusal.status, str(refusal)
    return PlanResult(
        status,
        status.message(sentence),
        settings.planner,
        0,
        planning_time_s=clock.elapsed(),
        phases_s=clock.phases,
        q_start=path[0],
        back=True,
        **figures,
    )


def recheck(
    obstacles: Callable[[], Obstacles],
    trajectory: Trajectory | None,
    q_measured: Array,
    settings: Settings,
    should_stop: Callable[[], bool] = never,
) -> tuple[Status, str]:
    """Check a motion once more before it is carried out; see `Pipeline.recheck`."""
    if trajectory is None:
        return Status.NOTHING_TO_EXECUTE, "the plan has no motion"
    try:
        world = obstacles()
        broken = contract_violations(world.robot, trajectory, q_measured, settings)
        if broken:
            return Status.PATH_INVALID, "; ".join(broken)
        hit = hit_of(world.exact_checker(should_stop), trajectory.configurations(CERTIFIED_STEP_RAD), should_stop)
    except Refusal as refusal:
        return refusal.status, str(refusal)
    if hit is not None:
        return Status.PATH_INVALID, f"the exact check refuses the motion in the newest scene: {hit}"
    return Status.SUCCEEDED, f"the motion of {trajectory.duration_s:.1f} s is still clear"


def obstruction(
    checker: Callable[[], ExactChecker], trajectory: Trajectory | None, from_time_s: float, should_stop: Callable[[], bool] = never
) -> str | None:
    """Look for something hard on the rest of a running motion; see `Pipeline.obstruction`."""
    if trajectory is None:
        return None
    rest = trajectory.configurations(CERTIFIED_STEP_RAD, from_time_s)
    if len(rest) == 0:
        return None
    try:
        return hit_of(checker(), rest, should_stop)
    except Refusal:
        return None
