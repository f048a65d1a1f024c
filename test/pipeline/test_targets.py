"""Targets: what is taken, and what is refused in a sentence."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from arm_helpers import settings

from lime_planner.core.errors import ProblemError
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.pipeline.spots import exclusion, hard_points, shown_radius_m, spared
from lime_planner.pipeline.targets import MAX_CANDIDATES, candidates_target, fruit_target, pose_target, target_from, target_of
from lime_planner.scene.scene import Scene

POSE = [0.5, 0.1, 0.4, 0.0, 0.7071, 0.0, 0.7071]


def candidates(count: int, **changed: Any) -> np.ndarray:
    poses = np.tile(np.array(POSE), (count, 1))
    for key, value in changed.items():
        poses[int(key[1:]) - 1, 4] = value
    return poses


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: candidates_target([]), "empty list"),
        (lambda: candidates_target(candidates(5000)), "5000 grasp candidates; at most 2000"),
        (lambda: candidates_target(candidates(12, n10=np.nan)), "grasp candidate 10 of 12"),
        (lambda: candidates_target([[0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 0.0]]), "grasp candidate 1 of 1.*length"),
        (lambda: candidates_target(np.zeros((3, 6))), r"shape \(P, 7\)"),
        (lambda: fruit_target([0.1, 0.2]), "3 finite numbers"),
        (lambda: fruit_target([0.1, np.inf, 0.3]), "3 finite numbers"),
        (lambda: fruit_target([0.5, 0.0, 0.5], 0.5), "radius is 0.5"),
        (lambda: pose_target(POSE, "any"), "freedom is 'any'.*exact, roll, cone"),
        (lambda: pose_target(POSE[:5]), "4 x 4"),
        (lambda: target_of(POSE[:5]), "3 numbers x y z .a fruit. or 7 numbers"),
        (lambda: target_of("there"), "numbers"),
    ],
)
def test_bad_targets_are_named(make: Any, words: str) -> None:
    with pytest.raises(ProblemError, match=words):
        make()


def test_shapes_say_what_an_array_is() -> None:
    assert target_of([0.5, 0.0, 0.4]).kind == "fruit"
    assert target_of(POSE, "roll").freedom == "roll"
    assert target_of(pose_to_matrix(POSE)).exact
    assert len(candidates_target(candidates(MAX_CANDIDATES)).poses) == MAX_CANDIDATES


@pytest.mark.parametrize("target", [fruit_target([0.5, 0.0, 0.4], 0.02), candidates_target(candidates(3)), pose_target(POSE, "cone")])
def test_a_target_is_read_as_it_was_written(target: Any) -> None:
    again = target_from({"target_pose": POSE, **target.origin()})
    assert again is not None
    assert (again.kind, again.freedom, again.radius_m) == (target.kind, target.freedom, target.radius_m)
    np.testing.assert_allclose(again.centre, target.centre, atol=1e-9)
    np.testing.assert_allclose(again.poses, target.poses, atol=1e-4)


def fruit_scene(radius_m: float = 0.022) -> tuple[Scene, np.ndarray]:
    """A fruit of which the front is seen, a branch 3 cm over it, and its stalk."""
    centre = np.array([0.6, 0.0, 0.5])
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(400, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ways[:, 0] = -np.abs(ways[:, 0])
    branch = centre + np.column_stack([np.zeros(21), np.linspace(-0.2, 0.2, 21), np.full(21, radius_m + 0.03)])
    stalk = centre + np.column_stack([np.zeros(10), np.zeros(10), np.linspace(radius_m, radius_m + 0.03, 10)])
    points = np.concatenate([centre + radius_m * ways, branch, stalk])
    return Scene.from_points(points, [2] * 400 + [1] * 31), centre


def test_the_whole_fruit_is_hard_and_only_its_stalk_is_let_go() -> None:
    scene, centre = fruit_scene()
    used = settings()
    assert shown_radius_m(scene, centre) == pytest.approx(0.022, abs=1e-4)
    assert shown_radius_m(scene, centre + [0.0, 0.2, 0.0]) is None
    spot = fruit_target(centre).spot(scene, used)
    points = hard_points(scene, spot, used)
    behind = centre + [0.022, 0.0, 0.0]  # the side that nothing shows
    assert np.linalg.norm(points - behind, axis=1).min() < used.stem_point_radius_m + 0.003
    hidden, zone_m = exclusion(spot, used)
    assert zone_m >= used.approach_distance_m
    let_go = points[spared(points, hidden)]
    assert len(let_go) > 5 and (let_go[:, 2] > centre[2] + 0.02 - 0.004).all()
    assert (np.abs(let_go[:, :2] - centre[:2]) < used.stalk_radius_m).all()
    # An exact pose lets the fruit go, and the hand that holds the fruit as well.
    for other in (pose_target(POSE[:0] + [*centre, 0, 0, 0, 1]).spot(scene, used), dataclasses.replace(spot, picked=True)):
        assert np.linalg.norm(hard_points(scene, other, used) - centre, axis=1).min() > 0.02


def test_a_fruit_without_a_size_is_refused() -> None:
    scene, centre = fruit_scene()
    nowhere = fruit_target(centre + [0.0, 0.3, 0.0])
    assert nowhere.spot(scene, settings(fruit_radius_m=0.03)).fruit_radius_m == 0.03
    with pytest.raises(ProblemError, match=r"shows no fruit at 0.600 0.300 0.500.*fruit_radius_m is 0"):
        nowhere.spot(scene, settings(fruit_radius_m=0.0))
