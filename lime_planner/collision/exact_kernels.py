"""What the exact checker computes before it asks FCL: which points, boxes and pairs of links can possibly touch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lime_planner.collision.link_grids import HALF_DIAGONAL_M, PITCH_M, LinkGrids
from lime_planner.core.jit import kernel
from lime_planner.core.types import Array, Bool, Int32, Int64

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


class LinkBoxes(NamedTuple):
    """Bounds of L links in the joints' frames [m].

    Attributes:
        joint: (L,) int64, the joint each link moves with, 0 for the base.
        gripper: (L,) bool.
        centre: (L, 3) of the bounding box.
        half: (L, 3) half its edges.
        hull: (H, 3) corners of the links' convex hulls; hull_start: (L + 1,) each link's range.
    """

    joint: Int64
    gripper: Bool
    centre: Array
    half: Array
    hull: Array
    hull_start: Int64


@kernel
def link_extents(boxes: LinkBoxes, poses: Array, out: Array) -> None:
    """Write the exact axis-aligned extents (L, 2, 3) of every link in the planning frame, from its convex hull's corners."""
    for k in range(boxes.joint.shape[0]):
        pose = poses[boxes.joint[k]]
        for r in range(3):
            low, high = np.inf, -np.inf
            for i in range(boxes.hull_start[k], boxes.hull_start[k + 1]):
                v = pose[r, 0] * boxes.hull[i, 0] + pose[r, 1] * boxes.hull[i, 1] + pose[r, 2] * boxes.hull[i, 2]
                low, high = min(low, v), max(high, v)
            out[k, 0, r], out[k, 1, r] = low + pose[r, 3], high + pose[r, 3]


@kernel
def boxes_meet(boxes: LinkBoxes, poses: Array, i: int, j: int) -> bool:
    """Tell whether the oriented bounding boxes of two links overlap (separating axis test, Gottschalk et al. 1996)."""
    a, b = poses[boxes.joint[i]], poses[boxes.joint[j]]
    rotation, size = np.empty((3, 3)), np.empty((3, 3))
    d, t = np.empty(3), np.empty(3)
    for r in range(3):
        d[r] = b[r, 3] - a[r, 3]
        for c in range(3):
            d[r] += b[r, c] * boxes.centre[j, c] - a[r, c] * boxes.centre[i, c]
    ha, hb = boxes.half[i], boxes.half[j]
    for r in range(3):
        t[r] = a[0, r] * d[0] + a[1, r] * d[1] + a[2, r] * d[2]
        for c in range(3):
            rotation[r, c] = a[0, r] * b[0, c] + a[1, r] * b[1, c] + a[2, r] * b[2, c]
            size[r, c] = abs(rotation[r, c]) + 1e-9
    for r in range(3):
        if abs(t[r]) > ha[r] + hb[0] * size[r, 0] + hb[1] * size[r, 1] + hb[2] * size[r, 2]:
            return False
        along = t[0] * rotation[0, r] + t[1] * rotation[1, r] + t[2] * rotation[2, r]
        if abs(along) > hb[r] + ha[0] * size[0, r] + ha[1] * size[1, r] + ha[2] * size[2, r]:
            return False
    for r in range(3):
        r1, r2 = (r + 1) % 3, (r + 2) % 3
        for c in range(3):
            c1, c2 = (c + 1) % 3, (c + 2) % 3
            reach = ha[r1] * size[r2, c] + ha[r2] * size[r1, c] + hb[c1] * size[r, c2] + hb[c2] * size[r, c1]
            if abs(t[r2] * rotation[r1, c] - t[r1] * rotation[r2, c]) > reach:
                return False
    return True


@kernel
def near_pairs(boxes: LinkBoxes, poses: Array, pairs: Int64, out: Int64) -> int:
    """Write the indices of `pairs` (K, 2) whose links' bounding boxes overlap; return their number."""
    count = 0
    for k in range(pairs.shape[0]):
        if boxes_meet(boxes, poses, pairs[k, 0], pairs[k, 1]):
            out[count] = k
            count += 1
    return count


