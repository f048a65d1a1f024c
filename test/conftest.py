"""What several test files share."""

from __future__ import annotations

import os
import signal
from pathlib import Path

# Before NumPy is imported: processors whose linear algebra rounds otherwise find other paths by the same seed, and pages show figures.
os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")

import numpy as np
import pytest
from domains import DOMAIN

ROOT = Path(__file__).resolve().parents[1]

# Set before rclpy is imported anywhere: wrong field types raise instead of arriving as garbage, and tests stay on this machine.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
# Whatever the shell says: what runs there, and the tests of another worker, must not be heard here.
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ.setdefault("MPLBACKEND", "Agg")
# A shell that runs the tests in the background lets them ignore ctrl-C, and what they start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


#: Files that take long, longest first: begun last, one of them keeps one worker busy while the other has nothing left.
# fmt: off
LONG = [
    "docs/test_docs", "pipeline/test_pipeline", "planning/test_lime_star", "ros/demo/test_demo", "viewer/test_view_nodes",
    "docs/test_tutorials", "cli/test_printed_commands", "ros/nodes/test_node_real", "experiments/test_wall_experiment",
    "pipeline/test_obstacle_settings", "collision/test_fast", "collision/test_edge_cost", "benchmarks/test_bench_kernels",
    "cli/test_cli_plan",
    "viewer/test_scene_backend", "core/test_kernel_cache", "experiments/test_lime_experiment", "pipeline/test_unseen",
    "experiments/test_cluster", "pipeline/test_warm_up", "scene/test_plant_generator", "pipeline/test_pipeline_statuses",
    "planning/test_function_space", "benchmarks/test_true_cost", "ros/execution/test_stop_closed_loop", "collision/test_exact",
    "motion/test_timing", "experiments/test_wall_reference", "planning/test_rrt_star", "robot/test_ik",
    "ros/nodes/test_reliability", "viewer/test_page_legible", "viewer/test_page", "ros/nodes/test_node_motion",
    "ros/nodes/test_node_life", "ros/nodes/test_look", "viewer/test_page_keyboard", "ros/execution/test_output",
]
# fmt: on


def pytest_configure(config: pytest.Config) -> None:
    """Have xdist take the files in the order below, not by how many tests they have."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the long files first."""
    places = {ROOT / "test" / f"{name}.py": place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: places.get(item.path, len(places)))


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
