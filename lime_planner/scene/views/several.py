"""Which of several cameras saw a point of the cloud that they have together, as a driver or a merging node publishes it.

A camera sees a point where nothing of the cloud lies before it, in its direction and beside it; the cloud holds all that each of the
cameras saw, so that what hid a point from one of them is in it. Points that more than one camera saw end rays of each: the first has them
as its own, for the others they are blocking points.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array, Bool, Float32, Int16
from lime_planner.scene.scene import VIEW_IDS, Scene
from lime_planner.scene.views.depth_map import cell_of, nearest_hits
from lime_planner.scene.voxels import frozen

BEHIND_M = 0.01  #: a point this far behind the nearest one in its direction is hidden: noise and slanted surfaces are less
_CELL_M = 0.006  # of the map of a camera, at the middle distance of the points


@kernel
def _in_sight(points: Any, origin: Any, depths: Any, behind: float) -> Any:
    """Tell which points have nothing before them, in their own cell and in those beside it."""
    cells = depths.shape[1]
    seen = np.zeros(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        face, row, column, distance = cell_of(points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2], cells)
        hidden = not distance > 0.0
        for r in range(max(0, row - 1), min(cells, row + 2)):
            for c in range(max(0, column - 1), min(cells, column + 2)):
                depth = depths[face, r, c]
                hidden = hidden or (depth > 0.0 and depth < distance - behind)
        seen[i] = not hidden
    return seen


class Sight:
    """What a camera sees of a cloud that may hide parts of itself."""

    def __init__(self, origin: Array, hiding: Float32) -> None:
        """Draw the map of a camera at an origin (3,) [m] before points (H, 3) [m]."""
        self._origin = origin.astype(np.float64)
        self._depths = nearest_hits(hiding, self._origin, _CELL_M) if len(hiding) else None

    def of(self, points: Float32) -> Bool:
        """Tell which of the cloud's points (N, 3) the camera sees, (N,)."""
        if not len(points) or self._depths is None:
            return np.zeros(len(points), np.bool_)
        seen: Bool = _in_sight(frozen(points), self._origin, self._depths, BEHIND_M)
        return seen


def seen_by_several(points: Float32, viewpoints: Array) -> tuple[Int16, Float32, Int16]:
    """Say which camera saw each point of a cloud.

    Args:
        points: (N, 3), in one frame with the viewpoints [m]; rows that are not finite are nobody's.
        viewpoints: (V, 3) [m].

    Returns:
        The number of the first camera that sees each point, -1 for none (N,); the points that others see too (B, 3) [m]; and the
        number of the camera of each of these (B,).
    """
    ids = np.full(len(points), -1, np.int16)
    finite = np.isfinite(points).all(axis=1)
    hiding = points[finite]
    also: list[tuple[Float32, Int16]] = []
    for number, place in enumerate(viewpoints):
        seen: Bool = np.array(finite)
        seen[finite] = Sight(place, hiding).of(hiding)
        again = seen & (ids >= 0)
        also.append((points[again], np.full(int(again.sum()), number, np.int16)))
        ids[seen & (ids < 0)] = number
    others, by = (np.concatenate(columns) for columns in zip(*also, strict=True)) if also else (np.empty((0, 3), np.float32), ids[:0])
    return ids, others, by


def without_hidden(scene: Scene) -> Scene:
    """Return a scene in which no camera has a point as its hit that another of the scene's points hides from it.

    For scenes that were put together of clouds of several cameras, leaves and stems say: what hides a stem may lie among the leaves.
    """
    viewpoints = scene.viewpoints
    if viewpoints is None or len(viewpoints) < 2:
        return scene
    classes = {name: getattr(scene, name.replace("_view_ids", "_points")) for name in (*VIEW_IDS, "blocking_view_ids")}
    columns = {name: getattr(scene, name).copy() for name in classes if getattr(scene, name) is not None}
    hiding = np.concatenate([points for points in classes.values() if points is not None])
    for number, place in enumerate(viewpoints):
        sight = Sight(place, hiding)
        for name, ids in columns.items():
            own = np.flatnonzero(ids == number)
            ids[own[~sight.of(classes[name][own])]] = -1
    by = columns.get("blocking_view_ids")
    if by is not None:
        columns["blocking_points"], columns["blocking_view_ids"] = classes["blocking_view_ids"][by >= 0], by[by >= 0]
    return dataclasses.replace(scene, **columns)


def warm_up() -> None:
    """Run every kernel once, so that no request pays for compilation."""
    seen_by_several(np.random.default_rng(0).uniform(0.4, 0.5, (64, 3)).astype(np.float32), np.zeros((1, 3)))
