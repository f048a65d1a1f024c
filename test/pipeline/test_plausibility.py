"""Scenes, targets and starts in another unit, axis or frame than the planner's are told so, and what is right is left alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arm_helpers import OFFSET, plant, robot_named, scan_files

from lime_planner.core.geometry import pose_to_matrix, quaternion_doubt
from lime_planner.pipeline.plausibility import doubts_about
from lime_planner.scene.scene import Scene

TARGET = pose_to_matrix([0.5, 0.1, 0.5, 0.0, 0.7071, 0.0, 0.7071])


def changed(scene: Scene, change: np.ndarray | float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scene:
    """A scene with its points scaled or turned."""
    matrix = np.eye(3) * change if np.isscalar(change) else np.asarray(change)
    parts = {
        name: (getattr(scene, name).astype(float) @ matrix.T + offset).astype(np.float32)
        for name in ("leaf_points", "stem_points", "fruit_points")
    }
    return dataclasses.replace(scene, target_pose=None, **parts)


def doubts(scene: Scene, target: np.ndarray = TARGET, start: object = None) -> tuple[str, ...]:
    robot = robot_named()
    return doubts_about(scene, robot, target[:3, 3], robot.home if start is None else np.asarray(start, float))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("density", ["sparse", "medium", "dense"])
def test_plants_as_they_should_be_raise_no_doubt(seed: int, density: str) -> None:
    assert doubts(plant(seed, density)) == ()


def test_real_scans_raise_no_doubt() -> None:
    for path in scan_files():
        scale = 24.0 if "seedling" in path.name else 1.0
        assert doubts(Scene.load(path, scale=scale, offset=OFFSET)) == (), path.name


@pytest.mark.parametrize(
    ("factor", "offset", "words"),
    [
        (1000.0, (0, 0, 0), "is that in millimetres?"),
        (100.0, (0, 0, 0), "is that in centimetres, or in another frame?"),
        (1.0, (3.0, 0, 0), "move it with --offset?"),
        (1.0, (30.0, 0.0, 0), "is that in the frame of the arm's base? move it with --offset"),
        (1.0, (500_000.0, 4_000_000.0, 100.0), "is that in the frame of the arm's base? move it with --offset"),
    ],
)
def test_scenes_out_of_reach(factor: float, offset: tuple[float, float, float], words: str) -> None:
    found = doubts(changed(plant(), factor, offset))
    assert len(found) == 1 and found[0].startswith("none of the scene's 71754 points is within the arm's reach of ")
    assert words in found[0]


def test_a_scan_in_millimetres_around_the_arm() -> None:
    scene = changed(plant(), 1000.0)
    centre = np.concatenate([scene.stem_points, scene.leaf_points]).mean(axis=0)
    (found,) = doubts(changed(scene, 1.0, tuple(-centre)))
    assert "is that in millimetres?" in found


def test_a_background_is_no_reason_to_doubt() -> None:
    scene = plant()
    wall = np.random.default_rng(0).uniform(-60.0, 60.0, (50_000, 3)).astype(np.float32)
    points = np.concatenate([scene.stem_points, scene.leaf_points, wall])
    labels = np.repeat([1, 0, 1], [len(scene.stem_points), len(scene.leaf_points), len(wall)])
    assert doubts(Scene.from_points(points, labels, frame_id="base")) == ()


@pytest.mark.parametrize("seed", range(4))
def test_a_plant_that_lies_on_its_side(seed: int) -> None:
    turned = changed(plant(seed), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))  # y up: x, z, -y
    (found,) = doubts(turned)
    assert "is the scene y-up?" in found


def test_labels_that_nobody_named() -> None:
    points = plant().stem_points
    scene = Scene.from_points(points, np.full(len(points), 7), frame_id="base")
    (found,) = doubts(scene)
    assert found == f"all {len(points)} points have labels that are not named, and count as stems: set leaf_labels and stem_labels"
    mixed = Scene.from_points(points, np.arange(len(points)) % 2, frame_id="base")
    assert doubts(mixed) == ()


def test_targets_and_starts() -> None:
    far = TARGET.copy()
    far[:3, 3] *= 1000.0
    (found,) = doubts(plant(), far)
    assert found.startswith("the target is 714.1 m away, the arm reaches ") and found.endswith("is that in millimetres?")
    scene, there = changed(plant(), 1.0, (30.0, 0.0, 0.0)), TARGET.copy()
    there[0, 3] += 30.0
    about_target, about_scene = doubts(scene, there)
    assert about_target.startswith("the target is 30.5 m away with its scene, the arm reaches ") and "metres" not in about_target
    assert about_scene.startswith("none of the scene's") and "metres" not in about_scene
    (found,) = doubts(plant(), start=[275.0, 167.0, 57.0, 241.0, 83.0, 75.0])
    assert found == "the start is 275, 167, 57, 241, 83, 75 rad, 44 turns: is it in degrees?"
    assert doubts(plant(), start=[4.8 + 2 * np.pi, 2.9, 1.0, 4.2, 1.4, 1.3]) == ()


def test_quaternions_far_from_unit_length() -> None:
    for pose in ([0, 0, 0, 0, 0.7071, 0, 0.7071], [0, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0.71, 0, 0, 0.71]):
        assert quaternion_doubt(pose) == ""
    assert quaternion_doubt([0, 0, 0, 0, 0, 0, 40]).startswith("the quaternion 0 0 0 40 has the length 40, not 1")
    assert "length 1.73" in quaternion_doubt([0, 0, 0, 1, 1, 0, 1])
    assert "1e+200" in quaternion_doubt([0, 0, 0, 0, 0, 0, 1e200])
