"""Where around a link a point must be looked at closely: unsigned distance to its mesh on a grid of voxels.

The exact checker asks FCL about a point only if the voxel it falls into may be near the link's surface, and takes a point in an
enclosed voxel for a hit: the mesh is only a surface, and what lies deep inside it touches no triangle.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lime_planner.core.atomic_files import replacing
from lime_planner.core.cache_folder import cache_root
from lime_planner.core.elsewhere import call_elsewhere
from lime_planner.core.quick_open3d import open3d
from lime_planner.core.types import Array, Float32, Int64
from lime_planner.robot.meshes import LinkMesh

PITCH_M = 0.00225  #: edge of a voxel
#: A voxel's centre and any point in it are at most half a diagonal apart; 0.01 mm more for the distances' single precision.
HALF_DIAGONAL_M = PITCH_M * 3**0.5 / 2 + 1e-5
_VERSION = 3  # of what is computed here; part of the cache's key


class LinkGrids(NamedTuple):
    """Voxels around L links, in the joints' frames [m].

    Attributes:
        origin: (L, 3), lowest corner of each grid, which reaches `padding` beyond the link's bounding box.
        size: (L, 3) int64, voxels per axis.
        start: (L,) int64, where each grid begins in `values`.
        values: float32, distance of each voxel's centre to the link's surface; negative where the voxel is enclosed: not within
            half a voxel's diagonal of the surface and cut off from the outside by voxels that are.
        padding: see `origin`.
    """

    origin: Array
    size: Int64
    start: Int64
    values: Float32
    padding: float


def build_grids(links: Sequence[LinkMesh], padding_m: float, should_stop: Callable[[], bool] = lambda: False) -> LinkGrids:
    """Make the grids of all links, or read them from the package's cache (a few seconds the first time).

    Args:
        links: the links' meshes.
        padding_m: how far the grids reach beyond the links; rounded up to whole centimetres.
        should_stop: cancels.

    Raises:
        Refusal: CANCELLED.
    """
    padding = 0.01 * int(np.ceil(padding_m / 0.01 - 1e-9))
    origin = np.stack([link.vertices.min(axis=0) - padding for link in links])
    top = np.stack([link.vertices.max(axis=0) + padding for link in links])
    size = np.ceil((top - origin) / PITCH_M).astype(np.int64)
    start = np.concatenate([[0], np.cumsum(size.prod(axis=1))]).astype(np.int64)
    known = [_stored_values(link, origin[i], size[i]) for i, link in enumerate(links)]
    missing = [i for i, values in enumerate(known) if values is None]
    if missing:
        made = call_elsewhere(_make_values, [links[i] for i in missing], origin[missing], size[missing], should_stop=should_stop)
        for i, values in zip(missing, made, strict=True):
            known[i] = values
    values = np.concatenate([values for values in known if values is not None])
    return LinkGrids(origin, size, start[:-1], values, padding)


def _file(link: LinkMesh, origin: Array, size: Int64) -> Path:
    digest = hashlib.sha256(f"{_VERSION} {PITCH_M} {origin.tolist()} {size.tolist()}".encode())
    digest.update(np.ascontiguousarray(link.vertices).tobytes())
    digest.update(np.ascontiguousarray(link.triangles).tobytes())
    return cache_root() / f"linkgrid-{digest.hexdigest()[:24]}.npy"


def _stored_values(link: LinkMesh, origin: Array, size: Int64) -> Float32 | None:
    try:
        stored = np.load(_file(link, origin, size))
        if stored.shape == (int(size.prod()),) and stored.dtype == np.float32:
            return np.asarray(stored)
    except (OSError, ValueError, EOFError):  # not there, or half-written by a process that was stopped
        pass
    return None


def _make_values(links: Sequence[LinkMesh], origin: Array, size: Int64) -> list[Float32]:
    """Make the values of several links, and store them; Open3D and SciPy hold the interpreter for seconds."""
    made = []
    for link, lowest, voxels in zip(links, origin, size, strict=True):
        values = _distance_values(link, lowest, voxels)
        with contextlib.suppress(OSError), replacing(_file(link, lowest, voxels)) as temporary:  # a full disk: do without
            np.save(temporary, values)
        made.append(values)
    return made


def _distance_values(link: LinkMesh, origin: Array, size: Int64) -> Float32:
    o3d = open3d()
    from scipy import ndimage

    axes = [origin[k] + PITCH_M * (np.arange(size[k]) + 0.5) for k in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(link.vertices.astype(np.float32), link.triangles.astype(np.uint32))
    distance: Float32 = scene.compute_distance(centres).numpy()
    # Every voxel that the surface passes through is a wall, so that no path from voxel to voxel leads through a closed surface.
    wall = distance <= HALF_DIAGONAL_M
    enclosed = ndimage.binary_fill_holes(wall) & ~wall
    return np.where(enclosed, -distance, distance).ravel().astype(np.float32)
