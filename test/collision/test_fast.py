"""The fast collision model against the exact meshes and against distances computed with Open3D, on a real scan and a generated plant.

The rates are printed: `pytest -s test/collision/test_fast.py`.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from arm_helpers import box_of, near_configurations, obstacles_of, pipeline_of, plant, robot_named, scan, scene_of
from test_exact import Reference

from lime_planner.collision.fast import LEAF, NEED, SELF
from lime_planner.collision.joint_space import measure
from lime_planner.collision.self_contact import SELF_CLEARANCE_M
from lime_planner.collision.world import required_clearance
from lime_planner.core.jit import kernel
from lime_planner.pipeline.goals import MODEL_ERROR_M
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.prices import PATCHES_PER_LEAF
from lime_planner.planning.space import evaluate
from lime_planner.scene.scene import Scene

ARMS = ("kinova_j2s6s200", "kinova_j2n6s300")
SCENES = ("scan", "plant")
COUNT = 2500
MARGIN_M = 0.005


@kernel
def evaluate_all(space, rows, out):
    for i in range(rows.shape[0]):
        out[i] = evaluate(space, rows[i])


@kernel
def required(world, q):
    return required_clearance(world, q)


@cache
def scene_named(name: str):
    return scan("h01p179") if name == "scan" else plant()


def measured(obstacles: Obstacles, rows: np.ndarray) -> np.ndarray:
    """Clearance, clearance of the arm to itself, leaf intensity, in columns, whatever is required."""
    space, out = obstacles.measuring_space(), np.empty((len(rows), 3))
    for q, row in zip(rows, out, strict=True):
        measure(space, q)
        row[:] = space.state.clear.min(), space.state.misc[SELF], space.state.misc[LEAF]
    return out


def evaluated(obstacles: Obstacles, rows: np.ndarray) -> np.ndarray:
    """What a planner is told: -1 where invalid, else the leaf intensity."""
    out = np.empty(len(rows))
    evaluate_all(obstacles.space(np.full(rows.shape[1], -1e3), np.full(rows.shape[1], 1e3)).handle(), np.ascontiguousarray(rows), out)
    return out


@cache
def case(arm: str, name: str):
    """Configurations around a canopy, what the fast model measures and what the exact check says."""
    scene = scene_named(name)
    rows = near_configurations(robot_named(arm), np.random.default_rng(2), COUNT, np.median(scene.leaf_points, axis=0), 0.3)
    obstacles = obstacles_of(scene, robot=arm)
    checker = obstacles.exact_checker()
    hits = [checker.stem_hit(q) for q in rows]
    own = np.array([hit is not None and hit.what == "self" for hit in hits])
    touching = np.array([hit is not None and hit.what == "stem" for hit in hits])
    leaf = np.array([checker.leaf_contact(q) for q in rows])
    return rows, obstacles, checker, measured(obstacles, rows), touching, own, leaf


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("arm", ARMS)
def test_stems(arm: str, name: str) -> None:
    rows, _, checker, fast, touching, own, _ = case(arm, name)
    clear = fast[:, 0]
    judged = ~own  # the exact check looks at the arm itself first
    false_clear = (clear > 0.0) & touching
    near = np.flatnonzero(np.abs(clear) < 0.004)
    exact = np.array([checker.stem_distance(rows[i]) for i in near])
    error = clear[near] - exact
    lost = np.flatnonzero((exact >= 0.003) & (clear[near] < MODEL_ERROR_M))
    refused = (clear < MARGIN_M) & ~touching & judged
    deepest = -exact[(clear[near] > 0.0)].min()
    free = ~touching[judged]
    print(
        f"\n{arm}, {name}: {COUNT} configurations, {100 * touching.mean():.0f} % in a stem; false clear with the margin 0 "
        f"{false_clear.sum()} ({1e3 * deepest:.2f} mm deep at most), with 1 mm {((clear > MODEL_ERROR_M) & touching).sum()}, with 5 mm "
        f"{((clear > MARGIN_M) & touching).sum()}; refused though free {100 * (clear[judged] <= 0.0)[free].mean():.2f} % with the "
        f"margin 0, {100 * refused.sum() / free.sum():.2f} % with 5 mm; within 4 mm of contact the error is {1e3 * error.mean():.2f} mm on "
        f"average, {1e3 * error.min():.2f} to {1e3 * error.max():.2f} mm"
    )
    assert 100 < touching.sum() < COUNT - 100
    # Optimistic by less than the margin, and by less than what is required at a goal.
    assert not ((clear > MARGIN_M) & touching).any()
    assert not ((clear > MODEL_ERROR_M) & touching).any()
    assert deepest < 0.002
    # And hardly conservative: what the meshes clear by 3 mm is not lost.
    assert len(lost) == 0
    assert error.min() > -0.0015


@pytest.mark.parametrize("arm", ARMS)
def test_clearance_against_independent_distances(arm: str) -> None:
    rows, obstacles, _, fast, _, _, _ = case(arm, "scan")
    reference, every = Reference(robot_named(arm)), range(len(robot_named(arm).links))
    chosen = np.flatnonzero((fast[:, 0] > -0.003) & (fast[:, 0] < 0.03))[:80]
    radius = obstacles.settings.stem_point_radius_m
    truth = np.array([reference.nearest(rows[i], obstacles.hard.astype(float), list(every), 0.06) for i in chosen]) - radius
    error = fast[chosen, 0] - truth
    print(f"\n{arm}: {len(chosen)} clearances against Open3D: {1e3 * error.min():.2f} to {1e3 * error.max():.2f} mm")
    assert len(chosen) == 80
    assert error.max() < 0.004  # far from contact it may interpolate over a corner of the mesh
    close = truth < 0.02
    assert error[close].min() > -0.003
    assert not ((fast[chosen, 0] > MODEL_ERROR_M) & (truth < -1e-5)).any()


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("arm", ARMS)
def test_leaves(arm: str, name: str) -> None:
    rows, _, _, fast, _, _, leaf = case(arm, name)
    found = fast[:, 2] > 0.0
    print(
        f"\n{arm}, {name}: leaf contact of the meshes {100 * leaf.mean():.1f} %, of the fast model {100 * found.mean():.1f} %, "
        f"missed {(leaf & ~found).sum()}, invented {(found & ~leaf).sum()}"
    )
    assert (leaf != found).mean() < 0.005
    assert set(np.unique(fast[:, 2])) <= {0.0, 1.0}
    graded = measured(obstacles_of(scene_named(name), robot=arm, leaf_cost="graded"), rows[:300])[:, 2]
    np.testing.assert_array_equal(graded > 0.0, found[:300])
    assert np.ptp(graded[graded > 0.0]) > 1.0  # one leaf and fifty do not cost the same


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("arm", ARMS)
def test_a_planner_is_told_what_is_measured(arm: str, name: str) -> None:
    rows, obstacles, _, fast, _, _, _ = case(arm, name)
    told = evaluated(obstacles, rows)
    border = (np.abs(fast[:, 0] - MARGIN_M) < 1e-6) | (np.abs(fast[:, 1] - SELF_CLEARANCE_M) < 1e-6)
    expected = np.where((fast[:, 0] >= MARGIN_M) & (fast[:, 1] >= SELF_CLEARANCE_M), fast[:, 2], -1.0)
    np.testing.assert_array_equal(told[~border], expected[~border])
    leafless = obstacles.space(np.full(6, -1e3), np.full(6, 1e3), leaves=False)
    out = np.empty(len(rows))
    evaluate_all(leafless.handle(), rows, out)
    np.testing.assert_array_equal(out, np.minimum(told, 0.0))
    tight = obstacles.space(rows[0] - 0.1, rows[0] + 0.1)
    evaluate_all(tight.handle(), rows, out)
    inside = (np.abs(rows - rows[0]) <= 0.1).all(axis=1)
    np.testing.assert_array_equal(out[~inside], -1.0)
    np.testing.assert_array_equal(out[inside], told[inside])


def test_permeability_costs_multiply() -> None:
    """Some leaves cost half, some double; those that cost nothing are free space."""
    scene = scene_named("plant")
    rows = near_configurations(robot_named(ARMS[0]), np.random.default_rng(4), 300, np.median(scene.leaf_points, axis=0), 0.3)
    plain = {mode: measured(obstacles_of(scene, leaf_cost=mode), rows)[:, 2] for mode in ("binary", "graded")}
    for factor in (0.0, 0.5, 3.0):
        scaled = dataclasses.replace(scene, leaf_costs=np.full(len(scene.leaf_points), factor, np.float32))
        for mode, before in plain.items():
            np.testing.assert_allclose(measured(obstacles_of(scaled, leaf_cost=mode), rows)[:, 2], factor * before, rtol=1e-5)
    left = scene.leaf_points[:, 1] > np.median(scene.leaf_points[:, 1])
    mixed = dataclasses.replace(scene, leaf_costs=np.where(left, 2.0, 0.5).astype(np.float32))
    only_left = dataclasses.replace(scene, leaf_costs=np.where(left, 1.0, 0.0).astype(np.float32))
    dear = measured(obstacles_of(only_left), rows)[:, 2] > 0.0
    expected = np.where(dear, 2.0, 0.5 * plain["binary"])
    found = measured(obstacles_of(mixed), rows)[:, 2]
    # Thinned to 4 mm, a point may stand for a neighbour on the other side of the border.
    assert (found != expected).mean() < 0.02
    assert 0.05 < dear.mean() < 0.95


def test_classes_with_prices_are_charged_the_highest_or_their_sum() -> None:
    """A cheap class beside a dear one: the dear one where both are touched (binary), both (graded)."""
    scene = scene_named("plant")
    rows = near_configurations(robot_named(ARMS[0]), np.random.default_rng(6), 300, np.median(scene.leaf_points, axis=0), 0.3)
    left = scene.leaf_points[:, 1] > np.median(scene.leaf_points[:, 1])
    points = np.concatenate([scene.leaf_points, scene.stem_points])
    labels = np.concatenate([np.where(left, 3, 0), np.ones(len(scene.stem_points), int)])
    priced = {
        side: Scene.from_points(points, labels, class_costs=costs) for side, costs in (("cheap", {0: 0.0, 3: 0.2}), ("dear", {3: 0.0}))
    }
    both = Scene.from_points(points, labels, class_costs={3: 0.2})
    for mode, together in (("binary", np.maximum), ("graded", np.add)):
        cheap, dear = (measured(obstacles_of(priced[side], leaf_cost=mode), rows)[:, 2] for side in ("cheap", "dear"))
        found = measured(obstacles_of(both, leaf_cost=mode), rows)[:, 2]
        # Thinned to 4 mm, and graded in cells of 10 mm, points of both classes meet along the border.
        off = np.abs(found - together(cheap, dear)) > (1e-6 if mode == "binary" else 0.05 * found + 0.05)
        assert off.mean() < 0.04
        assert ((cheap > 0.0) & (dear == 0.0)).sum() > 5 and ((cheap > 0.0) & (dear > 0.0)).sum() > 5


def test_graded_intensity_grows_with_the_leaf_touched() -> None:
    scene = scene_named("plant")
    rows = near_configurations(robot_named(ARMS[0]), np.random.default_rng(5), 200, np.median(scene.leaf_points, axis=0), 0.25)
    half = scene_of(scene.stem_points, scene.leaf_points[scene.leaf_ids % 2 == 0])
    whole = measured(obstacles_of(scene_of(scene.stem_points, scene.leaf_points), leaf_cost="graded"), rows)[:, 2]
    part = measured(obstacles_of(half, leaf_cost="graded"), rows)[:, 2]
    # Cells on the border of two leaves change their share; beyond that less leaf is never dearer.
    assert (part <= whole * 1.05 + 3.0 / PATCHES_PER_LEAF).all()
    assert part.sum() < 0.75 * whole.sum()


@pytest.mark.parametrize("arm", ARMS)
def test_the_arm_against_itself(arm: str) -> None:
    robot = robot_named(arm)
    low, high = box_of(robot)
    rows = np.random.default_rng(3).uniform(low, high, (4000, robot.n))
    obstacles = obstacles_of(scene_of(), robot=arm)
    checker = obstacles.exact_checker()
    exact = np.array([checker.stem_hit(q) is not None for q in rows])
    fast = measured(obstacles, rows)[:, 1] < SELF_CLEARANCE_M
    missed, refused = (exact & ~fast).sum(), (fast & ~exact).sum()
    print(f"\n{arm}: {exact.sum()} of {len(rows)} hit themselves; missed {missed}, refused though free {refused}")
    assert exact.sum() > 100
    assert not (exact & ~fast).any()
    assert (fast & ~exact).mean() < 0.02


@pytest.mark.parametrize("arm", ARMS)
def test_keep_out_boxes_floor_and_workspace(arm: str) -> None:
    robot = robot_named(arm)
    rows = near_configurations(robot, np.random.default_rng(6), 800, np.array([0.45, 0.0, 0.3]), 0.35)
    grown = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    limits = {
        "keep_out_boxes": lambda by: (np.array([0.4, -0.15, 0.2, 0.7, 0.2, 0.45]) + by * grown).tolist(),
        "floor_z_m": lambda by: 0.1 + by,
        "workspace_box": lambda by: (np.array([-0.5, -0.4, -0.3, 0.7, 0.4, 0.9]) - by * grown).tolist(),
    }
    own = measured(obstacles_of(scene_of(), robot=arm), rows)[:, 1] < SELF_CLEARANCE_M
    for name, limit in limits.items():
        valid = evaluated(obstacles_of(scene_of(), robot=arm, **{name: limit(0.0)}), rows) >= 0.0
        hit, near = (
            np.array([checker.stem_hit(q) is not None for q in rows])
            for checker in (obstacles_of(scene_of(), robot=arm, **{name: limit(by)}).exact_checker() for by in (0.0, MARGIN_M + 0.012))
        )
        assert hit.sum() > 50 and (~near).sum() > 50
        assert not (valid & hit).any(), name
        # Conservative by the spheres' overhang: what stays 12 mm farther away than the margin is not refused.
        assert (valid | near | own).mean() > 0.995, name


def test_what_stands_under_and_beside_the_base_is_no_obstacle_to_the_motion() -> None:
    """The base touches the table it is mounted on, and leaves hang on it: no path changes that."""
    robot = robot_named()
    rows = near_configurations(robot, np.random.default_rng(6), 100, np.array([0.45, 0.0, 0.5]), 0.3)
    base = next(link for link in robot.links if link.joint == 0)
    surface = base.vertices[base.vertices[:, 2] < 0.1]
    beside = surface + 0.006 * surface / np.linalg.norm(surface, axis=1, keepdims=True) * [1.0, 1.0, 0.0]
    bare, table = obstacles_of(scene_of()), [-0.5, -0.5, -0.5, 0.5, 0.5, float(base.vertices[:, 2].min()) - 0.002]
    crowded = obstacles_of(scene_of((), beside), keep_out_boxes=table)
    assert crowded.exact_checker().leaf_contact(rows[0])
    free = evaluated(bare, rows) >= 0.0
    away = np.array([crowded.exact_checker().stem_hit(q) is None for q in rows]) & free
    assert away.sum() > 30
    assert (evaluated(crowded, rows)[away] == 0.0).mean() > 0.9


def test_the_exclusion_sphere_spares_the_gripper_in_the_zone_only() -> None:
    """Configurations around a target deep in a scan: the fast model never spares what the exact check does not."""
    scene = scene_named("scan")
    rng = np.random.default_rng(8)
    target = scene.stem_points[len(scene.stem_points) // 2].astype(float)
    rows = near_configurations(robot_named(ARMS[0]), rng, 1500, target, 0.16)
    plain = obstacles_of(scene, target, target_exclusion_radius_m=0.0)
    spared = obstacles_of(scene, target, target_exclusion_radius_m=0.12, approach_zone_m=0.08)
    without, with_sphere = measured(plain, rows)[:, 0], measured(spared, rows)[:, 0]
    checker = spared.exact_checker()
    hits = [checker.stem_hit(q) for q in rows]
    touching = np.array([hit is not None and hit.what == "stem" for hit in hits])
    own = np.array([hit is not None and hit.what == "self" for hit in hits])
    assert not ((with_sphere > MODEL_ERROR_M) & touching).any()
    assert not ((with_sphere < -0.002) & ~touching & ~own).any()
    zone = np.linalg.norm([robot_named(ARMS[0]).forward(q)[:3, 3] - target for q in rows], axis=1) <= 0.08
    helped = (with_sphere > without + 0.002) & (without < 0.02)
    assert helped.sum() > 20
    assert zone[helped].all()
    assert (with_sphere >= np.minimum(without, 0.02) - 1e-9).all()  # beyond, both are lower bounds
    # Only the hand: a point on the forearm counts whatever the sphere.
    q = rows[np.flatnonzero(zone)[0]]
    link = next(link for link in robot_named(ARMS[0]).links if link.name.endswith("link_4"))
    pose = robot_named(ARMS[0]).link_poses(q)[link.joint]
    inside = pose[:3, :3] @ link.vertices[0] + pose[:3, 3]
    tool = robot_named(ARMS[0]).forward(q)[:3, 3]
    one = obstacles_of(scene_of([inside]), tool, target_exclusion_radius_m=0.5, approach_zone_m=1.0)
    assert measured(one, q[None])[0, 0] < 0.0
    assert one.exact_checker().stem_hit(q) is not None


def test_less_clearance_is_required_near_anchors_only() -> None:
    rows, obstacles, _, fast, _, _, _ = case(ARMS[0], "scan")
    tight = np.flatnonzero((fast[:, 0] > 0.0015) & (fast[:, 0] < 0.004) & (fast[:, 1] > 0.003))[:5]
    assert len(tight) == 5
    anchor, need = rows[tight[0]], fast[tight[0], 0] - 0.0004
    anchored = obstacles.with_anchors(anchor[None], np.array([need]))
    told = evaluated(anchored, rows[tight])
    assert told[0] >= 0.0
    assert (told[1:] == -1.0).all()
    world, slope = anchored.world, anchored.world.slope
    assert required(world, anchor) == pytest.approx(need)
    rng = np.random.default_rng(0)
    for distance in (0.0, 0.01, 0.05, 0.1, 0.3, 3.0):
        direction = rng.normal(size=6)
        q = anchor + distance * direction / np.linalg.norm(direction)
        assert required(world, q) == pytest.approx(min(world.margin, need + slope * distance))
        space = anchored.measuring_space()  # measuring is not subject to anchors
        measure(space, q)
        assert space.state.misc[NEED] > world.margin
    assert required(obstacles.world, anchor) == obstacles.world.margin == pytest.approx(MARGIN_M)


def test_spaces_of_two_threads_do_not_disturb_each_other() -> None:
    from concurrent.futures import ThreadPoolExecutor

    rows, obstacles, _, _, _, _, _ = case(ARMS[0], "plant")
    once = evaluated(obstacles, rows)
    with ThreadPoolExecutor(4) as pool:
        for again in pool.map(lambda _: evaluated(obstacles, rows), range(8)):
            np.testing.assert_array_equal(again, once)


def test_shapes_come_from_the_cache_unchanged() -> None:
    from lime_planner.collision.link_shapes import build_shapes

    one, two = pipeline_of().shapes, build_shapes(robot_named())
    for name in one._fields:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
