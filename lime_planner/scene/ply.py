"""PLY files: the numbers of their vertices, whatever their types, order and company.

All three encodings; every number type under both of its names, 64-bit integers too; list properties and other elements anywhere.
The format: http://paulbourke.net/dataformats/ply/.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Int64
from lime_planner.scene.text_numbers import TextNumbers

Columns = list[tuple[str, npt.NDArray[Any]]]

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER_BYTES = 1 << 20


@dataclasses.dataclass(frozen=True)
class _Property:
    """A property of an element: the type of its number, or of a list's numbers with the type of their count."""

    name: str
    kind: str
    count_kind: str = ""


@dataclasses.dataclass
class _Element:
    """An element of a file: how many records it has and what each consists of."""

    name: str
    count: int
    properties: list[_Property] = dataclasses.field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        return any(p.count_kind for p in self.properties)


def read_ply(path: Path) -> Columns:
    """Read the number properties of a file's vertices, in the file's order.

    Returns:
        Name and values (N,) of each; of the file's own types where it is binary, float64 where it is text.

    Raises:
        SceneError: the file is no PLY, its header makes no sense, or its body is shorter than the header says.
        OSError: it cannot be read.
    """
    content = path.read_bytes()
    encoding, elements, begin = _header(content)
    vertices = [element for element in elements if element.name == "vertex"]
    if len(vertices) != 1:
        names = ", ".join(element.name for element in elements) or "none"
        raise SceneError(f"has {len(vertices)} elements 'vertex', expected one; its elements: {names}")
    if encoding == "ascii":
        return _from_text(TextNumbers(content[begin:]), elements, vertices[0])
    return _from_bytes(content, begin, elements, vertices[0], _ORDERS[encoding])


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    """Return the encoding, the elements, and where the body begins [bytes]."""
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", content)
    if first is None:
        raise SceneError("is no PLY file (its first line is not 'ply')")
    newline = b"\r" if first[1] == b"\r" else b"\n"  # a line's own carriage return is white space
    place, encoding = first.end(), ""
    elements: list[_Element] = []
    while True:
        end = content.find(newline, place, _MAX_HEADER_BYTES)
        if end < 0:
            # A text file that ends with its header has no points; what else ends here was cut off.
            if content[place:].split() != [b"end_header"]:
                raise SceneError("is no PLY file, or its header is truncated (no line 'end_header')")
            end = len(content)
        words = content[place:end].decode("utf-8", errors="replace").split()
        place = min(end + len(newline), len(content))
        if words == ["end_header"]:
            break
        if words and words[0] not in ("comment", "obj_info"):
            encoding = _header_line(words, elements) or encoding
    if not encoding:
        raise SceneError("has no line 'format' in its header")
    return encoding, elements, place


def _header_line(words: list[str], elements: list[_Element]) -> str:
    """Take in one line of the header; return the encoding if the line names it."""
    line = " ".join(words)[:80]
    if words[0] == "format" and len(words) >= 2:
        if words[1] not in _ORDERS:
            raise SceneError(f"has the format {words[1]!r}, which is none of {', '.join(_ORDERS)}")
        return words[1]
    if words[0] == "element" and len(words) == 3 and re.fullmatch(r"[+-]?\d{1,18}", words[2]):
        if int(words[2]) < 0:
            raise SceneError(f"its header says {words[2]} {'points' if words[1] == 'vertex' else words[1]}")
        elements.append(_Element(words[1], int(words[2])))
        return ""
    if words[0] == "property" and elements and len(words) >= (5 if "list" in words[1:2] else 3):
        kinds = words[2:4] if words[1] == "list" else words[1:2]
        for kind in kinds:
            if kind not in _TYPES:
                raise SceneError(f"its header cannot be read as PLY: {kind!r} in {line!r} is none of {', '.join(_TYPES)}")
        if len(kinds) == 1:
            elements[-1].properties.append(_Property(" ".join(words[2:]), _TYPES[kinds[0]]))
            return ""
        if _TYPES[kinds[0]].startswith("f"):
            raise SceneError(f"its header cannot be read as PLY: the count of {line!r} is no integer")
        elements[-1].properties.append(_Property(" ".join(words[4:]), _TYPES[kinds[1]], _TYPES[kinds[0]]))
        return ""
    raise SceneError(f"its header cannot be read as PLY: {line!r}")


