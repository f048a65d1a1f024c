"""Distances from the nodes of a grid to the nearest of many points: exact close to the points, a lower bound farther away."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array, Float32, Int64

_BAND_NODES = 3.6  # distances up to this many spacings are exact at the nodes
_SLICE_NODES = 500_000  # and this many points: what is done between two looks at whether the caller has had enough, 10 ms or so
_SLICE_POINTS = 10_000


@kernel
def _splat(points: Any, origin: Any, h: Any, radius: Any, squares: Any, seeds: Any) -> Any:
    """Write each node's squared distance to its nearest point, exact within `radius`; mark the node nearest to each point."""
    nx, ny, nz = squares.shape
    inverse = 1.0 / h
    for i in range(points.shape[0]):
        x = (points[i, 0] - origin[0]) * inverse
        y = (points[i, 1] - origin[1]) * inverse
        z = (points[i, 2] - origin[2]) * inverse
        r = radius * inverse
        seeds[int(x + 0.5), int(y + 0.5), int(z + 0.5)] = 0.0
        for a in range(max(0, int(math.ceil(x - r))), min(nx - 1, int(x + r)) + 1):
            dx = (a - x) * (a - x)
            wy = math.sqrt(max(0.0, r * r - dx))
            for b in range(max(0, int(math.ceil(y - wy))), min(ny - 1, int(y + wy)) + 1):
                dxy = dx + (b - y) * (b - y)
                wz = math.sqrt(max(0.0, r * r - dxy))
                for c in range(max(0, int(math.ceil(z - wz))), min(nz - 1, int(z + wz)) + 1):
                    d = np.float32(dxy + (c - z) * (c - z))
                    if d < squares[a, b, c]:
                        squares[a, b, c] = d


@kernel
def _parabolas(f: Any, n: Any, v: Any, z: Any, out: Any) -> Any:
    """One line of the exact Euclidean distance transform (lower envelope of parabolas, Felzenszwalb and Huttenlocher 2012)."""
    k = -1
    for q in range(n):
        if f[q] >= 1e11:
            continue
        if k < 0:
            k = 0
            v[0] = q
            z[0] = -1e12
            z[1] = 1e12
            continue
        s = ((f[q] + q * q) - (f[v[k]] + v[k] * v[k])) / (2.0 * (q - v[k]))
        while s <= z[k]:
            k -= 1
            s = ((f[q] + q * q) - (f[v[k]] + v[k] * v[k])) / (2.0 * (q - v[k]))
        k += 1
        v[k] = q
        z[k] = s
        z[k + 1] = 1e12
    if k < 0:
        for q in range(n):
            out[q] = 1e12
        return
    k = 0
    for q in range(n):
        while z[k + 1] < q:
            k += 1
        d = q - v[k]
        out[q] = d * d + f[v[k]]


@kernel
def _transform_yz(g: Any, first: int, last: int) -> Any:
    """Squared Euclidean distance transform in node units, in place, along z and y of some planes; zeros are seeds, 1e12 elsewhere."""
    _, ny, nz = g.shape
    f = np.empty(ny)
    out = np.empty(ny)
    v = np.empty(ny, np.int64)
    z = np.empty(ny + 1)
    for a in range(first, last):
        for b in range(ny):
            seed = -1  # along z every seed is 0: the distance to the nearest one on either side is enough
            for c in range(nz):
                if g[a, b, c] == 0.0:
                    seed = c
                elif seed >= 0:
                    g[a, b, c] = np.float32((c - seed) * (c - seed))
            seed = -1
            for c in range(nz - 1, -1, -1):
                if g[a, b, c] == 0.0:
                    seed = c
                elif seed >= 0:
                    g[a, b, c] = min(g[a, b, c], np.float32((seed - c) * (seed - c)))
        for c in range(nz):
            for b in range(ny):
                f[b] = g[a, b, c]
            _parabolas(f, ny, v, z, out)
            for b in range(ny):
                g[a, b, c] = out[b]


