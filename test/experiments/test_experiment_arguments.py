"""What experiments and benchmarks share on their command line: where results go, and numbers that are none."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT

from benchmarks.planners.comparison import Comparison
from lime_planner.cli import main as cli
from lime_planner.core.errors import ParameterError
from lime_planner.experiments.problems import ProblemSpec
from lime_planner.experiments.runs.arguments import make_results_folder


def test_a_folder_that_cannot_be_is_named_with_the_reason(tmp_path: Path) -> None:
    make_results_folder(tmp_path / "new" / "folder")
    make_results_folder(tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []
    file = tmp_path / "plant.npz"
    file.write_text("")
    for path, reason in ((file, "it is a file"), (file / "deeper", "Not a directory"), (Path("/proc/x"), "No such file")):
        with pytest.raises(ParameterError) as refused:
            make_results_folder(path)
        assert str(refused.value).startswith(f"{path} cannot be the folder for results: {reason}")


@pytest.mark.parametrize(
    "arguments",
    [
        ("experiment", "wall", "--trials", 1, "--iterations", 50),
        ("experiment", "lime", "--trials", 1, "--plants", 0),
        ("experiment", "damage", "--plants", 1, "--limes", 1),
        ("bench", "scale", "--points", "--leaves", "--joints", 3, "--budget", 0),
    ],
    ids=lambda arguments: " ".join(map(str, arguments[:2])),
)
def test_commands_refuse_a_file_as_their_folder(arguments: tuple[Any, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plant.npz"
    file.write_text("")
    assert cli.main([*map(str, arguments), "--jobs", "1", "--out", str(file)]) == 1
    assert f"BAD_INPUT: {file} cannot be the folder for results: it is a file\n" in capsys.readouterr().err


def test_every_command_makes_its_folder_so() -> None:
    for path in (ROOT / "lime_planner" / "experiments").glob("*.py"):
        text = path.read_text(encoding="utf-8")
        called = {
            node.func.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        }
        assert "add_run_arguments(" not in text or path.name == "arguments.py" or "mkdir" not in called, path


@pytest.mark.parametrize("option", ["--marks", "--reference"])
@pytest.mark.parametrize("value", ["nan", "inf", "soon"])
def test_times_are_finite(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["bench", "planners", "--plants", "sparse:4", "--out", "unused", option, value])
    assert ended.value.code == 2
    assert f"argument {option}: '{value}' is not a finite number" in capsys.readouterr().err


def test_comparisons_check_their_times() -> None:
    problem: Any = ProblemSpec
    for marks in ((float("nan"),), (0.1, float("inf")), (0.0,)):
        with pytest.raises(ParameterError, match="marks must be rising times above 0 s"):
            Comparison("a", [problem], [], ["lime_star"], [1], marks)
    with pytest.raises(ParameterError, match="reference must be a time of at least 0 s, got nan"):
        Comparison("a", [problem], [], ["lime_star"], [1], (0.1,), reference_s=float("nan"))
