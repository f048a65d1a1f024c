"""The generated plant: the same from the same seed, as large as asked, and true to its ground truth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lime_planner.core.errors import ParameterError
from lime_planner.scene.plants.generator import DENSITIES, PlantOptions, generate_plant
from lime_planner.scene.plants.leaves import FACES
from lime_planner.scene.plants.surface import on_cones, triangle_areas
from lime_planner.scene.scene import Scene

SEEDS = range(4)


def plant(seed=0, **options):
    return generate_plant(np.random.default_rng(seed), PlantOptions(**options))


def test_the_same_seed_gives_the_same_plant_and_another_seed_another():
    one, two, other = plant(11), plant(11), plant(12)
    for field in dataclasses.fields(Scene):
        a, b = getattr(one, field.name), getattr(two, field.name)
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(one.fruit_centres, other.fruit_centres)


@pytest.mark.parametrize("density", DENSITIES)
def test_density_sets_the_leaves_and_the_default_fills_the_budget(density):
    for seed in SEEDS:
        scene = plant(seed, density=density)
        n_leaves = DENSITIES[density][0]
        assert len(np.unique(scene.leaf_triangle_ids)) == n_leaves
        assert len(np.unique(scene.leaf_ids)) == n_leaves
        assert len(scene.fruit_centres) == 8
        assert 5_000 < len(scene.stem_points) < 9_000
        if density == "medium":
            assert 50_000 < len(scene.leaf_points) < 70_000


def test_number_of_leaves_and_limes_and_size_can_be_chosen():
    scene = plant(1, n_leaves=33, n_limes=2, position_m=(1.0, 0.5, 0.1), height_m=1.4, trunk_m=0.4, radius_m=0.4)
    assert scene.leaf_triangle_ids.max() == 32
    assert len(scene.fruit_centres) == 2
    everything = np.concatenate([scene.leaf_points, scene.stem_points, scene.fruit_points])
    low, high = everything.min(axis=0), everything.max(axis=0)
    assert low[2] == pytest.approx(0.1, abs=0.02)
    assert 1.2 < high[2] < 1.65
    assert (np.abs(everything[:, :2] - [1.0, 0.5]) < 0.4 + 0.12).all()


def distance_to_triangles(points, triangles):
    """Exact distance from each point (N, 3) to its own triangle (N, 3, 3), by projection and the three edges."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-18)
    height = ((points - a) * normal).sum(axis=1)
    foot = points - height[:, None] * normal
    inside = np.ones(len(points), dtype=bool)
    nearest = np.full(len(points), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        edge = q - p
        inside &= (np.cross(edge, foot - p) * normal).sum(axis=1) >= 0.0
        t = np.clip(((points - p) * edge).sum(axis=1) / (edge * edge).sum(axis=1), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - p - t[:, None] * edge, axis=1))
    return np.where(inside, np.abs(height), nearest)


def test_every_leaf_point_lies_on_its_own_leaf():
    scene = plant(3, density="sparse", noise_m=0.0005)
    triangles = scene.leaf_triangles.astype(np.float64).reshape(-1, len(FACES), 3, 3)
    assert (scene.leaf_triangle_ids.reshape(-1, len(FACES)) == np.arange(len(triangles))[:, None]).all()
    points = scene.leaf_points.astype(np.float64)
    nearest = np.min([distance_to_triangles(points, triangles[scene.leaf_ids, k]) for k in range(len(FACES))], axis=0)
    assert nearest.max() < 3.0 * np.sqrt(3.0) * 0.0005 + 1e-6


def test_leaves_have_the_size_of_leaves_and_are_covered_evenly():
    scene = plant(4)
    corners = scene.leaf_triangles.reshape(-1, len(FACES) * 3, 3)[:, : 12 * 3]  # without the petiole
    length = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=-1).max(axis=(1, 2))
    assert length.min() > 0.045
    assert length.max() < 0.091
    areas = triangle_areas(scene.leaf_triangles).reshape(-1, len(FACES)).sum(axis=1)
    points = np.bincount(scene.leaf_ids, minlength=len(areas))
    np.testing.assert_allclose(points, areas * 150_000.0, rtol=0.05, atol=4)
    # Evenly: no triangle's middle is far from a point.
    centroids = scene.leaf_triangles.mean(axis=1)
    assert cKDTree(scene.leaf_points).query(centroids)[0].max() < 0.007


