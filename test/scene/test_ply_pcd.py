"""PLY and PCD files of every make: types, orders, lists, elements, layouts, compression; and what Open3D makes of ours."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.scene_files import fuzz
from benchmarks.scene_files.writer import lzf_compress
from lime_planner.core.errors import SceneError
from lime_planner.scene.pcd import read_pcd
from lime_planner.scene.ply import read_ply
from lime_planner.scene.scene import Scene

POINTS = np.array([[0.5, 0.0, 0.4], [0.5, 0.0, 0.5], [0.6, 0.0, 0.5]])
LABELS = [0, 1, 1]
NAMES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float", "f8": "double"}


def ply(properties: str, body: bytes, *, kind: str = "binary_little_endian", n: int = 3, before: str = "", after: str = "") -> bytes:
    """A file with `properties` such as `float x, uchar label`, and other elements as whole header lines."""
    lines = [f"property {p.strip()}" for p in properties.split(",")]
    return (
        "\n".join(
            ["ply", f"format {kind} 1.0", *before.split("\n"), f"element vertex {n}", *lines, *after.split("\n"), "end_header\n"]
        ).encode()
        + body
    )


def table(kinds: str, order: str = "<", label: str = "u1") -> np.ndarray:
    """The three points as records; `kinds` are those of x, y and z."""
    found = np.zeros(3, [(axis, order + kind) for axis, kind in zip("xyz", kinds.split(), strict=True)] + [("label", order + label)])
    found["x"], found["y"], found["z"] = POINTS.T
    found["label"] = LABELS
    return found


def check(path: Path, content: bytes, **options: Any) -> Scene:
    """One leaf and two stem points, where they belong."""
    path.write_bytes(content)
    scene = Scene.load(path, **options)
    np.testing.assert_allclose(scene.leaf_points, POINTS[:1], atol=1e-7)
    np.testing.assert_allclose(scene.stem_points, POINTS[1:], atol=1e-7)
    return scene


def test_random_files_whole_and_damaged(tmp_path: Path) -> None:
    """The same with more files: `python -m benchmarks.scene_files.fuzz`."""
    counts, faults = fuzz.run(120, 7, tmp_path)
    assert not faults, "\n".join(faults)
    assert counts[".ply right"] > 40 and counts[".pcd right"] > 40
    assert counts["truncated refused"] > 30 and counts["broken refused"] > 20


@pytest.mark.parametrize("kinds", ["f8 f8 f4", "f4 f4 f8", "f8 f4 f4", "f4 f8 f8", "f8 f8 f8"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_coordinates_of_mixed_types(tmp_path: Path, kinds: str, order: str) -> None:
    properties = ", ".join(f"{NAMES[kind]} {axis}" for axis, kind in zip("xyz", kinds.split(), strict=True))
    encoding = "binary_little_endian" if order == "<" else "binary_big_endian"
    check(tmp_path / "a.ply", ply(f"{properties}, uchar label", table(kinds, order).tobytes(), kind=encoding))


@pytest.mark.parametrize("label", NAMES)
def test_every_number_type_is_a_label(tmp_path: Path, label: str) -> None:
    xyz = "float x, float y, float z"
    check(tmp_path / "a.ply", ply(f"{xyz}, {NAMES[label]} label", table("f4 f4 f4", label=label).tobytes()))
    text = "".join(f"{x} {y} {z} {k:.3f}\n" for (x, y, z), k in zip(POINTS, LABELS, strict=True))  # as PDAL writes integers
    check(tmp_path / "b.ply", ply(f"{xyz}, {NAMES[label]} label", text.encode(), kind="ascii"))
    kind, size = ("F" if label[0] == "f" else label[0].upper()), label[1]
    head = f"VERSION .5\nCOLUMNS x y z label\nSIZE 4 4 4 {size}\nTYPE F F F {kind}\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA binary\n"
    check(tmp_path / "a.pcd", head.encode() + table("f4 f4 f4", label=label).tobytes())


@pytest.mark.parametrize("label", ["i8", "u8"])
def test_wide_integers_that_some_writers_have(tmp_path: Path, label: str) -> None:
    name = "int64" if label == "i8" else "uint64"
    check(tmp_path / "a.ply", ply(f"float x, float y, float z, {name} label", table("f4 f4 f4", label=label).tobytes()))
    check(tmp_path / "a.pcd", pcd(table("f4 f4 f4", label=label).tobytes(), "binary", kinds=f"4F 4F 4F 8{label[0].upper()}"))


def test_two_fields_that_could_be_meant(tmp_path: Path) -> None:
    found = ply("float x, float y, float z, uchar Label, uchar scalar_label", b"0 0 0 1 1\n", kind="ascii", n=1)
    (tmp_path / "a.ply").write_bytes(found)
    with pytest.raises(SceneError, match=r"has 2 fields 'label': Label, scalar_label"):
        Scene.load(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(found.replace(b"Label", b"label"))
    assert len(Scene.load(tmp_path / "a.ply").stem_points) == 1


def test_labels_of_points_that_are_not_finite_do_not_count(tmp_path: Path) -> None:
    text = b"0.5 0 0.4 0\n0.5 0 0.5 1\nnan nan nan nan\n0.6 0 0.5 1\n0.5 0 -nan(ind) 0.5\n"
    scene = check(tmp_path / "a.ply", ply("float x, float y, float z, float label", text, kind="ascii", n=5))
    assert scene.counts["non_finite"] == 2
    (tmp_path / "a.ply").write_bytes(ply("float x, float y, float z, float label", b"0 0 0 0\n0 0 1 nan\n", kind="ascii", n=2))
    with pytest.raises(SceneError, match=r"labels: 1 are not whole numbers, the first \(nan\) at point 1"):
        Scene.load(tmp_path / "a.ply")


def test_lists_and_other_elements_are_passed_over(tmp_path: Path) -> None:
    xyz, rows = "float x, float y, float z, uchar label", [row.tobytes() for row in table("f4 f4 f4")]
    lists = [struct.pack("<B", k) + b"\xff\xff\xff\xff" * k for k in (2, 0, 3)]
    check(tmp_path / "a.ply", ply(f"{xyz}, list uchar int view", b"".join(row + own for row, own in zip(rows, lists, strict=True))))
    check(tmp_path / "b.ply", ply(f"list uchar int view, {xyz}", b"".join(own + row for row, own in zip(rows, lists, strict=True))))
    faces = "element face 3\nproperty list uchar int vertex_indices"
    check(tmp_path / "c.ply", ply(xyz, b"".join(lists) + b"".join(rows), before=faces))
    cameras = "element nothing 5\nelement camera 2\nproperty double focal\nproperty char id"
    check(tmp_path / "d.ply", ply(xyz, b"\x00" * 18 + b"".join(rows) + b"".join(lists), before=cameras, after=faces))
    text = b"2 7 7\n0\n0.5 0 0.4 0\n0.5 0 0.5 1\n0.6 0 0.5 1\n"
    check(tmp_path / "e.ply", ply(xyz, text, kind="ascii", before="element face 2\nproperty list uchar int vertex_indices"))


def test_a_list_that_is_longer_than_the_file_is_refused_at_once(tmp_path: Path) -> None:
    xyz = "list uint double view, float x, float y, float z, uchar label"
    for n in (1, 3):
        (tmp_path / "a.ply").write_bytes(ply(xyz, struct.pack("<I", 4_000_000_000) + bytes(60), n=n))
        with pytest.raises(SceneError, match="is truncated"):
            Scene.load(tmp_path / "a.ply")
    (tmp_path / "b.ply").write_bytes(ply(xyz.replace("uint", "int"), struct.pack("<i", -1) + bytes(60), n=1))
    with pytest.raises(SceneError, match="has a list 'view' of -1 numbers"):
        Scene.load(tmp_path / "b.ply")


@pytest.mark.parametrize("newline", [b"\n", b"\r\n", b"\r"])
def test_ends_of_lines_comments_and_names(tmp_path: Path, newline: bytes) -> None:
    properties = "float X, float Y, float Z, float scalar_Original cloud index, uchar scalar_Label"
    rows = b"".join(row.tobytes()[:12] + b"\r\n\r\n" + row.tobytes()[12:] for row in table("f4 f4 f4"))
    content = ply(properties, b"", before="comment end_header\nobj_info element vertex 9\n").replace(b"\n", newline)
    check(tmp_path / "a.ply", content + rows)


def test_numbers_on_any_lines_if_they_add_up(tmp_path: Path) -> None:
    xyz = "float x, float y, float z, uchar label"
    check(tmp_path / "a.ply", ply(xyz, b"0.5 0 0.4 0 0.5 0 0.5 1 0.6 0 0.5 1", kind="ascii"))
    check(tmp_path / "b.ply", ply(xyz, b"0.5\n0\n0.4\n0\n0.5\n0\n0.5\n1\n0.6\n0\n0.5\n1\n", kind="ascii"))
    for body in (b"0.5 0 0.4 0 0.5 0 0.5 1 0.6 0 0.5", b"0.5 0 0.4 0 0.5\n0 0.5 1\n0.6 0 0.5 1\n"):
        (tmp_path / "c.ply").write_bytes(ply(xyz, body, kind="ascii"))
        with pytest.raises(SceneError, match=r"truncated|numbers a line"):
            Scene.load(tmp_path / "c.ply")


def pcd(body: bytes, data: str, *, fields: str = "x y z label", kinds: str = "4F 4F 4F 1U", more: str = "") -> bytes:
    sizes, letters = " ".join(k[0] for k in kinds.split()), " ".join(k[1] for k in kinds.split())
    return f"# .PCD\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {letters}\n{more}WIDTH 3\nHEIGHT 1\nDATA {data}\n".encode() + body


def test_compressed_pcd_and_the_place_of_the_sensor(tmp_path: Path) -> None:
    found = table("f4 f8 f4")
    body = b"".join(np.ascontiguousarray(found[name]).tobytes() for name in ("x", "y", "z", "label"))
    packed = lzf_compress(body)
    assert len(packed) < len(body), "there is a copy in it, not literals alone"
    content = pcd(
        struct.pack("<II", len(packed), len(body)) + packed, "binary_compressed", kinds="4F 8F 4F 1U", more="VIEWPOINT 1 2 3 0 0 0 1\n"
    )
    check(tmp_path / "a.pcd", content)
    viewpoint = read_pcd(tmp_path / "a.pcd")[1]
    assert viewpoint is not None and viewpoint.tolist() == [1, 2, 3, 0, 0, 1, 0]
    for broken in (packed[:-2], b"\xff\xff\xff" + packed[3:]):
        (tmp_path / "b.pcd").write_bytes(pcd(struct.pack("<II", len(broken), len(body)) + broken, "binary_compressed", kinds="4F 8F 4F 1U"))
        with pytest.raises(SceneError, match="compressed"):
            Scene.load(tmp_path / "b.pcd")


def test_copies_that_run_into_what_they_write(tmp_path: Path) -> None:
    body = bytes(12) * 3 + b"\x01\x01\x01"
    packed = lzf_compress(body)
    assert len(packed) < 12
    (tmp_path / "a.pcd").write_bytes(pcd(struct.pack("<II", len(packed), len(body)) + packed, "binary_compressed"))
    assert Scene.load(tmp_path / "a.pcd").stem_points.tolist() == [[0, 0, 0]] * 3


def test_sizes_that_no_memory_holds_are_refused(tmp_path: Path) -> None:
    for content, words in (
        (b"ply\nformat binary_little_endian 1.0\nelement nothing 999999999999\nelement vertex 1\nend_header\n", "no field 'x'"),
        (ply("float x, float y, float z, uchar label", b"", n=10**12), "truncated"),
        (ply("float x, float y, float z, uchar label", b"1 2 3 4", kind="ascii", n=10**12), "truncated"),
        (pcd(b"", "binary", more="POINTS 1000000000000\n"), "truncated"),
        (pcd(b"1 2 3 0\n", "ascii", more="POINTS 1000000000000\n"), "truncated"),
        (pcd(b"", "binary", more="COUNT 0 0 0 0\nPOINTS 1000000000000\n"), "no field 'x'"),
    ):
        path = tmp_path / ("a.ply" if content.startswith(b"ply") else "a.pcd")
        path.write_bytes(content)
        with pytest.raises(SceneError, match=words):
            Scene.load(path)


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_open3d_reads_what_we_write(tmp_path: Path, suffix: str) -> None:
    open3d = pytest.importorskip("open3d")
    scene = Scene(POINTS[:1], [2.5], POINTS[1:], np.empty((0, 3)))
    scene.save(tmp_path / f"a{suffix}")
    cloud = open3d.t.io.read_point_cloud(str(tmp_path / f"a{suffix}"))
    assert cloud.point["positions"].numpy() == pytest.approx(POINTS)
    assert cloud.point["label"].numpy()[:, 0].tolist() == LABELS
    assert cloud.point["permeability_cost"].numpy()[:, 0] == pytest.approx([2.5, 1.0, 1.0])
    assert [name for name, _ in (read_ply(tmp_path / "a.ply") if suffix == ".ply" else read_pcd(tmp_path / "a.pcd")[0])][3:] == [
        "label",
        "permeability_cost",
    ]
