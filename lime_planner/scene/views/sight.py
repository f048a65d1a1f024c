"""What a camera at a place would see of unseen space: rays cast through voxels of what is known.

What was seen hides what is behind it. Unseen space may hold anything: a ray is taken to come through it as often as light comes through
foliage, less often the longer its way there is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array, Float32, UInt8
from lime_planner.scene.voxels import frozen

#: Of unseen space: light falls to 1/e on a way of 40 cm. Foliage with 5 m² of leaves in a cubic metre, turned every way, has that.
EXTINCTION_PER_M = 2.5

_UNSEEN, _THING = 1, 2
_MOST_VOXELS = 30_000_000


@dataclass(frozen=True, eq=False)
class SightMap:
    """What is known of a box of space, for rays.

    Attributes:
        origin: (3,) its lowest corner [m].
        voxel_m: edge of a voxel [m].
        voxels: (X, Y, Z) 0 for seen and free, 1 for unseen, 2 for something that hides what is behind it.
    """

    origin: Array
    voxel_m: float
    voxels: UInt8

    def nearest_m(self, places: npt.ArrayLike, most_m: float) -> Array:
        """Return the distances from places (P, 3) to the nearest thing, by voxels, (P,), at most `most_m` [m]."""
        eyes = np.ascontiguousarray(places, dtype=np.float64).reshape(-1, 3)
        found: Array = _nearest(self.voxels, self.origin, self.voxel_m, eyes, most_m)
        return found

    def seen_from(
        self, eyes: npt.ArrayLike, aims: npt.ArrayLike, places: npt.ArrayLike, tangents: tuple[float, float], near_m: float
    ) -> Array:
        """Return how much of some places cameras would show that look at `aims`, (P,): the mean chance that a ray comes through.

        Args:
            eyes: (P, 3) where the cameras are; aims: (P, 3) what is in the middle of their pictures [m].
            places: (K, 3) what is to be shown [m].
            tangents: of half of the angles of view, across and up; the cameras are upright.
            near_m: what is nearer to a camera's picture plane is not shown.
        """
        some = np.ascontiguousarray(places, dtype=np.float64).reshape(-1, 3)
        stands, sights = (np.ascontiguousarray(rows, dtype=np.float64).reshape(-1, 3) for rows in (eyes, aims))
        loss = EXTINCTION_PER_M * self.voxel_m
        found: Array = _shares(self.voxels, self.origin, self.voxel_m, stands, sights, some, *tangents, near_m, loss)
        return found


@kernel
def _mark(voxels: Any, origin: Any, voxel: float, points: Any, what: int) -> None:
    for i in range(points.shape[0]):
        x, y, z = (points[i, 0] - origin[0]) / voxel, (points[i, 1] - origin[1]) / voxel, (points[i, 2] - origin[2]) / voxel
        if x < 0.0 or y < 0.0 or z < 0.0:
            continue
        if x < voxels.shape[0] and y < voxels.shape[1] and z < voxels.shape[2]:
            voxels[int(x), int(y), int(z)] = what


@kernel
def _nearest(voxels: Any, origin: Any, voxel: float, eyes: Any, most: float) -> Any:
    found = np.full(eyes.shape[0], most)
    for e in range(eyes.shape[0]):
        low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
        for k in range(3):
            low[k] = max(0, int(np.floor((eyes[e, k] - most - origin[k]) / voxel)))
            high[k] = min(voxels.shape[k] - 1, int(np.floor((eyes[e, k] + most - origin[k]) / voxel)))
        best = most * most
        for i in range(low[0], high[0] + 1):
            x = origin[0] + (i + 0.5) * voxel - eyes[e, 0]
            for j in range(low[1], high[1] + 1):
                y = origin[1] + (j + 0.5) * voxel - eyes[e, 1]
                if x * x + y * y >= best:
                    continue
                for k in range(low[2], high[2] + 1):
                    if voxels[i, j, k] == _THING:
                        z = origin[2] + (k + 0.5) * voxel - eyes[e, 2]
                        best = min(best, x * x + y * y + z * z)
        found[e] = np.sqrt(best)
    return found


@kernel
def _chance(voxels: Any, origin: Any, voxel: float, begin: Any, eye: Any, loss: float) -> Any:
    """The chance that a ray from a place comes through to an eye; the voxel of the place itself does not count."""
    at, step = np.empty(3, np.int64), np.empty(3, np.int64)
    until, every = np.empty(3), np.empty(3)
    length = 0.0
    for k in range(3):
        length += (eye[k] - begin[k]) ** 2
    length = np.sqrt(length) / voxel
    if length <= 0.0:
        return 1.0
    for k in range(3):
        place, way = (begin[k] - origin[k]) / voxel, (eye[k] - begin[k]) / voxel / length
        at[k] = int(np.floor(place))
        if way > 0.0:
            step[k], every[k], until[k] = 1, 1.0 / way, (at[k] + 1.0 - place) / way
        elif way < 0.0:
            step[k], every[k], until[k] = -1, -1.0 / way, (at[k] - place) / way
        else:
            step[k], every[k], until[k] = 0, np.inf, np.inf
    chance, gone, first = 0.0, 0.0, True
    while gone < length:
        k = 0
        if until[1] < until[k]:
            k = 1
        if until[2] < until[k]:
            k = 2
        after = min(until[k], length)
        inside = True
        for axis in range(3):
            if at[axis] < 0 or at[axis] >= voxels.shape[axis]:
                inside = False
        if inside and not first:
            what = voxels[at[0], at[1], at[2]]
            if what == _THING:
                return 0.0
            if what == _UNSEEN:
                chance += (after - gone) * loss
        gone, first = after, False
        at[k] += step[k]
        until[k] += every[k]
    return np.exp(-chance)


@kernel
def _shares(
    voxels: Any, origin: Any, voxel: float, eyes: Any, aims: Any, places: Any, across: float, up: float, near: float, loss: float
) -> Any:
    shares = np.zeros(eyes.shape[0])
    for e in range(eyes.shape[0]):
        forwards = aims[e] - eyes[e]
        length = np.sqrt((forwards * forwards).sum())
        if length < 1e-9:
            continue
        forwards /= length
        right = np.array([forwards[1], -forwards[0], 0.0])
        size = np.sqrt((right * right).sum())
        if size < 0.05:
            right, size = np.array([0.0, 1.0, 0.0]), 1.0
        right /= size
        down = np.array(
            [
                forwards[1] * right[2] - forwards[2] * right[1],
                forwards[2] * right[0] - forwards[0] * right[2],
                forwards[0] * right[1] - forwards[1] * right[0],
            ]
        )
        total = 0.0
        for i in range(places.shape[0]):
            offset = places[i] - eyes[e]
            z = (offset * forwards).sum()
            if z < near or abs((offset * right).sum()) > across * z or abs((offset * down).sum()) > up * z:
                continue
            total += _chance(voxels, origin, voxel, places[i], eyes[e], loss)
        shares[e] = total / max(places.shape[0], 1)
    return shares


def make_sight_map(things: Float32, unseen: Float32, low: Array, high: Array, voxel_m: float) -> SightMap:
    """Make the map of a box.

    Args:
        things: (N, 3) points that hide what is behind them [m].
        unseen: (U, 3) middles of unseen voxels [m].
        low, high: (3,) corners of the box [m].
        voxel_m: edge of a voxel, larger where the box is too large for it [m].
    """
    size = np.maximum(high - low, voxel_m)
    edge_m = max(voxel_m, float((np.prod(size) / _MOST_VOXELS) ** (1.0 / 3.0)))
    shape = np.ceil(size / edge_m).astype(np.int64) + 1
    voxels = np.zeros(tuple(int(n) for n in shape), np.uint8)
    for points, what in ((unseen, _UNSEEN), (things, _THING)):
        _mark(voxels, low, edge_m, frozen(np.asarray(points, dtype=np.float32).reshape(-1, 3)), what)
    return SightMap(low, edge_m, voxels)


def warm_up() -> None:
    """Run every kernel once."""
    things, unseen = np.array([[0.5, 0.0, 0.5]], np.float32), np.array([[0.6, 0.0, 0.5]], np.float32)
    sight = make_sight_map(things, unseen, np.zeros(3), np.ones(3), 0.1)
    sight.nearest_m([0.1, 0.1, 0.1], 0.1)
    sight.seen_from([0.1, 0.1, 0.1], unseen, unseen, (0.6, 0.5), 0.1)
