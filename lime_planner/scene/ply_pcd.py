"""Labelled point clouds in PLY and PCD files, by the names of their fields."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Float32, UInt8
from lime_planner.scene.pcd import read_pcd
from lime_planner.scene.ply import read_ply

_COST_FIELD = "permeability_cost"


def read_cloud(path: Path, label_field: str) -> dict[str, npt.NDArray[Any]]:
    """Read `points` (N, 3), `labels` (N,) and, where the file has the field, `permeability_cost` (N,); where a
    PCD names it, its VIEWPOINT as `viewpoints` (1, 3).

    Fields are found in any case and with the `scalar_` that CloudCompare puts before a name. Coordinates that the file holds in
    more than single precision stay in double.

    Raises:
        SceneError: the file is no point cloud, truncated, empty, or lacks a field.
    """
    try:
        columns, viewpoint = (read_ply(path), None) if path.suffix.lower() == ".ply" else read_pcd(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror or error})") from error
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    except MemoryError:
        raise SceneError(f"{path}: is too large for the memory of this machine") from None
    names = [name for name, _ in columns]
    axes = [columns[_find(path, names, axis)][1] for axis in "xyz"]
    labels = columns[_find(path, names, label_field)][1]
    if not len(labels):
        raise SceneError(f"{path}: holds no points")
    points = np.empty((len(labels), 3), np.result_type(np.float32, *axes))
    with np.errstate(invalid="ignore", over="ignore"):  # numbers that are none
        for k, axis in enumerate(axes):
            points[:, k] = axis
    members = {"points": points, "labels": labels}
    cost = _places(names, _COST_FIELD)
    if cost:
        members[_COST_FIELD] = columns[cost[0]][1]
    if viewpoint is not None:
        members["viewpoints"] = viewpoint[None, :3]
    return members


def write_cloud(path: Path, points: Float32, labels: UInt8, costs: Float32 | None) -> None:
    """Write points (N, 3) [m] with `label` and, if given, `permeability_cost`, as binary PLY or PCD.

    Raises:
        OSError: the file cannot be written.
    """
    columns: dict[str, npt.NDArray[Any]] = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], "label": labels}
    layout = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "<i4")]
    if costs is not None:
        columns[_COST_FIELD] = costs
        layout.append((_COST_FIELD, "<f4"))
    table = np.empty(len(points), layout)
    for name, column in columns.items():
        table[name] = column
    header = _ply_header(table) if path.suffix.lower() == ".ply" else _pcd_header(table)
    path.write_bytes(header.encode() + table.tobytes())


def _ply_header(table: npt.NDArray[Any]) -> str:
    kinds = {"f": "float", "i": "int"}
    properties = "".join(f"property {kinds[table.dtype[name].kind]} {name}\n" for name in table.dtype.names or ())
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{properties}end_header\n"


def _pcd_header(table: npt.NDArray[Any]) -> str:
    names = table.dtype.names or ()
    return (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(names)}\n"
        f"SIZE {' '.join(str(table.dtype[name].itemsize) for name in names)}\n"
        f"TYPE {' '.join(table.dtype[name].kind.upper() for name in names)}\n"
        f"COUNT {' '.join('1' for _ in names)}\n"
        f"WIDTH {len(table)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(table)}\nDATA binary\n"
    )


def _places(names: Sequence[str], wanted: str) -> list[int]:
    """Return where a field stands: under its own name, else in another case or behind CloudCompare's `scalar_`."""
    exact = [k for k, name in enumerate(names) if name == wanted]
    return exact or [k for k, name in enumerate(names) if name.lower().removeprefix("scalar_") == wanted.lower()]


def _find(path: Path, names: Sequence[str], wanted: str) -> int:
    places = _places(names, wanted)
    if len(places) == 1:
        return places[0]
    if places:
        raise SceneError(f"{path}: has {len(places)} fields {wanted!r}: {', '.join(names[k] for k in places)}")
    raise SceneError(f"{path}: has no field {wanted!r}; it has {', '.join(names) or 'none'}")
