"""Compiled voxel hashing: thin a cloud to one of its own points a voxel, and find points that stand alone.

SciPy and Open3D take 0.2 s to count neighbours of 100,000 points, and Open3D 28 s to thin 5 million; these take 10 ms and 1 s.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Bool, Float32, Int32

_SPAN = 1 << 20  # cells on either side of the origin that a key can hold: a kilometre of millimetres
_HASH = np.uint64(0x9E3779B97F4A7C15)


@kernel
def _key(ix: int, iy: int, iz: int) -> Any:
    return (np.int64(ix + _SPAN) << 42) | (np.int64(iy + _SPAN) << 21) | np.int64(iz + _SPAN)


@kernel
def _slot(keys: Any, shift: Any, key: Any) -> Any:
    """Return the slot that holds `key`, or the empty one (-1) where it belongs."""
    mask = keys.shape[0] - 1
    slot = np.int64((np.uint64(key) * _HASH) >> shift)
    while keys[slot] != -1 and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel
def _thin(points: Any, edge_m: float) -> Any:
    n = points.shape[0]
    # The table grows with the voxels found: one that fits the processor's cache is several times faster than one for n voxels.
    bits = 16
    shift = np.uint64(64 - bits)
    keys = np.full(1 << bits, np.int64(-1))
    voxel_in_slot = np.empty(1 << bits, np.int32)
    voxel_of = np.empty(n, np.int32)
    nearest = np.empty(n, np.int32)
    offset = np.empty(n, np.float32)
    key_of = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        fx, fy, fz = points[i, 0] / edge_m, points[i, 1] / edge_m, points[i, 2] / edge_m
        ix, iy, iz = np.floor(fx), np.floor(fy), np.floor(fz)
        # From the voxel's middle: keeping the point nearest to it keeps the others' displacement small.
        away = np.float32((fx - ix - 0.5) ** 2 + (fy - iy - 0.5) ** 2 + (fz - iz - 0.5) ** 2)
        key = _key(int(ix), int(iy), int(iz))
        slot = _slot(keys, shift, key)
        if keys[slot] != -1:
            voxel = voxel_in_slot[slot]
            voxel_of[i] = voxel
            if away < offset[voxel]:
                nearest[voxel], offset[voxel] = i, away
            continue
        keys[slot] = key
        voxel_in_slot[slot] = count
        nearest[count], offset[count], key_of[count] = i, away, key
        voxel_of[i] = count
        count += 1
        if 2 * count > keys.shape[0]:
            bits += 2
            shift = np.uint64(64 - bits)
            keys = np.full(1 << bits, np.int64(-1))
            voxel_in_slot = np.empty(1 << bits, np.int32)
            for voxel in range(count):
                slot = _slot(keys, shift, key_of[voxel])
                keys[slot], voxel_in_slot[slot] = key_of[voxel], voxel
    return nearest[:count].copy(), voxel_of


@kernel
def _farthest(points: Any, kept: Any, stands_for: Any) -> Any:
    farthest = 0.0
    for i in range(points.shape[0]):
        k = kept[stands_for[i]]
        square = 0.0
        for axis in range(3):
            square += (np.float64(points[i, axis]) - np.float64(points[k, axis])) ** 2
        farthest = max(farthest, square)
    return np.sqrt(farthest)


@kernel
def _lonely(points: Any, edge_m: float, at_least: int, bits: int) -> Any:
    n = points.shape[0]
    shift = np.uint64(64 - bits)
    keys = np.full(1 << bits, np.int64(-1))
    held = np.zeros(1 << bits, np.int32)
    slot_of = np.empty(n, np.int32)
    for i in range(n):
        key = _key(int(np.floor(points[i, 0] / edge_m)), int(np.floor(points[i, 1] / edge_m)), int(np.floor(points[i, 2] / edge_m)))
        slot = _slot(keys, shift, key)
        keys[slot] = key
        held[slot] += 1
        slot_of[i] = slot
    around = np.zeros(1 << bits, np.int32)
    for slot in range(keys.shape[0]):
        if keys[slot] == -1:
            continue
        key = keys[slot]
        ix, iy, iz = (key >> 42) - _SPAN, ((key >> 21) & 0x1FFFFF) - _SPAN, (key & 0x1FFFFF) - _SPAN
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    other = _slot(keys, shift, _key(ix + dx, iy + dy, iz + dz))
                    if keys[other] != -1:
                        around[slot] += held[other]
    lonely = np.zeros(n, np.bool_)
    for i in range(n):
        lonely[i] = around[slot_of[i]] < at_least
    return lonely


@kernel
def _keys(points: Any, edge_m: float) -> Any:
    keys = np.empty(points.shape[0], np.int64)
    for i in range(points.shape[0]):
        keys[i] = _key(int(np.floor(points[i, 0] / edge_m)), int(np.floor(points[i, 1] / edge_m)), int(np.floor(points[i, 2] / edge_m)))
    return keys


@kernel
def _linked(points: Any, seed: int, link_m: float, keys: Any, waiting: Any, ordered: Any) -> Any:
    """Flood from `seed`; `waiting` has the points cell by cell, those of a cell that are not linked yet first, `ordered` their keys."""
    n = points.shape[0]
    left = np.zeros(n, np.int64)  # how many those are, where a cell begins
    begin = 0
    for k in range(1, n + 1):
        if k == n or ordered[k] != ordered[begin]:
            left[begin] = k - begin
            begin = k
    linked = np.zeros(n, np.bool_)
    front = np.empty(n, np.int64)
    front[0], count = seed, 1  # the seed is found again among its neighbours
    while count > 0:
        count -= 1
        x, y, z, key = points[front[count], 0], points[front[count], 1], points[front[count], 2], keys[front[count]]
        ix, iy, iz = (key >> 42) - _SPAN, ((key >> 21) & 0x1FFFFF) - _SPAN, (key & 0x1FFFFF) - _SPAN
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    other = _key(ix + dx, iy + dy, iz + dz)
                    cell, end = 0, n  # the first that is not less
                    while cell < end:
                        half = (cell + end) // 2
                        if ordered[half] < other:
                            cell = half + 1
                        else:
                            end = half
                    if cell == n or ordered[cell] != other:
                        continue
                    k = cell
                    while k < cell + left[cell]:
                        i = waiting[k]
                        square = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 + (points[i, 2] - z) ** 2
                        if square > link_m * link_m:
                            k += 1
                            continue
                        left[cell] -= 1
                        last = cell + left[cell]
                        waiting[k], waiting[last] = waiting[last], i
                        linked[i] = True
                        front[count] = i
                        count += 1
    return linked


def frozen(points: Float32) -> Float32:
    """Return points as kernels take them: a scene's arrays are read-only, others are not, and Numba would compile each kernel twice."""
    view = np.ascontiguousarray(points).view()
    view.setflags(write=False)
    return view


