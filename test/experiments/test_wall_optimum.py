"""The exact optimum of planar worlds, against closed forms, another method, and the planners' bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from lime_planner.experiments.wall.optimum import plane_optimum, straight_cost
from lime_planner.planning.rrt_star.planner import PaperOptions, plan_paper
from lime_planner.planning.spaces.plane import PlaneWorld, random_wall, wall_g

WEIGHT = 100.0 / 3.0


def solid_leaves(world: PlaneWorld) -> PlaneWorld:
    return PlaneWorld("solid", world.lower, world.upper, world.start, world.goal, (), world.permeable + world.impermeable)


def test_geometry_g() -> None:
    assert straight_cost(wall_g(), WEIGHT) == pytest.approx(763.3, abs=0.05)
    optimum = plane_optimum(wall_g(), WEIGHT)
    assert optimum.cost == pytest.approx(588.3, abs=0.5)
    # Closed form: straight to the corner of the wide part, through the narrow part along its face, straight to the goal.
    assert optimum.cost == pytest.approx(2 * np.hypot(29.75, 30.0) + 20.5 + WEIGHT * 14.5, abs=1e-6)
    np.testing.assert_allclose(np.abs(optimum.path - [50.0, 50.0]), [[40, 0], [10.25, 30], [10.25, 30], [40, 0]], atol=1e-6)


def test_cheap_leaves_are_crossed_straight() -> None:
    optimum = plane_optimum(wall_g(), 1.0 / 3.0)
    assert optimum.cost == pytest.approx(80.0 + 20.5 / 3.0, abs=1e-9)


def test_slanted_wall_is_refracted() -> None:
    world = PlaneWorld("slab", (0, 0), (100, 100), (10, 20), (90, 80), (((30, -10), (50, -10), (70, 110), (50, 110)),))

    def through(y: np.ndarray) -> float:
        points = np.array([world.start, (30 + (y[0] + 10) / 6, y[0]), (50 + (y[1] + 10) / 6, y[1]), world.goal])
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return float(lengths @ [1.0, 1.0 + 3.0, 1.0])

    expected = minimize(through, [40.0, 50.0], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12}).fun
    assert plane_optimum(world, 3.0).cost == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("seed", [0, 2, 6])
def test_spacing_does_not_matter(seed: int) -> None:
    world = random_wall(seed)
    assert plane_optimum(world, WEIGHT, spacing=1.0).cost == pytest.approx(plane_optimum(world, WEIGHT, spacing=0.6).cost, rel=2e-4)


def test_expensive_leaves_are_solids() -> None:
    for seed in range(40):
        world = random_wall(seed)
        solid = plane_optimum(solid_leaves(world), 0.0)
        if np.isfinite(solid.cost):
            assert plane_optimum(world, 1e7).cost == pytest.approx(solid.cost, rel=1e-3)
            return
    raise AssertionError("no wall with an open gap among 40")


def test_closed_world_has_no_path() -> None:
    closed = PlaneWorld("closed", (0, 0), (100, 100), (10, 50), (90, 50), (), (((45, -10), (55, -10), (55, 110), (45, 110)),))
    optimum = plane_optimum(closed, 1.0)
    assert optimum.cost == np.inf
    assert optimum.path.shape == (0, 2)


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_planners_approach_the_optimum_and_never_beat_it(seed: int) -> None:
    world = random_wall(seed)
    optimum = plane_optimum(world, WEIGHT).cost
    options = PaperOptions(algorithm="rrt_star", cost="integral", radius="rrg", propagate=True)
    found = plan_paper(world.space(), world.start, world.goal, options, 1, iterations=6000).final.integral_cost
    assert optimum * (1.0 - 1e-6) <= found <= 1.03 * optimum
