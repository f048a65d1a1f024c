"""From a path to a motion that may leave: exact certificate, timing, contract."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable

import numpy as np

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.errors import Refusal
from lime_planner.core.parameters import Settings
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.motion.contract import violations
from lime_planner.motion.timing import time_path
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.context import Clock, ask
from lime_planner.pipeline.figures import leaf_profile
from lime_planner.pipeline.leaf_spans import LeafSpans, leaf_spans
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.robot.model import Robot

CERTIFIED_STEP_RAD = 0.01  # spacing of the exact check along a path
STRAIGHT_TOLERANCE_RAD = 0.001  # of corners on a straight stretch: a millimetre at the tool
SLOWED_RAD = 0.02  # the arm is slow already this far before contact
_MORE_CONTACT_RAD = 0.02  # with leaves, by which a motion may exceed its path before it is timed closer
_CLOSE_TOLERANCE_RAD = 0.001  # of corners, where the motion touched something with the tolerance of the settings


def hit_of(checker: ExactChecker, configurations: Array, should_stop: Callable[[], bool]) -> str | None:
    """Check configurations exactly, one after another; the contact found in words, None if there is none.

    Raises:
        Refusal: CANCELLED before the last one; what was not looked at must never pass for clear.
    """
    certificate = checker.certify(configurations, should_stop)
    if certificate.ok:
        return None
    if certificate.hit is None:
        raise Refusal(Status.CANCELLED, "the request was stopped during the exact check")
    return f"{certificate.hit} at sample {certificate.index} of {len(configurations)}"


def make_trajectory(
    robot: Robot,
    waypoints: Array,
    obstacles: Obstacles,
    settings: Settings,
    straight: slice | None = None,
    close: Array | None = None,
) -> Trajectory:
    """Time a path within the robot's scaled limits, slower inside leaves and at rest before the straight stretch where asked for.

    Args:
        robot: the arm.
        waypoints: (M, n) [rad].
        obstacles: tell where leaves are.
        settings: scalings and tolerances.
        straight: the waypoints along which the tool keeps to a straight line: there the motion stays closer to them.
        close: numbers of waypoints at which it stays as close.
    """
    tolerances = np.full(len(waypoints), settings.corner_tolerance_rad)
    if close is not None:
        tolerances[close] = min(_CLOSE_TOLERANCE_RAD, settings.corner_tolerance_rad)
    if straight is not None and len(waypoints[straight]) > 1:
        tolerances[straight] = min(STRAIGHT_TOLERANCE_RAD, settings.corner_tolerance_rad)
    contact = leaf_spans(obstacles, waypoints) if settings.leaf_speed_scale < 1.0 else None
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1)))
    rests = _rests(straight, len(waypoints)) if settings.stop_before_approach else []
    parts = [
        time_path(
            waypoints[first : last + 1],
            robot.velocity_limits,
            robot.acceleration_limits,
            joint_names=robot.joint_names,
            dt_s=settings.trajectory_dt_s,
            velocity_scaling=settings.velocity_scaling,
            acceleration_scaling=settings.acceleration_scaling,
            corner_tolerance_rad=tolerances[first : last + 1],
            speed_scale=None if contact is None else functools.partial(_slowed, contact, settings.leaf_speed_scale, lengths[first]),
        )
        for first, last in itertools.pairwise([0, *rests, len(waypoints) - 1])
    ]
    return functools.reduce(Trajectory.then, parts)


def _rests(straight: slice | None, count: int) -> list[int]:
    """Return the waypoints, of `count`, between a straight stretch and the rest of its path: one, or none."""
    if straight is None:
        return []
    first, stop, _ = straight.indices(count)
    return [at for at in (first, stop - 1) if 0 < at < count - 1]


def _slowed(contact: LeafSpans, scale: float, start_rad: float, p: Array) -> Array:
    """Return the share of the speed to use at lengths p along a part of a path that begins at a length of the whole, (K,)."""
    at = start_rad + p
    return np.where(contact.touches(at - SLOWED_RAD, at + SLOWED_RAD), scale, 1.0)


def contract_violations(robot: Robot, trajectory: Trajectory, q_measured: Array, settings: Settings) -> list[str]:
    """The rules of the motion command that a trajectory breaks, as sentences."""
    window = 2.0 * np.pi
    return violations(
        trajectory,
        q_measured=q_measured,
        lower=np.where(robot.continuous, q_measured - window - 1e-6, robot.lower),
        upper=np.where(robot.continuous, q_measured + window + 1e-6, robot.upper),
        velocity_limits=robot.velocity_limits,
        acceleration_limits=robot.acceleration_limits,
        velocity_scaling=settings.velocity_scaling,
        acceleration_scaling=settings.acceleration_scaling,
        joint_names=robot.joint_names,
        limit_tolerance_rad=settings.start_limit_tolerance_rad,
    )


def timed_motion(
    obstacles: Obstacles,
    checker: ExactChecker,
    waypoints: Array,
    q_measured: Array,
    settings: Settings,
    clock: Clock,
    should_stop: Callable[[], bool],
    leaf_contact_rad: float,
    straight: slice | None = None,
) -> Trajectory:
    """Time a path, hold it to the rules of the motion command, and check what comes out exactly.

    A motion that touches something hard where it cuts a corner of the certified path is timed once more, closer to the path; so is one
    that touches more leaves than the path, whose figures would not be its own: closer at the corners where it does.

    Args:
        obstacles: where leaves are; checker: where hard things are.
        waypoints: (M, n) the certified path [rad].
        q_measured: (n,) where the arm is [rad].
        settings: scalings and tolerances.
        clock: takes the times of the parts.
        should_stop: cancels.
        leaf_contact_rad: of the path, as its figures have it.
        straight: see `make_trajectory`.

    Raises:
        Refusal: PATH_INVALID with the broken rules or the contact; CANCELLED.
    """
    tolerances = [settings.corner_tolerance_rad]
    if settings.corner_tolerance_rad > _CLOSE_TOLERANCE_RAD:
        tolerances.append(_CLOSE_TOLERANCE_RAD)
    hit: str | None = None
    for tolerance in tolerances:
        trajectory = make_trajectory(
            obstacles.robot, waypoints, obstacles, dataclasses.replace(settings, corner_tolerance_rad=tolerance), straight
        )
        clock.lap("timing")
        ask(should_stop)
        broken = contract_violations(obstacles.robot, trajectory, q_measured, settings)
        if broken:
            raise Refusal(Status.PATH_INVALID, "; ".join(broken))
        rows = trajectory.configurations(CERTIFIED_STEP_RAD)
        hit = hit_of(checker, rows, should_stop)
        clock.lap("certificate")
        if hit is None:
            break
    else:
        raise Refusal(Status.PATH_INVALID, f"the exact check refuses the timed motion: {hit}")
    close = _leafy_corners(obstacles, waypoints, rows, leaf_contact_rad)
    if len(close) and tolerance > _CLOSE_TOLERANCE_RAD:
        closer = make_trajectory(obstacles.robot, waypoints, obstacles, settings, straight, close)
        broken = contract_violations(obstacles.robot, closer, q_measured, settings)
        if not broken and hit_of(checker, closer.configurations(CERTIFIED_STEP_RAD), should_stop) is None:
            trajectory = closer
        clock.lap("timing")
    return trajectory


def _leafy_corners(obstacles: Obstacles, waypoints: Array, rows: Array, leaf_contact_rad: float) -> Array:
    """Return the numbers of the waypoints (M, n) near which a motion (K, n) touches leaves, if for longer than its path does."""
    touches = leaf_profile(obstacles, rows)[0] > 0.0
    steps = np.linalg.norm(np.diff(rows, axis=0), axis=1)
    touching_rad = float((0.5 * (touches[1:].astype(float) + touches[:-1]) * steps).sum())
    if touching_rad <= leaf_contact_rad + _MORE_CONTACT_RAD:
        return np.zeros(0, np.int64)
    return np.unique(np.linalg.norm(rows[touches, None] - waypoints, axis=2).argmin(axis=1))