@kernel
def _transform_x(g: Any, first: int, last: int) -> Any:
    """The rest of the transform: along x, for some rows of y."""
    nx, _, nz = g.shape
    f = np.empty(nx)
    out = np.empty(nx)
    v = np.empty(nx, np.int64)
    z = np.empty(nx + 1)
    for b in range(first, last):
        for c in range(nz):
            for a in range(nx):
                f[a] = g[a, b, c]
            _parabolas(f, nx, v, z, out)
            for a in range(nx):
                g[a, b, c] = out[a]


@kernel
def _merge(squares: Any, far: Any, h: Any, band: Any, channel: Any, values: Any, first: int, last: int) -> Any:
    """Nodes in the band keep their exact distance; the others get a lower bound from the transform between nodes. Of some planes."""
    _, ny, nz = squares.shape
    for a in range(first, last):
        for b in range(ny):
            for c in range(nz):
                s = squares[a, b, c]
                if s < 1e11:
                    values[a, b, c, channel] = math.sqrt(s) * h
                else:
                    values[a, b, c, channel] = max(band, (math.sqrt(far[a, b, c]) - 0.8661) * h)


def _slices(count: int, size: int, pause: Callable[[], None]) -> Iterator[tuple[int, int]]:
    for first in range(0, count, max(size, 1)):
        pause()
        yield first, min(first + max(size, 1), count)


def filled(shape: tuple[int, ...], value: float, pause: Callable[[], None]) -> Float32:
    """Return an array of one value; the system hands out a hundred megabytes no faster than they can be written.

    Args:
        shape: of the array.
        value: of every element.
        pause: see `fill_channel`.
    """
    array = np.empty(shape, np.float32)
    for first, last in _slices(shape[0], 4 * _SLICE_NODES // max(int(np.prod(shape[1:])), 1), pause):
        array[first:last] = value
    return array


def fill_from_nodes(nodes: Int64, spacing_m: float, channel: int, values: Float32, pause: Callable[[], None]) -> None:
    """Write the exact distances to points that are nodes themselves into one channel of a grid.

    Args:
        nodes: (P, 3) their indices, P at least 1.
        spacing_m: distance between nodes.
        channel: last index of the values to write.
        values: (nx, ny, nz, C) distances [m].
        pause: see `fill_channel`.
    """
    shape = values.shape[:3]
    squares = filled(shape, 1e12, pause)
    squares[tuple(nodes.T)] = 0.0
    planes, rows = _SLICE_NODES // (shape[1] * shape[2]), _SLICE_NODES // (shape[0] * shape[2])
    for first, last in _slices(shape[0], planes, pause):
        _transform_yz(squares, first, last)
    for first, last in _slices(shape[1], rows, pause):
        _transform_x(squares, first, last)
    for first, last in _slices(shape[0], planes, pause):
        values[first:last, :, :, channel] = np.sqrt(squares[first:last]) * np.float32(spacing_m)


def fill_channel(
    points: Float32,
    origin: Array,
    spacing_m: float,
    channel: int,
    values: Float32,
    pause: Callable[[], None],
) -> None:
    """Write the distances to points into one channel of a grid.

    Args:
        points: (P, 3) [m], P at least 1, at least a spacing inside the grid.
        origin: (3,) position of node 0, 0, 0 [m].
        spacing_m: distance between nodes.
        channel: last index of the values to write.
        values: (nx, ny, nz, C) distances [m]: exact up to 3.6 spacings, beyond that a lower bound (short by at most 1.8 spacings).
        pause: called every ten milliseconds or so; what it raises ends the work.
    """
    shape = values.shape[:3]
    squares, seeds = (filled(shape, 1e12, pause) for _ in range(2))
    band = np.float32(_BAND_NODES * spacing_m)
    planes, rows = _SLICE_NODES // (shape[1] * shape[2]), _SLICE_NODES // (shape[0] * shape[2])
    for first, last in _slices(len(points), _SLICE_POINTS, pause):
        _splat(points[first:last], origin, spacing_m, _BAND_NODES * spacing_m, squares, seeds)
    for first, last in _slices(shape[0], planes, pause):
        _transform_yz(seeds, first, last)
    for first, last in _slices(shape[1], rows, pause):
        _transform_x(seeds, first, last)
    for first, last in _slices(shape[0], planes, pause):
        _merge(squares, seeds, spacing_m, band, channel, values, first, last)
