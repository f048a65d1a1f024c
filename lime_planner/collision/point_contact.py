"""Cloud points against one body's signed distance grid: what decides where spheres cannot."""

from __future__ import annotations

import math
from typing import Any

from lime_planner.collision.link_shapes import GRID_PADDING_M, Shapes
from lime_planner.core.jit import inline_kernel
from lime_planner.core.types import Array


@inline_kernel
def place(pose: Array, sphere: Array) -> tuple[float, float, float]:
    """Carry a sphere's centre from its joint's frame into the planning frame."""
    x = pose[0, 0] * sphere[0] + pose[0, 1] * sphere[1] + pose[0, 2] * sphere[2] + pose[0, 3]
    y = pose[1, 0] * sphere[0] + pose[1, 1] * sphere[1] + pose[1, 2] * sphere[2] + pose[1, 3]
    z = pose[2, 0] * sphere[0] + pose[2, 1] * sphere[1] + pose[2, 2] * sphere[2] + pose[2, 3]
    return x, y, z


@inline_kernel
def grid_distance(shapes: Shapes, b: int, x: float, y: float, z: float) -> Any:
    """Signed distance of body b's mesh from a place in its joint's frame; outside the grid, the grid's padding [m]."""
    inverse = 1.0 / shapes.spacing[b]
    gx = (x - shapes.origin[b, 0]) * inverse
    gy = (y - shapes.origin[b, 1]) * inverse
    gz = (z - shapes.origin[b, 2]) * inverse
    ny = shapes.size[b, 1]
    nz = shapes.size[b, 2]
    if gx < 0.0 or gy < 0.0 or gz < 0.0 or gx >= shapes.size[b, 0] - 1 or gy >= ny - 1 or gz >= nz - 1:
        return GRID_PADDING_M
    i = int(gx)
    j = int(gy)
    k = int(gz)
    fx = gx - i
    fy = gy - j
    fz = gz - k
    grid = shapes.grid
    at = shapes.offset[b] + (i * ny + j) * nz + k
    step = ny * nz
    c00 = grid[at] * (1.0 - fz) + grid[at + 1] * fz
    c01 = grid[at + nz] * (1.0 - fz) + grid[at + nz + 1] * fz
    c10 = grid[at + step] * (1.0 - fz) + grid[at + step + 1] * fz
    c11 = grid[at + step + nz] * (1.0 - fz) + grid[at + step + nz + 1] * fz
    return (c00 * (1.0 - fy) + c01 * fy) * (1.0 - fx) + (c10 * (1.0 - fy) + c11 * fy) * fx


@inline_kernel
def mesh_distance(shapes: Any, b: Any, pose: Any, x: Any, y: Any, z: Any) -> Any:
    """Signed distance of body b's mesh, its joint's frame at `pose`, from a place in the planning frame; see `grid_distance` [m]."""
    dx = x - pose[0, 3]
    dy = y - pose[1, 3]
    dz = z - pose[2, 3]
    return grid_distance(
        shapes,
        b,
        pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz,
        pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz,
        pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz,
    )


@inline_kernel
def cells_near(table: Any, x: Any, y: Any, z: Any, reach: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """First and last cell, on each axis, of the points' table that a cube around a place meets; last under first where none."""
    inverse = 1.0 / table.cell_m
    return (
        max(0, int(math.floor((x - reach - table.origin[0]) * inverse))),
        min(table.shape[0] - 1, int(math.floor((x + reach - table.origin[0]) * inverse))),
        max(0, int(math.floor((y - reach - table.origin[1]) * inverse))),
        min(table.shape[1] - 1, int(math.floor((y + reach - table.origin[1]) * inverse))),
        max(0, int(math.floor((z - reach - table.origin[2]) * inverse))),
        min(table.shape[2] - 1, int(math.floor((z + reach - table.origin[2]) * inverse))),
    )


@inline_kernel
def points_in_line(table: Any, i: Any, j: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """First point, and the one behind the last, in the cells `low` to `high` of a line of the points' table; equal where there are none."""
    line = (i * table.shape[1] + j) * table.shape[2]
    if high < low:
        return 0, 0
    return table.start[line + low], table.start[line + high + 1]


@inline_kernel
def points_near(
    shapes: Any, b: Any, pose: Any, table: Any, x: Any, y: Any, z: Any, reach: Any, enough: Any, skip: Any, skip_radius: Any
) -> Any:
    """Smallest distance from body b's mesh to the points of `table` within `reach` of a place.

    Stops at the first one under `enough`. Points within skip_radius of the upright segment `skip` (`World.exclusion`) do not count.
    """
    best = reach
    low0, high0, low1, high1, low2, high2 = cells_near(table, x, y, z, reach)
    for i in range(low0, high0 + 1):
        for j in range(low1, high1 + 1):
            begin, end = points_in_line(table, i, j, low2, high2)
            for at in range(begin, end):
                px = float(table.points[at, 0])
                py = float(table.points[at, 1])
                pz = float(table.points[at, 2])
                if (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2 > reach * reach:
                    continue
                if skip_radius > 0.0:
                    above = pz - skip[2]
                    above -= min(max(above, skip[4]), skip[5])
                    if (px - skip[0]) ** 2 + (py - skip[1]) ** 2 + above * above < skip_radius * skip_radius:
                        continue
                d = mesh_distance(shapes, b, pose, px, py, pz)
                if d < best:
                    best = d
                    if best < enough:
                        return best
    return best


@inline_kernel
def leaf_near(shapes: Any, b: Any, pose: Any, table: Any, x: Any, y: Any, z: Any, reach: Any, radius: Any, top: Any) -> tuple[Any, Any]:
    """Smallest distance from body b's mesh to the points of `table` within `reach` of a place, and the largest weight within `radius`.

    Stops at the first weight of `top` or more.
    """
    best = reach
    heaviest = 0.0
    low0, high0, low1, high1, low2, high2 = cells_near(table, x, y, z, reach)
    for i in range(low0, high0 + 1):
        for j in range(low1, high1 + 1):
            begin, end = points_in_line(table, i, j, low2, high2)
            for at in range(begin, end):
                px = float(table.points[at, 0])
                py = float(table.points[at, 1])
                pz = float(table.points[at, 2])
                if (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2 > reach * reach:
                    continue
                d = mesh_distance(shapes, b, pose, px, py, pz)
                best = min(best, d)
                if d < radius:
                    heaviest = max(heaviest, float(table.weights[at]))
                    if heaviest >= top:
                        return best, heaviest
    return best, heaviest


@inline_kernel
def touched_patches(
    shapes: Any, b: Any, pose: Any, table: Any, x: Any, y: Any, z: Any, reach: Any, radius: Any, marks: Any, mark: Any
) -> Any:
    """Sum of the weights of the points near a place that touch body b and carry no mark yet; they are marked."""
    total = 0.0
    low0, high0, low1, high1, low2, high2 = cells_near(table, x, y, z, reach)
    for i in range(low0, high0 + 1):
        for j in range(low1, high1 + 1):
            begin, end = points_in_line(table, i, j, low2, high2)
            for at in range(begin, end):
                if marks[at] == mark:
                    continue
                d = mesh_distance(shapes, b, pose, table.points[at, 0], table.points[at, 1], table.points[at, 2])
                if d < radius:
                    marks[at] = mark
                    total += table.weights[at]
    return total