# --- text


def _from_text(text: TextNumbers, elements: list[_Element], vertex: _Element) -> Columns:
    filled = [element for element in elements if element.properties]
    if vertex not in filled:
        return []
    first_line = sum(element.count for element in filled[: filled.index(vertex)])
    if len(text.line_lengths) == sum(element.count for element in filled):
        starts = _starts_by_line(text, vertex, first_line)
    else:
        # Other numbers of lines than of records: broken anywhere, or there is more in the file than its header says.
        try:
            starts = _starts_by_sum(text, filled, vertex)
        except SceneError as error:
            try:
                starts = _starts_by_line(text, vertex, first_line)
            except SceneError:
                raise error from None
    return _text_columns(text, vertex, starts)


def _starts_by_line(text: TextNumbers, vertex: _Element, first_line: int) -> Int64:
    """Return where each vertex begins, and where the last one ends, (count + 1,), if each stands on a line of its own."""
    lengths, width = text.line_lengths[first_line : first_line + vertex.count], len(vertex.properties)
    if len(lengths) < vertex.count:
        raise SceneError(f"is truncated: {len(lengths)} lines of points, its header needs {vertex.count}")
    starts = _text_starts(text, vertex, text.line(first_line))
    wrong = np.flatnonzero(np.diff(starts) != lengths)
    if len(wrong):
        numbers = f"{width} numbers" if not vertex.has_lists else f"{starts[wrong[0] + 1] - starts[wrong[0]]} numbers, lists included,"
        raise SceneError(f"its points are not {numbers} a line: point {wrong[0]} (counted from 0) has {lengths[wrong[0]]}")
    return starts


def _starts_by_sum(text: TextNumbers, elements: list[_Element], vertex: _Element) -> Int64:
    """Return the same for lines that are broken anywhere, if the file holds exactly as many numbers as its header says."""
    place, starts = 0, np.zeros(1, np.int64)
    for element in elements:
        walked = _text_starts(text, element, place)
        starts = walked if element is vertex else starts
        place = int(walked[-1])
    if place != len(text):
        raise SceneError(f"is truncated or damaged: it holds {len(text)} numbers, its header needs {place}")
    return starts


def _text_starts(text: TextNumbers, element: _Element, first: int) -> Int64:
    """Return the place of the first number of each record, and of the end, (count + 1,)."""
    if not element.has_lists:
        needed = first + element.count * len(element.properties)
        if needed > len(text):
            raise SceneError(f"is truncated: {len(text)} numbers, its header needs {needed}")
        return first + len(element.properties) * np.arange(element.count + 1)
    if first + element.count > len(text):
        raise SceneError(f"is truncated: {len(text)} numbers, its header says {element.count} {element.name}")
    values = text.values(first, len(text) - first)
    starts, place = np.empty(element.count + 1, np.int64), 0
    for k in range(element.count):
        starts[k] = first + place
        for p in element.properties:
            if place >= len(values):
                raise SceneError(f"is truncated: {len(text)} numbers hold {k} of its {element.count} {element.name}")
            if p.count_kind:
                place += _length(float(values[place]), element, p)
            place += 1
    starts[-1] = first + place
    if starts[-1] > len(text):
        raise SceneError(f"is truncated: {len(text)} numbers, its lists need {starts[-1]}")
    return starts


def _length(value: float, element: _Element, p: _Property) -> int:
    if not (0.0 <= value <= 1e15 and value == int(value)):
        raise SceneError(f"has a list {p.name!r} of {value:g} numbers in {element.name}")
    return int(value)


def _text_columns(text: TextNumbers, vertex: _Element, starts: Int64) -> Columns:
    first, last = int(starts[0]), int(starts[-1])
    values = text.values(first, last - first)
    if not vertex.has_lists:
        table = values.reshape(vertex.count, len(vertex.properties))
        return [(p.name, table[:, k]) for k, p in enumerate(vertex.properties)]
    places, columns = starts[:-1] - first, []
    for p in vertex.properties:
        if p.count_kind:
            places = places + 1 + values[places].astype(np.int64)
        else:
            columns.append((p.name, values[places]))
            places = places + 1
    return columns


# --- bytes


