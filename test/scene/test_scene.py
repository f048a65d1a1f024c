"""The scene: sorting labelled points, what is impermeable, moving it."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from lime_planner.core.errors import SceneError
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.plants.surface import on_spheres
from lime_planner.scene.scene import Scene
from lime_planner.scene.voxels import linked


def limes(*centres, radius=0.0225):
    rng = np.random.default_rng(0)
    points = on_spheres(rng, np.array(centres, dtype=float), np.full(len(centres), radius), 100_000.0)
    return Scene.from_points(points, np.full(len(points), 2)), np.array_split(points, len(centres))


@settings(max_examples=60, deadline=None)
@given(
    labels=st.lists(st.integers(-3, 260), max_size=40),
    leaf=st.lists(st.integers(-3, 5), max_size=3),
    stem=st.lists(st.integers(-3, 5), max_size=3),
    ignored=st.lists(st.integers(-3, 5), max_size=3),
    fruit=st.none() | st.integers(-3, 5),
)
def test_every_finite_point_is_in_one_class_and_nothing_unknown_is_permeable(labels, leaf, stem, ignored, fruit):
    points = np.arange(3.0 * len(labels)).reshape(-1, 3)
    if len(points) > 2:
        points[1, 2] = np.nan
    classes = {"leaf_labels": leaf, "stem_labels": stem, "fruit_labels": () if fruit is None else (fruit,), "ignored_labels": ignored}
    if fruit == 2 and 2 in {*leaf, *stem, *ignored}:
        fruit = None  # the default gives way
    named = [*set(leaf), *set(stem), *set(ignored), *([] if fruit is None else [fruit])]
    if len(set(named)) < len(named):
        with pytest.raises(SceneError, match="a class has one meaning"):
            Scene.from_points(points, labels, **classes)
        return
    scene = Scene.from_points(points, labels, **classes)
    counts = scene.counts
    assert counts["received"] == len(labels) == scene.n_points + counts["non_finite"] + counts["ignored"]
    by_x = {float(p[0]): label for p, label in zip(points, labels, strict=True)}
    for x in scene.leaf_points[:, 0]:
        assert by_x[float(x)] in leaf
        assert by_x[float(x)] not in {*stem, *ignored, fruit}
    for x in scene.stem_points[:, 0]:
        assert by_x[float(x)] in stem or by_x[float(x)] not in {*leaf, *ignored, fruit}


def test_the_default_fruit_gives_way_and_other_labels_have_one_meaning():
    scene = Scene.from_points(np.eye(3), [2, 1, 2], leaf_labels=[2])
    assert (len(scene.leaf_points), len(scene.stem_points), len(scene.fruit_points)) == (2, 1, 0)
    assert len(Scene.from_points(np.eye(3), [2, 1, 2]).fruit_points) == 2
    with pytest.raises(SceneError, match=r"^leaf_labels and stem_labels share 1; a class has one meaning$"):
        Scene.from_points(np.eye(3), [0, 1, 2], leaf_labels=[0, 1])
    with pytest.raises(SceneError, match=r"^leaf_labels and fruit_labels share 7;"):
        Scene.from_points(np.eye(3), [0, 1, 7], leaf_labels=[7], fruit_labels=[7])


def test_a_third_class_with_a_price_is_permeable_and_prices_multiply():
    points, cost = np.arange(15.0).reshape(5, 3), [1.0, 2.0, 2.0, 4.0, 1.0]
    scene = Scene.from_points(points, [0, 0, 5, 5, 1], permeability_cost=cost, class_costs=["5: 0.25"])
    assert scene.leaf_points[:, 0].tolist() == [0, 3, 6, 9] and scene.leaf_costs.tolist() == [1.0, 2.0, 0.5, 1.0]
    assert scene.stem_points[:, 0].tolist() == [12] and scene.counts["unknown_label"] == 0
    plain, dear = (Scene.from_points(points, [0, 0, 5, 5, 1], class_costs=prices) for prices in ({}, {0: 3.0, 5: 0.0}))
    assert plain.leaf_costs.tolist() == [1.0, 1.0] and dear.leaf_costs.tolist() == [3.0, 3.0, 0.0, 0.0]
    assert len(Scene.from_points(points, [0, 1, 2, 2, 2], class_costs={2: 0.5}).fruit_points) == 0  # the default fruit gives way


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (["5"], "'5' must be a label, a colon and a price"),
        (["five: 1"], "'five: 1' must be a whole number and a price"),
        (["5: nan"], "the price in '5: nan' must lie between 0 and 1e"),
        (["5: -1"], "the price in '5: -1' must lie between"),
        (["5: 1", "5: 2"], "label 5 has two prices, 1 and 2"),
        (["1: 0.5"], "stem_labels and class_costs share 1; a class has one meaning"),
        ({1.5: 1.0}, "'1.5: 1.0' must be a whole number"),
    ],
)
def test_a_wrong_price_is_named(rows, words):
    with pytest.raises(SceneError, match=words):
        Scene.from_points(np.eye(3), [0, 1, 5], class_costs=rows)


def test_unknown_labels_and_stakes_are_impermeable_and_counted():
    scene = Scene.from_points(np.eye(3), [0, 7, 9], ignored_labels=(9,), stake_points=[[1.0, 1.0, 1.0], [np.inf, 0.0, 0.0]])
    assert scene.leaf_points.tolist() == [[1, 0, 0]]
    assert scene.stem_points.tolist() == [[0, 1, 0], [1, 1, 1]]
    assert scene.counts == {"received": 5, "non_finite": 1, "ignored": 1, "unknown_label": 1}


def test_costs_follow_their_leaf_points():
    scene = Scene.from_points(np.eye(3), [1, 0, 0], permeability_cost=[-5.0, 2.0, 0.5])
    assert scene.leaf_costs.tolist() == [2.0, 0.5]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"points": np.zeros((3, 2))}, "points: shape"),
        ({"points": [["a", "b", "c"]] * 3}, "points: of type <U1, expected numbers"),
        ({"labels": [0, 1]}, "labels: shape"),
        ({"labels": [0.5, 1.0, 1.0]}, "whole numbers"),
        ({"labels": [np.nan, 1.0, 1.0]}, "whole numbers"),
        ({"labels": ["a", "b", "c"]}, "expected integers"),
        ({"permeability_cost": [-1.0, 1.0, 1.0]}, "below its limit 0"),
        ({"permeability_cost": [np.nan, 1.0, 1.0]}, "not finite"),
        ({"permeability_cost": [1.0]}, "permeability_cost: shape"),
        ({"target_pose": [0, 0, 0, 0, 0, 0, 0]}, "quaternion"),
        ({"target_pose": [0, 0, np.nan, 0, 0, 0, 1]}, "target_pose: 1 numbers are not finite"),
        ({"target_pose": [0, 0, 0]}, "target_pose: shape"),
        ({"leaf_ids": [1]}, "leaf_ids: shape"),
    ],
)
def test_what_does_not_fit_is_named(change, named):
    good = {"points": np.eye(3), "labels": [0, 0, 1]}
    with pytest.raises(SceneError, match=named):
        Scene.from_points(**{**good, **change})


def test_a_scene_cannot_be_changed_and_does_not_follow_the_callers_array():
    points = np.eye(3, dtype=np.float32)
    scene = Scene(points, np.ones(3, dtype=np.float32), points, points)
    points[:] = 9.0
    assert scene.leaf_points.max() == 1.0
    with pytest.raises(ValueError, match="read-only"):
        scene.stem_points[0, 0] = 5.0
    assert pickle.loads(pickle.dumps(scene)).stem_points.tolist() == scene.stem_points.tolist()


def test_only_the_targets_lime_is_let_go():
    scene, (first, second) = limes((0.5, 0.0, 0.5), (0.5, 0.08, 0.5))
    kept = scene.impermeable_points((0.5, 0.0, 0.5), 0.06)
    assert len(kept) == len(second)
    assert np.allclose(kept[:, 1].mean(), 0.08, atol=1e-3)
    assert len(scene.impermeable_points(None, 0.06)) == len(first) + len(second)
    assert len(scene.impermeable_points((0.5, 0.0, 0.7), 0.06)) == len(first) + len(second)


def test_a_tool_that_stops_before_the_lime_lets_all_of_it_go():
    scene, _ = limes((0.5, 0.0, 0.5))
    assert len(scene.impermeable_points((0.46, 0.0, 0.5), 0.06)) == 0


def test_a_lime_that_touches_the_targets_stays_but_for_a_sliver():
    scene, (first, second) = limes((0.5, 0.0, 0.5), (0.5, 0.0455, 0.5))
    kept = scene.impermeable_points((0.5, 0.0, 0.5), 0.06)
    assert 0.8 * len(second) < len(kept) <= len(second)
    assert (np.linalg.norm(kept - [0.5, 0.0, 0.5], axis=1) >= 0.0295).all()
    assert len(first) > 0


def test_linked_points_are_those_of_one_cluster():
    rng = np.random.default_rng(0)
    for _ in range(100):
        points = (rng.uniform(-0.1, 0.1, (int(rng.integers(1, 300)), 3)) * rng.uniform(0.2, 1.5)).astype(np.float32)
        seed = int(rng.integers(len(points)))
        near = ((points[:, None].astype(np.float64) - points[None]) ** 2).sum(axis=2) <= 0.012**2
        clusters = connected_components(near)[1]
        assert (linked(points, seed, 0.012) == (clusters == clusters[seed])).all()


def test_a_fruit_of_very_many_points_is_let_go_as_one_of_few():
    """A camera at close range sees a lime in tens of thousands of points."""
    rng = np.random.default_rng(0)
    around = rng.normal(size=(300_000, 3))
    lime = 0.023 * around / np.linalg.norm(around, axis=1)[:, None] + [0.5, 0.0, 0.5]
    other = lime + [0.0, 0.08, 0.0]
    scene = Scene.from_points(np.vstack([lime, other]), np.full(600_000, 2), frame_id="base")
    kept = scene.impermeable_points((0.5, 0.0, 0.5), 0.06)
    assert len(kept) == 300_000 and kept[:, 1].min() > 0.05


def test_moving_a_plant_takes_everything_along():
    plant = generate_plant(np.random.default_rng(3), PlantOptions(density="sparse"))
    moved = plant.moved((0.1, -0.2, 0.3))
    for name in ("leaf_points", "stem_points", "fruit_points", "leaf_triangles", "fruit_centres"):
        np.testing.assert_allclose(getattr(moved, name), getattr(plant, name) + np.float32([0.1, -0.2, 0.3]), atol=1e-6)
    np.testing.assert_allclose(moved.target_pose[:3], plant.target_pose[:3] + np.array([0.1, -0.2, 0.3]))
    np.testing.assert_array_equal(moved.target_pose[3:], plant.target_pose[3:])
    np.testing.assert_array_equal(moved.leaf_ids, plant.leaf_ids)


@pytest.mark.parametrize(("scale", "offset"), [(0.0, (0, 0, 0)), (np.nan, (0, 0, 0)), (1.0, (0, np.inf, 0)), (1.0, (0, 0))])
def test_a_bad_placement_is_refused(scale, offset):
    scene = Scene.from_points(np.eye(3), [0, 0, 1])
    with pytest.raises(SceneError):
        scene.placed(scale, offset)
