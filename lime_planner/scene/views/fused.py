"""What several pictures of a plant show together: an older point stays until a ray of a newer picture passes through it.

A ray passed through a point where the newer picture shows, in the direction of the point and all around it, something farther away: around
stems and fruit so far that cameras whose calibrations are 5 mm and 1° apart forget none of them for each other.
A direction without a return tells nothing: depth cameras return nothing from the sky, from dark leaves and beyond their range alike.
What was passed stays a blocking point of its own picture, whose rays ended there: nothing is known of what it hid then.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array, Bool, Float32
from lime_planner.scene.clean import subset
from lime_planner.scene.scene import Scene, merged
from lime_planner.scene.views.depth_map import cell_of, nearest_hits
from lime_planner.scene.voxels import frozen

PASSED_M = 0.02  #: a ray must end this far behind a point to have passed through it: noise and calibration are less
_CELL_M = 0.006  # of the map of a picture, at the middle distance of its hits
_AROUND_LEAF, _AROUND_STEM = 1, 3  # cells on each side of a point's direction in which nothing may have stopped a ray
_LEAST_AROUND = 0.44  # share of these cells, the point's own included, that a return must have come from


@kernel
def _passed(points: Any, origin: Any, depths: Any, behind: float, beside: int, least: float) -> Any:
    """Tell through which points rays passed."""
    cells = depths.shape[1]
    passed = np.zeros(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        face, row, column, distance = cell_of(points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2], cells)
        if distance <= 0.0:
            continue
        around, stopped = 0, False
        for r in range(max(0, row - beside), min(cells, row + beside + 1)):
            for c in range(max(0, column - beside), min(cells, column + beside + 1)):
                depth = depths[face, r, c]
                if depth > 0.0:
                    around += 1
                    stopped = stopped or depth < distance + behind
        passed[i] = around >= least * (2 * beside + 1) ** 2 and not stopped
    return passed


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """What one camera saw at one moment.

    Attributes:
        scene: its points, those that later pictures passed through already left out.
        taken_s: when, on any clock that does not jump [s].
    """

    scene: Scene
    taken_s: float

    @property
    def known(self) -> bool:
        """Whether it is known where all of it was seen from."""
        return self.scene.viewpoints is not None and len(self.scene.viewpoints) > 0


class Rays:
    """The rays of a picture, as far as they returned."""

    def __init__(self, picture: Picture) -> None:
        """Draw the maps of its viewpoints."""
        self._maps: list[tuple[Array, Float32]] = []
        viewpoints = picture.scene.viewpoints
        for k, hits in enumerate(picture.scene.hits_by_view()):
            if viewpoints is None or not len(hits):
                continue
            origin = viewpoints[k].astype(np.float64)
            self._maps.append((origin, nearest_hits(hits, origin, _CELL_M)))

    def through(self, points: Float32, beside: int) -> Bool:
        """Tell which points (N, 3) some ray passed through, and no ray was stopped so many cells beside them, (N,)."""
        passed: Bool = np.zeros(len(points), np.bool_)
        for origin, depths in self._maps:
            if len(points):
                passed |= _passed(frozen(points), origin, depths, PASSED_M, beside, _LEAST_AROUND)
        return passed

    def left_of(self, picture: Picture) -> Picture:
        """Return an older picture without the points that these rays passed through."""
        scene = picture.scene
        passed = [self.through(scene.leaf_points, _AROUND_LEAF)]
        passed += [self.through(points, _AROUND_STEM) for points in (scene.stem_points, scene.fruit_points)]
        if not any(part.any() for part in passed):
            return picture
        return dataclasses.replace(picture, scene=subset(scene, *(~part for part in passed), reason="passed_through"))


def add_picture(pictures: Sequence[Picture], newer: Picture) -> list[Picture]:
    """Return the pictures with one more, each without what the rays of newer ones passed through; oldest first."""
    older = [picture for picture in pictures if picture.taken_s <= newer.taken_s]
    later = [picture for picture in pictures if picture.taken_s > newer.taken_s]
    rays = Rays(newer)
    for picture in later:  # one that came late is judged by those taken after it
        newer = Rays(picture).left_of(newer)
    return [*(rays.left_of(picture) for picture in older), newer, *later]


def fused(pictures: Sequence[Picture], frame_id: str) -> Scene:
    """Put pictures together into one scene."""
    return pictures[0].scene if len(pictures) == 1 else merged([picture.scene for picture in pictures], frame_id)


def warm_up() -> None:
    """Run every kernel once, so that no request pays for compilation."""
    points = np.random.default_rng(0).uniform(0.4, 0.5, (64, 3)).astype(np.float32)
    picture = Picture(Scene.from_points(points, np.arange(64) % 2, viewpoints=[[0.0, 0.0, 0.0]]), 0.0)
    add_picture([picture], picture)
