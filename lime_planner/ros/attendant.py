"""A thread beside the node's own: what the engine, the stem watch and the marker desk have in common."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod


class Attendant(ABC):
    """A daemon thread that waits at `_condition` for work, until it is closed; a subclass says in `_run` what it does."""

    def __init__(self, name: str) -> None:
        """Make the thread; the subclass calls `_start` once it is complete.

        Args:
            name: of the thread, as debuggers and logs show it.
        """
        self._condition = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def _start(self) -> None:
        self._thread.start()

    def close(self, timeout_s: float = 2.0) -> bool:
        """End the thread; False if it is still at work after `timeout_s` (it dies with the process then)."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @abstractmethod
    def _run(self) -> None:
        """Work until `_closed`."""
