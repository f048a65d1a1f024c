"""Which frame lay where, and when: what `/tf` and `/tf_static` said, asked for any moment, as tf2 answers it."""

from __future__ import annotations

import bisect
import dataclasses
import threading

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import LimePlannerError
from lime_planner.core.geometry import clean_name, pose_to_matrix
from lime_planner.core.types import Array

#: How much of the past tf2 keeps, and so every node on the graph [s].
TF_HISTORY_S = 10.0


class NoTransform(LimePlannerError):
    """Two frames are not connected, or not at the time that was asked for; `may_come` tells whether waiting can help."""

    def __init__(self, sentence: str, *, may_come: bool = True) -> None:
        super().__init__(sentence)
        self.may_come = may_come


@dataclasses.dataclass
class _Edge:
    """Where a frame was, seen from its parent: for ever, or at stamps in ascending order."""

    parent: str
    always: Array | None = None
    stamps_s: list[float] = dataclasses.field(default_factory=list)
    poses: list[Array] = dataclasses.field(default_factory=list)


class TransformHistory:
    """The tree of frames over time. Every frame has one parent, the last one that it was said to have. Safe between threads."""

    def __init__(self, keep_s: float = TF_HISTORY_S) -> None:
        """Start without any frame.

        Args:
            keep_s: how far back from its newest one a frame's transforms are kept [s].
        """
        self._keep_s = keep_s
        self._edges: dict[str, _Edge] = {}
        self._lock = threading.Lock()

    @property
    def frames(self) -> list[str]:
        """The names of all frames, sorted."""
        with self._lock:
            return sorted({*self._edges, *(edge.parent for edge in self._edges.values())})

    def add(self, parent: str, child: str, pose: npt.ArrayLike, stamp_s: float, *, static: bool = False) -> None:
        """Take in a transform.

        Args:
            parent: the frame that it is seen from.
            child: the frame that is placed.
            pose: (7,) x y z qx qy qz qw of T_parent_child [m, -].
            stamp_s: when it held [s].
            static: whether it holds for ever.

        Raises:
            ProblemError: the pose is none.
        """
        T = pose_to_matrix(pose)
        parent, child = clean_name(parent), clean_name(child)
        if not parent or not child or parent == child:
            return
        with self._lock:
            edge = self._edges.get(child)
            if edge is None or edge.parent != parent or static != (edge.always is not None):
                edge = self._edges[child] = _Edge(parent)
            if static:
                edge.always = T
                return
            place = bisect.bisect_left(edge.stamps_s, stamp_s)
            if place < len(edge.stamps_s) and edge.stamps_s[place] == stamp_s:
                edge.poses[place] = T
                return
            edge.stamps_s.insert(place, stamp_s)
            edge.poses.insert(place, T)
            old = bisect.bisect_left(edge.stamps_s, edge.stamps_s[-1] - self._keep_s)
            del edge.stamps_s[:old], edge.poses[:old]

    def forget_moving(self) -> None:
        """Forget everything but the static transforms: the clock was set back."""
        with self._lock:
            self._edges = {child: edge for child, edge in self._edges.items() if edge.always is not None}

    def find(self, target: str, source: str, stamp_s: float = 0.0, *, clamp: bool = False) -> Array:
        """Return T_target_source (4, 4) at a time, every part of the chain interpolated.

        Args:
            target: frame of the result.
            source: frame of the data.
            stamp_s: when [s]; 0.0 for the newest time at which the whole chain is known.
            clamp: take the first or last known place where the history does not reach to `stamp_s`.

        Raises:
            NoTransform: see there.
        """
        target, source = clean_name(target), clean_name(source)
        with self._lock:
            up, down = self._chains(target, source)
            if stamp_s <= 0.0:
                moving = [edge.stamps_s[-1] for edge in map(self._edges.__getitem__, (*up, *down)) if edge.always is None]
                stamp_s = min(moving, default=0.0)
            T_ancestor_target, T_ancestor_source = (self._product(chain, stamp_s, clamp) for chain in (up, down))
        return np.asarray(np.linalg.inv(T_ancestor_target) @ T_ancestor_source)

    def anchor(self, base: str, source: str) -> str | None:
        """Return the frame by which one tells whether a base moved under data in a frame; None where nothing can tell.

        It is what base and data both hang from. Where the data hangs from the base itself (a camera on the robot), it is the frame
        that the base moves in: the parent of the first transform above it that changes.
        """
        base, source = clean_name(base), clean_name(source)
        with self._lock:
            try:
                up, _ = self._chains(base, source)
            except NoTransform:
                return None
            if up:
                return self._edges[up[-1]].parent
            frame, seen = base, {base}
            while frame in self._edges:
                edge = self._edges[frame]
                if edge.always is None:
                    return edge.parent
                frame = edge.parent
                if frame in seen:
                    return None
                seen.add(frame)
        return None

    def bolted(self, frame: str, thing: str) -> Array | None:
        """Return T_frame_thing (4, 4) of a thing that static transforms alone fasten below a frame; None where they do not."""
        frame, thing = clean_name(frame), clean_name(thing)
        with self._lock:
            chain = self._ancestors(thing)
            if frame not in chain:
                return None
            between = chain[: chain.index(frame)]
            return None if any(self._edges[name].always is None for name in between) else self._product(between, 0.0, False)

    def _chains(self, target: str, source: str) -> tuple[list[str], list[str]]:
        """Return the frames from target and from source up to below what both hang from, each to be followed by its parent."""
        to_root, ancestors = self._ancestors(target), self._ancestors(source)
        common = next((frame for frame in to_root if frame in ancestors), None)
        if common is None:
            known = ", ".join(sorted({*self._edges, *(edge.parent for edge in self._edges.values())})) or "none"
            missing = [frame for frame in (source, target) if frame not in self._edges and not self._is_parent(frame)]
            what = f"{missing[0]!r} is not known" if missing else "they are not connected"
            raise NoTransform(f"{what}; known frames: {known}")
        return to_root[: to_root.index(common)], ancestors[: ancestors.index(common)]

    def _is_parent(self, frame: str) -> bool:
        return any(edge.parent == frame for edge in self._edges.values())

    def _ancestors(self, frame: str) -> list[str]:
        found = [frame]
        while found[-1] in self._edges and self._edges[found[-1]].parent not in found:
            found.append(self._edges[found[-1]].parent)
        return found

    def _product(self, chain: list[str], stamp_s: float, clamp: bool) -> Array:
        """Return T_ancestor_frame of the first frame of a chain."""
        T = np.eye(4)
        for frame in chain:
            T = self._at(frame, stamp_s, clamp) @ T
        return T

    def _at(self, frame: str, stamp_s: float, clamp: bool) -> Array:
        edge = self._edges[frame]
        if edge.always is not None:
            return edge.always
        stamps, place = edge.stamps_s, bisect.bisect_left(edge.stamps_s, stamp_s)
        if place < len(stamps) and stamps[place] == stamp_s:
            return edge.poses[place]
        if place == 0:
            if clamp:
                return edge.poses[0]
            first = f"{frame!r} in {edge.parent!r} is known from {stamps[0]:.3f} s only, {stamps[0] - stamp_s:.3f} s after the stamp"
            raise NoTransform(first, may_come=False)
        if place == len(stamps):
            if clamp:
                return edge.poses[-1]
            raise NoTransform(f"{frame!r} in {edge.parent!r} is known up to {stamp_s - stamps[-1]:.3f} s before the stamp")
        share = (stamp_s - stamps[place - 1]) / (stamps[place] - stamps[place - 1])
        return _between(edge.poses[place - 1], edge.poses[place], share)


def _between(before: Array, after: Array, share: float) -> Array:
    """Return the pose at a share of the way between two poses (4, 4): straight, and by the shorter turn."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()
    T = np.eye(4)
    T[:3, :3] = before[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    T[:3, 3] = before[:3, 3] + share * (after[:3, 3] - before[:3, 3])
    return T
