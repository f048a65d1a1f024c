"""Freed memory goes back to the system."""

from __future__ import annotations

import platform
import re
from pathlib import Path

import numpy as np
import pytest

from lime_planner.ros import runtime


def resident_mb() -> float:
    match = re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())
    assert match is not None
    return int(match[1]) / 1024.0


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries give freed memory back by themselves, or cannot be asked")
def test_pages_between_blocks_in_use_go_back() -> None:
    blocks = [np.ones(8192) for _ in range(3000)]  # 64 kB each: below the size from which glibc asks the system for each
    kept = blocks[::100]
    del blocks
    before = resident_mb()
    runtime.give_back()
    assert resident_mb() < before - 100.0
    assert all(block.sum() == 8192.0 for block in kept)


def test_without_glibc_it_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "_TRIM", None)
    runtime.give_back()
    monkeypatch.setattr(runtime.ctypes, "CDLL", lambda name: object())
    assert runtime._find_trim() is None
