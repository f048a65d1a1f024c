"""ROS point clouds to arrays and back; what cannot be used is refused with BAD_INPUT."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2, PointField

from lime_planner.core.errors import Refusal, SceneError
from lime_planner.core.status import Status
from lime_planner.scene import point_cloud2
from lime_planner.scene.point_cloud2 import TYPES, XYZ, Cloud

_FROM_NUMPY = {np.dtype(name): number for number, name in TYPES.items()}


@contextlib.contextmanager
def _refusing() -> Iterator[None]:
    try:
        yield
    except SceneError as error:
        raise Refusal(Status.BAD_INPUT, str(error)) from None


def check_layout(msg: PointCloud2, topic: str, required: tuple[str, ...] = XYZ) -> None:
    """Check a cloud as `point_cloud2.check_layout` does.

    Raises:
        Refusal: BAD_INPUT with what is wrong, what is there, and what was expected.
    """
    with _refusing():
        point_cloud2.check_layout(msg, topic, required)


def decode_cloud(msg: PointCloud2, topic: str, *, required: tuple[str, ...] = (), optional: tuple[str, ...] = ()) -> Cloud:
    """Read a cloud as `point_cloud2.decode_cloud` does.

    Raises:
        Refusal: BAD_INPUT, see `check_layout`.
    """
    with _refusing():
        return point_cloud2.decode_cloud(msg, topic, required=required, optional=optional)


def encode_cloud(points: npt.ArrayLike, columns: Mapping[str, npt.NDArray[np.generic]] | None = None) -> PointCloud2:
    """Make an unorganised little-endian cloud; the caller fills in the header.

    Args:
        points: (N, 3) [m].
        columns: further fields, (N,) each, in one of the eight types of `PointField`.
    """
    xyz = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    further = dict(columns or {})
    layout = np.dtype([(name, "<f4") for name in XYZ] + [(name, column.dtype.newbyteorder("<")) for name, column in further.items()])
    table = np.empty(len(xyz), dtype=layout)
    for axis, name in enumerate(XYZ):
        table[name] = xyz[:, axis]
    for name, column in further.items():
        table[name] = column
    msg = PointCloud2()
    msg.height, msg.width = 1, len(xyz)
    described = dict(layout.fields or {})
    msg.fields = [
        PointField(name=name, offset=int(entry[1]), datatype=_FROM_NUMPY[entry[0].newbyteorder("=")], count=1)
        for name, entry in described.items()
    ]
    msg.is_bigendian = False
    msg.point_step = layout.itemsize
    msg.row_step = layout.itemsize * len(xyz)
    msg.is_dense = bool(np.isfinite(xyz).all())
    # Through the array's own buffer: assigning bytes would be checked value by value in Python.
    msg.data.frombytes(table.tobytes())
    return msg
