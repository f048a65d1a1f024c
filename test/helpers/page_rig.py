"""The 3-D page served in this process, for tests with a browser. Each file of tests has a fixture `backend` of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from arm_helpers import plant, robot_named, settings
from browser import Browser, chromium

from lime_planner.viewer.access import Access
from lime_planner.viewer.backend import Activity
from lime_planner.viewer.page import Page
from lime_planner.viewer.scene_backend import SceneBackend


def until(holds: Callable[[], bool], what: str, timeout_s: float = 60.0) -> None:
    """Wait until something holds."""
    deadline = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.02)


@contextmanager
def ready_backend(iterations: int, velocity_scaling: float = 1.0) -> Iterator[SceneBackend]:
    """A simulated arm before a plant, ready to plan."""
    choices = settings(iterations=iterations, seed=3, velocity_scaling=velocity_scaling)
    made = SceneBackend(robot_named, choices, scene=plant(15), title="plant")
    until(lambda: made.moment().activity is Activity.IDLE, "the planner", 120.0)
    yield made
    made.close()


@pytest.fixture(scope="module", name="served")
def served_fixture(backend: SceneBackend) -> Iterator[Page]:
    """Its page, at a port of its own; nothing may have failed in it."""
    page = Page(backend, Access(), 0)
    yield page
    assert page.failure == ""
    page.close()


@pytest.fixture(scope="module", name="browser")
def browser_fixture() -> Iterator[Browser]:
    """A Chromium."""
    with chromium() as running:
        yield running