def test_limes_are_limes_and_hang_free():
    for seed in SEEDS:
        scene = plant(seed, density="dense", n_limes=12)
        centres, radii = scene.fruit_centres.astype(np.float64), scene.fruit_radii
        assert (2 * radii >= 0.04).all()
        assert (2 * radii <= 0.05).all()
        gaps = np.linalg.norm(centres[:, None] - centres[None], axis=2) - radii[:, None] - radii[None]
        assert gaps[~np.eye(len(centres), dtype=bool)].min() > 0.003
        # Only the pedicel's end touches the lime: a cap at its top.
        tree = cKDTree(scene.stem_points)
        for centre, radius in zip(centres, radii, strict=True):
            for index in tree.query_ball_point(centre, radius - 0.002):
                raise AssertionError(f"wood at {scene.stem_points[index]} inside the lime at {centre}")
            near = scene.stem_points[tree.query_ball_point(centre, radius + 0.015)]
            assert len(near), "a lime without a pedicel"
            assert near[:, 2].max() > centre[2] + 0.7 * radius
        on_surface = np.abs(np.linalg.norm(scene.fruit_points[:, None] - centres[None], axis=2) - radii).min(axis=1)
        assert on_surface.max() < 0.003
        assert (centres[:, 0] < 0.62).mean() >= 0.5, "most limes hang on the robot's side"


def test_no_leaf_corner_is_inside_a_lime():
    for seed in SEEDS:
        scene = plant(seed, density="dense")
        corners = scene.leaf_triangles.reshape(-1, 3).astype(np.float64)
        depth = np.linalg.norm(corners[:, None] - scene.fruit_centres[None], axis=2) - scene.fruit_radii
        assert (depth < 0.0).any(axis=1).mean() < 1e-3


def test_the_wood_is_one_piece():
    # Linked by steps of 12 mm from the trunk's foot, every stem point is reached.
    scene = plant(6)
    tree = cKDTree(scene.stem_points)
    seen = np.zeros(len(scene.stem_points), dtype=bool)
    front = [int(scene.stem_points[:, 2].argmin())]
    while front:
        seen[front] = True
        linked = np.unique(np.concatenate([np.array(n) for n in tree.query_ball_point(scene.stem_points[front], 0.012)]))
        front = linked[~seen[linked]].astype(int).tolist()
    assert seen.mean() > 0.995


def test_cones_are_sampled_on_their_mantle(rng):
    starts, ends = rng.normal(0, 0.1, (5, 3)), rng.normal(0, 0.1, (5, 3))
    radii = np.tile([0.004, 0.002], (5, 1))
    points = on_cones(rng, starts, ends, radii, 200_000.0)
    along = (ends - starts) / np.linalg.norm(ends - starts, axis=1, keepdims=True)
    offset = points[:, None] - starts
    t = (offset * along).sum(axis=2)
    aside = np.linalg.norm(offset - t[..., None] * along, axis=2)
    length = np.linalg.norm(ends - starts, axis=1)
    wanted = 0.004 - 0.002 * t / length
    on_any = (np.abs(aside - wanted) < 1e-9) & (t > -1e-9) & (t < length + 1e-9)
    assert on_any.any(axis=1).all()


@pytest.mark.parametrize(
    "change",
    [
        {"density": "jungle"},
        {"n_leaves": 0},
        {"n_limes": -1},
        {"height_m": 9.0},
        {"trunk_m": 0.85},
        {"radius_m": 0.0},
        {"leaf_length_m": (0.09, 0.05)},
        {"lime_diameter_m": (0.0, 0.05)},
        {"noise_m": -1.0},
        {"leaf_points_per_m2": 0.0},
    ],
)
def test_options_out_of_range_are_named(change):
    with pytest.raises(ParameterError, match=next(iter(change))):
        PlantOptions(**change)
