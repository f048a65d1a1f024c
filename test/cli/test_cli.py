"""The command line: quick help, one-line errors, exit status."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from arm_helpers import plant

from lime_planner.cli import main as cli
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS
from lime_planner.scene.scene import Scene

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments: str) -> int:
    """Run in this process; argparse's exits become a status."""
    try:
        return cli.main(list(arguments))
    except SystemExit as exit_:
        return int(exit_.code or 0)


def leaves() -> list[tuple[str, ...]]:
    return [command.words for command in cli.COMMANDS if cli._exists(command) and not command.module.startswith("lime_planner.ros")]


@pytest.mark.parametrize("words", [(), *leaves()], ids=" ".join)
def test_help_teaches_within_80_columns(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*words, "--help") == 0
    text = capsys.readouterr().out
    assert "example" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.timed
def test_help_is_quick_and_imports_nothing_heavy() -> None:
    script = "import sys; from lime_planner.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    script += "print(sorted({'numpy', 'numba', 'open3d', 'pinocchio', 'rclpy', 'rich', 'matplotlib'} & set(sys.modules)), file=sys.stderr)"
    times = []
    for _ in range(3):
        began = time.monotonic()
        done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
        times.append(time.monotonic() - began)
        assert done.stderr.strip() == "[]"
    assert min(times) < 0.5


def test_module_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "lime_planner", "--version"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("lime-planner ")


def test_numbers_may_be_negative_powers() -> None:
    parser = cli.build_parser(["plan"])
    args = parser.parse_args(["plan", "x.npz", "--target", "0.5", "-1e-05", "-.3", "0", "-1", "0", "-2.5E-3", "--start", "-1", "2"])
    assert args.target == [0.5, -1e-05, -0.3, 0.0, -1.0, 0.0, -0.0025]
    assert args.start == [-1.0, 2.0]


