"""How far a sensor saw in each direction: a depth map over the faces of a cube around the sensor's origin.

A cube takes every field of view, a sensor inside the plant included, and needs no intrinsics. The cell of a direction holds

- the distance of its farthest hit: space nearer than that was passed by a ray, space beyond it lies in the shadow of what was hit;
- the nearest of its neighbours' where it is a hole of the sampling, a cell without a hit among cells that have one;
- infinity where rays met nothing inside the picture, the outline of all hits: there was nothing to meet, or the cloud was cropped there
  (where hits are so few that cells between them stay empty, only if no cell beside it has a hit either);
- zero outside the picture, where nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.jit import inline_kernel, kernel
from lime_planner.core.types import Array, Float32
from lime_planner.scene.voxels import frozen

_SMALLEST_CELLS, _MOST_CELLS = 32, 768  # along an edge of a face: 2.8° and 0.12° at its middle
_MOST_OF_NEAREST = 1024  # the same of a map of nearest hits
_HITS_AROUND_HOLE = 4  # of the eight cells around a cell without a hit; fewer make a gap in the plant
_DENSE = 3.0  # hits for each cell that has any: then an empty cell is a gap, whatever is beside it
_OUTLINE_DIRECTIONS = 32  # of the polygon that is drawn around a picture
_OUTLINE_POINTS = 5000  # looked at to draw it
_WIDEST_PICTURE_COS = 0.2  # a picture whose hits lie farther than 78° from its middle has no outline: the sensor stands in the plant


@dataclass(frozen=True, eq=False)
class DepthMap:
    """How far one view saw, by direction.

    Attributes:
        origin: (3,) of the sensor, in the frame of the points [m].
        depths: (6, N, N) distances from the origin [m], see the module.
    """

    origin: Array
    depths: Float32

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        self.origin.setflags(write=False)
        self.depths.setflags(write=False)


@inline_kernel
def cell_of(x: Any, y: Any, z: Any, cells: Any) -> tuple[Any, Any, Any, Any]:
    """Face, row and column of a direction (any length), and its length; length 0 for no direction."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, u, v, w = (0 if x > 0.0 else 1), y, z, ax
    elif ay >= az:
        face, u, v, w = (2 if y > 0.0 else 3), x, z, ay
    else:
        face, u, v, w = (4 if z > 0.0 else 5), x, y, az
    if w <= 0.0:
        return 0, 0, 0, 0.0
    scale = 0.5 * cells / w
    row = int(u * scale + 0.5 * cells)
    column = int(v * scale + 0.5 * cells)
    return face, min(row, cells - 1), min(column, cells - 1), np.sqrt(x * x + y * y + z * z)


@inline_kernel
def direction_of(face: Any, row: Any, column: Any, cells: Any) -> tuple[Any, Any, Any, Any]:
    """Direction of a cell's middle, on the cube of half edge 1, and its length: the inverse of `cell_of`."""
    sign = 1.0 if face % 2 == 0 else -1.0
    u, v = (2.0 * row + 1.0) / cells - 1.0, (2.0 * column + 1.0) / cells - 1.0
    length = np.sqrt(1.0 + u * u + v * v)
    if face < 2:
        return sign, u, v, length
    if face < 4:
        return u, sign, v, length
    return u, v, sign, length


@kernel
def _draw(points: Any, origin: Any, cells: int) -> Any:
    depths = np.zeros((6, cells, cells), np.float32)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        if not np.isfinite(x + y + z):
            continue
        face, row, column, distance = cell_of(x, y, z, cells)
        if distance > depths[face, row, column]:
            depths[face, row, column] = distance
    return depths


@kernel
def _draw_nearest(points: Any, origin: Any, cells: int) -> Any:
    depths = np.zeros((6, cells, cells), np.float32)
    for i in range(points.shape[0]):
        face, row, column, distance = cell_of(points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2], cells)
        if distance > 0.0 and (depths[face, row, column] == 0.0 or distance < depths[face, row, column]):
            depths[face, row, column] = distance
    return depths


