"""Which points the arm touches along a motion: those of a cloud, to show them, and those of unseen space, to look there."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.collision.distance_fields import PointHash
from lime_planner.collision.link_shapes import Shapes
from lime_planner.collision.point_contact import cells_near, mesh_distance, place
from lime_planner.core.jit import kernel
from lime_planner.core.types import Bool
from lime_planner.robot.kinematics import forward_kinematics
from lime_planner.robot.model import Robot


@kernel
def _touch(shapes: Any, poses: Any, points: Any, radius: float, out: Any) -> None:
    """Mark in `out` the points within `radius` of a body's mesh; bounding spheres sort out most of them."""
    for b in range(shapes.bound.shape[0]):
        if shapes.bound[b, 3] <= 0.0:
            continue
        pose = poses[b]
        x, y, z = place(pose, shapes.bound[b])
        reach = (shapes.bound[b, 3] + radius) ** 2
        for p in range(points.shape[0]):
            if (points[p, 0] - x) ** 2 + (points[p, 1] - y) ** 2 + (points[p, 2] - z) ** 2 > reach:
                continue
            if mesh_distance(shapes, b, pose, points[p, 0], points[p, 1], points[p, 2]) < radius:
                out[p] = True


def touched_points(robot: Robot, shapes: Shapes, configurations: npt.ArrayLike, points: npt.ArrayLike, radius_m: float) -> Bool:
    """Tell which points the arm touches at each of some configurations, (K, P).

    Args:
        robot, shapes: the arm.
        configurations: (K, n) [rad].
        points: (P, 3) in the planning frame [m].
        radius_m: radius of a point [m].
    """
    rows = np.ascontiguousarray(configurations, dtype=np.float64).reshape(-1, robot.n)
    cloud = np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 3)
    marks = np.zeros((len(rows), len(cloud)), dtype=np.bool_)
    poses = np.empty((robot.n + 1, 3, 4))
    for q, row in zip(rows, marks, strict=True):
        forward_kinematics(robot.chain, q, poses)
        _touch(shapes, poses, cloud, float(radius_m), row)
    return marks


@kernel
def _touch_any(shapes: Any, chain: Any, rows: Any, poses: Any, table: Any, radius: float, out: Any) -> None:
    """Mark in `out` the points of a hash that a body's mesh comes within `radius` of at any configuration."""
    for r in range(rows.shape[0]):
        forward_kinematics(chain, rows[r], poses)
        for b in range(shapes.bound.shape[0]):
            pose = poses[b]
            for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
                x, y, z = place(pose, shapes.coarse[c])
                reach = shapes.coarse[c, 3] + radius
                low0, high0, low1, high1, low2, high2 = cells_near(table, x, y, z, reach)
                if high2 < low2:
                    continue
                for i in range(low0, high0 + 1):
                    for j in range(low1, high1 + 1):
                        row = (i * table.shape[1] + j) * table.shape[2]
                        for at in range(table.start[row + low2], table.start[row + high2 + 1]):
                            if out[at]:
                                continue
                            px, py, pz = table.points[at, 0], table.points[at, 1], table.points[at, 2]
                            if (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2 > reach * reach:
                                continue
                            if mesh_distance(shapes, b, pose, px, py, pz) < radius:
                                out[at] = True


def touched_anywhere(robot: Robot, shapes: Shapes, configurations: npt.ArrayLike, table: PointHash, radius_m: float) -> Bool:
    """Tell which points of a hash the arm touches at any of some configurations, (P,), in the hash's order.

    Args:
        robot, shapes: the arm.
        configurations: (K, n) [rad].
        table: P points in the planning frame.
        radius_m: radius of a point [m].
    """
    rows = np.ascontiguousarray(configurations, dtype=np.float64).reshape(-1, robot.n)
    marks = np.zeros(len(table.points), dtype=np.bool_)
    if len(marks):
        _touch_any(shapes, robot.chain, rows, np.empty((robot.n + 1, 3, 4)), table, float(radius_m), marks)
    return marks
