"""PointCloud2 both ways: fields by name, all types, both byte orders, padding; and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import PointCloud2, PointField

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.ros.inputs.clouds import check_layout, decode_cloud, encode_cloud
from lime_planner.scene.scene import Scene

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def organised(
    rows: int, columns: int, datatype: int = 7, *, big: bool = False, gap: int = 0, pad: int = 0, order: str = "xyz", label: int = 0
) -> tuple[PointCloud2, np.ndarray, np.ndarray]:
    """A cloud with `gap` bytes before each field and `pad` bytes after each row, its points, and its labels."""
    base = np.dtype((">" if big else "<") + TYPES[datatype])
    names = [*order, *(["label"] if label else [])]
    types = [np.dtype((">" if big else "<") + TYPES[label]) if name == "label" else base for name in names]
    offsets, at = [], 0
    for kind in types:
        at += gap
        offsets.append(at)
        at += kind.itemsize
    step = at + gap
    row_step = columns * step + pad
    data = bytearray(np.random.default_rng(1).integers(0, 256, rows * row_step, dtype=np.uint8).tobytes())
    values = np.random.default_rng(2).integers(0, 100, (rows * columns, 3)).astype(np.float32)
    labels = np.arange(rows * columns) % 3
    for k in range(rows * columns):
        start = (k // columns) * row_step + (k % columns) * step
        for name, kind, offset in zip(names, types, offsets, strict=True):
            value = labels[k] if name == "label" else values[k, "xyz".index(name)]
            data[start + offset : start + offset + kind.itemsize] = np.array(value, kind).tobytes()
    msg = PointCloud2(height=rows, width=columns, point_step=step, row_step=row_step, is_bigendian=big)
    msg.header.frame_id = "base"
    msg.fields = [
        PointField(name=name, offset=offset, datatype=label if name == "label" else datatype, count=1)
        for name, offset in zip(names, offsets, strict=True)
    ]
    msg.data.frombytes(bytes(data))
    return msg, values, labels


@pytest.mark.parametrize("datatype", sorted(TYPES))
@pytest.mark.parametrize("big", [False, True])
def test_every_number_type_and_byte_order(datatype: int, big: bool) -> None:
    msg, values, _ = organised(1, 7, datatype, big=big)
    assert np.array_equal(decode_cloud(msg, "leaf_cloud").points, values)


@settings(max_examples=60, deadline=None)
@given(
    rows=st.integers(1, 5),
    columns=st.integers(1, 5),
    gap=st.integers(0, 9),
    pad=st.integers(0, 9),
    order=st.permutations("xyz").map("".join),
    datatype=st.sampled_from(sorted(TYPES)),
    label=st.sampled_from(sorted(TYPES)),
    big=st.booleans(),
)
def test_padding_order_and_organisation(
    rows: int, columns: int, gap: int, pad: int, order: str, datatype: int, label: int, big: bool
) -> None:
    msg, values, labels = organised(rows, columns, datatype, big=big, gap=gap, pad=pad, order=order, label=label)
    cloud = decode_cloud(msg, "labelled_cloud", required=("label",))
    assert np.array_equal(cloud.points, values)
    assert np.array_equal(cloud.columns["label"], labels)


def test_round_trip_with_columns_and_nan() -> None:
    points = np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, np.inf]], np.float32)
    msg = encode_cloud(points, {"label": np.array([1, 2], np.uint8), "permeability_cost": np.array([0.5, 2.0], np.float32)})
    msg.header.frame_id = "base"
    assert not msg.is_dense
    cloud = decode_cloud(msg, "labelled_cloud", required=("label",), optional=("permeability_cost", "intensity"))
    assert np.array_equal(cloud.points, points, equal_nan=True)
    assert cloud.columns["label"].tolist() == [1, 2]
    assert cloud.columns["permeability_cost"].tolist() == [0.5, 2.0]
    assert "intensity" not in cloud.columns


def test_an_empty_cloud_needs_no_fields() -> None:
    msg = PointCloud2()
    msg.header.frame_id = "base"
    cloud = decode_cloud(msg, "stem_cloud", required=("label",))
    assert cloud.points.shape == (0, 3)
    assert len(cloud.columns["label"]) == 0


def test_doubles_stay_doubles_and_those_beyond_floats_are_left_out() -> None:
    msg, _, _ = organised(1, 2, 8)
    msg.data = type(msg.data)("B")
    msg.data.frombytes(np.full(6, 1e300).tobytes())
    points = decode_cloud(msg, "leaf_cloud").points
    assert points.dtype == np.float64
    assert Scene.from_points(points, np.zeros(len(points), int)).counts["non_finite"] == len(points)


def broken(**changes: object) -> PointCloud2:
    msg, _, _ = organised(2, 3, label=2)
    for name, value in changes.items():
        setattr(msg, name, value)
    return msg


def without(name: str) -> PointCloud2:
    msg = broken()
    msg.fields = [field for field in msg.fields if field.name != name]
    return msg


def with_field(**changes: object) -> PointCloud2:
    msg = broken()
    for name, value in changes.items():
        setattr(msg.fields[0], name, value)
    return msg


def truncated() -> PointCloud2:
    msg = broken()
    msg.data = msg.data[:-5]
    return msg


def doubled() -> PointCloud2:
    msg = broken()
    msg.fields = [*msg.fields, msg.fields[1]]
    return msg


def nameless() -> PointCloud2:
    msg = broken()
    msg.header.frame_id = " / "
    return msg


REFUSED = {
    "no x": (without("x"), "no field 'x'"),
    "no z": (without("z"), "no field 'z'; its fields are x, y, label"),
    "no label": (without("label"), "no field 'label'"),
    "no fields": (broken(fields=[]), "its fields are none"),
    "twice the same": (doubled(), "the field 'y' 2 times"),
    "unknown type": (with_field(datatype=9), "datatype 9"),
    "array field": (with_field(count=3), "count 3"),
    "offset too large": (with_field(offset=4000), "beyond point_step"),
    "point_step zero": (broken(point_step=0), "beyond point_step 0"),
    "row_step too small": (broken(row_step=1), "row_step 1"),
    "data too short": (truncated(), "its header announces 6 points"),
    "width too large": (broken(width=2**31), "row_step"),
    "height too large": (broken(height=2**31), "its header announces"),
    "empty frame": (nameless(), "empty frame_id"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_what_is_refused_names_topic_and_reason(case: str) -> None:
    msg, words = REFUSED[case]
    with pytest.raises(Refusal, match="labelled_cloud") as caught:
        decode_cloud(msg, "labelled_cloud", required=("label",))
    assert caught.value.status is Status.BAD_INPUT
    assert words in str(caught.value)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_no_header_makes_it_crash(data: st.DataObject) -> None:
    msg, _, _ = organised(2, 3, label=2)
    msg.width, msg.height = data.draw(st.integers(0, 12)), data.draw(st.integers(0, 12))
    msg.point_step, msg.row_step = data.draw(st.integers(0, 64)), data.draw(st.integers(0, 128))
    msg.is_bigendian = data.draw(st.booleans())
    for field in msg.fields:
        field.offset, field.datatype, field.count = (
            data.draw(st.integers(0, 40)),
            data.draw(st.integers(0, 10)),
            data.draw(st.integers(0, 3)),
        )
    try:
        check_layout(msg, "leaf_cloud")
        cloud = decode_cloud(msg, "leaf_cloud", optional=("label",))
    except Refusal:
        return
    assert cloud.points.shape == (msg.width * msg.height, 3)
