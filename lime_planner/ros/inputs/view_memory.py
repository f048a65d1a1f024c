"""Which clouds are kept for what they show: the newest of each camera, and earlier ones from other places or of some time ago.

Callbacks only choose; points are decoded in the worker, once for each cloud that is used.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from lime_planner.core.types import Array
from lime_planner.ros.inputs.latest import Sample

NEAR_M, NEAR_RAD = 0.08, 0.17  #: a camera that moved less is where it was
AGAIN_S = 20.0  #: from one place a cloud is kept this often: something may have hidden the plant for a while
MOST = 8  #: clouds of one input that wait to be used


@dataclass(frozen=True, eq=False)
class Waiting:
    """A cloud that was not used yet.

    Attributes:
        name: of its input.
        sample: the message.
        frame: of its points.
        T_planning_cloud: (4, 4) where that was, as far as was known when it came; None where it was not.
        taken_s: when, on the monotonic clock.
    """

    name: str
    sample: Sample
    frame: str
    T_planning_cloud: Array | None
    taken_s: float

    def near(self, other: Waiting) -> bool:
        """Tell whether two clouds show the plant from one place."""
        a, b = self.T_planning_cloud, other.T_planning_cloud
        if a is None or b is None:
            return True
        cosine = 0.5 * (float(np.trace(a[:3, :3].T @ b[:3, :3])) - 1.0)
        return float(np.linalg.norm(a[:3, 3] - b[:3, 3])) < NEAR_M and cosine > np.cos(NEAR_RAD)


def taken_s(sample: Sample) -> float:
    """Return when a cloud was taken on the monotonic clock [s]: its stamp where the clocks allow to tell, else its arrival."""
    return sample.arrival_s + min(sample.ahead_s, 0.0)


class ViewMemory:
    """The clouds that wait to be used, by input and frame; written by callbacks, read by the worker."""

    def __init__(self) -> None:
        """Start empty."""
        self._lock = threading.Lock()
        self._waiting: dict[tuple[str, str], list[Waiting]] = {}
        self._used: dict[tuple[str, str], Waiting] = {}  # the last of each that was used, to which the next is compared

    def clear(self) -> None:
        """Forget everything: another arm."""
        with self._lock:
            self._waiting, self._used = {}, {}

    def arrived(self, cloud: Waiting, memory_s: float) -> None:
        """Take in a cloud; the one before it goes if it shows the plant from where an earlier one did not long ago."""
        with self._lock:
            key = (cloud.name, cloud.frame)
            waiting = self._waiting.setdefault(key, [])
            if waiting:
                before = waiting[-2] if len(waiting) > 1 else self._used.get(key)
                last = waiting[-1]
                if before is not None and last.near(before) and last.taken_s - before.taken_s < AGAIN_S:
                    waiting.pop()
            waiting.append(cloud)
            for old in list(self._waiting):
                self._waiting[old] = [w for w in self._waiting[old] if w is cloud or cloud.taken_s - w.taken_s < memory_s]
            if len(self._waiting[key]) > MOST:
                del self._waiting[key][0]

    def waiting(self) -> list[Waiting]:
        """Return all clouds that wait, in the order in which they were taken."""
        with self._lock:
            return sorted((w for clouds in self._waiting.values() for w in clouds), key=lambda w: w.taken_s)

    def use(self, cloud: Waiting) -> None:
        """Say that a cloud is used, or cannot be."""
        with self._lock:
            key = (cloud.name, cloud.frame)
            if cloud in self._waiting.get(key, ()):
                self._waiting[key].remove(cloud)
                self._used[key] = cloud

    def newest(self, frame: str) -> tuple[Waiting, ...]:
        """Return the newest cloud of each input in a frame, used or not."""
        with self._lock:
            keys = {key for key in (*self._waiting, *self._used) if key[1] == frame}
            last = [self._waiting[key][-1] if self._waiting.get(key) else self._used.get(key) for key in sorted(keys)]
        return tuple(cloud for cloud in last if cloud is not None)