@kernel
def near_points(
    boxes: LinkBoxes,
    grids: LinkGrids,
    poses: Array,
    blocks: PointBlocks,
    spared: Bool,
    sparing: bool,
    links: Int64,
    points: Int64,
    gaps: Array,
) -> int:
    """Collect every pair of link and point whose ball may touch the link.

    Args:
        boxes: the links' bounds.
        grids: the links' voxels, their padding at least the largest radius plus half a voxel's diagonal.
        poses: joint frames, (n + 1, 3, 4).
        blocks: the cloud.
        spared: (P,) bool, points that do not count for the gripper's links while `sparing`.
        sparing: see `spared`.
        links: written: index of each pair's link.
        points: written: index of each pair's point.
        gaps: written: a lower bound of the distance between surface and ball [m]; -inf for a point in an enclosed voxel, with which
            the collection ends.

    Returns:
        The number of pairs; more than fit into the arrays if they are too short.
    """
    count = 0
    inverse = 1.0 / PITCH_M
    for k in range(boxes.joint.shape[0]):
        pose = poses[boxes.joint[k]]
        skip = sparing and boxes.gripper[k]
        r00, r01, r02, tx = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
        r10, r11, r12, ty = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
        r20, r21, r22, tz = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
        nx, ny, nz = grids.size[k, 0], grids.size[k, 1], grids.size[k, 2]
        ox, oy, oz = grids.origin[k, 0], grids.origin[k, 1], grids.origin[k, 2]
        cx, cy, cz = boxes.centre[k, 0], boxes.centre[k, 1], boxes.centre[k, 2]
        hx, hy, hz = boxes.half[k, 0] + grids.padding, boxes.half[k, 1] + grids.padding, boxes.half[k, 2] + grids.padding
        for b in range(blocks.bounds.shape[0]):
            x, y, z = blocks.centres[b, 0] - tx, blocks.centres[b, 1] - ty, blocks.centres[b, 2] - tz
            dx = max(abs(r00 * x + r10 * y + r20 * z - cx) - hx, 0.0)
            dy = max(abs(r01 * x + r11 * y + r21 * z - cy) - hy, 0.0)
            dz = max(abs(r02 * x + r12 * y + r22 * z - cz) - hz, 0.0)
            if dx * dx + dy * dy + dz * dz > blocks.bounds[b] ** 2:
                continue
            for i in range(blocks.start[b], blocks.start[b + 1]):
                x, y, z = blocks.points[i, 0] - tx, blocks.points[i, 1] - ty, blocks.points[i, 2] - tz
                u = math.floor((r00 * x + r10 * y + r20 * z - ox) * inverse)
                v = math.floor((r01 * x + r11 * y + r21 * z - oy) * inverse)
                w = math.floor((r02 * x + r12 * y + r22 * z - oz) * inverse)
                if u < 0.0 or v < 0.0 or w < 0.0 or u >= nx or v >= ny or w >= nz:
                    continue
                value = float(grids.values[grids.start[k] + (int(u) * ny + int(v)) * nz + int(w)])
                gap = value - HALF_DIAGONAL_M - blocks.radii[i]
                if gap > 1e-6 or (skip and spared[i]):
                    continue
                if count < links.shape[0]:
                    links[count], points[count], gaps[count] = k, i, gap
                    if value < 0.0:
                        gaps[count] = -np.inf
                        return count + 1
                count += 1
    return count


@kernel
def lower_bounds(boxes: LinkBoxes, grids: LinkGrids, poses: Array, blocks: PointBlocks, spared: Bool, sparing: bool, bound: Array) -> None:
    """Write lower bounds (L, P) of the signed distance of every point to every link's surface [m].

    -inf for a point in an enclosed voxel, inf where the point does not count for the link (see `near_points`).
    """
    inverse = 1.0 / PITCH_M
    for k in range(boxes.joint.shape[0]):
        pose = poses[boxes.joint[k]]
        skip = sparing and boxes.gripper[k]
        for i in range(blocks.points.shape[0]):
            if skip and spared[i]:
                bound[k, i] = np.inf
                continue
            x, y, z = blocks.points[i, 0] - pose[0, 3], blocks.points[i, 1] - pose[1, 3], blocks.points[i, 2] - pose[2, 3]
            outside, index = 0.0, 0
            inside = True
            for c in range(3):
                local = pose[0, c] * x + pose[1, c] * y + pose[2, c] * z
                gap = max(abs(local - boxes.centre[k, c]) - boxes.half[k, c], 0.0)
                outside += gap * gap
                at = math.floor((local - grids.origin[k, c]) * inverse)
                inside = inside and at >= 0.0 and at < grids.size[k, c]
                index = index * grids.size[k, c] + int(at)
            value = math.sqrt(outside)
            if inside:
                stored = float(grids.values[grids.start[k] + index])
                if stored < 0.0:
                    value = -np.inf
                elif stored <= HALF_DIAGONAL_M + 1e-6:  # a voxel on the surface: the point may be inside, which counts as negative
                    value = -stored - HALF_DIAGONAL_M
                else:
                    value = max(value, stored - HALF_DIAGONAL_M)
            bound[k, i] = value


@kernel
def winding_number(vertices: Array, triangles: Int32, x: float, y: float, z: float) -> float:
    """Return how often a mesh winds round a point: 1 inside a closed one, 0 outside, in between near a hole.

    Sum of the triangles' solid angles (Van Oosterom and Strackee 1983) over 4π, as in Jacobson et al. 2013.
    """
    total = 0.0
    for t in range(triangles.shape[0]):
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        ax, ay, az = a[0] - x, a[1] - y, a[2] - z
        bx, by, bz = b[0] - x, b[1] - y, b[2] - z
        cx, cy, cz = c[0] - x, c[1] - y, c[2] - z
        la, lb, lc = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz), math.sqrt(cx * cx + cy * cy + cz * cz)
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
        total += math.atan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return total / (2.0 * math.pi)