@pytest.mark.parametrize("assignment", ["stem_margin_m=-1", "no_such=1", "stem_margin_m", "motion_enabled=false"])
def test_bad_parameters_are_one_line(assignment: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("plan", "x.npz", "--set", assignment) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("BAD_INPUT: ") and err.count("\n") == 1
    assert assignment.partition("=")[0] in err


def test_missing_scene(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    missing = tmp_path / "none.npz"
    assert run("scene", "info", str(missing)) == 1
    assert capsys.readouterr().err == f"BAD_INPUT: {missing}: there is no such file\n"


def test_debug_prints_a_traceback(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run("scene", "info", str(tmp_path / "none.npz"), "--debug") == 1
    err = capsys.readouterr().err
    assert "Traceback" in err and err.rstrip().endswith("there is no such file")


def test_a_defect_is_one_line_too(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from lime_planner.cli import scene as cli_scene_info

    def broken(_: object) -> int:
        raise ZeroDivisionError("a\nb")

    monkeypatch.setattr(cli_scene_info, "run_info", broken)
    assert run("scene", "info", "x.npz") == 1
    assert capsys.readouterr().err == "INTERNAL_ERROR: ZeroDivisionError: a b (--debug prints where)\n"


def test_a_missing_library_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from lime_planner.cli import scene as cli_scene_info

    def needs_ros(_: object) -> int:
        raise ModuleNotFoundError("No module named 'rclpy'", name="rclpy.node")

    monkeypatch.setattr(cli_scene_info, "run_info", needs_ros)
    assert run("scene", "info", "x.npz") == 1
    assert capsys.readouterr().err == "NOT_INSTALLED: the library 'rclpy' is not installed; pip install 'lime_planner[ros]' brings it\n"


def test_wrong_usage_is_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("plan") == 2
    assert run("plan", "x.npz", "--time", "1", "--iterations", "5") == 2
    assert "not allowed with" in capsys.readouterr().err


def test_plant_and_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sub" / "plant.npz"
    assert run("scene", "plant", "--seed", "3", "--density", "sparse", "--out", str(path)) == 0
    assert run("scene", "info", str(path)) == 0
    out = capsys.readouterr().out
    assert "leaf" in out and "frame: base" in out
    assert run("scene", "plant", "--height", "99", "--out", str(path)) == 1
    assert "height_m: 99.0 is outside 0.2 to 5" in capsys.readouterr().err


def test_info_lists_every_label_and_takes_what_they_mean(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    points = np.random.default_rng(0).uniform(0.3, 0.6, (7, 3))
    points[6] = np.nan
    np.savez(tmp_path / "a.npz", points=points, labels=np.array([0, 3, 3, 1, 2, 9, np.nan]))
    path = str(tmp_path / "a.npz")
    assert run("scene", "info", path) == 0
    assert (
        "labels: 0 (leaf): 1, 1 (stem): 1, 2 (fruit): 1, 3 (unknown, so impermeable): 2, 9 (unknown, so impermeable): 1\n"
        in capsys.readouterr().out
    )
    assert run("scene", "info", path, "--set", "leaf_labels=[3]", "--set", "ignored_labels=[0, 9]", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["points"] == {"leaf": 2, "stem": 1, "fruit": 1}
    assert {row["label"]: row["class"] for row in told["labels"]} == {0: "ignored", 1: "stem", 2: "fruit", 3: "leaf", 9: "ignored"}
    assert run("scene", "info", path, "--set", "seed=3") == 1
    assert "seed: only label_field, leaf_labels" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("factor", "turned", "labels", "words"),
    [
        (1000.0, False, 0, "is that in millimetres?"),
        (100.0, False, 0, "is that in centimetres, or in another frame?"),
        (1.0, True, 0, "is the scene y-up?"),
        (1.0, False, 7, "points have labels that are not named, and count as stems"),
    ],
)
def test_info_warns_as_plan_does(
    factor: float, turned: bool, labels: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points, classes, _ = plant(3).labelled_points()
    points = factor * (points[:, [0, 2, 1]] * [1, 1, -1] if turned else points)
    np.savez(tmp_path / "a.npz", points=points, labels=classes.astype(int) + labels)
    assert run("scene", "info", str(tmp_path / "a.npz")) == 0
    warned = capsys.readouterr().err
    assert warned.startswith("warning: ") and words in warned and warned.count("\n") == 1
    assert run("scene", "info", str(tmp_path / "a.npz"), "--json") == 0
    assert [f"warning: {sentence}\n" for sentence in json.loads(capsys.readouterr().out)["warnings"]] == [warned]


def test_a_target_in_a_file_with_a_crooked_quaternion_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points, classes, _ = plant(3).labelled_points()
    pose = plant(3).target_pose
    assert pose is not None
    np.savez(tmp_path / "a.npz", points=points, labels=classes, target_pose=pose * [1, 1, 1, 3, 3, 3, 3])
    for words in (("scene", "info"), ("plan", "--iterations", "10")):
        run(*words, str(tmp_path / "a.npz"))
        assert "has the length 3, not 1: are its numbers in the order x y z w?" in capsys.readouterr().err


def test_long_lines_fit_the_columns_that_are_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(3).save(tmp_path / "a.npz")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "60")
    for words in (("scene", "info", "a.npz"), ("parameters",)):
        assert run(*words) == 0
        lines = capsys.readouterr().out.splitlines()
        assert max(map(len, lines)) <= 60
    assert all(line == line.rstrip() and (line.startswith("  ") or " =" in line) for line in lines)


@pytest.mark.parametrize("command", ["plan", "scene info"])
def test_the_label_s_field_is_spelt_the_same_everywhere(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{0.5 + 0.001 * k} 0 0.5 {k % 2}\n" for k in range(40))
    properties = "property float x\nproperty float y\nproperty float z\nproperty int class\n"
    (tmp_path / "a.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 40\n{properties}end_header\n{rows}")
    path = str(tmp_path / "a.ply")
    assert run(*command.split(), path) == 1
    assert "label" in capsys.readouterr().err
    for options in (("--label-field", "class"), ("--set", "label_field=class")):
        run(*command.split(), path, *options)
        said = capsys.readouterr()
        assert "has no target_pose" in said.err if command == "plan" else "0 (leaf): 20, 1 (stem): 20" in said.out
    assert cli.build_parser(["view"]).parse_args(["view", path, "--label-field", "class"]).label_field == "class"
    assert cli.build_parser(["demo"]).parse_args(["demo", "--scene", path, "--label-field", "class"]).label_field == "class"


def test_a_film_without_what_writes_films_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from lime_planner.output import animation

    find = animation.importlib.util.find_spec
    monkeypatch.setattr(animation.importlib.util, "find_spec", lambda name, *more: None if name == "imageio_ffmpeg" else find(name, *more))
    assert run("animate", "is not even read.json", "--out", str(tmp_path / "a.mp4")) == 1
    assert capsys.readouterr().err == (
        "NOT_INSTALLED: a film needs imageio-ffmpeg, which is not installed: pip install 'lime_planner[video]' brings it; "
        "a .gif needs nothing\n"
    )


def test_coordinates_that_are_too_large_for_single_precision_are_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    near = np.random.default_rng(0).uniform(0.3, 0.6, (50, 3))
    far = near + [443_210.0, 5_621_987.0, 128.0]
    for kind in (np.float32, np.float64):
        np.savez(tmp_path / f"{np.dtype(kind)}.npz", points=far.astype(kind), labels=np.arange(50) % 2)
    assert run("scene", "info", str(tmp_path / "float32.npz")) == 0
    warned = (
        "warning: coordinates of 5621988 in single precision are 5e+02 mm apart: write them in double precision, or from an origin nearby\n"
    )
    assert capsys.readouterr().err.startswith(warned)
    assert run("scene", "info", str(tmp_path / "float64.npz")) == 0
    assert "precision" not in capsys.readouterr().err
    exact = Scene.load(tmp_path / "float64.npz", offset=(-443_210.0, -5_621_987.0, -128.0))
    assert np.abs(exact.leaf_points - near[::2]).max() < 1e-6


def test_parameters_lists_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("parameters", "--markdown") == 0
    out = capsys.readouterr().out
    assert all(f"`{name}`" in out for name in (*PARAMETERS, *NODE_PARAMETERS))
    assert run("parameters", "no such thing") == 1
