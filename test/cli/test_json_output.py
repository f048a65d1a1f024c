"""What every command does the same way: JSON for programs, bars for people at a terminal only, and completion in the shell."""

from __future__ import annotations

import io
import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from lime_planner.cli import main as cli
from lime_planner.cli.json_output import emit_json
from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS
from lime_planner.output import console as terminal


def answer(capsys: pytest.CaptureFixture[str], *arguments: Any) -> Any:
    """Run a command that must print JSON and nothing else."""
    assert cli.main([*map(str, arguments)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return json.loads(out)


def test_json_of_scenes_and_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plant.npz"
    grown = answer(capsys, "scene", "plant", "--density", "sparse", "--limes", 1, "--out", path, "--json")
    info = answer(capsys, "scene", "info", path, "--json")
    assert info["points"] == grown["points"] and info["target_pose"] == grown["target_pose"] and grown["points"]["leaf"] > 0
    assert info["frame_id"] == "base" and len(info["extent_m"]["stem"]) == 2 and info["start"] is None
    table = answer(capsys, "parameters", "--json")
    assert table.keys() == PARAMETERS.keys() | NODE_PARAMETERS.keys()
    assert table["stem_margin_m"]["unit"] == "m" and table["motion_enabled"]["node_only"] is True
    assert list(answer(capsys, "parameters", "stem_margin", "--json")) == ["stem_margin_m"]


def test_json_into_a_file_leaves_the_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "deep" / "parameters.json"
    assert cli.main(["parameters", "seed", "--json", str(file)]) == 0
    assert "seed = 0" in capsys.readouterr().out
    assert "seed" in json.loads(file.read_text())
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterError, match="cannot be written"):
        emit_json(tmp_path / "file" / "a.json", {})


def test_every_outcome_is_in_the_json(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands there from an earlier run must not be taken for this one's."""
    file = tmp_path / "plan.json"

    def told(*arguments: Any, exit_status: int = 1) -> dict[str, str]:
        file.write_text('{"status": "SUCCEEDED", "message": "SUCCEEDED: long ago"}')
        assert cli.main([*map(str, arguments), "--json", str(file)]) == exit_status
        figures = json.loads(file.read_text())
        out, err = capsys.readouterr()
        assert (out, err) == ("", figures["message"] + "\n") and figures["message"].startswith(figures["status"] + ": ")
        return dict(figures)

    missing = tmp_path / "none.npz"
    assert told("plan", missing) == {"status": "BAD_INPUT", "message": f"BAD_INPUT: {missing}: there is no such file"}
    assert told("plan", missing, "--set", "seed=-1")["status"] == "BAD_INPUT"
    assert told("plan", exit_status=2)["message"].startswith("BAD_INPUT: give a SCENE")
    assert told("scene", "info", missing)["status"] == "BAD_INPUT"
    from lime_planner.cli import plan as cli_plan

    def raising(error: BaseException) -> Any:
        def run(_: object) -> int:
            raise error

        return run

    for error, status, code in (
        (KeyboardInterrupt(), "CANCELLED", 130),
        (ZeroDivisionError("x"), "INTERNAL_ERROR", 1),
        (ModuleNotFoundError("No module named 'rosbags'", name="rosbags"), "NOT_INSTALLED", 1),
    ):
        monkeypatch.setattr(cli_plan, "run", raising(error))
        assert told("plan", missing, exit_status=code)["status"] == status
    monkeypatch.undo()
    assert cli.main(["plan", str(missing), "--json"]) == 1
    out, err = capsys.readouterr()
    assert json.loads(out) == {"status": "BAD_INPUT", "message": err.rstrip()}


def test_an_outcome_never_takes_the_place_of_something_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "plant.npz"
    scene.write_bytes(b"PK a scene")
    assert cli.main(["plan", "--json", str(scene)]) == 2  # argparse takes the scene for the file
    assert f"--json took {scene} for the file to write" in capsys.readouterr().err
    assert scene.read_bytes() == b"PK a scene"
    assert cli.main(["plan", str(scene), "--json", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.StringIO()
    monkeypatch.setattr(terminal, "console", lambda error: Console(file=shown, force_terminal=True, width=80))
    with terminal.working("growing", total=2) as bar:
        bar.say("growing leaves")
        bar.advance()
    assert "growing leaves" in shown.getvalue()
    with terminal.working("planning", seconds=0.2):
        time.sleep(0.25)
    assert "planning" in shown.getvalue()


def test_no_bar_elsewhere(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.working("growing") as bar:
        bar.say("growing leaves")
        bar.advance()
    assert capsys.readouterr() == ("", "")


def test_nothing_asked_for_is_answered_with_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    out, err = capsys.readouterr()
    assert out == "" and "lime-planner doctor" in err
    assert max(map(len, err.splitlines())) <= 80


def test_completion(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab", reason="shtab is not in this environment (extra `completion`)")
    assert cli.main(["completion", "zsh"]) == 0
    assert capsys.readouterr().out.startswith("#compdef lime-planner")
    assert cli.main(["completion", "bash"]) == 0
    script = capsys.readouterr().out

    def completed(*words: str) -> set[str]:
        listed = " ".join(f"'{word}'" for word in words)
        tail = f"COMP_WORDS=({listed}); COMP_CWORD={len(words) - 1}; _shtab_lime_planner; printf '%s\\n' \"${{COMPREPLY[@]}}\""
        done = subprocess.run(["bash", "-c", f"{script}\n{tail}"], capture_output=True, text=True, check=True)
        return set(done.stdout.split())

    assert completed("lime-planner", "d") >= {"demo", "doctor"}
    assert completed("lime-planner", "scene", "") >= {"plant", "info", "tomatowur"}
    assert completed("lime-planner", "plan", "--le") == {"--leaf"}
    assert completed("lime-planner", "completion", "") >= {"bash", "zsh"}
