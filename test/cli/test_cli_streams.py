"""The command line as a process among others: pipes that close, full disks, terminals of few characters, other people's machines."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lime_planner.core.terminal import prepare_streams


def run(command: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run a line of Bash in which `lime-planner` is the command."""
    line = f'set -o pipefail; lime-planner() {{ "{sys.executable}" -m lime_planner "$@"; }}; {command}'
    return subprocess.run(
        ["bash", "-c", line],
        env={**os.environ, **environment},
        capture_output=True,
        timeout=120,
        check=False,
        cwd=Path(__file__).parents[2],
    )


@pytest.mark.parametrize("words", ["parameters", "--help", "parameters --json -", "plan --help"])
def test_a_reader_that_has_had_enough_is_no_failure(words: str) -> None:
    done = run(f"lime-planner {words} | head -n 1")
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.count(b"\n") == 1


@pytest.mark.parametrize("words", ["parameters", "--help", "--version", "parameters --json -"])
def test_a_full_standard_output_is_one_sentence(words: str) -> None:
    done = run(f"lime-planner {words} > /dev/full")
    assert done.returncode == 1
    assert done.stderr == b"INTERNAL_ERROR: standard output cannot be written: No space left on device\n"


def test_standard_output_that_is_closed() -> None:
    done = run("lime-planner parameters >&-")
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437"])
def test_terminals_of_few_characters(encoding: str) -> None:
    done = run("lime-planner parameters", PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    text = done.stdout.decode(encoding)
    assert "Step of the paper's planners" in text
    assert ("(delta)" in text) == (encoding != "cp437")  # which has a delta
    assert "?" not in text


def test_file_names_that_are_no_text() -> None:
    done = run(r"lime-planner plan $'/tmp/\xff.npz'")
    assert done.returncode == 1
    assert done.stderr == b"BAD_INPUT: /tmp/?.npz: there is no such file\n"


def test_without_a_compiler_one_sentence(tmp_path: Path) -> None:
    import numpy as np

    np.savez(
        tmp_path / "one.npz", points=np.zeros((1, 3), np.float32), labels=np.ones(1, np.uint8), target_pose=[0.4, 0, 0.4, 0, 0, 0, 1.0]
    )
    done = run(f"lime-planner plan {tmp_path}/one.npz", NUMBA_DISABLE_JIT="1")
    assert done.returncode == 1
    assert done.stderr == b"BAD_INPUT: NUMBA_DISABLE_JIT is set, and without the compiler nothing can be planned: unset it\n"


def test_what_is_replaced(capsysbinary: pytest.CaptureFixture[bytes]) -> None:
    import io

    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    before, sys.stdout = sys.stdout, stream
    try:
        prepare_streams()
        print("5 ≥ 3 – π/2 → ✓ 語")
    finally:
        sys.stdout = before
    stream.flush()
    assert stream.buffer.getvalue() == b"5 >= 3 - pi/2 -> ok ?\n"  # type: ignore[attr-defined]
