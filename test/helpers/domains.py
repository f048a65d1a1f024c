"""The ROS domains of this process of tests, which no other process of tests on this machine has: workers do not hear each other."""

from __future__ import annotations

import os
import socket

#: Domains that one process has; modules that start nodes twice give the second ones another.
COUNT = 4
#: Domains up to 101 are safe on every system.
_FIRST = range(1, 101, COUNT)
_DISCOVERY_PORT = 7400  #: DDS discovers by UDP at this port and 250 more for each domain; the same number is bound by TCP here.


def _claim() -> tuple[int, socket.socket | None]:
    """Bind the port that stands for the first free domain; the socket lasts as long as the process, however it ends."""
    begin = os.getpid() % len(_FIRST)
    for domain in (*_FIRST[begin:], *_FIRST[:begin]):
        held = socket.socket()
        try:
            held.bind(("127.0.0.1", _DISCOVERY_PORT + 250 * domain))
        except OSError:
            held.close()
        else:
            return domain, held
    return _FIRST[begin], None


#: The first of them, and what holds it.
DOMAIN, _HELD = _claim()