def _bits(n: int) -> int:
    return max(4, int(2 * n).bit_length())


def thin(points: Float32, edge_m: float) -> tuple[Int32, Int32]:
    """Keep, of each voxel, the point nearest to its middle.

    Args:
        points: (N, 3) finite, within 2^20 voxels of the origin [m].
        edge_m: edge of the voxels.

    Returns:
        Indices of the kept points (K,), and for each point (N,) which of them stands for it.
    """
    kept, stands_for = _thin(frozen(points), float(edge_m))
    return kept, stands_for


def displacement(points: Float32, kept: Int32, stands_for: Int32) -> float:
    """Return the largest distance [m] from a point to the kept one that stands for it; at most √3 edges, usually little over one."""
    return float(_farthest(frozen(points), kept, stands_for))


def lonely(points: Float32, radius_m: float, neighbours: int) -> Bool:
    """Tell which points (N,) have fewer than `neighbours` others in the block of 3³ cells of edge `radius_m` around them.

    The block holds the ball of `radius_m`: a point with enough neighbours in the ball is never called lonely.
    """
    result: Bool = _lonely(frozen(points), float(radius_m), neighbours + 1, _bits(len(points)))
    return result


def linked(points: Float32, seed: int, link_m: float) -> Bool:
    """Tell which points (N,) are reached from point `seed` by steps of at most `link_m` from point to point."""
    some = frozen(points)
    keys = _keys(some, float(link_m))
    waiting = np.argsort(keys, kind="stable")  # here: a sort compiled by Numba takes seconds to compile
    result: Bool = _linked(some, seed, float(link_m), keys, waiting, keys[waiting])
    return result


def warm_up() -> None:
    """Compile the kernels, or load them from the cache: 2 s or 0.1 s."""
    points = np.zeros((2, 3), dtype=np.float32)
    displacement(points, *thin(points, 0.01))
    lonely(points, 0.01, 1)
    linked(points, 0, 0.01)
