"""What the command line says when it is mistyped, on narrow terminals, and at the press of the tabulator key."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lime_planner.cli import main as cli
from lime_planner.cli.parser import closest, sentence


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("plann plant.npz", "there is no command 'plann'; did you mean plan?"),
        ("Doctor", "there is no command 'Doctor'; did you mean doctor?"),
        ("plant --out a.npz", "there is no command 'plant'; did you mean scene plant?"),
        ("info a.npz", "there is no command 'info'; did you mean scene info?"),
        ("scene inf a.npz", "there is no command 'inf'; did you mean info?"),
        ("xyzzy", "there is no command 'xyzzy'; (choose from plan, view,"),
        ("plan a.npz --pictrue a.png", "there is no option --pictrue; did you mean --picture?"),
        ("plan a.npz --seeed=3", "there is no option --seeed; did you mean --seed?"),
        ("plan a.npz --joint_states /x", "there is no option --joint_states; did you mean --joint-states?"),
        ("plan a.npz --stem-margin 3", "there is no option --stem-margin; did you mean --set stem_margin_m=…?"),
        ("plan a.npz --leaf-labels [3]", "there is no option --leaf-labels; did you mean --set leaf_labels=…?"),
        ("plan a.npz --labelfield class", "there is no option --labelfield; did you mean --label-field?"),
        ("plan a.npz --seed x", "argument --seed: 'x' is no whole number"),
        ("plan a.npz --time soon", "argument --time: 'soon' is no number"),
        ("doctor --only machin", "there is no group 'machin'; did you mean machine? There are libraries, machine,"),
        ("scene plant --out a.npz --densty dense", "there is no option --densty; did you mean --density?"),
        ("doctor --xyzzy", "there is no option --xyzzy\n"),
        ("plan a.npz --planner lime", "'lime' is not one of them; did you mean lime_star?"),
        ("completion basch", "'basch' is not one of them; did you mean bash?"),
    ],
)
def test_did_you_mean(words: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(words.split())
    assert ended.value.code == 2
    assert meant in capsys.readouterr().err


def test_parameters_are_found_as_they_are_spelt(capsys: pytest.CaptureFixture[str]) -> None:
    for spelling in ("stem_margn_m", "stem-margn-m"):
        assert cli.main(["plan", "a.npz", "--set", f"{spelling}=0.1"]) == 1
        assert "there is no parameter 'stem_margn_m'; did you mean stem_margin_m" in capsys.readouterr().err
    assert cli.main(["plan", "a.npz", "--set", "stem-margin-m=9"]) == 1
    assert "stem_margin_m" in capsys.readouterr().err


def test_capitals_stay() -> None:
    assert sentence("the 3-D page of ROS 2") == "The 3-D page of ROS 2."
    assert closest("PLAN", ["plan", "view"]) == ["plan"]


@pytest.mark.parametrize("command", [(), *(command.words for command in cli.COMMANDS)])
@pytest.mark.parametrize("columns", [60, 200])
def test_help_fits_the_terminal(
    command: tuple[str, ...], columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    with pytest.raises(SystemExit):
        cli.main([*command, "--help"])
    text = capsys.readouterr().out
    too_long = [
        line
        for line in text.splitlines()
        if len(line) > min(80, columns) and len(line.split()) > 1 and not line.lstrip().startswith(("[", "--methods"))
    ]
    assert not too_long
    examples = text.partition("xample")[2].replace(" \\\n", " ")
    assert "lime-planner" in " ".join(examples.split()) or not command or "make demo" in examples


def printed_completion(shell: str) -> str:
    command = [sys.executable, "-m", "lime_planner", "completion", shell]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout


def test_completion_of_parameters(tmp_path: Path) -> None:
    script = tmp_path / "completion.bash"
    done = subprocess.run(
        [sys.executable, "-m", "lime_planner", "completion", "bash"], capture_output=True, text=True, check=True, timeout=120
    )
    script.write_text(done.stdout)
    bash = f"""source {script}
    function=$(complete -p lime-planner | sed 's/.*-F \\([^ ]*\\).*/\\1/')
    complete_words() {{
      COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMPREPLY=()
      $function lime-planner "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD-1]}}"
      echo "${{COMPREPLY[@]}}"
    }}
    complete_words lime-planner plan a.npz --set stem_mar
    complete_words lime-planner plan a.npz --set leaf_pol
    complete_words lime-planner view a.npz --set motion_en
    complete_words lime-planner anim"""
    lines = subprocess.run(["bash", "-c", bash], capture_output=True, text=True, check=True, timeout=60).stdout.splitlines()
    assert lines[0] == "stem_margin_m="
    assert lines[1].split() == ["leaf_policy=permeable", "leaf_policy=solid", "leaf_policy=ignored"]
    assert lines[2].split() == ["motion_enabled=true", "motion_enabled=false"]
    assert lines[3] == "animate"
    zsh = subprocess.run(
        [sys.executable, "-m", "lime_planner", "completion", "zsh"], capture_output=True, text=True, check=True, timeout=120
    ).stdout
    assert "_lime_planner_parameters" in zsh and "leaf_policy=solid" in zsh
