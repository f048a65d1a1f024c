"""The suite itself: workers that do not hear each other, and an order that names files which exist."""

from __future__ import annotations

import subprocess
import sys

import domains
from conftest import LONG, ROOT


def test_processes_of_tests_have_ros_domains_of_their_own() -> None:
    """Also those whose process ids would give them the same one, and they are free again when the process has ended."""
    number = 4 * 25 + domains.DOMAIN // domains.COUNT
    code = f"import os; os.getpid = lambda: {number}; import domains; print(domains.DOMAIN, flush=True); input()"
    command = [sys.executable, "-c", code]
    running = [subprocess.Popen(command, cwd=ROOT / "test" / "helpers", stdin=-1, stdout=-1, text=True) for _ in range(3)]
    found = [int(process.stdout.readline()) for process in running if process.stdout is not None]
    for process in running:
        process.communicate("\n", timeout=20.0)
    assert len({domains.DOMAIN, *found}) == 4
    assert all(abs(one - other) >= domains.COUNT for one in found for other in (domains.DOMAIN, *found) if one != other)
    assert max(found) + domains.COUNT - 1 <= 101
    again = subprocess.run(command, cwd=ROOT / "test" / "helpers", input="\n", stdout=-1, text=True, timeout=20.0, check=True)
    assert int(again.stdout) in found


def test_the_long_files_exist_and_are_named_once() -> None:
    assert [name for name in LONG if not (ROOT / "test" / f"{name}.py").is_file()] == []
    assert len(set(LONG)) == len(LONG)
