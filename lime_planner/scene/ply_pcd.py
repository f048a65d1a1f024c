"""PLY and PCD files with an integer label, read and written by Open3D.

Open3D returns uninitialised memory for what a truncated or malformed file does not hold, without an error that Python sees. The
header and the size of the body are therefore checked here first, and the numbers themselves in text files.
"""

from __future__ import annotations

import dataclasses
import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Float32, UInt8

_MAX_HEADER_BYTES = 65_536
_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


@dataclasses.dataclass(frozen=True)
class _Header:
    """What a file says of itself: names of the fields, points, bytes and numbers of each point, where the points start."""

    fields: tuple[str, ...]
    n_points: int
    point_bytes: int
    point_numbers: int
    encoding: str  # ascii | binary | binary_compressed
    body: int  # offset of the first point [bytes]; in a text file the offset of the first line after the header
    skip_lines: int = 0  # lines of a text body before the points


def read_cloud(path: Path, label_field: str) -> dict[str, npt.NDArray[Any]]:
    """Read `points` (N, 3), `labels` (N,) and, where the file has the field, `permeability_cost` (N,).

    The label's field is found in any case and with the `scalar_` that CloudCompare puts before a name.

    Raises:
        SceneError: the file is no point cloud, truncated, empty, or lacks a field.
    """
    try:
        header = _ply_header(path) if path.suffix.lower() == ".ply" else _pcd_header(path)
        _check_body(path, header)
    except (OSError, UnicodeDecodeError, IndexError, KeyError, ValueError, struct.error) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{path}: its header cannot be read as {path.suffix[1:].upper()} ({type(error).__name__}: {error})") from error
    if not header.n_points:
        raise SceneError(f"{path}: holds no points")
    _require(path, header.fields, "x", "y", "z")
    label = _find(path, header.fields, label_field)

    import open3d  # 1 s, and only these two kinds of file need it

    try:
        with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
            cloud = open3d.t.io.read_point_cloud(path)
        points = cloud.point["positions"].numpy()
        labels = cloud.point[label].numpy()[:, 0]
        members = {"points": points, "labels": labels}
        if "permeability_cost" in header.fields:
            members["permeability_cost"] = cloud.point["permeability_cost"].numpy()[:, 0]
    except (RuntimeError, ValueError, KeyError, IndexError) as error:
        raise SceneError(f"{path}: Open3D cannot read it ({_sentence(error)})") from error
    if len(points) != header.n_points:
        raise SceneError(f"{path}: {len(points)} of its {header.n_points} points could be read")
    return members


def write_cloud(path: Path, points: Float32, labels: UInt8, costs: Float32 | None) -> None:
    """Write points (N, 3) [m] with `label` and, if given, `permeability_cost`, as binary PLY or PCD.

    Raises:
        OSError: the file cannot be written.
    """
    import open3d

    tensor = open3d.core.Tensor.from_numpy
    cloud = open3d.t.geometry.PointCloud(tensor(np.ascontiguousarray(points)))
    cloud.point["label"] = tensor(labels.astype(np.int32)[:, None])
    if costs is not None:
        cloud.point["permeability_cost"] = tensor(np.ascontiguousarray(costs)[:, None])
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        if not open3d.t.io.write_point_cloud(path, cloud):
            raise OSError(f"Open3D could not write {path.name}")


def _sentence(error: Exception) -> str:
    # Open3D's texts carry colours and the path of its own source file.
    return str(error).replace("\x1b[1;31m", "").replace("\x1b[0;m", "").strip().rsplit(": ", 1)[-1]


def _find(path: Path, fields: tuple[str, ...], wanted: str) -> str:
    if wanted in fields:
        return wanted
    for field in fields:
        if field.lower().removeprefix("scalar_") == wanted.lower():
            return field
    raise SceneError(f"{path}: has no field {wanted!r}; it has {', '.join(fields)}")


def _require(path: Path, fields: tuple[str, ...], *wanted: str) -> None:
    for field in wanted:
        if field not in fields:
            raise SceneError(f"{path}: has no field {field!r}; it has {', '.join(fields) or 'none'}")


