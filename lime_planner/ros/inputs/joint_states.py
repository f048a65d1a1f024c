"""What the arm's joints did lately: the newest configuration, its age, the one at a cloud's stamp, and whether the arm rests.

Stillness is judged by positions alone: the velocities that Kinova's driver reports are unreliable.

Many drivers report a joint that turns without end within one turn, so that its angle jumps by 2π where the joint has hardly moved.
Every state is put on the turn nearest the one before as it enters the history; what is behind it (the watch over a motion, stops,
stillness, the arm at a cloud's stamp) sees angles without jumps. A plan begins on the turn that the driver reports then.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import Refusal
from lime_planner.core.geometry import whole_turns
from lime_planner.core.status import Status
from lime_planner.core.types import Array

#: How much of the past is kept [s]: clouds of slow cameras are this old at most when they arrive.
HISTORY_S = 5.0
#: Stamps that go back by more than this come from a clock that was set back, not from a message that was late [s].
CLOCK_JUMP_S = 1.0
#: A cloud's stamp may lie this far outside the history before its arm state counts as unknown [s].
STAMP_SLACK_S = 0.2
#: Velocities are measured over at least and at most this long [s]: Kinova's driver sends ten states a second.
_SHORTEST_SPAN_S, _LONGEST_SPAN_S = 0.05, 0.3


@dataclass(frozen=True)
class ArmState:
    """One measured configuration.

    Attributes:
        q: (n,) [rad]; in the history continuous joints are on the turn nearest the state before.
        arrival_s: when it arrived, on the monotonic clock.
        stamp_s: its stamp in ROS time; 0.0 when it had none.
        latency_s: ROS time at arrival minus stamp; 0.0 without a stamp.
        velocity: (n,) [rad/s], from the positions of the last tenth of a second or so; None where the history has none.
    """

    q: Array
    arrival_s: float
    stamp_s: float
    latency_s: float
    velocity: Array | None = None

    def age_s(self, now_s: float) -> float:
        """Age of the measurement at the monotonic time `now_s`, its way here included where the clocks allow to tell."""
        return now_s - self.arrival_s + max(self.latency_s, 0.0)


class JointHistory:
    """The arm's states of the last seconds; written by the callback, read from every thread."""

    def __init__(self, continuous: npt.ArrayLike | None = None) -> None:
        """Start empty.

        Args:
            continuous: which joints turn without end, (n,) bool; None: none of them.
        """
        self._condition = threading.Condition()
        self._states: deque[ArmState] = deque()
        self._continuous = None if continuous is None else np.array(continuous, dtype=bool)
        self._before: Array | None = None  # the state before, for a history whose stamps were set back too
        self._added: Array | None = None  # what the newest state has more than its message [rad]: whole turns
        self._refusal: tuple[float, str] | None = None
        self.received = 0
        self.refused = 0
        self.foreign = 0

    def add(self, state: ArmState, *, counted: bool = False) -> ArmState:
        """Take in a valid state as it was reported; `counted` tells that it was received, and skipped, before.

        Returns:
            The state as it is remembered: continuous joints on the turn nearest the state before.
        """
        with self._condition:
            self.received += not counted
            self.foreign -= counted
            state = self._followed_up(state)
            if self._states and 0.0 < state.stamp_s < self._states[-1].stamp_s - CLOCK_JUMP_S:
                self._states.clear()  # simulated time began again: the stamps before mean nothing now
            self._states.append(state)
            while self._states and self._states[0].arrival_s < state.arrival_s - HISTORY_S:
                self._states.popleft()
            self._condition.notify_all()
            return state

    def _followed_up(self, state: ArmState) -> ArmState:
        if self._continuous is not None and self._before is not None:
            self._added = whole_turns(self._before - state.q, self._continuous)
            if self._added.any():
                state = replace(state, q=state.q + self._added)
        self._before = state.q
        measured_s = state.arrival_s - state.latency_s
        for older in reversed(self._states):
            apart_s = measured_s - (older.arrival_s - older.latency_s)
            if apart_s > _LONGEST_SPAN_S:
                break
            if apart_s >= _SHORTEST_SPAN_S:
                return replace(state, velocity=(state.q - older.q) / apart_s)
        return state

    def take_reported_turns(self) -> None:
        """Put the history on the turns that the newest message reported; only while nothing is compared with an older plan.

        A driver that was switched off may count its turns from zero again; a motion must begin on the turn it reports.
        """
        with self._condition:
            if self._added is None or self._before is None or not self._added.any():
                return
            added, self._added = self._added, None
            self._before = self._before - added
            self._states = deque(replace(state, q=state.q - added) for state in self._states)

    def refuse(self, arrival_s: float, sentence: str) -> bool:
        """Count a state that cannot be used; True when its sentence is a new one."""
        with self._condition:
            self.received += 1
            self.refused += 1
            new = self._refusal is None or self._refusal[1] != sentence
            self._refusal = (arrival_s, sentence)
            return new

    def skip(self) -> None:
        """Count a message that is not about the arm's joints."""
        with self._condition:
            self.received += 1
            self.foreign += 1

    def clear(self, continuous: npt.ArrayLike | None = None) -> None:
        """Forget everything: another robot, with these continuous joints, (n,) bool."""
        with self._condition:
            self._states.clear()
            self._refusal = self._before = self._added = None
            self._continuous = None if continuous is None else np.array(continuous, dtype=bool)

    @property
    def newest(self) -> ArmState | None:
        """The newest valid state."""
        with self._condition:
            return self._states[-1] if self._states else None

    def fresh(self, max_age_s: float, max_ahead_s: float = 0.0) -> ArmState:
        """Return the newest state.

        Args:
            max_age_s: oldest allowed age [s]; 0: any.
            max_ahead_s: how far its stamp may lie in the future [s]; 0: any.

        Raises:
            Refusal: NO_JOINT_STATE, BAD_INPUT (only unusable ones arrive), STALE_INPUT.
        """
        with self._condition:
            state = self._states[-1] if self._states else None
            refusal = self._refusal
        now_s = time.monotonic()
        stale = state is None or (max_age_s > 0.0 and state.age_s(now_s) > max_age_s)
        if stale and refusal is not None and (state is None or refusal[0] > state.arrival_s):
            raise Refusal(Status.BAD_INPUT, refusal[1])
        if state is None:
            other = f"; {self.foreign} messages named none of the arm's joints" if self.foreign else ""
            raise Refusal(Status.NO_JOINT_STATE, f"no joint state has been received{other}")
        if stale:
            raise Refusal(Status.STALE_INPUT, f"the newest joint state is {state.age_s(now_s):.2f} s old, the limit is {max_age_s:g} s")
        if max_ahead_s > 0.0 and -state.latency_s > max_ahead_s:
            sentence = f"the joint states' stamps lie {-state.latency_s:.2f} s in the future, the limit is {max_ahead_s:g} s"
            raise Refusal(Status.BAD_INPUT, f"{sentence}: compare the clocks")
        return state

    def at(self, stamp_s: float) -> Array | None:
        """Return the configuration at a stamp in ROS time (n,) [rad], interpolated; None where the history does not reach back.

        A stamp of zero means now; for one that is newer than the newest state, that state is the best guess.
        """
        with self._condition:
            states = [state for state in self._states if state.stamp_s > 0.0] if stamp_s > 0.0 else []
            newest = self._states[-1] if self._states else None
        if newest is None:
            return None
        if not states:
            return newest.q
        states.sort(key=lambda state: state.stamp_s)  # late ones come in between
        stamps = np.array([state.stamp_s for state in states])
        after = int(np.searchsorted(stamps, stamp_s))
        if after == 0:
            return states[0].q if stamps[0] - stamp_s <= STAMP_SLACK_S else None
        if after == len(states):
            return states[-1].q  # no newer state yet: the newest is the best guess, and the arm's padding covers the rest
        before = states[after - 1]
        share = (stamp_s - before.stamp_s) / max(states[after].stamp_s - before.stamp_s, 1e-9)
        return before.q + share * (states[after].q - before.q)

    def still(self, within_s: float, tolerance_rad: float) -> bool:
        """Tell whether every joint stayed within `tolerance_rad` for the last `within_s` seconds, by at least three states."""
        with self._condition:
            states = list(self._states)
        if not states or time.monotonic() - states[-1].arrival_s > within_s:
            return False
        begin_s = time.monotonic() - within_s
        first = next((k for k in range(len(states) - 1, -1, -1) if states[k].arrival_s <= begin_s), None)
        if first is None or len(states) - first < 3:
            return False
        recent = np.array([state.q for state in states[first:]])
        return bool(np.ptp(recent, axis=0).max() <= tolerance_rad)

    def moving(self, within_s: float, tolerance_rad: float) -> bool:
        """Tell whether a joint certainly moved by more than `tolerance_rad` within the last `within_s` seconds."""
        begin_s = time.monotonic() - within_s
        with self._condition:
            recent = np.array([state.q for state in self._states if state.arrival_s >= begin_s])
        return len(recent) > 1 and bool(np.ptp(recent, axis=0).max() > tolerance_rad)

    def wait_still(self, within_s: float, tolerance_rad: float, timeout_s: float, should_stop: Callable[[], bool]) -> bool:
        """Wait until `still`; False after `timeout_s` or when `should_stop` says so."""
        deadline = time.monotonic() + timeout_s
        while not self.still(within_s, tolerance_rad):
            remaining = deadline - time.monotonic()
            if remaining <= 0.0 or should_stop():
                return False
            with self._condition:
                self._condition.wait(min(remaining, 0.02))
        return True
