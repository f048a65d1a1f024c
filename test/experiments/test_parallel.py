"""Trials in processes of their own: one that fails, one that loses its process, one that always does."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from lime_planner.experiments.runs.parallel import RETRIES, WorkerError, run_trials


def slow_unless_wrong(number: int) -> int:
    if number == 2:
        raise ValueError(f"trial {number} is impossible")
    time.sleep(0.3)
    return number


def test_an_error_comes_after_what_the_others_finished() -> None:
    done: list[int] = []
    with pytest.raises(ValueError, match="trial 2 is impossible"):
        run_trials(slow_unless_wrong, [1, 2, *range(3, 60)], done.append, jobs=2, description="")
    assert 1 in done  # it was under way when the other process met the error
    assert 2 not in done and len(done) < 20  # nothing new was begun


def dies_once(task: tuple[Path, int]) -> int:
    folder, number = task
    if number == 3 and not (folder / "died").exists():
        (folder / "died").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / f"{number}-{time.monotonic_ns()}").touch()
    return number


def test_a_killed_process_costs_nothing_but_its_time(tmp_path: Path) -> None:
    done: list[int] = []
    assert run_trials(dies_once, [(tmp_path, n) for n in range(20)], done.append, jobs=2, description="")
    assert (tmp_path / "died").exists()
    assert sorted(done) == list(range(20))  # every one, and none twice


def dies_always(task: tuple[Path, int]) -> int:
    folder, number = task
    if number == 3:
        (folder / str(time.monotonic_ns())).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02)
    return number


def test_a_task_that_kills_every_process_is_named(tmp_path: Path) -> None:
    done: list[int] = []
    with pytest.raises(WorkerError, match=rf"died in each of {1 + RETRIES} attempts at \(.*, 3\)"):
        run_trials(dies_always, [(tmp_path, n) for n in range(12)], done.append, jobs=2, description="")
    assert len(list(tmp_path.iterdir())) == 1 + RETRIES
    assert set(done) <= set(range(12)) - {3} and len(set(done)) == len(done)
    assert 11 in done  # what came after it is done before it gets its last attempt


def test_an_error_in_taking_a_result_ends_the_run() -> None:
    done: list[int] = []

    def full(result: int) -> None:
        done.append(result)
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="disk"):
        run_trials(abs, range(100), full, jobs=2, description="")
    assert len(done) == 1
