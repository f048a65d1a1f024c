"""What the command line may reach for: fruit by number or word, three or seven numbers, and files of candidates."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_helpers import plant, scene_of, settings

from lime_planner.cli.grasp_targets import check_together, read_candidates, targets_of
from lime_planner.cli.main import main
from lime_planner.core.errors import LimePlannerError, UsageError
from lime_planner.pipeline.scene_targets import own_target

POSES = np.tile([0.5, 0.1, 0.4, 0.0, 0.7071, 0.0, 0.7071], (3, 1))
TOOL = np.array([0.2, -0.3, 0.5])


def arguments(**given: Any) -> argparse.Namespace:
    return argparse.Namespace(**({"target": None, "fruit": None, "candidates": None, "freedom": None, "scale": 1.0} | given))


def test_fruit_by_number_word_and_place() -> None:
    scene = plant()
    assert scene.fruit_centres is not None
    centres = scene.fruit_centres.astype(np.float64)
    (second,) = targets_of(arguments(fruit="1"), scene, settings(), TOOL)
    np.testing.assert_allclose(second.centre, centres[1])
    assert second.radius_m == pytest.approx(float(scene.fruit_radii[1]))  # type: ignore[index]
    (nearest,) = targets_of(arguments(fruit="nearest"), scene, settings(), TOOL)
    everything = targets_of(arguments(fruit="any"), scene, settings(), TOOL)
    np.testing.assert_allclose(everything[0].centre, nearest.centre)
    away = [float(np.linalg.norm(target.centre - TOOL)) for target in everything]
    assert len(everything) == len(centres) and away == sorted(away)
    (place,) = targets_of(arguments(target=[0.5, 0.1, 0.4]), scene, settings(), TOOL)
    assert place.kind == "fruit" and place.radius_m is None
    (pose,) = targets_of(arguments(target=list(POSES[0])), scene, settings(grasp_freedom="roll"), TOOL)
    assert (pose.kind, pose.freedom) == ("pose", "roll")


def test_a_scene_that_knows_its_fruit_is_about_it() -> None:
    scene = plant()
    own = own_target(scene, "exact", TOOL)
    assert own is not None and own.kind == "fruit" and scene.target_pose is not None
    np.testing.assert_allclose(own.centre, scene.target_pose[:3], atol=1e-3)
    assert targets_of(arguments(), scene_of(np.zeros((1, 3))), settings(), TOOL) == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"fruit": "99"}, "fruit 99 is not there; the scene has"),
        ({"fruit": "-1"}, "fruit -1 is not there"),
        ({"fruit": "ripest"}, "fruit is 'ripest'; it must be a number from 0 to"),
    ],
)
def test_fruit_that_is_not_there(given: dict[str, Any], words: str) -> None:
    with pytest.raises(LimePlannerError, match=words):
        targets_of(arguments(**given), plant(), settings(), TOOL)


def test_a_scene_without_fruit_says_so() -> None:
    with pytest.raises(LimePlannerError, match="does not know its fruit"):
        targets_of(arguments(fruit="nearest"), scene_of(np.zeros((1, 3))), settings(), TOOL)


def test_one_target_at_a_time() -> None:
    with pytest.raises(UsageError, match="--fruit and --candidates each say what to reach"):
        check_together(arguments(fruit="0", candidates=Path("x.csv")))
    with pytest.raises(UsageError, match="--freedom is about a target pose"):
        check_together(arguments(fruit="0", freedom="roll"))
    check_together(arguments(target=[1.0] * 7, freedom="cone"))


def test_candidates_from_files(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(str(v) for v in row) for row in POSES)
    (tmp_path / "a.txt").write_text(f"# from a detector\n{rows}\n")
    (tmp_path / "a.csv").write_text("x,y,z,qx,qy,qz,qw\n" + rows.replace(" ", ","))
    (tmp_path / "a.json").write_text(json.dumps({"candidates": POSES.tolist()}))
    np.save(tmp_path / "a.npy", POSES)
    np.savez(tmp_path / "a.npz", candidates=POSES, scores=np.zeros(3))
    for suffix in ("txt", "csv", "json", "npy", "npz"):
        np.testing.assert_allclose(np.asarray(read_candidates(tmp_path / f"a.{suffix}")), POSES)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.csv", "1,2,3\n", "pose 1 needs 7 numbers"),
        ("a.csv", "", "empty list"),
        ("a.txt", "0.5 0 0.4 0 0 0 1\n0.5 nan 0.4 0 0 0 1\n", "grasp candidate 2 of 2"),
        ("a.json", "{", "cannot be read as grasp candidates"),
        ("a.npy", "no array", "cannot be read as grasp candidates"),
        ("a.xyz", "1", "ends in none of"),
    ],
)
def test_bad_candidate_files_are_named(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(LimePlannerError, match=words):
        targets_of(arguments(candidates=tmp_path / name), scene_of(np.zeros((1, 3))), settings(), TOOL)
    with pytest.raises(LimePlannerError, match="cannot be read"):
        read_candidates(tmp_path / "none.csv")


def test_a_scale_that_makes_fruit_too_large_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant(15).save(tmp_path / "plant.npz")
    assert main(["plan", str(tmp_path / "plant.npz"), "--scale", "1000"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("BAD_INPUT: --scale 1000 makes the scene's fruit 2") and "metres for each unit of the file" in said
