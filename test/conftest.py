"""What several test files share."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]

# Set before rclpy is imported anywhere: wrong field types raise instead of arriving as garbage, and tests stay on this machine.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("MPLBACKEND", "Agg")
# A shell that runs the tests in the background lets them ignore ctrl-C, and what they start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Let one half of the suite be empty: the tests that were asked for by name may all be in the other."""
    if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED and session.config.option.markexpr:
        session.exitstatus = pytest.ExitCode.OK


def shared_data() -> Path:
    """Folder of the real plant scans: LIME_PLANNER_DATA, else ../shared/data beside the repository; skips the test where it is absent."""
    named = os.environ.get("LIME_PLANNER_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real plant scans: {folder} is not a folder (set LIME_PLANNER_DATA)")
    return folder


@pytest.fixture(name="shared_data", scope="session")
def shared_data_fixture() -> Path:
    """The same as a fixture."""
    return shared_data()


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(7)
