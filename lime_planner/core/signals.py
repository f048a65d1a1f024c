"""Waiting for SIGINT and SIGTERM without ever missing one."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import threading
import time

#: What ends a program of this package.
ENDING = (signal.SIGINT, signal.SIGTERM)
_WOKEN = 0  # no signal has this number


class EndSignals:
    """SIGINT and SIGTERM as bytes in a pipe, from when it is made until `close`.

    Handlers written in Python run in the main thread only, between two of its instructions. A signal that another thread receives, or that
    comes right before the main thread begins to wait, would lie there until that wait is over by itself, which may be never. The
    interpreter itself writes to this pipe at once, whatever its threads do (`signal.set_wakeup_fd`).

    Raises:
        ValueError: made outside of the main thread, which alone may set handlers.
    """

    def __init__(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            raise ValueError("signals can be waited for in the main thread only")
        self._ended = False
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        # The pipe first, then the handlers: what comes in between does what it did before, and nothing is lost. Without a handler of its
        # own a signal would not be written.
        self._descriptor = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        self._handlers = {number: signal.signal(number, lambda *_: None) for number in ENDING}

    def wait(self, timeout_s: float | None = None) -> bool:
        """Whether a signal came since this was made, or `wake` was called; waits for it, for `timeout_s` at most."""
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        poll = select.poll()  # select() takes no descriptor above 1,023
        poll.register(self._reader, select.POLLIN)
        while not self._ended:
            left_ms = None if deadline_s is None else max(1e3 * (deadline_s - time.monotonic()), 0.0)
            if not poll.poll(left_ms):
                return False
            self._ended = os.read(self._reader, 1)[0] in (_WOKEN, *ENDING)  # other signals' handlers write as well
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
