"""Which ROS domains are in use on this machine, seen by the UDP ports that DDS participants open (RTPS 2.2, section 9.6.1)."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
_BASE, _DOMAIN_GAIN, _FIRST, _PARTICIPANT_GAIN = 7400, 250, 10, 2


def participants_by_domain() -> dict[int, int]:
    """Return the number of participants of this machine in each domain; empty where the system does not tell."""
    ports: set[int] = set()
    for table in _TABLES:
        try:
            lines = table.read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        ports |= {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    counts: Counter[int] = Counter()
    for port in ports:
        domain, offset = divmod(port - _BASE, _DOMAIN_GAIN)
        # Each participant has two ports next to each other; the first one is even.
        if domain >= 0 and offset >= _FIRST and (offset - _FIRST) % _PARTICIPANT_GAIN == 0 and port + 1 in ports:
            counts[domain] += 1
    return dict(sorted(counts.items()))
