"""How many processors this process may use."""

from __future__ import annotations

import math
import os
from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup")


def usable_cores(cgroup: Path = _CGROUP) -> int:
    """Return the number of processors this process may use, at least 1: a container's quota counts, and a processor affinity.

    Args:
        cgroup: where the kernel says what a container may use.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.floor(min(cores, _quota(cgroup))))


def _quota(cgroup: Path) -> float:
    """Return the processors that a container's quota amounts to (version 2 of control groups, then 1); inf without one."""
    try:
        texts = (cgroup / "cpu.max").read_text(encoding="ascii").split()
    except (OSError, UnicodeDecodeError):
        try:
            folder = cgroup / "cpu"
            texts = [(folder / f"cpu.cfs_{name}_us").read_text(encoding="ascii").strip() for name in ("quota", "period")]
        except (OSError, UnicodeDecodeError):
            return math.inf
    try:
        quota, period = (float(text) for text in texts)
    except ValueError:  # "max": no quota
        return math.inf
    return quota / period if quota > 0.0 and period > 0.0 else math.inf
