"""After a refusal the command line says what to type next, and that is a command that works."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from arm_helpers import plant, robot_named

from lime_planner.cli.main import main
from lime_planner.cli.next_step import Refused, next_command
from lime_planner.core.status import Status
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.targets import Target, fruit_target, pose_target
from lime_planner.scene.scene import Scene

POSE = "--target 0.5 -0.1 0.4 0 0.7 0 0.7"
AT, FRUIT = pose_target([0.5, -0.1, 0.4, 0.0, 0.7, 0.0, 0.7]), fruit_target([0.5, -0.1, 0.4])
FAR = fruit_target([500.0, -100.0, 400.0])
STATIC = Scene.from_points(plant(15).stem_points, np.ones(len(plant(15).stem_points), int))


def refused(words: str, status: Status, target: Target | None = None, scene: Scene = STATIC, seed: int = 1, **more: Any) -> Refused:
    result = PlanResult(status, status.message("so"), "lime_star", seed, target=target)
    free: Any = SimpleNamespace(stem_hit=lambda q: None)
    values: dict[str, Any] = {"file": "p.npz", "scale": 1.0, "offset": np.zeros(3)} | more
    return Refused(tuple(shlex.split(words)), scene=scene, robot=robot_named(), result=result, checker=lambda: free, **values)


@pytest.mark.parametrize(
    ("words", "status", "target", "scene", "expected"),
    [
        (f"plan p.npz {POSE} --seed 1", Status.GOAL_IN_STEM, AT, STATIC, "plan p.npz --seed 1 --target 0.5 -0.1 0.4"),
        (f"plan {POSE} p.npz", Status.NO_IK_SOLUTION, AT, STATIC, "plan p.npz --target 0.5 -0.1 0.4"),
        ("plan p.npz", Status.GOAL_IN_STEM, AT, STATIC, "plan p.npz --freedom cone"),
        ("plan p.npz", Status.GOAL_IN_STEM, FRUIT, plant(15), "plan p.npz --fruit any"),
        ("plan p.npz --fruit 3", Status.GOAL_IN_STEM, FRUIT, plant(15), "plan p.npz --fruit any"),
        ("plan p.npz --target 3 0 0.5", Status.NO_IK_SOLUTION, fruit_target([3, 0, 0.5]), plant(15), "plan p.npz --fruit any"),
        ("plan p.npz --target 500 -100 400", Status.NO_IK_SOLUTION, FAR, STATIC, "plan p.npz --target 0.5 -0.1 0.4"),
        ("plan p.npz --start 0 -1e-3 0 --seed 2", Status.START_INVALID, None, STATIC, "plan p.npz --seed 2"),
        ("plan p.npz", Status.START_IN_STEM, None, STATIC, "plan p.npz --start 5.31 2.84 1.32 4.63 2.09 1.57"),
        ("plan p.npz --iterations 50", Status.NO_PATH, None, STATIC, "plan p.npz --iterations 200"),
        ("plan p.npz", Status.TIMED_OUT, None, STATIC, "plan p.npz --time 2"),
        ("plan --time 1 'a b.npz'", Status.LEAF_BUDGET_EXCEEDED, None, STATIC, "plan 'a b.npz' --time 4"),
        ("plan p.npz --seed 7", Status.PATH_INVALID, None, STATIC, "plan p.npz --seed 2"),
        ("plan p.npz", Status.CANCELLED, None, STATIC, ""),
    ],
)  # fmt: skip
def test_the_next_command_is_made_of_the_refused_one(
    words: str, status: Status, target: Target | None, scene: Scene, expected: str
) -> None:
    found = next_command(refused(words, status, target, scene), lambda _: True)
    if "--start 5.31" in expected:  # the built-in home, turned by half a radian
        q = np.round(robot_named().home + [0.5, 0, 0, 0, 0, 0], 2)
        expected = " ".join(["plan p.npz --start", *(f"{angle:g}" for angle in q)])
    assert found == (f"lime-planner {expected}" if expected else "")


def test_what_does_not_work_is_not_proposed() -> None:
    tried: list[list[str]] = []

    def never(words: Sequence[str]) -> bool:
        tried.append(list(words))
        return False

    assert next_command(refused("plan p.npz --fruit any", Status.NO_IK_SOLUTION, FRUIT), never) == "lime-planner scene info p.npz"
    boxed = refused("plan p.npz --set voxel_m=0.004 --time 1 --start 1 2", Status.START_INVALID)
    assert next_command(boxed, never) == "lime-planner view p.npz --set voxel_m=0.004 --start 1 2"
    assert ["plan", "p.npz", "--set", "voxel_m=0.004", "--time", "1"] in tried
    assert any("--start" in words and "--offset" not in words for words in tried[2:]) and any("--offset" in words for words in tried)
    assert all(tried.count(words) == 1 for words in tried)
    assert next_command(refused("plan --bag b", Status.START_IN_STEM, file=""), never) == ""


def written(scene: Scene, path: Path, factor: float, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
    points, labels, _ = scene.labelled_points()
    assert scene.target_pose is not None
    pose = [*(factor * (scene.target_pose[:3] + offset)), *scene.target_pose[3:]]
    np.savez(path, points=factor * (points + np.array(offset)), labels=labels, target_pose=pose)


@pytest.mark.parametrize(
    ("seed", "density", "factor", "offset", "options", "status", "proposed"),
    [
        (15, "medium", 1.0, None, "--start 0 0 0 0 0 0", "START_INVALID", ""),
        (22, "sparse", 1.0, None, "", "START_IN_STEM", "--start "),
        (15, "medium", 1.0, None, "--target 0 0 0.3", "START_IN_STEM", "--fruit any"),
        (15, "medium", 1.0, None, "--target 3 0 0.5 0 0 0 1", "NO_IK_SOLUTION", "--fruit any"),
        (15, "medium", 1.0, None, "--offset 550 0 50", "NO_IK_SOLUTION", "--offset "),
        (15, "medium", 1000.0, (0.0, 0.0, 0.0), "", "NO_IK_SOLUTION", "--scale 0.001"),
        (15, "medium", 100.0, (0.0, 0.0, 0.0), "", "NO_IK_SOLUTION", "--scale 0.01"),
        (15, "medium", 1.0, (30.0, 0.0, 0.0), "", "NO_IK_SOLUTION", "--offset -"),
    ],
)
def test_it_is_printed_and_works(
    seed: int,
    density: str,
    factor: float,
    offset: tuple[float, float, float] | None,
    options: str,
    status: str,
    proposed: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "plant.npz"
    if offset is None:
        plant(seed, density).save(path)
    else:
        written(plant(seed, density), path, factor, offset)
    assert main(["plan", str(path), *options.split(), "--time", "0.5", "--seed", "1"]) == 1
    *_, said, advice = capsys.readouterr().err.splitlines()
    assert said.startswith(f"{status}: ") and advice.startswith("try: lime-planner plan ") and proposed in advice, advice
    assert main(shlex.split(advice.removeprefix("try: lime-planner "))) == 0
