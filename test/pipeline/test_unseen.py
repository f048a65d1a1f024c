"""Space that no camera has seen: its price along edges and in plans, its figures, its limit, and nothing of it where all is seen."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from arm_helpers import near_configurations, pipeline_of, plant, robot_named, settings

from lime_planner.collision.touched_points import touched_points
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.obstacles import UNSEEN_VOXEL_M, Obstacles
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.targets import Target, fruit_target
from lime_planner.planning.space import line, one
from lime_planner.robot.model import home
from lime_planner.scene.camera import seen_scene
from lime_planner.scene.scene import Scene

EYE = (0.0, 0.0, 0.6)
QUICK = {"iterations": 1500, "ik_starts": 100, "max_grasps": 200}
SHARE, WEIGHT = 0.4, 1000.0


@cache
def partial() -> Scene:
    return seen_scene(plant(5), [EYE])


def plan(scene: Scene, target: Target | Array, **values: object) -> PlanResult:
    return pipeline_of().plan(scene, target, home(robot_named()), settings(**(QUICK | values)), seed=3)


def nearest_fruits(count: int) -> Array:
    """Centres of the plant's fruits that are nearest to the arm."""
    centres = plant(5).fruit_centres
    assert centres is not None
    return np.asarray(centres[np.argsort(np.linalg.norm(centres, axis=1))[:count]], dtype=np.float64)


def obstacles(**values: object) -> Obstacles:
    return pipeline_of().obstacles(partial(), None, settings(**values))


def in_unseen(configurations: Array) -> Array:
    """Whether the arm is within half a voxel of the middle of an unseen one, by going through all of them."""
    seen = pipeline_of().seen_map(partial())
    marks = touched_points(robot_named(), pipeline_of().shapes, configurations, seen.unseen, 0.5 * UNSEEN_VOXEL_M)
    return np.asarray(marks.any(axis=1))


def test_an_edge_pays_for_leaves_and_for_what_is_unseen() -> None:
    """J = ∫ (1 + w · leaf + w · share · unseen) ds, against samples every three milliradians."""
    priced, bare = obstacles(unseen_price=SHARE), obstacles(unseen_price=0.0)
    limits = np.full(6, -50.0), np.full(6, 50.0)
    costly, free = priced.space(*limits), bare.space(*limits)
    rows = near_configurations(robot_named(), np.random.default_rng(2), 250, partial().stem_points.mean(axis=0), 0.3)
    rows = np.array([q for q in rows if one(free, q) >= 0.0])
    some, compared, unseen_total = np.random.default_rng(3), 0, 0.0
    for q in rows[:40]:
        other = q + 0.1 * some.normal(size=6)
        alone, both = line(free, q, other, WEIGHT, np.inf), line(costly, q, other, WEIGHT, np.inf)
        assert np.isinf(alone) == np.isinf(both), "what is unseen never blocks"
        if np.isinf(alone):
            continue
        samples, lengths = sample_path(np.array([q, other]), 0.003)
        inside = in_unseen(samples)
        expected = float(lengths[-1] * 0.5 * (inside[1:] * 1.0 + inside[:-1]).mean())
        borders = np.count_nonzero(np.diff(inside * 1))
        assert (both - alone) / (WEIGHT * SHARE) == pytest.approx(expected, abs=0.004 * (borders + 1))
        assert line(costly, q, other, WEIGHT, 0.5 * both) > 0.5 * both, "it stops early, above the bound"
        compared, unseen_total = compared + 1, unseen_total + expected
    assert compared > 10 and unseen_total > 0.5


def test_a_configuration_pays_too() -> None:
    costly, free = (obstacles(unseen_price=price).space(np.full(6, -50.0), np.full(6, 50.0)) for price in (SHARE, 0.0))
    rows = near_configurations(robot_named(), np.random.default_rng(4), 300, partial().stem_points.mean(axis=0), 0.3)
    rows = np.array([q for q in rows if one(free, q) >= 0.0])
    inside = in_unseen(rows)
    assert 10 < inside.sum() < len(rows) - 10
    more = np.array([one(costly, q) - one(free, q) for q in rows])
    assert (np.abs(more - SHARE * inside) < 1e-6).mean() > 0.97, "half a voxel apart to half a millimetre"


