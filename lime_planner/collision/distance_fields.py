"""Distance fields of leaves and stems, and the points themselves in a spatial hash.

A field answers "how far is the nearest point" at any place in a few nanoseconds: the distance is exact at the nodes of a grid
close to the points and a lower bound further away; between nodes it is interpolated. Where that is not accurate enough, the
caller asks the hash for the points themselves. Nothing here knows robots or labels beyond "leaf" and "stem".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lime_planner.collision.distance_grid import fill_channel, fill_from_nodes, filled
from lime_planner.core.jit import inline_kernel, kernel
from lime_planner.core.types import Array, Float32, Int32, Int64, UInt8

STEM, LEAF = 0, 1  # channels of a field's values
EMPTY_DISTANCE_M = 10.0  # what a field without points answers
_HASH_CELL_M = 0.02
_MAX_NODES = 12_000_000


class PointHash(NamedTuple):
    """Points sorted by cubic cells.

    Attributes:
        origin: (3,) lowest corner of the first cell [m].
        cell_m: edge of a cell [m].
        shape: (3,) int64, cells per axis.
        start: (cells + 1,) int32, first point of each cell in `points`.
        points: (P, 3) float32 [m], sorted by cell.
        weights: (P,) float32, the points' permeability costs (ones for stems).
    """

    origin: Array
    cell_m: float
    shape: Int64
    start: Int32
    points: Float32
    weights: Float32


class Fields(NamedTuple):
    """Distances to the nearest stem and leaf point on one grid, and the points.

    Attributes:
        origin: (3,) position of node 0, 0, 0 [m].
        spacing_m: distance between nodes [m].
        values: (nx, ny, nz, 2) float32, distance [m] to the nearest stem (0) and leaf (1) point: exact up to 3.6 spacings, beyond
            that a lower bound (short by at most 1.8 spacings).
        boxes: (2, 2, 3) lowest and highest corner of the stem points and of the leaf points [m].
        present: (2,) uint8, whether there is any stem point, any leaf point.
        stems: the stem points in a hash.
        leaves: the leaf points in a hash.
    """

    origin: Array
    spacing_m: float
    values: Float32
    boxes: Array
    present: UInt8
    stems: PointHash
    leaves: PointHash


@kernel
def _count_cells(points: Any, origin: Any, inverse: Any, shape: Any, cell_of: Any, start: Any) -> Any:
    for i in range(points.shape[0]):
        c = 0
        for k in range(3):
            j = int((points[i, k] - origin[k]) * inverse)
            j = min(max(j, 0), shape[k] - 1)
            c = c * shape[k] + j
        cell_of[i] = c
        start[c + 1] += 1
    for c in range(start.shape[0] - 1):
        start[c + 1] += start[c]


@kernel
def _place_points(points: Any, weights: Any, cell_of: Any, start: Any, fill: Any, out: Any, out_weights: Any) -> Any:
    for i in range(points.shape[0]):
        c = cell_of[i]
        at = start[c] + fill[c]
        fill[c] += 1
        for k in range(3):
            out[at, k] = points[i, k]
        out_weights[at] = weights[i]


def hash_points(points: npt.ArrayLike, weights: npt.ArrayLike | None = None, cell_m: float = _HASH_CELL_M) -> PointHash:
    """Sort points into cells.

    Args:
        points: (P, 3) finite [m].
        weights: (P,) or None for ones.
        cell_m: edge of a cell; made larger where the points spread too far for it.
    """
    array = np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 3)
    weight = np.ones(len(array), np.float32) if weights is None else np.ascontiguousarray(weights, dtype=np.float32)
    if len(array) == 0:
        zero = np.zeros(3)
        return PointHash(zero, float(cell_m), np.ones(3, np.int64), np.zeros(2, np.int32), array, weight)
    origin = array.min(axis=0).astype(np.float64) - 1e-6
    extent = array.max(axis=0) - origin
    while np.prod(np.floor(extent / cell_m) + 1) > 4e6:
        cell_m *= 2.0
    shape = (np.floor(extent / cell_m) + 1).astype(np.int64)
    cell_of = np.empty(len(array), np.int64)
    start = np.zeros(int(shape.prod()) + 1, np.int32)
    _count_cells(array, origin, 1.0 / cell_m, shape, cell_of, start)
    ordered, ordered_weight = np.empty_like(array), np.empty_like(weight)
    _place_points(array, weight, cell_of, start, np.zeros(len(start), np.int32), ordered, ordered_weight)
    return PointHash(origin, float(cell_m), shape, start, ordered, ordered_weight)


def build_fields(
    stem_points: npt.ArrayLike,
    leaf_points: npt.ArrayLike,
    leaf_costs: npt.ArrayLike | None = None,
    *,
    spacing_m: float = 0.01,
    padding_m: float = 0.10,
    pause: Callable[[], None] = lambda: None,
) -> Fields:
    """Build the distance fields of one scene.

    Args:
        stem_points: (M, 3) finite [m].
        leaf_points: (N, 3) finite [m].
        leaf_costs: (N,) permeability costs ≥ 0, or None for ones.
        spacing_m: spacing of the grid; made larger where the clouds spread over more than 12 million nodes.
        padding_m: how far the grid reaches beyond the points; outside it the distance to their bounding box serves.
        pause: called every ten milliseconds or so; what it raises ends the work.
    """
    stems = np.ascontiguousarray(stem_points, dtype=np.float32).reshape(-1, 3)
    leaves = np.ascontiguousarray(leaf_points, dtype=np.float32).reshape(-1, 3)
    boxes = np.zeros((2, 2, 3))
    present = np.array([len(stems) > 0, len(leaves) > 0], np.uint8)
    for channel, points in ((STEM, stems), (LEAF, leaves)):
        if len(points):
            boxes[channel, 0], boxes[channel, 1] = points.min(axis=0), points.max(axis=0)
    if present.any():
        low = boxes[present.astype(bool), 0].min(axis=0) - padding_m
        high = boxes[present.astype(bool), 1].max(axis=0) + padding_m
    else:
        low, high = np.zeros(3), np.full(3, spacing_m)
    spacing_m = max(spacing_m, float((np.prod(high - low) / _MAX_NODES) ** (1 / 3)))
    while np.prod(np.ceil((high - low) / spacing_m) + 2.0) > _MAX_NODES:  # an extent far longer than the others has many border nodes
        spacing_m *= 1.05
    shape = np.ceil((high - low) / spacing_m).astype(np.int64) + 2
    values = filled((*(int(count) for count in shape), 2), EMPTY_DISTANCE_M, pause)
    for channel, points in ((STEM, stems), (LEAF, leaves)):
        if len(points):
            fill_channel(points, low, spacing_m, channel, values, pause)
    pause()
    return Fields(low, spacing_m, values, boxes, present, hash_points(stems), hash_points(leaves, leaf_costs))


def lattice_fields(places: npt.ArrayLike, spacing_m: float, *, padding_m: float = 0.10, pause: Callable[[], None] = lambda: None) -> Fields:
    """Build the field of permeable points that lie on a cubic lattice, such as the middles of voxels: a quarter of the work for many.

    Args:
        places: (N, 3) finite, N at least 1, whole numbers of spacings apart along each axis [m].
        spacing_m: of the lattice and of the grid.
        padding_m: how far the grid reaches beyond the points.
        pause: see `build_fields`.
    """
    points = np.ascontiguousarray(places, dtype=np.float32).reshape(-1, 3)
    lowest, highest = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    rim = int(np.ceil(padding_m / spacing_m))
    shape = np.rint((highest - lowest) / spacing_m).astype(np.int64) + 1 + 2 * rim
    if float(np.prod(shape.astype(np.float64))) > _MAX_NODES:
        return build_fields(np.zeros((0, 3)), points, spacing_m=spacing_m, padding_m=padding_m, pause=pause)
    values = filled((*(int(count) for count in shape), 2), EMPTY_DISTANCE_M, pause)
    nodes = np.rint((points - lowest) / spacing_m).astype(np.int64) + rim
    fill_from_nodes(nodes, spacing_m, LEAF, values, pause)
    boxes = np.zeros((2, 2, 3))
    boxes[LEAF] = lowest, highest
    present = np.array([0, 1], np.uint8)
    return Fields(lowest - rim * spacing_m, float(spacing_m), values, boxes, present, hash_points(np.zeros((0, 3))), hash_points(points))


@inline_kernel
def box_distance(box: Any, x: Any, y: Any, z: Any) -> Any:
    """Distance from a place to an axis-aligned box (2, 3), 0 inside [m]."""
    dx = max(box[0, 0] - x, 0.0, x - box[1, 0])
    dy = max(box[0, 1] - y, 0.0, y - box[1, 1])
    dz = max(box[0, 2] - z, 0.0, z - box[1, 2])
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@inline_kernel
def sample(fields: Any, x: Any, y: Any, z: Any) -> Any:
    """Interpolated distances (stem, leaf) at a place [m]; outside the grid, the distance to the points' bounding boxes."""
    values = fields.values
    inverse = 1.0 / fields.spacing_m
    gx = (x - fields.origin[0]) * inverse
    gy = (y - fields.origin[1]) * inverse
    gz = (z - fields.origin[2]) * inverse
    if gx < 0.0 or gy < 0.0 or gz < 0.0 or gx >= values.shape[0] - 1 or gy >= values.shape[1] - 1 or gz >= values.shape[2] - 1:
        stem = box_distance(fields.boxes[0], x, y, z) if fields.present[0] else EMPTY_DISTANCE_M
        leaf = box_distance(fields.boxes[1], x, y, z) if fields.present[1] else EMPTY_DISTANCE_M
        return stem, leaf
    i = np.uint64(gx)
    j = np.uint64(gy)
    k = np.uint64(gz)
    one = np.uint64(1)
    fx = np.float32(gx - i)
    fy = np.float32(gy - j)
    fz = np.float32(gz - k)
    ex = np.float32(1.0) - fx
    ey = np.float32(1.0) - fy
    ez = np.float32(1.0) - fz
    w00 = ex * ey
    w01 = ex * fy
    w10 = fx * ey
    w11 = fx * fy
    stem = ez * (
        w00 * values[i, j, k, 0] + w01 * values[i, j + one, k, 0] + w10 * values[i + one, j, k, 0] + w11 * values[i + one, j + one, k, 0]
    )
    stem += fz * (
        w00 * values[i, j, k + one, 0]
        + w01 * values[i, j + one, k + one, 0]
        + w10 * values[i + one, j, k + one, 0]
        + w11 * values[i + one, j + one, k + one, 0]
    )
    leaf = ez * (
        w00 * values[i, j, k, 1] + w01 * values[i, j + one, k, 1] + w10 * values[i + one, j, k, 1] + w11 * values[i + one, j + one, k, 1]
    )
    leaf += fz * (
        w00 * values[i, j, k + one, 1]
        + w01 * values[i, j + one, k + one, 1]
        + w10 * values[i + one, j, k + one, 1]
        + w11 * values[i + one, j + one, k + one, 1]
    )
    return float(stem), float(leaf)


@inline_kernel
def lower_bound(distance: Any, spacing_m: Any) -> Any:
    """Lower bound of the true distance given the interpolated one [m].

    The distance to a point set is the minimum of convex functions, so linear interpolation overstates it: by at most h²/(4 d) at a
    true distance d well above the spacing h (second derivatives 1/d in two directions), and by the half diagonal of a cell near 0.
    For interpolated distances from 1.5 h on, the largest product of error and distance over all places in a cell is 0.3054 h².
    """
    if distance > 1.5 * spacing_m:
        return distance - 0.306 * spacing_m * spacing_m / distance
    if distance > spacing_m:
        return distance - 0.5 * spacing_m
    return max(0.0, distance - 0.867 * spacing_m)
