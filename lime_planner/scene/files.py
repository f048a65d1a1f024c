"""Scene files: `.npz`, and PLY and PCD with an integer label, to and from plain arrays (`Scene.load`, `Scene.save`).

An `.npz` holds `points` (N, 3) [m] and `labels` (N,), and optionally `permeability_cost` (N,), `target_pose` (7,), `grasp_candidates` (P,
7), `frame_id`, `stake_points` (S, 3), `viewpoints` (V, 3) with `view_ids` (N,), what cameras saw that is no obstacle, `blocking_points`
(B, 3) with `blocking_view_ids` (B,), and the ground truth of generated plants: `leaf_ids` (N,),
`leaf_triangles` (L, 3, 3), `leaf_triangle_ids` (L,), `fruit_centres` (F, 3), `fruit_radii` (F,). Recorded scenes also hold the arm's
configuration when they were taken, `start` (n,) [rad] with `start_joints` (n,), and how far thinning moved their points. Pickled members
are refused: a scene file cannot run code.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.atomic_files import replacing
from lime_planner.core.errors import SceneError
from lime_planner.core.types import Array
from lime_planner.scene.ply_pcd import read_cloud, write_cloud

SUFFIXES = (".npz", ".ply", ".pcd")

_TRUTH = ("leaf_triangles", "leaf_triangle_ids", "fruit_centres", "fruit_radii")
_VIEWS = ("viewpoints", "view_ids", "blocking_points", "blocking_view_ids")
_OPTIONAL = ("permeability_cost", "target_pose", "grasp_candidates", "stake_points", "leaf_ids", *_VIEWS, *_TRUTH)

_DISPLACEMENTS = ("stem_displacement_m", "leaf_displacement_m")

Members = dict[str, Any]


@dataclass(frozen=True)
class Start:
    """Where the arm was when a scene was taken.

    Attributes:
        joint_names: the arm's joints.
        q: (n,) their angles, turns kept [rad].
    """

    joint_names: tuple[str, ...]
    q: Array


def read_members(path: str | os.PathLike[str], label_field: str) -> Members:
    """Read the arrays of a scene file as they are written there.

    Args:
        path: an `.npz`, `.ply` or `.pcd` file.
        label_field: name of the label in PLY and PCD files; an `.npz` has `labels`.

    Returns:
        `points` (N, 3) and `labels` (N,), in the types of the file, and what it has of `permeability_cost` (N,), `target_pose`,
        `grasp_candidates`, `frame_id` (text), `stake_points`, `leaf_ids`, and the ground truth of generated plants, unchecked.

    Raises:
        SceneError: the file is missing, of another kind, truncated, empty, or without a needed field.
    """
    path = Path(path)
    if path.is_dir():
        raise SceneError(f"{path}: is a folder, not a scene file")
    suffix = _suffix(path)
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file")
    members: Members = _read_npz(path) if suffix == ".npz" else {**read_cloud(path, label_field)}
    if not len(np.atleast_1d(members["points"])):
        raise SceneError(f"{path}: holds no points")
    if "frame_id" in members:
        members["frame_id"] = _text(path, "frame_id", members["frame_id"])
    for name in _DISPLACEMENTS:
        if name in members:
            members[name] = _displacement(path, name, members[name])
    return members


def load_start(path: str | os.PathLike[str]) -> Start | None:
    """Return where the arm was when a scene was recorded; None where the file does not say.

    Raises:
        SceneError: the file is damaged, or its angles do not fit its joint names.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        return None
    try:
        with np.load(path, allow_pickle=False) as archive:
            if "start" not in archive.files or "start_joints" not in archive.files:
                return None
            q, names = np.asarray(archive["start"], dtype=np.float64), tuple(map(str, archive["start_joints"]))
    except Exception as error:  # as in `_read_npz`
        raise SceneError(f"{path}: its start cannot be read ({_why_unreadable(path, error)})") from error
    if q.shape != (len(names),) or not np.isfinite(q).all():
        raise SceneError(f"{path}: start has shape {q.shape}, expected ({len(names)},) finite angles, one for each of start_joints")
    return Start(names, q)


def write_members(path: str | os.PathLike[str], members: Mapping[str, Any], start: Start | None = None) -> None:
    """Write a scene file; a reader never sees half of it.

    Args:
        path: an `.npz`, `.ply` or `.pcd` file.
        members: see `read_members`; of these a PLY or PCD keeps the points, the labels and the costs alone.
        start: where the arm was, in an `.npz` only.

    Raises:
        SceneError: the suffix is unknown or the file cannot be written.
    """
    path = Path(path)
    suffix = _suffix(path)
    try:
        with replacing(path) as temporary:
            if suffix == ".npz":
                arm: Members = {} if start is None else {"start": start.q, "start_joints": np.array(start.joint_names)}
                with temporary.open("wb") as file:  # NumPy would put another suffix after `.NPZ`
                    np.savez_compressed(file, **{**members, **arm})
            else:
                write_cloud(temporary, members["points"], members["labels"], members.get("permeability_cost"))
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror or error})") from error


def _why_unreadable(path: Path, error: Exception) -> str:
    """Return why NumPy could not read an archive; its own words advise to load it unsafely."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if not zipfile.is_zipfile(path):
        return "it is no zip archive, or its end is missing" if path.stat().st_size else "it is empty"
    return "an array in it holds Python objects" if "Object arrays" in str(error) else "an array in it is damaged"


def _read_npz(path: Path) -> Members:
    members: Members = {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in ("points", "labels"):
                if name not in archive.files:
                    raise SceneError(f"{path}: has no array {name!r}; it has {_one_line(', '.join(sorted(archive.files))) or 'none'}")
            for name in ("points", "labels", "frame_id", *_OPTIONAL, *_DISPLACEMENTS):
                if name in archive.files:
                    members[name] = archive[name]
                    if not isinstance(members[name], np.ndarray):  # a member that does not begin as an array comes as its bytes
                        raise SceneError(f"{path}: {name} is no array")
            points = members["points"]
            if points.dtype.kind in "fiu" and (points.ndim != 2 or points.shape[1] != 3):
                raise SceneError(f"{path}: points: shape {points.shape}, expected (N, 3)")
    except SceneError:
        raise
    except Exception as error:  # a damaged file makes zipfile, zlib, tokenize and NumPy raise a dozen kinds
        raise SceneError(f"{path}: is not a readable .npz file ({_why_unreadable(path, error)})") from error
    return members


def _one_line(text: str) -> str:
    """A text from a file, whatever it holds, fit for a sentence."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise SceneError(f"{path}: a scene file ends in one of {', '.join(SUFFIXES)}, not in {suffix or 'nothing'!r}")
    return suffix


def _text(path: Path, name: str, value: npt.NDArray[Any]) -> str:
    if value.size != 1 or value.dtype.kind not in "US":
        raise SceneError(f"{path}: {name}: of type {value.dtype} and shape {value.shape}, expected one text")
    text = value.item()
    return text.decode("utf-8", errors="replace") if isinstance(text, bytes) else str(text)


def _displacement(path: Path, name: str, value: npt.NDArray[Any]) -> float:
    if value.size != 1 or value.dtype.kind not in "iuf" or not 0.0 <= value.item() < np.inf:
        raise SceneError(f"{path}: {name}: {value!r} is not a finite number of at least 0")
    return float(value.item())
