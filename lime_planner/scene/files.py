"""Scene files: `.npz`, and PLY and PCD with an integer label, to and from `Scene`.

An `.npz` holds `points` (N, 3) [m] and `labels` (N,), and optionally `permeability_cost` (N,), `target_pose` (7,), `frame_id`,
`stake_points` (S, 3), and the ground truth of generated plants: `leaf_ids` (N,), `leaf_triangles` (L, 3, 3), `leaf_triangle_ids`
(L,), `fruit_centres` (F, 3), `fruit_radii` (F,). Recorded scenes also hold the arm's configuration when they were taken, `start`
(n,) [rad] with `start_joints` (n,), and how far thinning moved their points. Pickled members are refused: a scene file cannot run code.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Array, Float32, UInt8
from lime_planner.scene.ply_pcd import read_cloud, write_cloud
from lime_planner.scene.scene import DEFAULT_FRAME, FRUIT, LEAF, STEM, Scene

SUFFIXES = (".npz", ".ply", ".pcd")

_TRUTH = ("leaf_triangles", "leaf_triangle_ids", "fruit_centres", "fruit_radii")
_OPTIONAL = ("permeability_cost", "target_pose", "stake_points", "leaf_ids", *_TRUTH)

_DISPLACEMENTS = ("stem_displacement_m", "leaf_displacement_m")

Members = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Start:
    """Where the arm was when a scene was taken.

    Attributes:
        joint_names: the arm's joints.
        q: (n,) their angles, turns kept [rad].
    """

    joint_names: tuple[str, ...]
    q: Array


def load_scene(
    path: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    offset: npt.ArrayLike | None = None,
    label_field: str = "label",
    default_frame: str = DEFAULT_FRAME,
    leaf_labels: Sequence[int] = (LEAF,),
    stem_labels: Sequence[int] = (STEM,),
    fruit_label: int | None = FRUIT,
    ignored_labels: Sequence[int] = (),
) -> Scene:
    """Load a scene, enlarge it by `scale` about its origin, then move it by `offset`; its target pose goes with it.

    Args:
        path: an `.npz`, `.ply` or `.pcd` file.
        scale: metres for each unit of the file.
        offset: (3,) [m] in the planning frame.
        label_field: name of the label in PLY and PCD files; an `.npz` has `labels`.
        default_frame: the frame of a file that names none.
        leaf_labels: see `Scene.from_points`, as the next three.
        stem_labels: the known impermeable labels.
        fruit_label: the label of fruit; the default gives way to classes that name it.
        ignored_labels: the labels to drop.

    Raises:
        SceneError: the file is missing, of another kind, truncated, empty, without a needed field, a field does not fit, or two
            classes share a label.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise SceneError(f"{path}: a scene file ends in one of {', '.join(SUFFIXES)}, not in {suffix or 'nothing'!r}")
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file")
    members = _read_npz(path) if suffix == ".npz" else read_cloud(path, label_field)
    if not len(members["points"]):
        raise SceneError(f"{path}: holds no points")
    frame = str(members.pop("frame_id", default_frame)) or default_frame
    try:
        displacements = {name: _displacement(name, members.pop(name)) for name in _DISPLACEMENTS if name in members}
        scene = Scene.from_points(
            members.pop("points"),
            members.pop("labels"),
            frame_id=frame,
            leaf_labels=leaf_labels,
            stem_labels=stem_labels,
            fruit_label=fruit_label,
            ignored_labels=ignored_labels,
            **members,
            **displacements,
        )
        if not scene.n_points:
            raise SceneError(f"none of its points can be used ({_listed(scene.counts)})")
        return scene.placed(scale, (0.0, 0.0, 0.0) if offset is None else offset)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


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
    except Exception as error:  # as for the scene itself
        raise SceneError(f"{path}: its start cannot be read ({type(error).__name__}: {error})") from error
    if q.shape != (len(names),) or not np.isfinite(q).all():
        raise SceneError(f"{path}: start has shape {q.shape}, expected ({len(names)},) finite angles, one for each of start_joints")
    return Start(names, q)


def save_scene(path: str | os.PathLike[str], scene: Scene, start: Start | None = None) -> None:
    """Write a scene; a reader never sees half a file. PLY and PCD keep the points, their labels and costs, and nothing else.

    Args:
        path: an `.npz`, `.ply` or `.pcd` file.
        scene: what to write.
        start: where the arm was, in an `.npz` only.

    Raises:
        SceneError: the suffix is unknown or the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise SceneError(f"{path}: a scene file ends in one of {', '.join(SUFFIXES)}, not in {suffix or 'nothing'!r}")
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".npz":
            _write_npz(temporary, scene, start)
        else:
            points, labels, costs = labelled_points(scene)
            write_cloud(temporary, points, labels, costs if (costs != 1.0).any() else None)
        os.replace(temporary, path)
    except OSError as error:
        raise SceneError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def labelled_points(scene: Scene) -> tuple[Float32, UInt8, Float32]:
    """Return the scene as one cloud: points (N, 3) [m], labels (N,), permeability costs (N,); leaves, then stems, then fruit."""
    points = np.concatenate([scene.leaf_points, scene.stem_points, scene.fruit_points])
    sizes = (len(scene.leaf_points), len(scene.stem_points), len(scene.fruit_points))
    labels = np.repeat(np.array([LEAF, STEM, FRUIT], dtype=np.uint8), sizes)
    costs = np.ones(len(points), dtype=np.float32)
    costs[: sizes[0]] = scene.leaf_costs
    return points, labels, costs


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
    except SceneError:
        raise
    except Exception as error:  # a damaged file makes zipfile, zlib, tokenize and NumPy raise a dozen kinds
        raise SceneError(f"{path}: is not a readable .npz file ({type(error).__name__}: {_one_line(str(error))})") from error
    return members


def _one_line(text: str) -> str:
    """A text from a file, whatever it holds, fit for a sentence."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _write_npz(path: Path, scene: Scene, start: Start | None) -> None:
    points, labels, costs = labelled_points(scene)
    members: dict[str, Any] = {"points": points, "labels": labels, "frame_id": np.array(scene.frame_id)}
    if (costs != 1.0).any():
        members["permeability_cost"] = costs
    if scene.target_pose is not None:
        members["target_pose"] = scene.target_pose
    if scene.leaf_ids is not None:
        members["leaf_ids"] = np.concatenate([scene.leaf_ids, np.full(len(points) - len(scene.leaf_ids), -1, dtype=np.int32)])
    members.update({name: getattr(scene, name) for name in _TRUTH if getattr(scene, name) is not None})
    members.update({name: np.float64(value) for name in _DISPLACEMENTS if (value := getattr(scene, name)) > 0.0})
    if start is not None:
        members.update(start=start.q, start_joints=np.array(start.joint_names))
    np.savez_compressed(path, **members)


def _displacement(name: str, value: npt.NDArray[Any]) -> float:
    if value.ndim or value.dtype.kind not in "iuf" or not 0.0 <= value < np.inf:
        raise SceneError(f"{name}: {value!r} is not a finite number of at least 0")
    return float(value)


def _listed(counts: Any) -> str:
    return ", ".join(f"{value} {name}" for name, value in counts.items() if value)
