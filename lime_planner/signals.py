"""Waiting for SIGINT and SIGTERM without ever missing one."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time

#: What ends a program of this package.
ENDING = (signal.SIGINT, signal.SIGTERM)
_WOKEN = 0  # no signal has this number


class EndSignals:
    """SIGINT and SIGTERM as bytes in a pipe, from when it is made until `close`. For the main thread, which alone may set handlers.

    Handlers written in Python run in the main thread only, between two of its instructions. A signal that another thread receives, or that
    comes right before the main thread begins to wait, would lie there until that wait is over by itself, which may be never. The
    interpreter itself writes to this pipe at once, whatever its threads do (`signal.set_wakeup_fd`).
    """

    def __init__(self) -> None:
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        # Without a handler of its own a signal would not be written but do what it does by default.
        self._handlers = {number: signal.signal(number, lambda *_: None) for number in ENDING}
        self._descriptor = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Return True after the first signal since this was made, or after `wake`; False when the time is over before."""
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left_s = None if deadline_s is None else max(deadline_s - time.monotonic(), 0.0)
            if not select.select([self._reader], [], [], left_s)[0]:
                return False
            if os.read(self._reader, 1)[0] in (_WOKEN, *ENDING):  # other signals' handlers write as well
                return True

    def wake(self) -> None:
        """End the wait without a signal, from any thread."""
        with contextlib.suppress(BlockingIOError):  # full of earlier signals: as good as written
            os.write(self._writer, bytes([_WOKEN]))

    def ignore(self) -> None:
        """Ignore both signals from now on, for good: what they ask for is under way."""
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)

    def close(self) -> None:
        """Put back what was there before."""
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._descriptor)
        os.close(self._reader)
        os.close(self._writer)
