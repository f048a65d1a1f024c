"""Cleaning: what is dropped, what must never be, what thinning displaces, and how long it takes."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lime_planner.core.errors import SceneError
from lime_planner.scene.clean import clean_scene, remove_arm
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import Scene
from lime_planner.scene.voxels import displacement, lonely, thin, warm_up


@pytest.fixture(scope="module")
def plant():
    return generate_plant(np.random.default_rng(2), PlantOptions(density="medium"))


def rows(points):
    return {tuple(p) for p in points.tolist()}


@pytest.mark.parametrize("edge_m", [0.001, 0.004, 0.03])
def test_thinning_keeps_one_point_of_the_cloud_in_each_voxel(plant, edge_m):
    points = plant.leaf_points
    kept, stands_for = thin(points, edge_m)
    voxels = np.floor(points.astype(np.float64) / edge_m)
    assert len(kept) == len(np.unique(voxels, axis=0))
    np.testing.assert_array_equal(voxels[kept[stands_for]], voxels)
    offsets = np.linalg.norm(points.astype(np.float64) - points[kept[stands_for]].astype(np.float64), axis=1)
    assert displacement(points, kept, stands_for) == pytest.approx(offsets.max(), abs=1e-9)
    assert offsets.max() < np.sqrt(3.0) * edge_m


def test_lonely_points_have_few_neighbours_and_few_neighbours_at_twice_the_distance_are_lonely(rng):
    points = rng.uniform(-0.3, 0.3, (3000, 3)).astype(np.float32)
    found = lonely(points, 0.03, 4)
    tree = cKDTree(points)
    in_ball = tree.query_ball_point(points, 0.03, return_length=True) - 1
    in_block = tree.query_ball_point(points, 2 * np.sqrt(3.0) * 0.03, return_length=True) - 1
    assert found.sum() > 50
    assert (in_ball[found] < 4).all()
    assert found[in_block < 4].all()


def test_crop_counts_and_keeps_what_is_in_reach(plant):
    centre = np.array([0.0, 0.1, 0.2], dtype=np.float32)
    clean = clean_scene(plant, reach_m=0.7, base_position=centre, outlier_neighbours=0)
    for name in ("leaf_points", "stem_points", "fruit_points"):
        points = getattr(plant, name)
        inside = points[np.linalg.norm(points - centre, axis=1) <= 0.7]
        np.testing.assert_array_equal(getattr(clean, name), inside)
    assert clean.counts["cropped"] == plant.n_points - clean.n_points > 0
    assert clean.counts["received"] == plant.counts["received"]
    assert clean.stem_displacement_m == clean.leaf_displacement_m == 0.0
    np.testing.assert_array_equal(clean.target_pose, plant.target_pose)
    assert len(clean.leaf_ids) == len(clean.leaf_points)


def test_stray_leaf_points_go_and_a_thin_twig_stays():
    rng = np.random.default_rng(0)
    leaf = rng.uniform((0.5, 0.0, 0.5), (0.56, 0.04, 0.501), (500, 3))
    stray = np.array([[0.3, 0.3, 0.3], [0.2, -0.3, 0.6]])
    twig = np.stack([np.full(6, 0.4), np.linspace(-0.3, -0.1, 6), np.full(6, 0.8)], axis=1)
    scene = Scene.from_points(np.concatenate([leaf, stray, twig]), [0] * 502 + [1] * 6)
    clean = clean_scene(scene, reach_m=2.0)
    assert clean.counts["outliers"] == 2
    assert len(clean.leaf_points) == 500
    assert rows(clean.stem_points) == rows(scene.stem_points)


def test_no_stem_is_touched_while_there_are_few(plant):
    clean = clean_scene(plant, reach_m=5.0)
    assert rows(clean.stem_points) == rows(plant.stem_points)
    assert rows(clean.fruit_points) == rows(plant.fruit_points)
    assert clean.counts["thinned_stem"] == 0


def test_displacement_bounds_hold_where_thinning_was_needed(plant):
    clean = clean_scene(plant, reach_m=5.0, max_leaf_points=20_000, max_stem_points=4_000, outlier_neighbours=0)
    assert 0.0 < clean.stem_displacement_m < 0.003 * np.sqrt(3.0)
    assert 0.0 < clean.leaf_displacement_m < 0.01
    for name, bound in (("stem_points", clean.stem_displacement_m), ("leaf_points", clean.leaf_displacement_m)):
        before, after = getattr(plant, name), getattr(clean, name)
        assert len(after) < len(before)
        assert rows(after) <= rows(before)
        assert cKDTree(after).query(before)[0].max() <= bound + 1e-7
    assert len(clean.leaf_points) <= 22_000
    assert clean.counts["thinned_leaf"] == len(plant.leaf_points) - len(clean.leaf_points)
    assert clean.counts["thinned_stem"] == plant.n_points - len(plant.leaf_points) - len(clean.stem_points) - len(clean.fruit_points)
    again = clean_scene(clean, reach_m=5.0)  # what was displaced stays displaced
    assert again.stem_displacement_m == clean.stem_displacement_m


def test_a_thinned_leaf_point_is_as_costly_as_the_costliest_it_stands_for():
    points = np.array([[0.5, 0.0, 0.5]] * 4) + np.arange(4)[:, None] * 1e-5
    scene = Scene.from_points(points, [0] * 4, permeability_cost=[0.5, 3.0, 1.0, 0.0])
    clean = clean_scene(scene, reach_m=2.0, max_leaf_points=1, outlier_neighbours=0)
    assert clean.leaf_costs.tolist() == [3.0]


@pytest.mark.parametrize("change", [{"reach_m": 0.0}, {"reach_m": np.nan}, {"reach_m": 1e6}, {"reach_m": 1.0, "voxel_m": 0.0}])
def test_bad_limits_are_refused(plant, change):
    with pytest.raises(SceneError, match=list(change)[-1]):
        clean_scene(plant, **change)


def test_far_points_and_empty_scenes_are_no_trouble():
    scene = Scene.from_points([[1e30, 0.0, 0.0], [0.1, 0.0, 0.0]], [0, 1])
    clean = clean_scene(scene, reach_m=1.0)
    assert (len(clean.leaf_points), len(clean.stem_points)) == (0, 1)
    assert clean.counts["cropped"] == 1
    assert clean_scene(Scene.from_points(np.zeros((0, 3)), []), reach_m=1.0).n_points == 0


def to_a_box(points):
    """Distance from an arm that is a box of half sizes 5, 5, 20 cm about (0.3, 0, 0.4)."""
    outside = np.abs(points.astype(np.float64) - [0.3, 0.0, 0.4]) - [0.05, 0.05, 0.20]
    return np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)


def test_the_arm_is_removed_and_a_stem_15_mm_away_survives():
    points = np.array([[0.3, 0.0, 0.4], [0.365, 0.0, 0.4], [0.359, 0.0, 0.4], [0.3, 0.055, 0.5], [0.3, 0.2, 0.4], [0.3, 0.04, 0.59]])
    scene = Scene.from_points(points, [1, 1, 1, 0, 0, 2], permeability_cost=[1, 1, 1, 2, 3, 1])
    seen = remove_arm(scene, to_a_box, 0.01)
    np.testing.assert_allclose(seen.stem_points, [[0.365, 0.0, 0.4]])
    np.testing.assert_allclose(seen.leaf_points, [[0.3, 0.2, 0.4]])
    assert seen.leaf_costs.tolist() == [3.0]
    assert len(seen.fruit_points) == 0
    assert seen.counts["on_arm"] == 4
    with pytest.raises(SceneError, match="padding_m"):
        remove_arm(scene, to_a_box, -0.01)


def cloud(n):
    rng = np.random.default_rng(0)
    plant = generate_plant(rng, PlantOptions(density="dense", leaf_points_per_m2=100_000.0))
    source = np.concatenate([plant.leaf_points, plant.stem_points, plant.fruit_points])
    labels = np.repeat(np.array([0, 1, 2], dtype=np.uint8), [len(plant.leaf_points), len(plant.stem_points), len(plant.fruit_points)])
    pick = rng.integers(len(source), size=n)
    points = source[pick] + rng.normal(0.0, 0.001, (n, 3)).astype(np.float32)
    points[::1000] = np.nan
    return points, labels[pick]


def thin_by_sorting(points):
    """The plain way to thin once, with NumPy: a measure of how fast the machine is at such work right now."""
    cells = np.floor(points[np.isfinite(points).all(axis=1)] / 0.004).astype(np.int64)
    np.unique((cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2], return_index=True, return_inverse=True)


@pytest.mark.timed
@pytest.mark.parametrize("n", [100_000, 5_000_000])
def test_a_scene_is_cleaned_in_the_time_of_one_plain_thinning(n):
    """Points taken in, cropped, lonely ones dropped, thinned as often as it takes: about 1.2 times what NumPy takes to thin once."""
    points, labels = cloud(n)
    warm_up()
    ratios = []
    for _ in range(3):  # the machine is shared: the best of three
        begin = time.process_time()
        scene = clean_scene(Scene.from_points(points, labels), reach_m=1.2)
        cleaned = time.process_time()
        thin_by_sorting(points)
        ratios.append((cleaned - begin) / (time.process_time() - cleaned))
        if ratios[-1] < 2.0:
            break
    assert min(ratios) < 2.0
    assert scene.counts["non_finite"] == n // 1000
