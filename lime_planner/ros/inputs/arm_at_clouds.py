"""Where the arm stood when each cloud was taken, for as long as the cloud is used: joint states are forgotten sooner than a still scene."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lime_planner.core.types import Array
from lime_planner.ros.inputs.joint_states import ArmState, JointHistory

#: How long after a cloud the joint states are looked through for the one of its stamp [s].
_SETTLING_S = 1.0
#: Clouds of each input that are remembered: newer ones arrive while one is decoded.
_KEPT = 32


@dataclass(frozen=True)
class _Noted:
    """What is known about one cloud.

    Attributes:
        stamp_s, arrival_s: its stamp in ROS time (0.0: none), and when it arrived on the monotonic clock.
        messages: the joint states that had come by then, as they came, the newest last.
        q: where the arm stood (n,) [rad], as far as is known.
        settled: whether nothing better will be known.
    """

    stamp_s: float
    arrival_s: float
    messages: Sequence[Any]
    q: Array | None
    settled: bool


class ArmAtClouds:
    """Notes the arm's configuration for every cloud that comes; used by the callbacks, the engine's thread and the worker."""

    def __init__(self, joints: JointHistory) -> None:
        """Start empty.

        Args:
            joints: the measured states.
        """
        self._joints = joints
        self._lock = threading.Lock()
        self._noted: dict[str, dict[int, _Noted]] = {}
        self._used: dict[str, frozenset[int]] = {}

    def remember(self, name: str, numbers: frozenset[int]) -> None:
        """Say which clouds of an input are still used, besides the newest ones."""
        with self._lock:
            self._used[name] = numbers

    def arrived(self, name: str, number: int, stamp_s: float, messages: Sequence[Any]) -> None:
        """Take note of a cloud.

        Args:
            name: of its input.
            number: of the cloud.
            stamp_s: its stamp in ROS time, 0.0 for none: the arm stood then where it stands now.
            messages: the joint states that came last, as they came, for an arm that becomes known later.
        """
        with self._lock:
            notes = self._noted.setdefault(name, {})
            notes[number] = self._look(_Noted(stamp_s, time.monotonic(), tuple(messages), None, False))
            used = self._used.get(name, frozenset())
            for old in sorted(notes)[:-_KEPT]:
                if old not in used:
                    del notes[old]

    def look(self) -> None:
        """Look once more for clouds that came before the joint states of their stamps; to be called with every joint state."""
        with self._lock:
            for notes in self._noted.values():
                for number, noted in notes.items():
                    if not noted.settled:
                        notes[number] = self._look(noted)

    def begin_anew(self, read: Callable[[Any], ArmState | None]) -> None:
        """Say that the arm is another one, or known now.

        Args:
            read: makes a state of a joint state message; None where it is not about the arm.
        """
        with self._lock:
            for notes in self._noted.values():
                for number, noted in notes.items():
                    found = self._look(noted)
                    if found.q is None or noted.stamp_s <= 0.0:
                        states = (read(message) for message in reversed(noted.messages))
                        state = next((state for state in states if state is not None), None)
                        found = found if state is None else replace(noted, q=state.q, settled=True)
                    notes[number] = found

    def at(self, name: str, number: int) -> Array | None:
        """Return where the arm stood when a cloud was taken, (n,) [rad]; None when that is not known."""
        with self._lock:
            noted = self._noted.get(name, {}).get(number)
        return None if noted is None else noted.q

    def settled(self, name: str, number: int) -> bool:
        """Tell whether nothing better will be known about where the arm stood; a moving arm's place is a guess before."""
        with self._lock:
            noted = self._noted.get(name, {}).get(number)
        return noted is None or noted.settled

    def _look(self, noted: _Noted) -> _Noted:
        newest = self._joints.newest
        if newest is None:
            return replace(noted, q=None, settled=False)
        settled = noted.stamp_s <= 0.0 or newest.stamp_s <= 0.0 or newest.stamp_s >= noted.stamp_s
        settled |= time.monotonic() - noted.arrival_s > _SETTLING_S
        return replace(noted, q=self._joints.at(noted.stamp_s), settled=settled)
