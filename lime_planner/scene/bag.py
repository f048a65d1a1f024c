"""Recordings of ROS (rosbag2 as sqlite3 or MCAP, and ROS 1 bags), read without ROS: the newest message of a topic at a given time."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from lime_planner.core.errors import ProblemError, SceneError
from lime_planner.core.transform_history import TransformHistory

CLOUD = "sensor_msgs/msg/PointCloud2"
POSE = "geometry_msgs/msg/PoseStamped"
POINT = "geometry_msgs/msg/PointStamped"
POSES = "geometry_msgs/msg/PoseArray"
JOINTS = "sensor_msgs/msg/JointState"
_TF = "tf2_msgs/msg/TFMessage"
_TF_TOPICS = ("/tf_static", "/tf")
_STORAGE = (".db3", ".mcap")

_NS = 1_000_000_000
_FIRST_WINDOW_NS = _NS  #: how far back is looked first; clouds come more often than that


@dataclass(frozen=True)
class Recorded:
    """One message of a recording.

    Attributes:
        topic: where it was published.
        at_s: when it was recorded, from the recording's beginning [s].
        msg: the message, with the attributes that ROS gives it.
    """

    topic: str
    at_s: float
    msg: Any


class Recording:
    """An open recording; a context manager."""

    def __init__(self, path: Path) -> None:
        """Name the recording.

        Args:
            path: the folder that `ros2 bag record` made, a file in it or from it (.mcap, .db3), or a ROS 1 bag.
        """
        self.path = path
        self._reader: Any = None

    def __enter__(self) -> Recording:
        """Open it.

        Raises:
            SceneError: it is missing, damaged or empty.
        """
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        path = self.path
        if not path.exists():
            raise SceneError(f"{path}: there is no such recording")
        if path.suffix in _STORAGE and (path.parent / "metadata.yaml").is_file():
            path = path.parent  # a recording may be split into several files
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            raise SceneError(_without_metadata(path))
        with self._readable():
            # Recordings of older distributions do not hold the definitions of their messages.
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self._reader.open()
        if not self._reader.message_count:
            self.__exit__(None, None, None)
            raise SceneError(f"{self.path}: holds no messages")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close it."""
        self._reader.close()

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last [s]."""
        return float(self._reader.duration - 1) / _NS  # rosbags counts to just after the last one

    def topics(self, kind: str | None = None) -> list[str]:
        """Return the topics, all or those of one type."""
        return sorted({c.topic for c in self._reader.connections if kind is None or c.msgtype == kind})

    def find(self, name: str, kind: str) -> str | None:
        """Return the topic of a type whose last part is `name`; None if there is none, or more than one."""
        found = [topic for topic in self.topics(kind) if topic.rsplit("/", 1)[-1] == name]
        return found[0] if len(found) == 1 else None

    def check_time(self, at_s: float) -> None:
        """Check a time against the recording's length.

        Raises:
            SceneError: it lies outside.
        """
        if not 0.0 <= at_s <= self.duration_s:
            raise SceneError(f"{self.path}: is {self.duration_s:.3f} s long; --at {at_s:g} lies outside")

    def newest(self, topic: str, kind: str, at_s: float, usable: Callable[[Any], bool] = lambda _: True) -> Recorded:
        """Return the newest message of a topic at a time.

        Args:
            topic: its full name.
            kind: the type that it must have.
            at_s: from the recording's beginning [s].
            usable: tells whether a message counts; where none does, the newest one is returned.

        Raises:
            SceneError: no such topic, another type, or its first message comes later.
        """
        connections = self._connections(topic, kind)
        begin = int(self._reader.start_time)
        until = begin + round(at_s * _NS)
        newest: Recorded | None = None
        window = _FIRST_WINDOW_NS
        while until >= begin:
            since = max(begin, until - window)
            for recorded in self._backwards(connections, since, until):
                if usable(recorded.msg):
                    return recorded
                newest = newest or recorded
            until, window = since - 1, window * 4
        if newest is not None:
            return newest
        with self._readable():
            first = next(iter(self._reader.messages(connections)), None)
        if first is None:
            raise SceneError(f"{self.path}: {topic} has no message")
        raise SceneError(f"{self.path}: the first message of {topic} comes at {(first[1] - begin) / _NS:.3f} s, after --at {at_s:g}")

    def between(self, topic: str, kind: str, since_s: float, until_s: float) -> list[Recorded]:
        """Return the messages of a topic recorded within a span of time, from the recording's beginning [s], in their order.

        Raises:
            SceneError: no such topic, or another type.
        """
        begin = int(self._reader.start_time)
        since, until = begin + round(since_s * _NS), begin + round(until_s * _NS)
        return list(self._backwards(self._connections(topic, kind), max(since, begin), until))[::-1]

    def _backwards(self, connections: list[Any], since: int, until: int) -> Iterator[Recorded]:
        """Yield the messages from `until` back to `since` [ns], both included; only those that are asked for are decoded."""
        begin = int(self._reader.start_time)
        with self._readable():
            raw = list(self._reader.messages(connections, start=since, stop=until + 1)) if until >= since else []
        for connection, time_ns, content in reversed(raw):
            with self._readable():
                msg = self._decoded(content, connection.msgtype)
            yield Recorded(connection.topic, (time_ns - begin) / _NS, msg)

    def transforms(self, until_s: float, since_s: float = 0.0) -> TransformHistory:
        """Return the transforms of `/tf` recorded in a span of time, and all of `/tf_static`; broken ones are left out."""
        history = TransformHistory(keep_s=math.inf)
        begin = int(self._reader.start_time)
        for topic in _TF_TOPICS:
            connections = [c for c in self._reader.connections if c.topic == topic and c.msgtype == _TF]
            static = topic == _TF_TOPICS[0]
            # Static transforms hold for all time, also where the recorder got them late.
            span = {} if static else {"start": begin + round(since_s * _NS), "stop": begin + round(until_s * _NS) + 1}
            with self._readable():
                for connection, time_ns, raw in self._reader.messages(connections, **span) if connections else ():
                    for stamped in self._decoded(raw, connection.msgtype).transforms:
                        _add(history, stamped, time_ns / _NS, static)
        return history

    def _decoded(self, raw: bytes, kind: str) -> Any:
        """Decode a message; what its writer left behind it does not count (rclpy pads with whatever was in its memory)."""
        from rosbags.highlevel import AnyReaderError

        try:
            return self._reader.deserialize(raw, kind)
        except AnyReaderError:
            if not self._reader.is2 or len(raw) < 4:
                raise
            definition = self._reader.typestore.get_msgdef(kind)
            decode = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
            msg, _ = decode(raw[4:], 0, definition.cls, self._reader.typestore)
            return msg

    def _connections(self, topic: str, kind: str) -> list[Any]:
        of_topic = [c for c in self._reader.connections if c.topic == topic]
        there = ", ".join(self.topics(kind)) or "none"
        wanted = kind.replace("/msg/", "/")
        if not of_topic:
            raise SceneError(f"{self.path}: has no topic {topic}; topics of type {wanted}: {there}")
        others = {c.msgtype for c in of_topic if c.msgtype != kind}
        if others:
            is_ = ", ".join(sorted(others)).replace("/msg/", "/")
            raise SceneError(f"{self.path}: {topic} holds {is_}, not {wanted}; topics of that type: {there}")
        return of_topic

    @contextlib.contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # damaged files make sqlite, lz4, YAML and struct raise a dozen kinds
            why = "it is damaged, cut off, or of another kind"
            if isinstance(error, OSError) and error.strerror:
                why = error.strerror
            elif self.path.is_file() and not self.path.stat().st_size:
                why = "it is empty"
            advice = "; where a recorder was cut off, `mcap recover FILE` mends it" if self.path.suffix == ".mcap" else ""
            raise SceneError(f"{self.path}: is not a readable recording: {why}{advice}") from error


def _without_metadata(path: Path) -> str:
    """Say what to do with a folder that its recorder did not finish."""
    files = sorted(file.name for file in path.iterdir() if file.suffix in _STORAGE)
    if not files:
        return f"{path}: has no metadata.yaml, and no .mcap or .db3 either; name the folder that `ros2 bag record` made"
    return (
        f"{path}: has no metadata.yaml, as after a crash of its recorder: `ros2 bag reindex {path}` writes it again, "
        f"or name one file alone: {', '.join(files[:5])}"
    )


def _add(history: TransformHistory, stamped: Any, recorded_s: float, static: bool) -> None:
    t, r, stamp = stamped.transform.translation, stamped.transform.rotation, stamped.header.stamp
    stamp_s = float(stamp.sec) + float(stamp.nanosec) * 1e-9
    with contextlib.suppress(ProblemError):
        pose = [t.x, t.y, t.z, r.x, r.y, r.z, r.w]
        history.add(stamped.header.frame_id, stamped.child_frame_id, pose, stamp_s if stamp_s > 0.0 else recorded_s, static=static)
