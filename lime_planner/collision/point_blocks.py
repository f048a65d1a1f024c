"""A point cloud in small blocks, so that most of it can be passed over with one comparison each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lime_planner.core.types import Array, Int64

_MERGE_M = 0.001  # points within one cube of this edge become one
_BLOCK_M = 0.04


class PointBlocks(NamedTuple):
    """Balls around points, sorted into blocks.

    Attributes:
        points: (P, 3) centres in the planning frame [m].
        radii: (P,) radii [m]: the cloud's, enlarged where points were merged so that every merged ball is covered.
        centres: (B, 3) centre of each block's bounding sphere.
        bounds: (B,) radius of that sphere, the points' radii left out.
        start: (B + 1,) int64, block b holds the points start[b] to start[b + 1].
        largest: the largest of the radii [m].
    """

    points: Array
    radii: Array
    centres: Array
    bounds: Array
    start: Int64
    largest: float


def make_blocks(points: npt.ArrayLike, radius_m: float, reach_m: float) -> PointBlocks:
    """Crop, merge and sort a cloud.

    Points farther from the origin than `reach_m` plus the radius are left out. Points that share a cube of 1 mm are merged into
    one whose radius covers them all: never smaller, at most 1.8 mm larger, and exact wherever the cloud is thinned to 2 mm or so.

    Args:
        points: (N, 3) in the planning frame [m]; all finite.
        radius_m: radius of the balls around them.
        reach_m: see above.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    cloud = cloud[np.einsum("ij,ij->i", cloud, cloud) <= (reach_m + radius_m) ** 2]
    if len(cloud) == 0:
        return PointBlocks(cloud, np.zeros(0), np.zeros((0, 3)), np.zeros(0), np.zeros(1, dtype=np.int64), radius_m)
    _, first, group = np.unique(_cubes(cloud, _MERGE_M), return_index=True, return_inverse=True)
    radii = np.full(len(first), radius_m)
    np.maximum.at(radii, group, radius_m + np.linalg.norm(cloud - cloud[first[group]], axis=1))
    cloud = cloud[first]
    _, block = np.unique(_cubes(cloud, _BLOCK_M), return_inverse=True)
    order = np.argsort(block, kind="stable")
    cloud, radii, block = cloud[order], radii[order], block[order]
    start = np.concatenate([[0], np.cumsum(np.bincount(block))]).astype(np.int64)
    low, high = np.minimum.reduceat(cloud, start[:-1]), np.maximum.reduceat(cloud, start[:-1])
    centres = 0.5 * (low + high)
    bounds = np.maximum.reduceat(np.linalg.norm(cloud - centres[block], axis=1), start[:-1])
    return PointBlocks(np.ascontiguousarray(cloud), radii, centres, bounds, start, float(radii.max()))


def _cubes(cloud: Array, edge_m: float) -> Int64:
    """Number the cube of a lattice that each point lies in, (N,)."""
    cells = np.floor((cloud - cloud.min(axis=0)) / edge_m).astype(np.int64)
    columns, rows = cells[:, 2].max() + 1, cells[:, 1].max() + 1
    return np.asarray((cells[:, 0] * rows + cells[:, 1]) * columns + cells[:, 2])
