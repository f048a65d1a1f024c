"""A scene's arrays brought to another place: enlarged and shifted as a file needs it, or carried along by a rigid motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.scene.arrays import frozen, numbers

#: Fields of a scene, and of its file, that move and grow with the points, and those that only grow.
_POSES = ("target_pose", "grasp_candidates")
_POINTS = ("points", "leaf_points", "stem_points", "fruit_points", "stake_points", "viewpoints", "blocking_points")
MOVED = (*_POINTS, "leaf_triangles", "fruit_centres", *_POSES)
SCALED = ("fruit_radii", "stem_displacement_m", "leaf_displacement_m")


def placed(arrays: Mapping[str, Any], scale: float, offset_xyz: npt.ArrayLike) -> dict[str, Any]:
    """Return a scene's arrays, by name, enlarged about the origin and then moved, in double precision; the others as they are."""
    offset = frozen("offset", offset_xyz, np.float64, (3,))
    if not (np.isfinite(scale) and scale > 0.0):
        raise SceneError(f"scale: {scale} is not a finite number above 0")
    placed = dict(arrays)
    if scale == 1.0 and not offset.any():
        return placed
    for name in (name for name in MOVED if name in arrays):
        value = np.array(numbers(name, arrays[name]), dtype=np.float64)
        if value.shape[-1:] != ((7,) if name in _POSES else (3,)):
            continue  # `Scene` refuses it with its shape
        value[..., :3] *= scale
        value[..., :3] += offset
        placed[name] = value
    for name in (name for name in SCALED if name in arrays):
        placed[name] = numbers(name, arrays[name]) * scale
    return placed


def carried(arrays: Mapping[str, Any], T: npt.ArrayLike) -> dict[str, Any]:
    """Return arrays of a scene, by name, each of them moved by T (4, 4) [m], in double precision."""
    motion = frozen("T", T, np.float64, (4, 4))
    moved: dict[str, Any] = {}
    for name, value in arrays.items():
        if name == "target_pose":
            moved[name] = matrix_to_pose(motion @ pose_to_matrix(value))
        elif name == "grasp_candidates":
            moved[name] = np.array([matrix_to_pose(motion @ pose_to_matrix(pose)) for pose in value]).reshape(-1, 7)
        else:
            moved[name] = value.astype(np.float64) @ motion[:3, :3].T + motion[:3, 3]
    return moved
