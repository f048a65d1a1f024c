"""The arm against itself: spheres and surface points of one body in the distance grid of another."""

from __future__ import annotations

import math
from typing import Any

from lime_planner.jit import inline_kernel
from lime_planner.robot.contact import grid_distance
from lime_planner.robot.shapes import GRID_PADDING_M
from lime_planner.robot.world import CAP_M

SELF_CLEARANCE_M = 0.002  # kept between two bodies of the arm
_LOOK_CLOSER_M = 0.002


@inline_kernel
def _sphere_in_grid(shapes: Any, a: Any, inner: Any, outer: Any, sphere: Any) -> Any:
    """Lower bound of the distance between body a and a sphere of another body."""
    x = outer[0, 0] * sphere[0] + outer[0, 1] * sphere[1] + outer[0, 2] * sphere[2] + outer[0, 3] - inner[0, 3]
    y = outer[1, 0] * sphere[0] + outer[1, 1] * sphere[1] + outer[1, 2] * sphere[2] + outer[1, 3] - inner[1, 3]
    z = outer[2, 0] * sphere[0] + outer[2, 1] * sphere[1] + outer[2, 2] * sphere[2] + outer[2, 3] - inner[2, 3]
    px = inner[0, 0] * x + inner[1, 0] * y + inner[2, 0] * z
    py = inner[0, 1] * x + inner[1, 1] * y + inner[2, 1] * z
    pz = inner[0, 2] * x + inner[1, 2] * y + inner[2, 2] * z
    h = shapes.spacing[a]
    gap = 0.0
    low = shapes.origin[a]
    gx = max(low[0] - px, 0.0, px - low[0] - h * (shapes.size[a, 0] - 1))
    gy = max(low[1] - py, 0.0, py - low[1] - h * (shapes.size[a, 1] - 1))
    gz = max(low[2] - pz, 0.0, pz - low[2] - h * (shapes.size[a, 2] - 1))
    gap = math.sqrt(gx * gx + gy * gy + gz * gz)
    if gap > 0.0:
        return gap + GRID_PADDING_M - sphere[3]
    return grid_distance(shapes, a, px, py, pz) - sphere[3]


@inline_kernel
def pair_clearance(shapes: Any, a: int, b: int, inner: Any, outer: Any) -> Any:
    """Clearance between bodies a and b at the poses `inner` and `outer`: spheres of b, its surface points where that is close."""
    best = CAP_M
    for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
        d = _sphere_in_grid(shapes, a, inner, outer, shapes.coarse[c])
        if d > SELF_CLEARANCE_M + _LOOK_CLOSER_M:
            best = min(best, d)
            continue
        for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
            d = _sphere_in_grid(shapes, a, inner, outer, shapes.fine[f])
            if d > SELF_CLEARANCE_M:
                best = min(best, d)
                continue
            for s in range(shapes.surface_start[f], shapes.surface_start[f + 1]):
                point = shapes.surface[s]
                x = outer[0, 0] * point[0] + outer[0, 1] * point[1] + outer[0, 2] * point[2] + outer[0, 3] - inner[0, 3]
                y = outer[1, 0] * point[0] + outer[1, 1] * point[1] + outer[1, 2] * point[2] + outer[1, 3] - inner[1, 3]
                z = outer[2, 0] * point[0] + outer[2, 1] * point[1] + outer[2, 2] * point[2] + outer[2, 3] - inner[2, 3]
                d = grid_distance(
                    shapes,
                    a,
                    inner[0, 0] * x + inner[1, 0] * y + inner[2, 0] * z,
                    inner[0, 1] * x + inner[1, 1] * y + inner[2, 1] * z,
                    inner[0, 2] * x + inner[1, 2] * y + inner[2, 2] * z,
                )
                best = min(best, d)
                if best < SELF_CLEARANCE_M:
                    return best
    return best


@inline_kernel
def self_clearance(shapes: Any, scratch: Any, own: Any) -> Any:
    """Write the clearance of each pair of bodies that can touch to `own`; the smallest. Stops at the first that is too small."""
    best = CAP_M
    for p in range(shapes.pairs.shape[0]):
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
