"""Calls in a process of their own: what comes back, what is raised, and that the interpreter is free meanwhile."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lime_planner.core.elsewhere import call_elsewhere
from lime_planner.core.errors import LimePlannerError, ParameterError, Refusal
from lime_planner.core.parameters import validate
from lime_planner.core.status import Status


def threaded(call: Callable[[], Any]) -> Any:
    """Call in a thread that is not the main one; what it returns or raises."""
    found: list[Any] = []

    def run() -> None:
        try:
            found.append(call())
        except Exception as error:
            found.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(60.0)
    return found[0]


def test_a_thread_calls_elsewhere_and_the_main_thread_here() -> None:
    assert call_elsewhere(os.getpid) == os.getpid()
    assert threaded(lambda: call_elsewhere(os.getpid)) not in (None, os.getpid())
    assert threaded(lambda: call_elsewhere(np.arange, 5)).tolist() == [0, 1, 2, 3, 4]


def test_errors_of_the_package_come_back_and_a_dead_process_is_told() -> None:
    error = threaded(lambda: call_elsewhere(validate, "time_budget_s", -1.0))
    assert isinstance(error, ParameterError) and "time_budget_s" in str(error)
    error = threaded(lambda: call_elsewhere(os._exit, 3))
    assert isinstance(error, LimePlannerError) and "_exit ended with 3: without a word" in str(error)
    error = threaded(lambda: call_elsewhere(os.listdir, "/nowhere"))
    assert isinstance(error, LimePlannerError) and "/nowhere" in str(error)


def test_a_call_is_given_up_when_nobody_wants_it() -> None:
    began_s = time.monotonic()
    error = threaded(lambda: call_elsewhere(time.sleep, 50.0, should_stop=lambda: time.monotonic() > began_s + 0.2))
    assert isinstance(error, Refusal) and error.status is Status.CANCELLED
    assert time.monotonic() - began_s < 10.0
    large = np.zeros(3_000_000)  # more than a pipe holds
    assert threaded(lambda: call_elsewhere(np.sum, large)) == 0.0


@pytest.mark.timed
def test_grids_made_elsewhere_are_those_made_here(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """And other threads run on meanwhile, whatever holds the interpreter over there."""
    from lime_planner.collision.link_grids import build_grids
    from lime_planner.robot.model import load_robot

    monkeypatch.setenv("LIME_PLANNER_CACHE_DIR", str(tmp_path))
    links = load_robot("kinova_j2n6s300").links[-2:]
    waits: list[float] = []
    done = threading.Event()

    def tick() -> None:
        last_s = time.monotonic()
        while not done.is_set():
            time.sleep(0.002)
            now_s = time.monotonic()
            waits.append(now_s - last_s)
            last_s = now_s

    thread = threading.Thread(target=tick)
    thread.start()
    away = threaded(lambda: build_grids(links, 0.03))
    done.set()
    thread.join()
    for path in tmp_path.glob("linkgrid-*"):
        path.unlink()
    here = build_grids(links, 0.03)
    assert np.array_equal(away.values, here.values) and np.array_equal(away.start, here.start)
    assert np.percentile(waits, 99) < 0.05
    stopped = threaded(lambda: build_grids(links, 0.07, lambda: True))
    assert isinstance(stopped, Refusal)
