"""Keeps a repeated warning from filling the log, without hiding a different one behind it."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable

_NUMBERS = re.compile(r"[-+0-9.]+")
_REMEMBERED = 200


class Throttle:
    """Passes each kind of sentence on once in a while; sentences that differ only in their numbers are of one kind."""

    def __init__(self, log: Callable[[str], object], period_s: float) -> None:
        """Make a throttle.

        Args:
            log: where sentences go.
            period_s: shortest time between two of one kind [s].
        """
        self._log = log
        self._period_s = period_s
        self._lock = threading.Lock()
        self._seen: dict[str, tuple[float, int]] = {}

    def __call__(self, sentence: str) -> None:
        """Log the sentence, or count it for the next time."""
        kind = _NUMBERS.sub("#", sentence)
        now_s = time.monotonic()
        with self._lock:
            last_s, held_back = self._seen.get(kind, (-float("inf"), 0))
            if now_s - last_s < self._period_s:
                self._seen[kind] = (last_s, held_back + 1)
                return
            if len(self._seen) >= _REMEMBERED:
                self._seen.clear()
            self._seen[kind] = (now_s, 0)
        self._log(f"{sentence} ({held_back} more like this since the last)" if held_back else sentence)