def test_where_everything_is_seen_nothing_changes() -> None:
    """The same path to the last bit, whatever the unseen costs: without viewpoints, and with views that hide nothing."""
    full, aim = plant(5), fruit_target(nearest_fruits(1)[0])
    seen = dataclasses.replace(
        full,
        viewpoints=np.array([EYE]),
        leaf_view_ids=np.full(len(full.leaf_points), -1),
        stem_view_ids=np.full(len(full.stem_points), -1),
        fruit_view_ids=np.full(len(full.fruit_points), -1),
    )
    bare = plan(full, aim, unseen_price=0.0)
    for scene in (full, seen):
        other = plan(scene, aim, unseen_price=7.0)
        np.testing.assert_array_equal(other.waypoints, bare.waypoints)
        assert (other.views, other.unseen_contact_rad, other.tool_unseen_m) == (0, 0.0, 0.0)
        assert other.cost == bare.cost and "no view" not in other.message


def test_the_price_leads_through_seen_space_and_the_figures_say_so() -> None:
    aims = [fruit_target(centre) for centre in nearest_fruits(3)]
    without, with_price = ([plan(partial(), aim, unseen_price=price) for aim in aims] for price in (0.0, 1.0))
    assert all(result.succeeded for result in (*without, *with_price))
    free_rad, priced_rad = (sum(result.unseen_contact_rad for result in results) for results in (without, with_price))
    assert free_rad > 0.1 and priced_rad < 0.5 * free_rad, (free_rad, priced_rad)
    for result, price in [(result, 0.0) for result in without] + [(result, 1.0) for result in with_price]:
        assert result.views == 1 and 0.0 <= result.tool_unseen_m <= result.tool_path_length_m
        samples, lengths = sample_path(result.waypoints, 0.003)
        inside = in_unseen(samples)
        # The inside of the target fruit is hard, not unseen: what the plan counts may be less by where only that is met.
        assert result.unseen_contact_rad <= float(lengths[-1]) * inside.mean() + 0.02
        extra = result.cost - result.path_length_rad - result.collision_cost
        assert extra == pytest.approx(price * 1000.0 * result.unseen_contact_rad, abs=0.05)
        figures = result.figures()
        assert (figures["views"], figures["unseen_contact_rad"]) == (1, result.unseen_contact_rad)
        assert f"{result.unseen_contact_rad:.2f} rad of it in space that no view shows (1 known)" in result.message


def test_too_much_unseen_space_is_refused() -> None:
    target = pose_to_matrix(plant(5).target_pose)
    found = plan(partial(), target)
    assert found.succeeded and found.unseen_contact_rad > 0.0, found.message
    refused = plan(partial(), target, max_unseen_contact_rad=0.0)
    assert refused.status is Status.UNSEEN and refused.trajectory is None
    assert "rad of the best path lie in space that 1 view did not show, allowed are 0.000 rad" in refused.message
    assert plan(partial(), target, max_unseen_contact_rad=found.unseen_contact_rad + 0.01).succeeded


def test_the_papers_planner_counts_its_nodes_there() -> None:
    aim = fruit_target(nearest_fruits(1)[0])
    result = plan(partial(), aim, planner="rrt_star", paper=True, iterations=8000, unseen_price=SHARE)
    assert result.succeeded and result.cost_metric == "node", result.message
    nodes = (result.cost - result.path_length_rad - result.collision_cost) / (100.0 * SHARE)
    assert nodes == pytest.approx(round(nodes), abs=1e-6) and 0.0 <= nodes <= in_unseen(result.waypoints).sum() + 1e-6
