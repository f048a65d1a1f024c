"""The smallest distance to stems along a path is that of its rows, found without looking at each."""

from __future__ import annotations

import numpy as np
import pytest
from arm_helpers import obstacles_of, plant, robot_named

from lime_planner.pipeline.clearance import StemClearance


@pytest.mark.parametrize("reach_rad", [0.3, 1.5])
def test_the_smallest_of_a_path_is_that_of_its_rows(reach_rad: float, rng: np.random.Generator) -> None:
    robot = robot_named()
    clearance = StemClearance(obstacles_of(plant(15)))
    found = []
    for _ in range(6):
        rows = np.linspace(robot.home, robot.home + rng.uniform(-reach_rad, reach_rad, robot.n), 60)
        found.append(clearance.smallest(rows))
        assert found[-1] == pytest.approx(clearance.along(rows).min(), abs=1e-9)
    assert len(set(found)) > 1
