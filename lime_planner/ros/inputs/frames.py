"""Where a cloud's or a target's frame is, seen from the planning frame: from tf2 where it is installed, else from parameters."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from builtin_interfaces.msg import Time
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.time import Time as RosTime

from lime_planner.core.errors import ParameterError, ProblemError, Refusal
from lime_planner.core.geometry import TransformTree, clean_name, pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.core.types import Array


class Frames(Protocol):
    """What the node needs to know about frames.

    Attributes:
        source: where transforms are taken from, in words.
    """

    source: str

    def lookup(self, target: str, source: str, stamp: Time, timeout_s: float, should_stop: Callable[[], bool]) -> Array:
        """Return T_target_source (4, 4) at `stamp`.

        Args:
            target: frame of the result.
            source: frame of the data.
            stamp: time of the data; zero for the newest known.
            timeout_s: how long to wait for a transform that has not arrived yet.
            should_stop: ends the wait early.

        Raises:
            Refusal: TF_ERROR naming both frames.
        """
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
        self.source = f"static_transforms alone ({len(transforms)} given): tf2_ros cannot be imported"
        for text in transforms:
            words = text.replace(",", " ").split()
            try:
                if len(words) != 9:
                    raise ValueError(f"{len(words)} words instead of 9")
                T_parent_child = pose_to_matrix([float(word) for word in words[2:]])
            except (ValueError, ProblemError) as error:
                raise ParameterError(f"static_transforms: {text!r} is not `parent child x y z qx qy qz qw` ({error})") from None
            self._tree.add(words[0], words[1], T_parent_child)

    def find(self, target: str, source: str) -> Array | None:
        """Return T_target_source (4, 4), or None where no chain connects them."""
        return self._tree.find(target, source)

    def lookup(self, target: str, source: str, stamp: Time, timeout_s: float, should_stop: Callable[[], bool]) -> Array:
        """See `Frames.lookup`; nothing is waited for."""
        found = self.find(target, source)
        if found is None:
            known = ", ".join(self._tree.frames) or "none"
            raise Refusal(
                Status.TF_ERROR,
                f"no transform from {source!r} to {target!r}; tf2 is not there and static_transforms knows the frames: {known}",
            )
        return found


class TfFrames:
    """tf2's buffer, polled from the worker's thread; the static transforms come first.

    Attributes:
        source: see `Frames`.
    """

    source = "static_transforms first, then tf2"

    def __init__(self, buffer: Any, static: StaticFrames, *, poll_s: float = 0.01) -> None:
        """Wrap a buffer.

        Args:
            buffer: a `tf2_ros.Buffer`, or anything with its `lookup_transform(target, source, time)`.
            static: transforms from parameters.
            poll_s: pause between two looks [s].
        """
        self._buffer = buffer
        self._static = static
        self._poll_s = poll_s

    def lookup(self, target: str, source: str, stamp: Time, timeout_s: float, should_stop: Callable[[], bool]) -> Array:
        """See `Frames.lookup`."""
        found = self._static.find(target, source)
        if found is not None:
            return found
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                t = self._buffer.lookup_transform(clean_name(target), clean_name(source), RosTime.from_msg(stamp)).transform
                p, r = t.translation, t.rotation
                return pose_to_matrix([p.x, p.y, p.z, r.x, r.y, r.z, r.w])
            except Exception as error:  # tf2's own exceptions share no base with anything importable here
                if time.monotonic() >= deadline or should_stop():
                    raise Refusal(Status.TF_ERROR, f"no transform from {source!r} to {target!r} within {timeout_s:g} s: {error}") from None
            time.sleep(self._poll_s)


def make_frames(node: Any, transforms: Sequence[str]) -> Frames:
    """Return tf2's view where tf2_ros can be imported, otherwise the static one.

    Raises:
        ParameterError: see `StaticFrames`.
    """
    static = StaticFrames(transforms)
    try:
        import tf2_ros  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        return static
    # A buffer that is given the node opens the service `tf2_frames` on it, one more name on the graph that nothing here needs. What
    # else it would do with the node is done here: when simulated time jumps back, what came from its future is forgotten, for tf2
    # would take everything newer for old.
    buffer = tf2_ros.Buffer()
    back = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=True)
    node.tf_jumps = node.get_clock().create_jump_callback(back, post_callback=lambda _: buffer.clear())
    node.tf_listener = tf2_ros.TransformListener(buffer, node)  # the node keeps both alive
    return TfFrames(buffer, static)
