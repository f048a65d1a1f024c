"""A thread beside the node's own: what the engine, the stem watch and the marker desk have in common."""

from __future__ import annotations

import threading


class Attendant:
    """A daemon thread that waits at `_condition` for work, until it is closed; a subclass says in `_run` what it does."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(daemon=True)

    def _start(self, name: str) -> None:
        """Start the thread; to be called once the subclass is complete."""
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self, timeout_s: float = 2.0) -> bool:
        """End the thread; False if it is still at work after `timeout_s` (it dies with the process then)."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        raise NotImplementedError
