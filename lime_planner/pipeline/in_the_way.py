"""What a refused plan was refused for, as a configuration that can be drawn: where the arm would have to be, and what it meets there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from lime_planner.collision.exact import Hit
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import PARAMETERS, settings_from
from lime_planner.core.status import Status
from lime_planner.core.types import Array, Float32
from lime_planner.pipeline.goals import ARM_BLOCKED, HAND_BLOCKED
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.pipeline.result import PlanRecord, PlanResult
from lime_planner.robot.ik import solve_ik
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

_APPROACHES = 12  # blocked approaches for which a configuration is looked for
_STARTS = 24
_NEAR_M = 0.03  # hard points are part of the obstacle this far from the contact


@dataclass(frozen=True, eq=False)
class InTheWay:
    """A configuration that was refused, and why.

    Attributes:
        q: (n,) [rad].
        hit: the contact there.
    """

    q: Array
    hit: Hit

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that are blocked: one, or the two that touch each other."""
        return (self.hit.link, self.hit.other) if self.hit.what == "self" else (self.hit.link,)

    @property
    def box(self) -> int | None:
        """Number of the keep-out box that is touched, None where it is something else."""
        return int(self.hit.other.rpartition(" ")[2]) if self.hit.what == "keep_out" else None

    def place(self, robot: Robot) -> Array | None:
        """Return where the contact is (3,) [m]; None for what has no place of its own, a box or the floor."""
        if self.hit.what != "self":
            return self.hit.place
        poses = robot.link_poses(self.q)
        one, other = (
            link.vertices @ poses[link.joint][:3, :3].T + poses[link.joint][:3, 3]
            for name in self.links
            for link in robot.links
            if link.name == name
        )
        apart_m, nearest = cKDTree(other).query(one)
        first = int(np.argmin(apart_m))
        return np.asarray(0.5 * (one[first] + other[np.asarray(nearest)[first]]))

    def obstacle(self, scene: Scene) -> Float32:
        """Return the scene's hard points around the contact (P, 3) [m]; none where it is no point that is met."""
        points = np.concatenate([scene.stem_points, scene.fruit_points])
        if self.hit.place is None:
            return points[:0]
        near: Float32 = points[np.linalg.norm(points - self.hit.place, axis=1) < _NEAR_M]
        return near


def in_the_way_of(robot: Robot, scene: Scene, result: PlanResult) -> InTheWay | None:
    """Look for what stands in the way of a plan of which only the result is left; see `in_the_way`."""
    if result.succeeded or result.target is None:
        return None
    settings = settings_from({name: value for name, value in result.parameters.items() if name in PARAMETERS})
    return in_the_way(Pipeline(robot), PlanRecord(0, scene, settings, None, result))


def in_the_way(pipeline: Pipeline, record: PlanRecord) -> InTheWay | None:
    """Look for what stands in the way of a refused plan; None where nothing hard does, or the plan was not refused for it.

    Args:
        pipeline: of the arm that it was made for.
        record: the plan. A start that is blocked shows itself; of blocked goals the first that meets a stem, else the first.
    """
    result, settings = record.result, record.settings
    if result.q_start is None or result.target is None:
        return None
    if result.status not in (Status.START_IN_STEM, Status.START_INVALID, Status.GOAL_IN_STEM):
        return None
    obstacles = pipeline.obstacles(record.scene, result.target.spot(record.scene, settings), settings)
    checker = obstacles.exact_checker(lambda: False)
    if result.status is not Status.GOAL_IN_STEM:
        hit = checker.stem_hit(result.q_start)
        return None if hit is None else InTheWay(result.q_start, hit)
    if result.target.kind == "pose":
        poses = result.target.poses
    else:
        blocked = np.isin(result.approach_outcomes, (HAND_BLOCKED, ARM_BLOCKED))
        poses = np.array([pose_to_matrix(pose) for pose in result.approaches[blocked]]).reshape(-1, 4, 4)
        poses = poses[:: max(1, len(poses) // _APPROACHES)]
    inside = np.clip(result.q_start, pipeline.robot.lower, pipeline.robot.upper)
    other: InTheWay | None = None
    rng = np.random.default_rng(0)
    for T in poses:
        for q in solve_ik(pipeline.robot, T, inside, rng, max_solutions=4, starts=_STARTS).solutions:
            hit = checker.stem_hit(q)
            if hit is not None and hit.place is not None:
                return InTheWay(q, hit)
            other = other or (None if hit is None else InTheWay(q, hit))
    return other
