"""What the views of a scene show together: which space around the plant was seen, and which none of them looked into.

A place is *unseen* where it lies behind what some view hit, at most `SHADOW_M` behind it, and no view looked past it; and that only within
the box of the plant's points and `AROUND_M` around it. Elsewhere nothing counts as unseen: outside of every picture a cloud says nothing,
and what stands behind the plant is not the planner's question. Whatever ended a ray casts a shadow, the arm itself included.

Memory grows with the shadows: voxels are made in blocks along them, the box itself is held as one byte for each block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.jit import inline_kernel, kernel
from lime_planner.core.types import Array, Float32, Int32, UInt8
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.depth_map import DepthMap, cell_of, direction_of, make_depth_map

SHADOW_M = 0.4  #: how far behind a hit space counts as unseen: through a canopy, not to the wall behind it
AROUND_M = 0.05  #: how far around the box of the plant's points
MOST_VIEWS = 64  #: those with the most hits; what only others looked through stays unseen

#: What `SeenMap.classify` answers: seen and nothing there (or too far from the plant to matter), unseen, or a point of a class.
FREE, UNSEEN, LEAF, STEM, FRUIT = range(5)

_BLOCK = 8  # voxels along an edge of a block
_MOST_BLOCKS = 50_000_000
_HIDDEN, _PASSED = 1, 2


@dataclass(frozen=True, eq=False)
class SeenMap:
    """What the views of a scene show.

    Attributes:
        views: a depth map for each view; none where no point's viewpoint is known.
        voxel_m: edge of a voxel [m].
        unseen: (K, 3) middles of the unseen voxels [m].
        origin: (3,) corner of the first voxel [m].
        points: the leaf, the stem and the fruit points, (N, 3) each [m].
    """

    views: tuple[DepthMap, ...]
    voxel_m: float
    unseen: Float32
    origin: Array
    points: tuple[Float32, Float32, Float32]

    @property
    def unseen_volume_m3(self) -> float:
        """Volume of the unseen space [m³]."""
        return len(self.unseen) * self.voxel_m**3

    def classify(self, places: npt.ArrayLike) -> UInt8:
        """Return what is known of the voxels of places (P, 3) [m]: FREE, UNSEEN, LEAF, STEM or FRUIT, (P,), the last that applies."""
        asked = self._voxels(np.asarray(places, dtype=np.float64).reshape(-1, 3))
        found = np.full(len(asked), FREE, np.uint8)
        for code, points in zip((UNSEEN, LEAF, STEM, FRUIT), (self.unseen, *self.points), strict=True):
            own = np.unique(_keys(self._voxels(points)))
            at = np.searchsorted(own, _keys(asked))
            if len(own):
                found[own[np.minimum(at, len(own) - 1)] == _keys(asked)] = code
        return found

    def _voxels(self, places: npt.NDArray[np.floating]) -> npt.NDArray[np.int64]:
        return np.floor((places - self.origin) / self.voxel_m).astype(np.int64)


def _keys(voxels: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    x, y, z = (voxels + (1 << 20)).T
    return np.asarray((x << 42) | (y << 21) | z)


@kernel
def _mark_blocks(depths: Any, origin: Any, low: Any, edge: float, reach: float, marked: Any) -> None:
    """Mark the blocks that lie behind the hits of a view."""
    cells = depths.shape[1]
    steps = int(np.ceil(reach / (0.5 * edge))) + 1
    for face in range(6):
        for row in range(cells):
            for column in range(cells):
                depth = depths[face, row, column]
                if depth <= 0.0 or depth == np.inf:
                    continue
                x, y, z, length = direction_of(face, row, column, cells)
                x, y, z = x / length, y / length, z / length
                for step in range(steps):
                    t = depth + min(step * 0.5 * edge, reach)
                    px = (origin[0] + x * t - low[0]) / edge
                    py = (origin[1] + y * t - low[1]) / edge
                    pz = (origin[2] + z * t - low[2]) / edge
                    if px < 0.0 or py < 0.0 or pz < 0.0:
                        continue
                    i, j, k = int(px), int(py), int(pz)
                    if i < marked.shape[0] and j < marked.shape[1] and k < marked.shape[2]:
                        marked[i, j, k] = 1


@inline_kernel
def _judged(known: Any, distance: Any, depth: Any, near: Any, reach: Any) -> Any:
    """What is known of a place once a view has looked towards it, how far it saw there, and how far the place is away."""
    if depth <= 0.0:
        return known
    if distance < depth + near:
        return _PASSED  # before the hit, or at it: what is there is in the cloud
    return _HIDDEN if distance < depth + reach else known


@kernel
def _judge(blocks: Any, state: Any, low: Any, voxel: float, depths: Any, origin: Any, near: float, reach: float) -> None:
    """Mark the voxels of blocks that a view looked past, and those in its shadow."""
    cells = depths.shape[1]
    size = _BLOCK
    half = 0.5 * size * voxel
    first = np.empty(3)  # middle of a block's first voxel, seen from the sensor
    for b in range(blocks.shape[0]):
        for k in range(3):
            first[k] = low[k] + (blocks[b, k] * size + 0.5) * voxel - origin[k]
        to_middle = half - 0.5 * voxel
        mx, my, mz = abs(first[0] + to_middle), abs(first[1] + to_middle), abs(first[2] + to_middle)
        if mx >= my and mx >= mz:
            along, rows, columns, others = 0, 1, 2, max(my, mz)
        elif my >= mz:
            along, rows, columns, others = 1, 0, 2, max(mx, mz)
        else:
            along, rows, columns, others = 2, 0, 1, max(mx, my)
        if max(mx, my, mz) - half > others + half:  # the whole block lies behind one face of the cube
            face = 2 * along + (0 if first[along] > 0.0 else 1)
            step_along, step_row, step_column = size ** (2 - along), size ** (2 - rows), size ** (2 - columns)
            for i in range(size):
                w = abs(first[along] + i * voxel)
                scale = 0.5 * cells / w
                for j in range(size):
                    u = first[rows] + j * voxel
                    row = min(int(u * scale + 0.5 * cells), cells - 1)
                    square = w * w + u * u
                    at = i * step_along + j * step_row
                    for k in range(size):
                        if state[b, at] != _PASSED:
                            v = first[columns] + k * voxel
                            depth = depths[face, row, min(int(v * scale + 0.5 * cells), cells - 1)]
                            state[b, at] = _judged(state[b, at], np.sqrt(square + v * v), depth, near, reach)
                        at += step_column
            continue
        for at in range(size * size * size):
            if state[b, at] == _PASSED:
                continue
            x = first[0] + at // (size * size) * voxel
            y = first[1] + at // size % size * voxel
            z = first[2] + at % size * voxel
            face, row, column, distance = cell_of(x, y, z, cells)
            state[b, at] = _PASSED if distance == 0.0 else _judged(state[b, at], distance, depths[face, row, column], near, reach)


@kernel
def _hidden_places(blocks: Any, state: Any, low: Any, high: Any, voxel: float) -> Any:
    size = _BLOCK
    count = 0
    for b in range(blocks.shape[0]):
        for at in range(size * size * size):
            count += state[b, at] == _HIDDEN
    found = np.empty((count, 3), np.float32)
    count = 0
    for b in range(blocks.shape[0]):
        at = 0
        for i in range(size):
            x = low[0] + (blocks[b, 0] * size + i + 0.5) * voxel
            for j in range(size):
                y = low[1] + (blocks[b, 1] * size + j + 0.5) * voxel
                within = x <= high[0] and y <= high[1]
                for k in range(size):
                    if state[b, at] == _HIDDEN and within:
                        z = low[2] + (blocks[b, 2] * size + k + 0.5) * voxel
                        if z <= high[2]:
                            found[count, 0], found[count, 1], found[count, 2] = x, y, z
                            count += 1
                    at += 1
    return found[:count]


def unseen_voxels(views: Sequence[DepthMap], low: Array, high: Array, voxel_m: float, shadow_m: float = SHADOW_M) -> Float32:
    """Find the space in a box that lies behind what views hit and that none of them looked into.

    Args:
        views: all in one frame.
        low, high: (3,) corners of the box [m].
        voxel_m: edge of a voxel, the first of which begins at `low` [m].
        shadow_m: how far behind a hit space counts as unseen [m].

    Returns:
        (K, 3) middles of the unseen voxels [m].
    """
    if not views or (high <= low).any():
        return np.empty((0, 3), dtype=np.float32)
    edge_m = _BLOCK * voxel_m
    shape = np.floor((high - low) / edge_m).astype(np.int64) + 1
    if float(np.prod(shape.astype(np.float64))) > _MOST_BLOCKS:
        raise ValueError(f"a box of {np.round(high - low, 2).tolist()} m holds more than {_MOST_BLOCKS} blocks of {edge_m:.3f} m")
    marked = np.zeros(tuple(int(n) for n in shape), np.uint8)
    for view in views:
        _mark_blocks(view.depths, view.origin, low, edge_m, shadow_m, marked)
    blocks: Int32 = np.ascontiguousarray(np.argwhere(marked), dtype=np.int32)
    state = np.zeros((len(blocks), _BLOCK**3), np.uint8)
    for view in views:
        _judge(blocks, state, low, voxel_m, view.depths, view.origin, 0.5 * voxel_m, shadow_m)
    found: Float32 = _hidden_places(blocks, state, low, high, voxel_m)
    return found


def make_seen_map(scene: Scene, voxel_m: float, *, reach_m: float = np.inf) -> SeenMap:
    """Make the map of what a scene's views show.

    Args:
        scene: its `viewpoints` say where points were seen from. Points of unknown origin cast no shadow; without any viewpoint nothing
            is unseen.
        voxel_m: edge of a voxel [m].
        reach_m: nothing is looked for farther than this from the frame's origin, along each axis [m].
    """
    classes = (scene.leaf_points, scene.stem_points, scene.fruit_points)
    plant = [points for points in classes if len(points)]
    none = SeenMap((), voxel_m, np.empty((0, 3), np.float32), np.zeros(3), classes)
    if scene.viewpoints is None or not plant:
        return none
    # A thinned cloud has gaps, through which no ray went: cells as wide as these.
    cell_m = max(voxel_m, 2.0 * scene.leaf_displacement_m, 2.0 * scene.stem_displacement_m)
    hits = scene.hits_by_view()
    largest = sorted(range(len(hits)), key=lambda v: len(hits[v]), reverse=True)[:MOST_VIEWS]
    views = tuple(make_depth_map(hits[v], scene.viewpoints[v], cell_m) for v in sorted(largest) if len(hits[v]))
    low = np.maximum(np.min([points.min(axis=0) for points in plant], axis=0).astype(np.float64) - AROUND_M, -reach_m)
    high = np.minimum(np.max([points.max(axis=0) for points in plant], axis=0).astype(np.float64) + AROUND_M, reach_m)
    return SeenMap(views, voxel_m, unseen_voxels(views, low, high, voxel_m), low, classes)