@kernel
def _complete(hit: Any, outline: Any, beside: int) -> Any:
    """Fill the holes of the sampling, and open cells inside the outline, (E, 3) normals that point inwards, with few hits beside them."""
    cells = hit.shape[1]
    depths = hit.copy()
    held = np.zeros(cells, np.bool_)  # rows with a hit
    for face in range(6):
        for row in range(cells):
            held[row] = hit[face, row].any()
        for row in range(cells):
            nearby = held[max(0, row - 1) : min(cells, row + 2)].any()
            for column in range(cells):
                if hit[face, row, column] > 0.0:
                    continue
                hits, nearest = 0, np.float32(np.inf)
                if nearby:
                    for r in range(max(0, row - 1), min(cells, row + 2)):
                        for c in range(max(0, column - 1), min(cells, column + 2)):
                            if hit[face, r, c] > 0.0:
                                hits += 1
                                nearest = min(nearest, hit[face, r, c])
                if hits >= _HITS_AROUND_HOLE:
                    depths[face, row, column] = nearest
                if hits > beside or outline.shape[0] == 0:
                    continue
                x, y, z, _ = direction_of(face, row, column, cells)
                inside = True
                for edge in range(outline.shape[0]):
                    if outline[edge, 0] * x + outline[edge, 1] * y + outline[edge, 2] * z < 0.0:
                        inside = False
                        break
                if inside:
                    depths[face, row, column] = np.inf
    return depths


def _outline(directions: Array) -> Array:
    """Draw the picture around unit directions (N, 3) as a convex cone: (E, 3) normals that point inwards, none where it is too wide."""
    none = np.zeros((0, 3))
    middle = directions.sum(axis=0)
    length = float(np.linalg.norm(middle))
    if len(directions) < 3 or length < 1e-9:
        return none
    middle /= length
    cosines = directions @ middle
    if cosines.min() < _WIDEST_PICTURE_COS:
        return none
    across = np.cross(middle, np.eye(3)[int(np.abs(middle).argmin())])
    across /= np.linalg.norm(across)
    flat = np.stack([directions @ across, directions @ np.cross(middle, across)]) / cosines
    angles = 2.0 * np.pi * np.arange(_OUTLINE_DIRECTIONS) / _OUTLINE_DIRECTIONS
    sides = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    farthest = (sides @ flat).max(axis=1)
    # side · flat <= farthest, with flat = (d · across, d · up) / (d · middle)
    return np.asarray(farthest[:, None] * middle - sides[:, :1] * across - sides[:, 1:] * np.cross(middle, across))


def make_depth_map(hits: npt.ArrayLike, origin: npt.ArrayLike, cell_m: float) -> DepthMap:
    """Make the depth map of one view.

    Args:
        hits: (N, 3) where its rays ended, whatever they met [m]; rows that are not finite are passed over.
        origin: (3,) of the sensor, in the same frame [m].
        cell_m: size of a cell at the middle distance of the hits [m]; cells are never wider than 2.8° nor finer than 0.12°.
    """
    points = frozen(np.asarray(hits, dtype=np.float32).reshape(-1, 3))
    place = np.array(origin, dtype=np.float64).reshape(3)
    some = points[:: max(1, len(points) // _OUTLINE_POINTS)] - place
    away = np.linalg.norm(some, axis=1)
    known = np.isfinite(away) & (away > 1e-6)
    middle_m = float(np.median(away[known])) if known.any() else 1.0
    cells = int(np.clip(np.ceil(2.0 * middle_m / max(cell_m, 1e-4)), _SMALLEST_CELLS, _MOST_CELLS))
    outline = _outline(some[known] / away[known, None])
    drawn = _draw(points, place, cells)
    dense = len(points) >= _DENSE * np.count_nonzero(drawn)
    return DepthMap(place, _complete(drawn, outline, _HITS_AROUND_HOLE - 1 if dense else 0))


def nearest_hits(hits: npt.NDArray[np.floating], origin: Array, cell_m: float) -> Float32:
    """Return the distance of the nearest hit in each cell of the cube around an origin.

    Args:
        hits: (N, 3), N > 0 [m].
        origin: (3,) of the sensor [m].
        cell_m: size of a cell at the middle distance of the hits [m]; see `make_depth_map`.

    Returns:
        (6, M, M) [m], 0 where there is none.
    """
    some = hits[:: max(1, len(hits) // _OUTLINE_POINTS)] - origin.astype(hits.dtype)
    middle_m = float(np.median(np.sqrt(np.einsum("ij,ij->i", some, some))))
    cells = int(np.clip(np.ceil(2.0 * middle_m / cell_m), _SMALLEST_CELLS, _MOST_OF_NEAREST))
    depths: Float32 = _draw_nearest(frozen(hits), origin, cells)
    return depths
