"""The points of a sensor_msgs/PointCloud2, from rclpy or from a recording: fields by name, every number type, byte order and padding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError

#: NumPy types (without byte order) of `PointField.datatype`.
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
XYZ = ("x", "y", "z")
#: The optional field of leaf points that scales their cost.
COST_FIELD = "permeability_cost"


@dataclass(frozen=True)
class Cloud:
    """A decoded cloud.

    Attributes:
        points: (N, 3) float32, or float64 where a coordinate is a wider number than that [m], in the message's frame; rows may be NaN.
        columns: the further fields asked for and present, (N,) each, in their own types.
    """

    points: npt.NDArray[np.floating]
    columns: Mapping[str, npt.NDArray[np.generic]]


def _refuse(topic: str, sentence: str) -> SceneError:
    return SceneError(f"{topic} {sentence}")


def check_layout(msg: Any, topic: str, required: tuple[str, ...] = XYZ) -> None:
    """Check a cloud's header, fields and sizes without reading its points.

    Args:
        msg: the message: rclpy's, or another with the same attributes.
        topic: its topic's short name, for sentences.
        required: the fields that must be there.

    Raises:
        SceneError: with what is wrong, what is there, and what was expected.
    """
    if not msg.header.frame_id.strip("/ "):
        raise _refuse(topic, "has an empty frame_id; it must name the frame of its points")
    count = int(msg.width) * int(msg.height)
    if count == 0:
        return  # an empty cloud needs no fields: point cloud libraries publish it without any
    names = [field.name for field in msg.fields]
    for name in required:
        if name not in names:
            raise _refuse(topic, f"has no field {name!r}; its fields are {', '.join(names) or 'none'}")
        if names.count(name) > 1:
            raise _refuse(topic, f"has the field {name!r} {names.count(name)} times")
    for field in msg.fields:
        if field.name in required:
            _check_field(msg, field, topic)
    row_length = int(msg.width) * int(msg.point_step)
    if msg.height > 1 and msg.row_step < row_length:
        raise _refuse(topic, f"has row_step {msg.row_step}, less than width x point_step = {row_length}")
    needed = (int(msg.height) - 1) * int(msg.row_step if msg.height > 1 else row_length) + row_length
    if len(msg.data) < needed:
        raise _refuse(topic, f"holds {len(msg.data)} bytes, but its header announces {count} points in {needed} bytes")


def _check_field(msg: Any, field: Any, topic: str) -> None:
    if field.datatype not in TYPES:
        raise _refuse(topic, f"has field {field.name!r} of datatype {field.datatype}; known are 1 to 8")
    if field.count > 1:
        raise _refuse(topic, f"has field {field.name!r} with count {field.count}; expected 1")
    size = np.dtype(TYPES[field.datatype]).itemsize
    if field.offset + size > msg.point_step:
        end = field.offset + size
        raise _refuse(topic, f"has field {field.name!r} at bytes {field.offset} to {end}, beyond point_step {msg.point_step}")


def decode_cloud(msg: Any, topic: str, *, required: tuple[str, ...] = (), optional: tuple[str, ...] = ()) -> Cloud:
    """Read a cloud's points and some of its further fields.

    Args:
        msg: the message; organised clouds, padded points and rows, both byte orders.
        topic: its topic's short name, for sentences.
        required: further fields that must be there (beyond x, y, z).
        optional: further fields that are read where they are there.

    Raises:
        SceneError: see `check_layout`.
    """
    present = {field.name: field for field in msg.fields}
    wanted = (*XYZ, *required, *(name for name in optional if name in present))
    check_layout(msg, topic, wanted)
    count = int(msg.width) * int(msg.height)
    if count == 0:
        return Cloud(np.empty((0, 3), np.float32), {name: np.empty(0, np.float32) for name in wanted[3:]})
    order = ">" if msg.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": list(wanted),
            "formats": [order + TYPES[present[name].datatype] for name in wanted],
            "offsets": [int(present[name].offset) for name in wanted],
            "itemsize": int(msg.point_step),
        }
    )
    strides = (int(msg.row_step) if msg.height > 1 else count * int(msg.point_step), int(msg.point_step))
    table = np.ndarray((int(msg.height), int(msg.width)), dtype=layout, buffer=memoryview(msg.data), strides=strides)
    points = np.empty((count, 3), np.result_type(np.float32, *(table.dtype[name] for name in XYZ)))
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate(XYZ):
            points[:, axis] = table[name].reshape(-1)
    columns = {name: table[name].reshape(-1).astype(table[name].dtype.newbyteorder("=")) for name in wanted[3:]}
    return Cloud(points, columns)
