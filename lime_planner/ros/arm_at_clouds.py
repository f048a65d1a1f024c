"""Where the arm stood when each cloud was taken, for as long as the cloud is used: joint states are forgotten sooner than a still scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.ros.joints import ArmState, JointHistory

Array = npt.NDArray[np.float64]

#: How long after a cloud the joint states are looked through for the one of its stamp [s].
_SETTLING_S = 1.0


@dataclass(frozen=True)
class _Noted:
    """What is known about the newest cloud of one input.

    Attributes:
        number: of the cloud.
        stamp_s, arrival_s: its stamp in ROS time (0.0: none), and when it arrived on the monotonic clock.
        msg: the joint state that was the newest then, as it came.
        q: where the arm stood (n,) [rad], as far as is known.
        settled: whether nothing better will be known.
    """

    number: int
    stamp_s: float
    arrival_s: float
    msg: Any
    q: Array | None
    settled: bool


class ArmAtClouds:
    """Notes the arm's configuration for every newest cloud; written by the callbacks, read by the worker."""

    def __init__(self, joints: JointHistory) -> None:
        """Start empty.

        Args:
            joints: the measured states.
        """
        self._joints = joints
        self._noted: dict[str, _Noted] = {}

    def arrived(self, name: str, number: int, stamp_s: float, msg: Any) -> None:
        """Take note of a cloud.

        Args:
            name: of its input; number: its own.
            stamp_s: its stamp in ROS time, 0.0 for none: the arm stood then where it stands now.
            msg: the newest joint state as it came, None before the first one.
        """
        self._noted[name] = self._look(_Noted(number, stamp_s, time.monotonic(), msg, None, False))

    def look(self) -> None:
        """Look once more for clouds that came before the joint states of their stamps; to be called with every joint state."""
        for name, noted in list(self._noted.items()):
            if not noted.settled:
                self._noted[name] = self._look(noted)

    def begin_anew(self, read: Callable[[Any], ArmState | None]) -> None:
        """Say that the arm is another one, or known now; `read` makes a state of a joint state message, or None."""
        for name, noted in list(self._noted.items()):
            state = None if noted.msg is None else read(noted.msg)
            found = self._look(noted)
            if state is not None and (found.q is None or noted.stamp_s <= 0.0):
                found = replace(noted, q=state.q, settled=True)
            self._noted[name] = found

    def at(self, name: str, number: int) -> Array | None:
        """Return where the arm stood when a cloud was taken, (n,) [rad]; None when that is not known."""
        noted = self._noted.get(name)
        return None if noted is None or noted.number != number else noted.q

    def _look(self, noted: _Noted) -> _Noted:
        newest = self._joints.newest
        if newest is None:
            return replace(noted, q=None, settled=False)
        settled = noted.stamp_s <= 0.0 or newest.stamp_s <= 0.0 or newest.stamp_s >= noted.stamp_s
        settled |= time.monotonic() - noted.arrival_s > _SETTLING_S
        return replace(noted, q=self._joints.at(noted.stamp_s), settled=settled)
