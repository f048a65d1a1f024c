"""The paper's planners on the arm: the same promises as on the plane, where they claim them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from lime_planner.core.parameters import settings_from
from lime_planner.pipeline import Pipeline
from lime_planner.planning.rrt_star.planner import PaperOptions, PaperOutcome, plan_paper
from lime_planner.planning.space import one
from lime_planner.robot.model import home, load_robot
from lime_planner.scene.scene import Scene

ALGORITHMS = ("rrt_star", "apf_rrt_star", "p_rrt_star")


@pytest.fixture(scope="module")
def arm() -> Any:
    """The arm at home, a stem and a curtain of leaves beside its hand, and two goals beyond them."""
    robot = load_robot("kinova_j2s6s200")
    q = home(robot)
    goals = np.array([q + np.array([0.6, 0.2, -0.2, 0.0, 0.1, 0.0]), q + np.array([-0.7, 0.1, 0.1, 0.2, 0.0, 0.3])])
    between = [robot.forward(q + 0.5 * (g - q))[:3, 3] for g in goals]
    rng = np.random.default_rng(0)
    stem = between[0] + np.array([0.12, 0.0, 0.0]) + np.stack([np.zeros(80), np.zeros(80), np.linspace(-0.3, 0.3, 80)], axis=1)
    leaves = np.concatenate([centre + rng.uniform(-0.08, 0.08, (400, 3)) for centre in between])
    points = np.concatenate([leaves, stem])
    labels = np.r_[np.zeros(len(leaves), dtype=int), np.ones(len(stem), dtype=int)]
    scene = Scene.from_points(points.astype(np.float32), labels, frame_id=robot.planning_frame)
    obstacles = Pipeline(robot).obstacles(scene, None, settings_from({}))
    lower, upper = np.minimum(q, goals.min(axis=0)) - 0.4, np.maximum(q, goals.max(axis=0)) + 0.4
    return obstacles, lower, upper, q, goals


def solve(arm: Any, options: PaperOptions, seed: int = 0, iterations: int = 1500, **kwargs: Any) -> PaperOutcome:
    obstacles, lower, upper, q, goals = arm
    return plan_paper(obstacles.space(lower, upper), q, goals, options, seed, iterations=iterations, **kwargs)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("changes", [{}, {"propagate": True}, {"propagate": True, "cost": "integral"}])
def test_promises(arm: Any, algorithm: str, changes: dict[str, Any]) -> None:
    options = PaperOptions.arm(algorithm, goal_bias=0.1, goal_radius=0.3, **changes)
    outcome = solve(arm, options, marks=tuple(range(250, 1501, 250)))
    obstacles, lower, upper, q, goals = arm
    tree = outcome.tree
    expected = tree.cost[tree.parent[1:]] + tree.edge_cost[1:]
    if options.propagate:
        np.testing.assert_array_equal(tree.cost[1:], expected)
    else:
        assert (tree.cost[1:] >= expected - 1e-9).all()
    stored = [s.stored_cost for s in outcome.snapshots]
    assert all(later <= earlier for earlier, later in itertools.pairwise(stored))
    path = outcome.path
    assert path is not None
    np.testing.assert_array_equal(path[0], q)
    assert any(np.array_equal(path[-1], g) for g in goals)
    space = obstacles.space(lower, upper)
    intensity = np.array([one(space, node) for node in path])
    assert intensity.min() >= 0.0
    assert outcome.final.node_cost == pytest.approx(outcome.final.length + 100.0 * intensity.sum())
    if options.cost == "integral":
        assert outcome.final.integral_cost == pytest.approx(outcome.final.stored_cost)
        for a, b in itertools.pairwise(path):
            for t in np.linspace(0.0, 1.0, max(2, int(np.ceil(np.linalg.norm(b - a) / 0.01)))):  # a tenth of a step
                assert one(space, (1.0 - t) * a + t * b) >= 0.0
    elif options.propagate:
        assert outcome.final.node_cost == pytest.approx(outcome.final.stored_cost + 100.0 * intensity[-1])


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_same_seed_same_path(arm: Any, algorithm: str) -> None:
    options = PaperOptions.arm(algorithm)
    first, second = solve(arm, options, 3, 600), solve(arm, options, 3, 600, marks=(17, 300))
    np.testing.assert_array_equal(first.tree.rows, second.tree.rows)
    np.testing.assert_array_equal(first.tree.parent, second.tree.parent)


def test_time_of_1500_iterations(arm: Any) -> None:
    options = PaperOptions.arm("rrt_star")
    solve(arm, options, 0, 10)
    assert min(solve(arm, options, s).final.elapsed_s for s in range(3)) < 0.25  # about 0.01 s on a free core