def _from_bytes(content: bytes, place: int, elements: list[_Element], vertex: _Element, order: str) -> Columns:
    for element in (element for element in elements if element.properties):
        starts = _byte_starts(content, place, element, order)
        if element is vertex:
            return _byte_columns(content, vertex, starts, order)
        place = int(starts[-1])
    return []


def _byte_starts(content: bytes, place: int, element: _Element, order: str) -> Int64:
    """Return where each record begins, and where the last one ends, (count + 1,) [bytes]."""
    sizes = [np.dtype(p.kind).itemsize for p in element.properties]
    fixed = sum(np.dtype(p.count_kind).itemsize if p.count_kind else size for p, size in zip(element.properties, sizes, strict=True))
    if place + element.count * fixed > len(content):
        needed, there = element.count * fixed, len(content) - place
        what = "points" if element.name == "vertex" else element.name
        raise SceneError(f"is truncated: {max(there, 0)} bytes of {what}, its header needs {needed}")
    if not element.has_lists:
        return place + fixed * np.arange(element.count + 1, dtype=np.int64)
    regular = _regular_starts(content, place, element, order)
    if regular is not None:
        return regular
    starts = np.empty(element.count + 1, np.int64)
    counts = [np.dtype(order + p.count_kind) if p.count_kind else None for p in element.properties]
    for k in range(element.count):
        starts[k] = place
        for p, size, count in zip(element.properties, sizes, counts, strict=True):
            if count is None:
                place += size
                continue
            if place + count.itemsize > len(content):
                raise SceneError(f"is truncated within the lists of {element.name} {k} of {element.count}")
            length = int(np.frombuffer(content, count, 1, place)[0])
            place += count.itemsize + _length(length, element, p) * size
        if place > len(content):
            raise SceneError(f"is truncated within the lists of {element.name} {k} of {element.count}")
    starts[-1] = place
    return starts


def _regular_starts(content: bytes, place: int, element: _Element, order: str) -> Int64 | None:
    """Return the same where every record has lists as long as the first one's; None where one has not."""
    if not element.count:
        return np.full(1, place, np.int64)
    first = dataclasses.replace(element, count=1)
    lengths: list[int] = []
    at = place
    for p in first.properties:
        if not p.count_kind:
            at += np.dtype(p.kind).itemsize
            continue
        count = np.dtype(order + p.count_kind)
        if at + count.itemsize > len(content):
            return None
        lengths.append(_length(int(np.frombuffer(content, count, 1, at)[0]), element, p))
        at += count.itemsize + lengths[-1] * np.dtype(p.kind).itemsize
    stride = at - place
    if place + element.count * stride > len(content):
        return None
    at, remaining = place, list(lengths)
    for p in element.properties:
        if not p.count_kind:
            at += np.dtype(p.kind).itemsize
            continue
        count, length = np.dtype(order + p.count_kind), remaining.pop(0)
        if (_strided(content, at, element.count, stride, count) != length).any():
            return None
        at += count.itemsize + length * np.dtype(p.kind).itemsize
    return place + stride * np.arange(element.count + 1, dtype=np.int64)


def _strided(content: bytes, place: int, count: int, stride: int, kind: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return one number of each of equally long records, (count,)."""
    return np.ndarray((count,), kind, buffer=content, offset=place, strides=(stride,))


def _byte_columns(content: bytes, vertex: _Element, starts: Int64, order: str) -> Columns:
    if not vertex.count:
        return [(p.name, np.empty(0, p.kind)) for p in vertex.properties if not p.count_kind]
    strides = np.diff(starts)
    stride = int(strides[0]) if (strides == strides[0]).all() else 0
    codes = np.frombuffer(content, np.uint8)

    def numbers(places: Int64, kind: str) -> npt.NDArray[Any]:
        dtype = np.dtype(order + kind)
        if stride and (np.diff(places) == stride).all():
            found = _strided(content, int(places[0]), vertex.count, stride, dtype)
        else:
            found = codes[places[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
        return found.astype(dtype.newbyteorder("="))

    places, columns = starts[:-1], []
    for p in vertex.properties:
        if p.count_kind:
            lengths = numbers(places, p.count_kind).astype(np.int64)
            places = places + np.dtype(p.count_kind).itemsize + lengths * np.dtype(p.kind).itemsize
        else:
            columns.append((p.name, numbers(places, p.kind)))
            places = places + np.dtype(p.kind).itemsize
    return columns
