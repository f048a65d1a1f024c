"""PCD files: the fields of their points, of every type, as text, binary, or compressed.

The format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html, and `COLUMNS` in place of `FIELDS` as before 0.6.
"""

from __future__ import annotations

import dataclasses
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Array
from lime_planner.scene.text_numbers import TextNumbers

Columns = list[tuple[str, npt.NDArray[Any]]]

_KINDS = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"I": (1, 2, 4, 8), "U": (1, 2, 4, 8), "F": (2, 4, 8)}
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_MAX_HEADER_BYTES = 1 << 20
_NO_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class _Header:
    """What a file says of itself: names, types and lengths of the fields, points, where the body begins, the sensor's pose."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    counts: tuple[int, ...]
    n_points: int
    encoding: str
    body: int
    viewpoint: Array | None


def read_pcd(path: Path) -> tuple[Columns, Array | None]:
    """Read the fields of a file's points that hold one number each, in the file's order.

    Returns:
        Name and values (N,) of each, of the file's own types where it is binary, float64 where it is text; and where the sensor was,
        x y z qx qy qz qw (7,) in the frame of the points, None where the file does not say.

    Raises:
        SceneError: the file is no PCD, its header makes no sense, or its body is shorter than the header says.
        OSError: it cannot be read.
    """
    content = path.read_bytes()
    header = _header(content)
    if not header.n_points or not sum(header.counts):
        return [(name, np.empty(0)) for name, count in zip(header.names, header.counts, strict=True) if count == 1], header.viewpoint
    layout = np.dtype({"names": [str(k) for k in range(len(header.names))], "formats": _formats(header)})
    if header.encoding == "ascii":
        return _from_text(TextNumbers(content[header.body :]), header), header.viewpoint
    if header.encoding == "binary":
        needed, there = header.n_points * layout.itemsize, len(content) - header.body
        if there < needed:
            raise SceneError(f"is truncated: {max(there, 0)} bytes of points, its header needs {needed}")
        table = np.frombuffer(content, layout, header.n_points, header.body)
        columns = [(name, table[str(k)]) for k, name in enumerate(header.names) if header.counts[k] == 1]
        return [(name, np.ascontiguousarray(column)) for name, column in columns], header.viewpoint
    return _from_compressed(content, header, layout.itemsize), header.viewpoint


def _header(content: bytes) -> _Header:
    entries: dict[str, list[str]] = {}
    place = 0
    while "DATA" not in entries:
        end = content.find(b"\n", place, _MAX_HEADER_BYTES)
        if end < 0:
            if not content[place:].startswith(b"DATA"):
                raise SceneError("is no PCD file, or its header is truncated (no line 'DATA')")
            end = len(content)
        words = content[place:end].decode("utf-8", errors="replace").split()
        place = min(end + 1, len(content))
        if words and not words[0].startswith("#"):
            entries.setdefault(words[0].upper(), words[1:])
    names = entries.get("FIELDS") or entries.get("COLUMNS") or []
    if not names:
        raise SceneError("its header cannot be read as PCD: it names no FIELDS")
    sizes = _integers(entries, "SIZE", [4] * len(names))
    letters = [word.upper() for word in entries.get("TYPE", ["F"] * len(names))]
    counts = _integers(entries, "COUNT", [1] * len(names))
    if not len(names) == len(sizes) == len(counts) == len(letters):
        raise SceneError("FIELDS, SIZE, TYPE and COUNT of its header differ in length")
    for name, size, letter, count in zip(names, sizes, letters, counts, strict=True):
        if size not in _SIZES.get(letter, ()) or not 0 <= count <= 1 << 20:
            raise SceneError(f"its header cannot be read as PCD: the field {name!r} has TYPE {letter}, SIZE {size}, COUNT {count}")
    if "POINTS" in entries:
        n_points = _integers(entries, "POINTS", [])[0]
    else:
        n_points = _integers(entries, "WIDTH", [])[0] * _integers(entries, "HEIGHT", [1])[0]
    if n_points < 0:
        raise SceneError(f"its header says {n_points} points")
    encoding = (entries["DATA"] or ["nothing"])[0].lower()
    if encoding not in _ENCODINGS:
        raise SceneError(f"DATA {encoding!r} is none of {', '.join(_ENCODINGS)}")
    kinds = tuple(f"<{_KINDS[letter]}{size}" for letter, size in zip(letters, sizes, strict=True))
    return _Header(tuple(names), kinds, tuple(counts), n_points, encoding, place, _viewpoint(entries))


def _integers(entries: dict[str, list[str]], name: str, default: list[int]) -> list[int]:
    words = entries.get(name)
    if words is None and default:
        return default
    if not words or not all(re.fullmatch(r"[+-]?\d{1,18}", word) for word in words):
        raise SceneError(f"its header cannot be read as PCD: {name} {' '.join(words or ['is missing'])[:80]}")
    return [int(word) for word in words]


def _viewpoint(entries: dict[str, list[str]]) -> Array | None:
    try:
        x, y, z, qw, qx, qy, qz = values = tuple(float(word) for word in entries.get("VIEWPOINT", ()))
    except ValueError:
        return None
    if values == _NO_VIEWPOINT or not np.isfinite(values).all():
        return None  # what writers put there who do not know it
    return np.array([x, y, z, qx, qy, qz, qw])


def _formats(header: _Header) -> list[Any]:
    return [kind if count == 1 else (kind, (count,)) for kind, count in zip(header.kinds, header.counts, strict=True)]


def _from_text(text: TextNumbers, header: _Header) -> Columns:
    width, lengths = sum(header.counts), text.line_lengths
    wrong = np.flatnonzero(lengths[: header.n_points] != width)
    if len(lengths) < header.n_points or len(wrong):
        # Lines may be broken anywhere, if the numbers are as many as the header says.
        if len(wrong) and len(lengths) == header.n_points:
            at = int(wrong[0])
            raise SceneError(f"its points are not {width} numbers a line: point {at} (counted from 0) has {lengths[at]}")
        if len(text) != header.n_points * width:
            raise SceneError(f"is truncated or damaged: it holds {len(text)} numbers, its header says {header.n_points} points of {width}")
    table = text.values(0, header.n_points * width).reshape(header.n_points, width)
    firsts = np.cumsum((0, *header.counts))
    return [(name, table[:, firsts[k]]) for k, name in enumerate(header.names) if header.counts[k] == 1]


def _from_compressed(content: bytes, header: _Header, point_bytes: int) -> Columns:
    """Unpack a body in which the fields follow one another, each for all points."""
    if len(content) < header.body + 8:
        raise SceneError("is truncated: the sizes of its compressed points are missing")
    packed, unpacked = struct.unpack_from("<II", content, header.body)
    needed = header.n_points * point_bytes
    if unpacked != needed:
        raise SceneError(f"holds {unpacked} bytes of points, its header says {needed}")
    begin = header.body + 8
    if len(content) < begin + packed:
        raise SceneError(f"is truncated: {len(content) - begin} compressed bytes, its header needs {packed}")
    body = _lzf_decompress(content[begin : begin + packed], unpacked)
    columns: Columns = []
    place = 0
    for name, kind, count in zip(header.names, header.kinds, header.counts, strict=True):
        if count == 1:
            columns.append((name, np.frombuffer(body, kind, header.n_points, place)))
        place += header.n_points * count * np.dtype(kind).itemsize
    return columns


def _lzf_decompress(packed: bytes, size: int) -> bytes:
    """Unpack LZF, the compression of Marc Lehmann's liblzf: literal runs, and copies of what came up to 8 KiB before.

    Raises:
        SceneError: the data is damaged, or does not unpack to `size` bytes.
    """
    damaged = SceneError("its compressed points are damaged")
    result = bytearray()
    place, end = 0, len(packed)
    while place < end:
        control = packed[place]
        place += 1
        if control < 32:
            run = packed[place : place + control + 1]
            if len(run) != control + 1:
                raise damaged
            result += run
            place += control + 1
            continue
        length = control >> 5
        if place + 1 + (length == 7) > end:
            raise damaged
        if length == 7:
            length += packed[place]
            place += 1
        back = ((control & 31) << 8 | packed[place]) + 1
        place += 1
        length += 2
        begin = len(result) - back
        if begin < 0:
            raise damaged
        if length <= back:
            result += result[begin : begin + length]
        else:  # the copy runs into what it writes
            piece = bytes(result[begin:])
            result += (piece * (length // back + 1))[:length]
        if len(result) > size:
            raise damaged
    if len(result) != size:
        raise SceneError(f"its compressed points unpack to {len(result)} bytes, its header says {size}")
    return bytes(result)
