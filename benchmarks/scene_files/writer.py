"""Writes PLY and PCD files of random make: types, orders, encodings, company and layout, with what a reader must find in them.

It shares no line with the package's readers, so that a mistake is not made twice.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

_PLY_NAMES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
_KINDS = tuple(_PLY_NAMES)
_LETTERS = {"i": "I", "u": "U", "f": "F"}
_EXTRAS = ("red", "green", "blue", "alpha", "nx", "ny", "nz", "intensity", "f_rest_0", "f_rest_1", "time", "scalar_Original cloud index")


@dataclass(frozen=True)
class CloudFile:
    """A file and its right value.

    Attributes:
        suffix: `.ply` or `.pcd`.
        content: the file.
        points: (N, 3), in the wider of float32 and the types of the coordinates; NaN where the file has NaN.
        labels: (N,), as float64, exact for every label that is written.
        costs: (N,) permeability costs, or None.
        make: what it is made of, in words.
    """

    suffix: str
    content: bytes
    points: npt.NDArray[np.floating]
    labels: npt.NDArray[np.float64]
    costs: npt.NDArray[np.float64] | None
    make: str


@dataclass(frozen=True)
class _List:
    """A list property: type of its count, type of its numbers, the numbers of each record."""

    count_kind: str
    kind: str
    rows: list[npt.NDArray[Any]]


_Column = npt.NDArray[Any] | _List


def random_file(rng: np.random.Generator) -> CloudFile:
    """Make one file."""
    n = int(rng.choice([1, 2, 3, int(rng.integers(4, 60)), int(rng.integers(60, 400))]))
    columns, points, labels, costs = _cloud(rng, n)
    make = ", ".join(f"{name}:{'list' if isinstance(column, _List) else column.dtype.str[1:]}" for name, column in columns.items())
    if rng.random() < 0.5:
        content, encoding = _ply(rng, columns, n)
        return CloudFile(".ply", content, points, labels, costs, f"{encoding} {make}")
    content, encoding = _pcd(rng, {name: column for name, column in columns.items() if not isinstance(column, _List)}, n)
    return CloudFile(".pcd", content, points, labels, costs, f"{encoding} {make}")


def _cloud(rng: np.random.Generator, n: int) -> tuple[dict[str, _Column], Any, Any, Any]:
    """Return shuffled columns, and the points, labels and costs among them."""
    columns: dict[str, _Column] = {}
    axes = ("X", "Y", "Z") if rng.random() < 0.1 else ("x", "y", "z")
    for axis in axes:
        kind = str(rng.choice(["f4", "f4", "f4", "f8", "f8", "i2", "i4", "u1"]))
        far = rng.choice([0.0, 0.0, 443210.0]) if kind == "f8" else 0.0
        values = rng.uniform(-3.0, 3.0, n) if kind[0] == "f" else rng.integers(0, 100, n)
        columns[axis] = (values + far).astype(kind)
    label_kind = str(rng.choice(_KINDS))
    top = 100 if label_kind in ("i1", "u1") else 30_000
    label = rng.choice([0, 1, 2, int(rng.integers(3, top))], n).astype(label_kind)
    nan_row = rng.random(n) < (0.2 if rng.random() < 0.3 else 0.0)
    if all(columns[axis].dtype.kind == "f" for axis in axes):  # type: ignore[union-attr]
        for axis in axes:
            columns[axis][nan_row] = np.nan  # type: ignore[index]
        if label.dtype.kind == "f":
            label[nan_row] = np.nan
    columns[str(rng.choice(["label", "label", "Label", "scalar_Label", "scalar_label"]))] = label
    costs = None
    if rng.random() < 0.3:
        costs = columns["permeability_cost"] = rng.uniform(0.0, 3.0, n).astype(rng.choice(["f4", "f8"]))
    for name in rng.permutation(_EXTRAS)[: rng.integers(0, 5)]:
        columns[str(name)] = _random_column(rng, str(rng.choice(_KINDS)), n)
    if rng.random() < 0.3:
        columns["view"] = _random_list(rng, n)
    points = np.empty((n, 3), np.result_type(np.float32, *(columns[axis] for axis in axes)))  # type: ignore[arg-type]
    for k, axis in enumerate(axes):
        points[:, k] = columns[axis]
    order = rng.permutation(len(columns))
    names = list(columns)
    shuffled = {names[k]: columns[names[k]] for k in order}
    return shuffled, points, label.astype(np.float64), None if costs is None else costs.astype(np.float64)


def _random_column(rng: np.random.Generator, kind: str, n: int) -> npt.NDArray[Any]:
    if kind[0] == "f":
        return (rng.standard_normal(n) * 10.0 ** rng.integers(-6, 7)).astype(kind)
    limits = np.iinfo(kind)
    return rng.integers(limits.min, limits.max, n, dtype=np.int64, endpoint=True).astype(kind)


def _random_list(rng: np.random.Generator, n: int) -> _List:
    kind, same = str(rng.choice(_KINDS)), rng.random() < 0.5
    lengths = np.full(n, rng.integers(0, 5)) if same else rng.integers(0, 6, n)
    return _List(str(rng.choice(["u1", "u1", "u2", "i4", "u4", "i1"])), kind, [_random_column(rng, kind, int(k)) for k in lengths])


# --- PLY


def _ply(rng: np.random.Generator, columns: dict[str, _Column], n: int) -> tuple[bytes, str]:
    encoding = str(rng.choice(["ascii", "binary_little_endian", "binary_big_endian"]))
    elements: list[tuple[str, dict[str, _Column], int]] = [("vertex", columns, n)]
    for name in rng.permutation(["face", "camera", "edge", "material"])[: rng.integers(0, 4)]:
        count = int(rng.integers(0, 7))
        own: dict[str, _Column] = {f"p{k}": _random_column(rng, str(rng.choice(_KINDS)), count) for k in range(rng.integers(0, 3))}
        if name == "face" or rng.random() < 0.4:
            own["vertex_indices"] = _random_list(rng, count)
        elements.insert(int(rng.integers(0, len(elements) + 1)), (str(name), own, count))
    header = ["ply", f"format {encoding} 1.0"]
    for name, own, count in elements:
        header.append(f"element {name} {count}")
        for p, column in own.items():
            if isinstance(column, _List):
                kinds = f"{rng.choice(_PLY_NAMES[column.count_kind])} {rng.choice(_PLY_NAMES[column.kind])}"
                header.append(f"property list {kinds} {p}")
            else:
                header.append(f"property {rng.choice(_PLY_NAMES[column.dtype.str[1:]])} {p}")
    for _ in range(rng.integers(0, 3)):
        place = int(rng.integers(1, len(header) + 1))
        header.insert(
            place, str(rng.choice(["comment made by VCGLIB", "obj_info num_cols 640", "comment", "comment element vertex 3", ""]))
        )
    newline = str(rng.choice(["\n", "\n", "\n", "\r\n", "\r"]))
    text = newline.join([*header, "end_header", ""]).encode()
    if encoding == "ascii":
        return text + _ascii(rng, [_words(own, count) for _, own, count in elements], newline), encoding
    order = "<" if encoding == "binary_little_endian" else ">"
    return text + b"".join(_records(own, count, order) for _, own, count in elements), encoding


def _words(columns: dict[str, _Column], count: int) -> list[list[str]]:
    return [[word for column in columns.values() for word in _row_words(column, k)] for k in range(count)]


def _row_words(column: _Column, k: int) -> list[str]:
    if isinstance(column, _List):
        return [str(len(column.rows[k])), *(_word(value) for value in column.rows[k])]
    return [_word(column[k])]


def _word(value: Any) -> str:
    if value.dtype.kind == "f":
        return "nan" if np.isnan(value) else repr(float(value))
    return str(int(value))


def _ascii(rng: np.random.Generator, elements: list[list[list[str]]], newline: str) -> bytes:
    rows = [row for element in elements for row in element if row]
    how = rng.random()
    if how < 0.75:  # a record a line, as nearly everybody writes
        gap = str(rng.choice([" ", " ", "\t", "  "]))
        end = str(rng.choice(["", "", " "])) + newline
        body = end.join(gap.join(row) for row in rows) + (end if rng.random() < 0.9 else "")
        return body.encode()
    words = [word for row in rows for word in row]
    width = len(words) if how < 0.85 else int(rng.integers(1, 9))
    lines = [" ".join(words[k : k + width]) for k in range(0, len(words), max(width, 1))]
    if len(lines) == len(rows):  # as many lines as records, which do not stand on them: no reader could know
        lines = [" ".join(words)] if len(rows) != 1 else lines
    return (newline.join(lines) + newline).encode()


def _records(columns: dict[str, _Column], count: int, order: str) -> bytes:
    parts: list[bytes] = []
    for k in range(count):
        for column in columns.values():
            if isinstance(column, _List):
                parts.append(np.array([len(column.rows[k])], order + column.count_kind).tobytes())
                parts.append(column.rows[k].astype(order + column.kind).tobytes())
            else:
                parts.append(column[k : k + 1].astype(order + column.dtype.str[1:]).tobytes())
    return b"".join(parts)


# --- PCD


def _pcd(rng: np.random.Generator, columns: dict[str, npt.NDArray[Any]], n: int) -> tuple[bytes, str]:
    fields: list[tuple[str, npt.NDArray[Any]]] = [(name.replace(" ", "_"), column[:, None]) for name, column in columns.items()]
    for name in ("_", "_", "descriptor"):
        if rng.random() < 0.2:
            wide = _random_column(rng, str(rng.choice(_KINDS)), n * (count := int(rng.integers(2, 6)))).reshape(n, count)
            fields.insert(int(rng.integers(0, len(fields) + 1)), (name, wide))
    encoding = str(rng.choice(["ascii", "binary", "binary_compressed"]))
    kinds = [column.dtype.str[1:] for _, column in fields]
    counts = [column.shape[1] for _, column in fields]
    rows = next((rows for rows in (4, 3, 2) if n % rows == 0), 1) if rng.random() < 0.3 else 1
    header = [
        "# .PCD v.7 - Point Cloud Data file format",
        str(rng.choice(["VERSION .7", "VERSION 0.7", "VERSION .5"])),
        f"{rng.choice(['FIELDS', 'FIELDS', 'COLUMNS'])} {' '.join(name for name, _ in fields)}",
        f"SIZE {' '.join(kind[1] for kind in kinds)}",
        f"TYPE {' '.join(_LETTERS[kind[0]] for kind in kinds)}",
        f"WIDTH {n // rows}",
        f"HEIGHT {rows}",
    ]
    if max(counts) > 1 or rng.random() < 0.8:
        header.insert(5, f"COUNT {' '.join(map(str, counts))}")
    if rng.random() < 0.7:
        header.append(str(rng.choice(["VIEWPOINT 0 0 0 1 0 0 0", "VIEWPOINT 0.5 -0.25 1 0 1 0 0"])))
    if rng.random() < 0.8:
        header.append(f"POINTS {n}")
    newline = str(rng.choice(["\n", "\n", "\r\n"]))
    text = newline.join([*header, f"DATA {encoding}", ""]).encode()
    if encoding == "ascii":
        words = [[_word(value) for _, column in fields for value in column[k]] for k in range(n)]
        return text + _ascii(rng, [words], newline), encoding
    if encoding == "binary":
        return text + b"".join(column[k].astype("<" + column.dtype.str[1:]).tobytes() for k in range(n) for _, column in fields), encoding
    body = b"".join(column.astype("<" + column.dtype.str[1:]).tobytes() for _, column in fields)
    packed = lzf_compress(body)
    return text + struct.pack("<II", len(packed), len(body)) + packed, encoding


def lzf_compress(data: bytes) -> bytes:
    """Pack data as liblzf does: literal runs of up to 32, copies of 3 to 264 bytes from up to 8 KiB before."""
    out, literals = bytearray(), bytearray()
    seen: dict[bytes, int] = {}

    def flush() -> None:
        for k in range(0, len(literals), 32):
            run = literals[k : k + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literals.clear()

    place = 0
    while place < len(data):
        key = data[place : place + 3]
        earlier = seen.get(key, -1) if len(key) == 3 else -1
        seen[key] = place
        if earlier < 0 or place - earlier > 8192:
            literals.append(data[place])
            place += 1
            continue
        length = 3
        while length < 264 and place + length < len(data) and data[earlier + length] == data[place + length]:
            length += 1
        flush()
        back, code = place - earlier - 1, length - 2
        if code < 7:
            out.append(code << 5 | back >> 8)
        else:
            out.extend((7 << 5 | back >> 8, code - 7))
        out.append(back & 255)
        place += length
    flush()
    return bytes(out)
