"""What a plan does over time, for plots, player and animation: where the tool is, how near the stems are, which leaves are touched."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from lime_planner.collision.touched_points import touched_points
from lime_planner.core.types import Array, Bool, Int64
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline.clearance import StemClearance
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.leaf_spans import leaf_spans
from lime_planner.pipeline.result import PlanRecord
from lime_planner.pipeline.spots import Spot

_STEP_S = 0.04  # between two samples of a motion
_STEP_RAD = 0.03  # between two samples of a path that has no times
_MOST = 300
CLEARANCE_SHOWN_M = 0.1  #: larger clearances are of no interest


@dataclass(frozen=True, eq=False)
class Timeline:
    """A motion in K samples.

    Attributes:
        times_s: (K,) from 0; for a path that was refused before it was timed, its length so far [rad] in their place.
        timed: whether they are times.
        configurations: (K, n) [rad].
        tool: (K, 3) position of the tool in the planning frame [m].
        leaf: (K,) price of the leaves touched, 0 where none is.
        clearance_m: (K,) distance to the nearest stem, at most `CLEARANCE_SHOWN_M`.
        cost: (K,) ∫ (1 + w · leaf) ds so far [rad].
        length_rad: length of what is followed, in joint space.
        leaf_contact_rad: length of its part in contact with leaves.
        leaf_points: (P,) indices of the scene's leaf points that are touched at any time.
        touched: (K, P) which of them are touched at each sample, or nearer to it than to any other.
    """

    times_s: Array
    timed: bool
    configurations: Array
    tool: Array
    leaf: Array
    clearance_m: Array
    cost: Array
    length_rad: float
    leaf_contact_rad: float
    leaf_points: Int64
    touched: Bool

    @property
    def duration_s(self) -> float:
        """The last time."""
        return float(self.times_s[-1])

    def at(self, t_s: float) -> int:
        """Return the number of the sample nearest to a time."""
        return int(np.abs(self.times_s - t_s).argmin())

    def configuration(self, t_s: float) -> Array:
        """Return the configuration at a time (n,), between samples interpolated."""
        return np.array([np.interp(t_s, self.times_s, column) for column in self.configurations.T])


def timeline_of(pipeline: Pipeline, shown: PlanRecord) -> Timeline:
    """Follow a plan in its scene.

    Args:
        pipeline: of the arm that it was made for.
        shown: a plan with a path (`PlanRecord.found`).
    """
    robot, settings, scene = pipeline.robot, shown.settings, shown.scene
    times, configurations, timed = _samples(shown.result.trajectory, shown.result.waypoints)
    obstacles = pipeline.obstacles(scene, _spot(shown), settings)
    contact = leaf_spans(obstacles, configurations)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(configurations, axis=0), axis=1))])
    marks = touched_points(robot, pipeline.shapes, configurations, scene.leaf_points, settings.leaf_point_radius_m)
    # Contact that begins and ends between two samples shows at the nearer one: else leaves would cost that are never touched.
    middles = contact.spans[:, :2].mean(axis=1)
    between = np.array([np.interp(middles, lengths, column) for column in configurations.T]).T
    for middle, mark in zip(
        middles, touched_points(robot, pipeline.shapes, between, scene.leaf_points, settings.leaf_point_radius_m), strict=True
    ):
        marks[int(np.abs(lengths - middle).argmin())] |= mark
    ever = np.flatnonzero(marks.any(axis=0))
    return Timeline(
        times,
        timed,
        configurations,
        np.array([robot.forward(q)[:3, 3] for q in configurations]),
        contact.price_at(lengths),
        StemClearance(obstacles).along(configurations, CLEARANCE_SHOWN_M),
        lengths + settings.weight * contact.charged_until(lengths),
        float(lengths[-1]),
        contact.contact_rad,
        ever,
        np.ascontiguousarray(marks[:, ever]),
    )


def _spot(shown: PlanRecord) -> Spot | Array | None:
    """What the plan was measured against: around its target it let go of the same things."""
    aim = shown.result.target
    if aim is None:
        return None if shown.target is None else shown.target[:3]
    return dataclasses.replace(aim.spot(shown.scene, shown.settings), picked=shown.result.back)


def _samples(trajectory: Trajectory | None, waypoints: Array) -> tuple[Array, Array, bool]:
    if trajectory is None:
        rows, lengths = sample_path(waypoints, _STEP_RAD)
        keep = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST)).round().astype(int))
        return lengths[keep], rows[keep], False
    count = int(np.clip(np.ceil(trajectory.duration_s / _STEP_S), 2, _MOST))
    times = np.linspace(0.0, trajectory.duration_s, count + 1)
    return times, trajectory.sample(times), True
