"""Where the frame of each message was at its stamp, noted when it comes: a scene that is seen once outlives every history of transforms."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from lime_planner.core.base_motion import Seen, motion_since, seen_at_stamp
from lime_planner.core.errors import Refusal
from lime_planner.core.geometry import clean_name
from lime_planner.core.parameters import NodeSettings
from lime_planner.core.status import Status
from lime_planner.core.transform_history import NoTransform
from lime_planner.core.types import Array
from lime_planner.ros.convert import stamp_s
from lime_planner.ros.inputs.frames import Frames, waited

#: Messages of each input that are remembered: newer ones arrive while one is used.
_KEPT = 8


@dataclass
class _Note:
    """What is known of one message: where it was, and whether nothing better will be known."""

    header: Any
    seen: Seen | None = None
    settled: bool = False


class Placements:
    """Notes and tells where messages were; used by the callbacks, the worker and the watch over a motion."""

    def __init__(self, frames: Frames, planning_frame: str, fixed_frame: str) -> None:
        """Start empty.

        Args:
            frames: where frames are.
            planning_frame: where everything is needed; empty while the arm is not known.
            fixed_frame: the frame in which clouds and targets stay while the base moves; empty for the planning frame.
        """
        self._frames = frames
        self._planning_frame = clean_name(planning_frame)
        self._fixed_frame = clean_name(fixed_frame)
        self._lock = threading.Lock()
        self._noted: dict[str, dict[int, _Note]] = {}
        self._used: dict[str, frozenset[int]] = {}
        self._pending = False
        frames.listen(self.look)

    def use_planning_frame(self, planning_frame: str) -> None:
        """Say that everything is needed in another frame from now on."""
        with self._lock:
            self._planning_frame = clean_name(planning_frame)
            self._noted = {name: {k: _Note(note.header) for k, note in notes.items()} for name, notes in self._noted.items()}
            self._pending = True
        self.look()

    def remember(self, name: str, numbers: frozenset[int]) -> None:
        """Say which messages of an input are still used, besides the newest ones."""
        with self._lock:
            self._used[name] = numbers

    def noted(self, name: str, number: int) -> Array | None:
        """Return T_planning_data (4, 4) of a message at its stamp, as far as that is known by now."""
        with self._lock:
            note = self._noted.get(name, {}).get(number)
        return None if note is None or note.seen is None else note.seen.T_planning_data

    def arrived(self, name: str, number: int, header: Any) -> None:
        """Take note of a message.

        Args:
            name: of its input.
            number: of the message.
            header: its header; an empty frame is refused elsewhere.
        """
        with self._lock:
            notes = self._noted.setdefault(name, {})
            notes[number] = _Note(header)
            used = self._used.get(name, frozenset())
            for old in sorted(notes)[:-_KEPT]:
                if old not in used:
                    del notes[old]
            self._pending = True
        self.look()

    def look(self) -> None:
        """Look for what came before the transforms of its stamp; called with every message on `/tf`."""
        if not self._pending:
            return
        with self._lock:
            self._pending = False
            if not self._planning_frame:
                return
            for note in [note for notes in self._noted.values() for note in notes.values() if not note.settled]:
                try:
                    note.seen, note.settled = self._see(note.header, complete=True), True
                except NoTransform as error:
                    self._pending = self._pending or error.may_come
                    with contextlib.suppress(NoTransform):  # the frame itself may be known, and not by what its base moves
                        note.seen = self._see(note.header)

    def place(
        self, name: str, number: int | None, header: Any, node: NodeSettings, should_stop: Callable[[], bool]
    ) -> tuple[Array, Array | None]:
        """Return where a message's frame was at its stamp, and where the planning frame has gone since.

        Args:
            name: of its input.
            number: of the message; None for one that came otherwise.
            header: its header.
            node: the parameters.
            should_stop: ends a wait for transforms early.

        Returns:
            T_planning_data (4, 4) at the stamp, and T_now_then (4, 4), the planning frame of the stamp in that of now; None where it
            has not moved.

        Raises:
            Refusal: TF_ERROR; STALE_INPUT, the base moved and there is no fixed frame.
        """
        target, source = self._planning_frame, clean_name(header.frame_id)

        def find() -> Seen:
            with self._lock:
                note = self._noted.get(name, {}).get(-1 if number is None else number)
                if note is not None and note.seen is not None:
                    return note.seen
            return self._see(header)

        seen = waited(find, target, source, node.tf_timeout_s, should_stop)
        try:
            return seen.T_planning_data, motion_since(seen, self._frames.find, target, name, node.max_base_motion_m)
        except NoTransform as error:
            raise Refusal(Status.TF_ERROR, f"no transform from {seen.reference!r} to {target!r} now: {error}") from None

    def _see(self, header: Any, *, complete: bool = False) -> Seen:
        source, at_s = clean_name(header.frame_id), stamp_s(header.stamp)
        find = partial(self._frames.find, stamp_s=at_s)
        anchor = self._frames.anchor(self._planning_frame, source)
        return seen_at_stamp(find, self._planning_frame, source, self._fixed_frame, anchor, complete=complete)