def _header_lines(path: Path, last: str) -> tuple[list[list[str]], int]:
    """Return the words of each line up to the one that starts with `last`, and the offset of what follows."""
    lines: list[list[str]] = []
    with path.open("rb") as file:
        while file.tell() < _MAX_HEADER_BYTES:
            raw = file.readline(_MAX_HEADER_BYTES)
            if not raw:
                break
            words = raw.decode("ascii", errors="replace").split()
            if words:
                lines.append(words)
                if words[0] == last:
                    return lines, file.tell()
    raise SceneError(f"{path}: is no {path.suffix[1:].upper()} file, or its header is truncated (no line {last!r})")


def _ply_header(path: Path) -> _Header:
    lines, body = _header_lines(path, "end_header")
    if lines[0] != ["ply"]:
        raise SceneError(f"{path}: is no PLY file (its first line is not 'ply')")
    encoding = "ascii"
    fields: list[str] = []
    n_points = point_bytes = element = before_bytes = before_lines = 0
    inside: str | None = None
    for words in lines[1:]:
        if words[0] == "format":
            encoding = "ascii" if words[1] == "ascii" else "binary"
        elif words[0] == "element":
            inside, element = words[1], int(words[2])
            if inside == "vertex":
                n_points = element
            elif not fields:
                before_lines += element
        elif words[0] == "property":
            if inside == "vertex":
                if words[1] == "list":
                    raise SceneError(f"{path}: its vertices have a list {words[-1]!r}, which no point cloud has")
                fields.append(words[2])
                point_bytes += _PLY_BYTES[words[1]]
            elif not fields:
                if words[1] == "list":
                    raise SceneError(f"{path}: has lists before its vertices; write the vertices first")
                before_bytes += element * _PLY_BYTES[words[1]]
    offset = body + (before_bytes if encoding == "binary" else 0)
    return _Header(tuple(fields), n_points, point_bytes, len(fields), encoding, offset, before_lines)


def _pcd_header(path: Path) -> _Header:
    lines, body = _header_lines(path, "DATA")
    entries = {words[0]: words[1:] for words in lines if not words[0].startswith("#")}
    fields = tuple(entries["FIELDS"])
    sizes = [int(word) for word in entries["SIZE"]]
    counts = [int(word) for word in entries.get("COUNT", ["1"] * len(fields))]
    if not len(fields) == len(sizes) == len(counts) == len(entries["TYPE"]):
        raise SceneError(f"{path}: FIELDS, SIZE, TYPE and COUNT of its header differ in length")
    n_points = int(entries["POINTS"][0]) if "POINTS" in entries else int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
    point_bytes = sum(size * count for size, count in zip(sizes, counts, strict=True))
    return _Header(fields, n_points, point_bytes, sum(counts), entries["DATA"][0], body)


def _check_body(path: Path, header: _Header) -> None:
    """Refuse a file whose body is shorter than its header says, or whose text is not numbers."""
    if header.n_points < 0:
        raise SceneError(f"{path}: its header says {header.n_points} points")
    size = path.stat().st_size - header.body
    needed = header.n_points * header.point_bytes
    if header.encoding == "binary_compressed":
        with path.open("rb") as file:
            file.seek(header.body)
            packed, unpacked = struct.unpack("<II", file.read(8))
        if unpacked != needed:
            raise SceneError(f"{path}: holds {unpacked} bytes of points, its header says {needed}")
        needed = packed + 8
    elif header.encoding == "ascii":
        needed = header.n_points * 2 * header.point_numbers - 1  # a digit and a separator for each number
    elif header.encoding != "binary":
        raise SceneError(f"{path}: DATA {header.encoding!r} is none of ascii, binary, binary_compressed")
    if header.n_points and size < needed:
        raise SceneError(f"{path}: is truncated: {max(size, 0)} bytes of points, its header needs {needed}")
    if header.encoding == "ascii" and header.n_points:
        text = path.read_bytes()[header.body :]
        try:
            table = np.loadtxt(io.BytesIO(text), skiprows=header.skip_lines, max_rows=header.n_points, ndmin=2, comments=None)
        except ValueError as error:
            raise SceneError(f"{path}: its points are not {header.point_numbers} numbers a line ({str(error).split(';')[0]})") from error
        if table.shape != (header.n_points, header.point_numbers):
            raise SceneError(
                f"{path}: holds {table.shape[0]} points of {table.shape[1]} numbers, "
                f"its header says {header.n_points} of {header.point_numbers}"
            )
