"""After a refusal the command line says what to type next, and that is a command that works."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from arm_helpers import plant

from lime_planner.cli.main import main
from lime_planner.cli.next_step import next_command
from lime_planner.core.status import Status

POSE = "--target 0.5 -0.1 0.4 0 0.7 0 0.7"


@pytest.mark.parametrize(
    ("words", "status", "figures", "expected"),
    [
        (f"plan p.npz {POSE} --seed 1", Status.GOAL_IN_STEM, {"target_kind": "pose"}, "plan p.npz --seed 1 --target 0.5 -0.1 0.4"),
        (f"plan {POSE} p.npz", Status.NO_IK_SOLUTION, {"target_kind": "pose"}, "plan p.npz --target 0.5 -0.1 0.4"),
        ("plan p.npz", Status.GOAL_IN_STEM, {"target_kind": "pose"}, "plan p.npz --freedom cone"),
        ("plan p.npz", Status.GOAL_IN_STEM, {"target_kind": "fruit"}, "plan p.npz --fruit any"),
        ("plan p.npz --fruit any", Status.NO_IK_SOLUTION, {"target_kind": "fruit"}, "scene info p.npz"),
        ("plan p.npz --start 0 -1e-3 0 --seed 2", Status.START_INVALID, {}, "plan p.npz --seed 2"),
        ("plan p.npz", Status.START_IN_STEM, {}, ""),
        ("plan p.npz --iterations 50", Status.NO_PATH, {}, "plan p.npz --iterations 200"),
        ("plan p.npz", Status.TIMED_OUT, {}, "plan p.npz --time 2"),
        ("plan --time 1 'a b.npz'", Status.LEAF_BUDGET_EXCEEDED, {}, "plan 'a b.npz' --time 4"),
        ("plan p.npz --seed 7", Status.PATH_INVALID, {"seed": 7}, "plan p.npz --seed 8"),
        ("plan p.npz", Status.CANCELLED, {}, ""),
    ],
)
def test_the_next_command_is_made_of_the_refused_one(words: str, status: Status, figures: dict[str, object], expected: str) -> None:
    assert next_command(shlex.split(words), "p.npz", status, figures) == (f"lime-planner {expected}" if expected else "")


def test_it_is_printed_and_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plant.npz"
    plant(15).save(path)
    assert main(["plan", str(path), "--start", *["0"] * 6, "--iterations", "300", "--seed", "1"]) == 1
    refused, advice = capsys.readouterr().err.splitlines()
    assert refused.startswith("START_INVALID: ") and advice.startswith("try: lime-planner plan ")
    assert main(shlex.split(advice.removeprefix("try: lime-planner "))) == 0
