"""Grasp poses on limes and in foliage: where they are, where they point, what is in the way."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lime_planner.core.errors import ProblemError, SceneError
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.scene.plants.generator import USUAL_DENSITIES, PlantOptions, generate_plant
from lime_planner.scene.plants.grasp_targets import approach_directions, canopy_targets, grasp_pose, lime_targets
from lime_planner.scene.scene import Scene


def angle_to_ray(pose, base=(0.0, 0.0, 0.0)):
    ray = pose[:3] - np.asarray(base)
    return np.arccos(np.clip(pose_to_matrix(pose)[:3, 2] @ ray / np.linalg.norm(ray), -1.0, 1.0))


def test_directions_fill_the_cap_and_stay_in_it(rng):
    directions = approach_directions(rng, (0.5, 0.2, 0.6), 4000, base_position=(0.0, 0.0, 0.3))
    ray = np.array([0.5, 0.2, 0.3]) / np.linalg.norm([0.5, 0.2, 0.3])
    cosine = directions @ ray
    assert cosine.min() >= np.cos(np.pi / 4) - 1e-12
    # Even over the cap means: the cosine is uniform.
    assert abs(cosine.mean() - (1 + np.cos(np.pi / 4)) / 2) < 0.005


def test_a_grasp_pose_points_the_tools_z_along_the_approach():
    matrix = pose_to_matrix(grasp_pose((1.0, 2.0, 3.0), (0.0, 0.6, -0.8), 0.4))
    np.testing.assert_allclose(matrix[:3, 2], [0.0, 0.6, -0.8], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3], [1.0, 2.0, 3.0])
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"direction": (0, 0, 0)}, "direction must have a length of at least 1e-06, got (0, 0, 0)"),
        ({"direction": (1e-9, 0, 0)}, "direction must have a length of at least 1e-06"),
        ({"direction": (np.nan, 0, 1)}, "direction must be 3 finite numbers, got (nan, 0, 1)"),
        ({"direction": "ahead"}, "direction must be numbers, got 'ahead'"),
        ({"direction": (1, 0, 0, 0)}, "direction must be 3 finite numbers"),
        ({"position": (0.5, 0.1)}, "position must be 3 finite numbers, got (0.5, 0.1)"),
        ({"position": (0.5, np.nan, 0.1)}, "position must be 3 finite numbers"),
        ({"roll_rad": np.inf}, "roll_rad must be a finite angle, got inf"),
        ({"roll_rad": [0.0]}, "roll_rad must be a finite angle, got [0.0]"),
    ],
)
def test_what_is_no_grasp_is_named(given, words):
    with pytest.raises(ProblemError) as refused:
        grasp_pose(**{"position": (0.5, 0.0, 0.5), "direction": (1.0, 0.0, 0.0), **given})
    assert str(refused.value).startswith(words)


def test_directions_of_any_length_point_the_same_way():
    for length in (2e-6, 3.0, 1e300):
        np.testing.assert_allclose(grasp_pose((0, 0, 0), (0.0, length, 0.0)), grasp_pose((0, 0, 0), (0.0, 1.0, 0.0)), atol=1e-12)


@pytest.mark.parametrize("density", USUAL_DENSITIES)
@pytest.mark.parametrize("seed", range(3))
def test_the_plants_target_is_a_lime_among_leaves_approached_from_the_robot(density, seed):
    scene = generate_plant(np.random.default_rng(seed), PlantOptions(density=density))
    pose = scene.target_pose
    centres = scene.fruit_centres.astype(np.float64)
    lime = np.linalg.norm(centres - pose[:3], axis=1).argmin()
    assert np.linalg.norm(centres[lime] - pose[:3]) < 1e-6
    assert angle_to_ray(pose) <= np.pi / 4 + 1e-6
    near = cKDTree(scene.leaf_points).query_ball_point(pose[:3], 0.10)
    assert len(np.unique(scene.leaf_ids[near])) >= 4
    # On the way in, 3 to 20 cm before the lime and 5 cm to each side: leaves, and at most a few points of a twig.
    way = pose_to_matrix(pose)[:3, 2]
    for points, low, high in ((scene.leaf_points, 15, 1e9), (scene.stem_points, 0, 5)):
        back = (pose[:3] - points) @ way
        aside = np.linalg.norm(pose[:3] - points - back[:, None] * way, axis=1)
        assert low <= ((back > 0.03) & (back < 0.2) & (aside < 0.05)).sum() <= high
    # It is the target's lime that does not count as an obstacle, no other.
    radius = scene.fruit_radii[lime]
    solid = scene.impermeable_points(pose[:3], 0.06)
    fruit = solid[len(scene.stem_points) :]
    assert np.linalg.norm(fruit - pose[:3], axis=1).min(initial=np.inf) > radius
    of_this = np.linalg.norm(scene.fruit_points - pose[:3], axis=1) < radius + 0.004
    assert len(fruit) == len(scene.fruit_points) - of_this.sum()


def test_every_lime_has_a_target():
    scene = generate_plant(np.random.default_rng(9), PlantOptions(n_limes=10))
    poses = lime_targets(scene, np.random.default_rng(1))
    assert len(poses) == len(scene.fruit_centres) == 10
    for pose, centre in zip(poses, scene.fruit_centres, strict=True):
        np.testing.assert_allclose(pose[:3], centre, atol=1e-7)
        assert angle_to_ray(pose) <= np.pi / 4 + 1e-6
    np.testing.assert_array_equal(poses, lime_targets(scene, np.random.default_rng(1)))


def test_a_plant_without_limes_has_no_target():
    scene = generate_plant(np.random.default_rng(9), PlantOptions(n_limes=0, density="sparse"))
    assert scene.target_pose is None
    assert lime_targets(scene, np.random.default_rng(0)) == []
    with pytest.raises(SceneError, match="fruit_centres"):
        lime_targets(Scene.from_points(np.eye(3), [0, 0, 0]), np.random.default_rng(0))


def test_targets_in_a_real_canopy_keep_the_rule(shared_data):
    for path in sorted(shared_data.glob("*.npz")):
        scene = Scene.load(path, scale=24.0 if "seedling" in path.name else 1.0, offset=(0.55, 0.0, 0.05))
        poses = canopy_targets(scene, np.random.default_rng(0), 5)
        stems = cKDTree(scene.stem_points)
        low, high = np.quantile(scene.leaf_points, (0.2, 0.8), axis=0)
        for pose in poses:
            assert stems.query(pose[:3])[0] >= 0.03
            assert cKDTree(scene.leaf_points).query(pose[:3])[0] < 1e-6
            assert (pose[:3] >= low - 1e-6).all()
            assert (pose[:3] <= high + 1e-6).all()
            assert angle_to_ray(pose) <= np.pi / 4 + 1e-6


def test_a_canopy_without_room_is_named():
    points = np.random.default_rng(0).uniform(0, 0.1, (200, 3))
    with pytest.raises(SceneError, match=r"0\.03 m away from every stem"):
        canopy_targets(Scene.from_points(np.tile(points, (2, 1)), [0] * 200 + [1] * 200), np.random.default_rng(0), 3)
    with pytest.raises(SceneError, match="no leaf points"):
        canopy_targets(Scene.from_points(points, [1] * 200), np.random.default_rng(0), 3)
