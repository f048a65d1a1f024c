"""Which cloud points the arm touches along a motion: for showing them, not for planning."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.collision.link_shapes import Shapes
from lime_planner.collision.point_contact import mesh_distance, place
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
