"""Where a cloud's or a target's frame is, seen from another: from parameters first, then from `/tf` and `/tf_static`.

The package reads these topics itself, into the history that recordings are read into as well: one set of rules, live and recorded,
with or without tf2_ros. Only the message type, tf2_msgs, must be there.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from builtin_interfaces.msg import Time
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from lime_planner.core.errors import ParameterError, ProblemError, Refusal
from lime_planner.core.geometry import TransformTree, clean_name, pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.core.transform_history import NoTransform, TransformHistory
from lime_planner.core.types import Array
from lime_planner.ros.convert import stamp_s

Found = TypeVar("Found")

_POLL_S = 0.01
_DEPTH = 100  #: as tf2's listeners have it


class Frames(Protocol):
    """What the node needs to know about frames.

    Attributes:
        source: where transforms are taken from, in words.
    """

    source: str

    def find(self, target: str, source: str, stamp_s: float = 0.0) -> Array:
        """Return T_target_source (4, 4) at a stamp [s], 0.0 for the newest; nothing is waited for.

        Raises:
            NoTransform: see `TransformHistory.find`.
        """
        ...

    def anchor(self, base: str, source: str) -> str | None:
        """Return the frame by which one tells whether `base` moved under data in `source`, see `TransformHistory.anchor`."""
        ...

    def bolted(self, frame: str, thing: str) -> Array | None:
        """Return T_frame_thing (4, 4) of a thing that never moves against a frame; None where that is not known."""
        ...

    def listen(self, heard: Callable[[], None]) -> None:
        """Have something called after every message with transforms."""
        ...


class StaticFrames:
    """Transforms that never change, chained over any number of frames.

    Attributes:
        source: see `Frames`.
    """

    def __init__(self, transforms: Sequence[str] = ()) -> None:
        """Read the transforms.

        Args:
            transforms: `parent child x y z qx qy qz qw` each, T_parent_child in metres.

        Raises:
            ParameterError: an entry that cannot be read.
        """
        self._tree = TransformTree()
        self.source = f"static_transforms alone ({len(transforms)} given): tf2_msgs cannot be imported"
        for text in transforms:
            words = text.replace(",", " ").split()
            try:
                if len(words) != 9:
                    raise ValueError(f"{len(words)} words instead of 9")
                T_parent_child = pose_to_matrix([float(word) for word in words[2:]])
            except (ValueError, ProblemError) as error:
                raise ParameterError(f"static_transforms: {text!r} is not `parent child x y z qx qy qz qw` ({error})") from None
            self._tree.add(words[0], words[1], T_parent_child)

    def find(self, target: str, source: str, stamp_s: float = 0.0) -> Array:
        """See `Frames.find`."""
        found = self._tree.find(target, source)
        if found is None:
            known = ", ".join(self._tree.frames) or "none"
            raise NoTransform(f"tf2 is not there and static_transforms knows the frames: {known}", may_come=False)
        return found

    def anchor(self, base: str, source: str) -> str | None:
        """See `Frames.anchor`: what never changes tells of no motion."""
        return None

    def bolted(self, frame: str, thing: str) -> Array | None:
        """See `Frames.bolted`."""
        return self._tree.find(frame, thing)

    def listen(self, heard: Callable[[], None]) -> None:
        """See `Frames.listen`: there is nothing to hear."""


class TfFrames:
    """What `/tf` and `/tf_static` said; the static transforms of the parameters come first.

    Attributes:
        source: see `Frames`.
    """

    source = "static_transforms first, then /tf and /tf_static"

    def __init__(self, static: StaticFrames) -> None:
        """Start without any transform but the parameters'.

        Args:
            static: transforms from parameters.
        """
        self._static = static
        self._history = TransformHistory()
        self._heard: list[Callable[[], None]] = []

    def take(self, msg: Any, *, static: bool) -> None:
        """Take in a `tf2_msgs/TFMessage`; a transform that is none is left out, as tf2 does it."""
        for stamped in msg.transforms:
            t, r = stamped.transform.translation, stamped.transform.rotation
            with contextlib.suppress(ProblemError):
                pose = (t.x, t.y, t.z, r.x, r.y, r.z, r.w)
                self._history.add(stamped.header.frame_id, stamped.child_frame_id, pose, stamp_s(stamped.header.stamp), static=static)
        for heard in self._heard:
            heard()

    def forget_moving(self) -> None:
        """Forget what moves: simulated time was set back, and what came from its future would make everything newer look old."""
        self._history.forget_moving()

    def known(self) -> list[str]:
        """Return the names of the frames that the topics told of, sorted."""
        return self._history.frames

    def find(self, target: str, source: str, stamp_s: float = 0.0) -> Array:
        """See `Frames.find`."""
        with contextlib.suppress(NoTransform):
            return self._static.find(target, source)
        return self._history.find(target, source, stamp_s)

    def anchor(self, base: str, source: str) -> str | None:
        """See `Frames.anchor`."""
        with contextlib.suppress(NoTransform):
            self._static.find(base, source)
            return self._history.anchor(base, base)  # fastened to the base by a parameter
        return self._history.anchor(base, source)

    def bolted(self, frame: str, thing: str) -> Array | None:
        """See `Frames.bolted`."""
        T_frame_thing = self._static.bolted(frame, thing)
        return self._history.bolted(frame, thing) if T_frame_thing is None else T_frame_thing

    def listen(self, heard: Callable[[], None]) -> None:
        """See `Frames.listen`."""
        self._heard.append(heard)


def lookup(frames: Frames, target: str, source: str, stamp: Time, timeout_s: float, should_stop: Callable[[], bool]) -> Array:
    """Return T_target_source (4, 4) at a stamp, waited for.

    Args:
        frames: where frames are.
        target: frame of the result.
        source: frame of the data.
        stamp: time of the data; zero for the newest known.
        timeout_s: how long to wait for a transform that has not arrived yet.
        should_stop: ends the wait early.

    Raises:
        Refusal: TF_ERROR naming both frames.
    """
    at_s = stamp_s(stamp)
    return waited(lambda: frames.find(target, source, at_s), clean_name(target), clean_name(source), timeout_s, should_stop)


def waited(find: Callable[[], Found], target: str, source: str, timeout_s: float, should_stop: Callable[[], bool]) -> Found:
    """Return what `find` finds, waited for.

    Args:
        find: raises `NoTransform` where it does not find anything yet.
        target: frame of the result, for the sentence.
        source: frame of the data, for the sentence.
        timeout_s: how long to wait.
        should_stop: ends the wait early.

    Raises:
        Refusal: TF_ERROR naming both frames.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return find()
        except NoTransform as error:
            no_transform = f"no transform from {source!r} to {target!r}"
            if not error.may_come:
                raise Refusal(Status.TF_ERROR, f"{no_transform}; {error}") from None
            if time.monotonic() >= deadline or should_stop():
                raise Refusal(Status.TF_ERROR, f"{no_transform} within {timeout_s:g} s: {error}") from None
        time.sleep(_POLL_S)


def make_frames(node: Any, transforms: Sequence[str]) -> Frames:
    """Return what `/tf` says where its messages can be imported, otherwise the static view.

    Raises:
        ParameterError: see `StaticFrames`.
    """
    static = StaticFrames(transforms)
    try:
        from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        return static
    frames = TfFrames(static)
    group = ReentrantCallbackGroup()
    moving = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
    latched = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(TFMessage, "/tf", lambda msg: frames.take(msg, static=False), moving, callback_group=group)
    node.create_subscription(TFMessage, "/tf_static", lambda msg: frames.take(msg, static=True), latched, callback_group=group)
    back = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=True)
    # The node keeps what it was given alive.
    node.tf_jumps = node.get_clock().create_jump_callback(back, post_callback=lambda _: frames.forget_moving())
    return frames
