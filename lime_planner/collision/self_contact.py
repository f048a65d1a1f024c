"""The arm against itself: spheres and surface points of one body in the distance grid of another."""

from __future__ import annotations

import math
from typing import Any

from lime_planner.collision.link_shapes import GRID_PADDING_M
from lime_planner.collision.point_contact import grid_distance
from lime_planner.collision.world import CAP_M
from lime_planner.core.jit import inline_kernel

SELF_CLEARANCE_M = 0.002  # kept between two bodies of the arm
_LOOK_CLOSER_M = 0.002


@inline_kernel
def _relative(inner: Any, outer: Any) -> Any:
    """Pose of one body in another's frame, row by row: 3 × 4 numbers, the planning frame's turns left out."""
    x = outer[0, 3] - inner[0, 3]
    y = outer[1, 3] - inner[1, 3]
    z = outer[2, 3] - inner[2, 3]
    return (
        inner[0, 0] * outer[0, 0] + inner[1, 0] * outer[1, 0] + inner[2, 0] * outer[2, 0],
        inner[0, 0] * outer[0, 1] + inner[1, 0] * outer[1, 1] + inner[2, 0] * outer[2, 1],
        inner[0, 0] * outer[0, 2] + inner[1, 0] * outer[1, 2] + inner[2, 0] * outer[2, 2],
        inner[0, 0] * x + inner[1, 0] * y + inner[2, 0] * z,
        inner[0, 1] * outer[0, 0] + inner[1, 1] * outer[1, 0] + inner[2, 1] * outer[2, 0],
        inner[0, 1] * outer[0, 1] + inner[1, 1] * outer[1, 1] + inner[2, 1] * outer[2, 1],
        inner[0, 1] * outer[0, 2] + inner[1, 1] * outer[1, 2] + inner[2, 1] * outer[2, 2],
        inner[0, 1] * x + inner[1, 1] * y + inner[2, 1] * z,
        inner[0, 2] * outer[0, 0] + inner[1, 2] * outer[1, 0] + inner[2, 2] * outer[2, 0],
        inner[0, 2] * outer[0, 1] + inner[1, 2] * outer[1, 1] + inner[2, 2] * outer[2, 1],
        inner[0, 2] * outer[0, 2] + inner[1, 2] * outer[1, 2] + inner[2, 2] * outer[2, 2],
        inner[0, 2] * x + inner[1, 2] * y + inner[2, 2] * z,
    )


@inline_kernel
def _carry(pose: Any, point: Any) -> tuple[Any, Any, Any]:
    """Apply such a pose to a point, or to a sphere's centre."""
    return (
        pose[0] * point[0] + pose[1] * point[1] + pose[2] * point[2] + pose[3],
        pose[4] * point[0] + pose[5] * point[1] + pose[6] * point[2] + pose[7],
        pose[8] * point[0] + pose[9] * point[1] + pose[10] * point[2] + pose[11],
    )


@inline_kernel
def _box_gap(shapes: Any, a: Any, x: Any, y: Any, z: Any) -> Any:
    """Squared distance of a place in body a's frame from its grid's box."""
    low = shapes.origin[a]
    h = shapes.spacing[a]
    gx = max(low[0] - x, 0.0, x - low[0] - h * (shapes.size[a, 0] - 1))
    gy = max(low[1] - y, 0.0, y - low[1] - h * (shapes.size[a, 1] - 1))
    gz = max(low[2] - z, 0.0, z - low[2] - h * (shapes.size[a, 2] - 1))
    return gx * gx + gy * gy + gz * gz


@inline_kernel
def _sphere_in_grid(shapes: Any, a: Any, pose: Any, sphere: Any) -> Any:
    """Lower bound of the distance between body a and a sphere of another body, whose pose in a's frame is given."""
    x, y, z = _carry(pose, sphere)
    gap = _box_gap(shapes, a, x, y, z)
    if gap > 0.0:
        return math.sqrt(gap) + GRID_PADDING_M - sphere[3]
    return grid_distance(shapes, a, x, y, z) - sphere[3]


@inline_kernel
def pair_clearance(shapes: Any, a: int, b: int, inner: Any, outer: Any) -> Any:
    """Clearance between bodies a and b at the poses `inner` and `outer`: spheres of b, its surface points where that is close."""
    pose = _relative(inner, outer)
    bound = shapes.bound[b]
    x, y, z = _carry(pose, bound)
    reach = bound[3] + SELF_CLEARANCE_M + _LOOK_CLOSER_M
    gap = _box_gap(shapes, a, x, y, z)
    if gap > reach * reach:
        return math.sqrt(gap) + GRID_PADDING_M - bound[3]
    best = CAP_M
    for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
        d = _sphere_in_grid(shapes, a, pose, shapes.coarse[c])
        if d > SELF_CLEARANCE_M + _LOOK_CLOSER_M:
            best = min(best, d)
            continue
        for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
            d = _sphere_in_grid(shapes, a, pose, shapes.fine[f])
            if d > SELF_CLEARANCE_M:
                best = min(best, d)
                continue
            for s in range(shapes.surface_start[f], shapes.surface_start[f + 1]):
                x, y, z = _carry(pose, shapes.surface[s])
                best = min(best, grid_distance(shapes, a, x, y, z))
                if best < SELF_CLEARANCE_M:
                    return best
    return best


@inline_kernel
def self_clearance(shapes: Any, scratch: Any, own: Any) -> Any:
    """Write the clearance of each pair of bodies that can touch to `own`; the smallest. Stops at the first that is too small.

    Pairs that are not to be looked at (`Scratch.open`) count as far from each other.
    """
    best = CAP_M
    for p in range(shapes.pairs.shape[0]):
        if not (scratch.open[1] >> (p & 63)) & 1:
            own[p] = CAP_M
            continue
        a = shapes.pairs[p, 0]
        b = shapes.pairs[p, 1]
        dx = scratch.centres[a, 0] - scratch.centres[b, 0]
        dy = scratch.centres[a, 1] - scratch.centres[b, 1]
        dz = scratch.centres[a, 2] - scratch.centres[b, 2]
        clearance = math.sqrt(dx * dx + dy * dy + dz * dz) - shapes.bound[a, 3] - shapes.bound[b, 3]
        if clearance <= GRID_PADDING_M:
            # The outer body's spheres go into the inner body's grid: the gripper's are the finest.
            clearance = pair_clearance(shapes, a, b, scratch.poses[a], scratch.poses[b])
        own[p] = clearance
        best = min(best, clearance)
        if best < SELF_CLEARANCE_M:
            break
    return best
