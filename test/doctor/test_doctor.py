"""`lime-planner doctor` without a robot: a healthy installation, and every planted fault of machine and environment found and named."""

from __future__ import annotations

import io
import shlex
from pathlib import Path

import pytest
from doctor_helpers import Doctor, assert_named, doctor_fixture, surroundings  # noqa: F401  (fixtures)

from lime_planner.cli import main as cli
from lime_planner.cli.parameter_file import read_parameter_file
from lime_planner.doctor.libraries import probe
from lime_planner.doctor.machine import shipped_profile
from lime_planner.ros.tools.dds_round_trip import measure


def test_a_healthy_installation(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """For people: no fault, one line for each check, every library with its version."""
    monkeypatch.delenv("COLUMNS", raising=False)
    assert cli.main(["doctor", "--only", "libraries,machine,robot,dds"]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert err == ""
    assert all(line.startswith(("ok ", "warning ")) for line in lines[:-1]), out
    assert lines[-1].startswith("0 faults, ")
    for name in (
        "numpy: 2",
        "numba: 0",
        "pin: ",
        "open3d",
        "python: 3.1",
        "kernel cache: ",
        "robot: kinova_j2s6s200: 6 joints",
        "DDS: two",
    ):
        assert name in out, out


def test_columns_on_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from rich.console import Console

    from lime_planner.output import console as tables

    shown = io.StringIO()
    monkeypatch.setattr(tables, "console", lambda *, error=False: Console(file=shown, force_terminal=True, color_system=None, width=80))
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "nowhere.xml")
    assert cli.main(["doctor", "--only", "machine,dds"]) == 1
    lines = shown.getvalue().splitlines()
    assert any(line.startswith("ok      python              3.1") for line in lines)
    assert any(line.startswith("fault   cloud profile       FASTRTPS_DEFAULT_PROFILES_FILE names nowhere.xml:") for line in lines)
    path = str(shipped_profile())
    assert any(path in line for line in lines)  # to be copied: not torn apart
    assert all(len(line) <= 80 for line in lines if path not in line)
    assert "1 faults, " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("variable", "value", "check", "words"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "discovery", ["is OFF"]),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "NEAR", "discovery", ["'NEAR'"]),
        ("ROS_DOMAIN_ID", "300", "ROS domain", ["'300'"]),
        ("ROS_DOMAIN_ID", "a", "ROS domain", ["'a'"]),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "nowhere.xml", "cloud profile", ["nowhere.xml"]),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", __file__, "cloud profile", ["no XML"]),
        ("RMW_IMPLEMENTATION", "rmw_nonsense", "DDS", ["code 102", "rmw_nonsense"]),
    ],
)
def test_a_planted_fault_of_the_environment(
    doctor: Doctor, monkeypatch: pytest.MonkeyPatch, variable: str, value: str, check: str, words: list[str]
) -> None:
    monkeypatch.setenv(variable, value)
    code, findings = doctor("--only", "dds,live", "--live")
    assert code == 1
    assert_named(findings, check, *words)
    assert_named(findings, "listening", "skipped", level="warning")


def test_processes_that_cannot_find_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    assert not measure(0.5).heard


def test_planted_faults_of_the_libraries(doctor: Doctor, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One is missing, one lacks a system library, one crashes; the others stand in for themselves, to be quick."""
    for name in ("numpy", "scipy", "numba", "pinocchio", "fcl", "open3d", "matplotlib", "rich"):
        (tmp_path / f"{name}.py").write_text("")
    (tmp_path / "trimesh.py").write_text("raise ImportError('libGL.so.1: cannot open shared object file')")
    (tmp_path / "toppra.py").write_text("import os; os.abort()")
    (tmp_path / "yaml.py").write_text("raise ModuleNotFoundError(\"No module named 'yaml'\", name='yaml')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code, findings = doctor("--only", "libraries")
    assert code == 1
    assert_named(findings, "trimesh", "libGL.so.1")
    assert_named(findings, "toppra", "SIGABRT")
    assert_named(findings, "PyYAML", "No module named 'yaml'")
    assert findings["rich"]["level"] == "ok"
    assert "No module named" in probe(["no_such_library"])["no_such_library"].failure


def test_a_library_that_is_missing_or_too_old(doctor: Doctor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.requires", lambda _: ["no-such-library>=2", "rich>=999"])
    code, findings = doctor("--only", "libraries")
    assert code == 1
    assert_named(findings, "no-such-library", "is not installed")
    assert "pip install 'no-such-library>=2'" in findings["no-such-library"]["cure"]
    assert_named(findings, "rich", "needed is >=999")


def test_a_plug_in_that_is_missing_is_missing_from_its_extra(doctor: Doctor, monkeypatch: pytest.MonkeyPatch) -> None:
    from lime_planner.doctor import libraries

    versions = libraries._version
    monkeypatch.setattr(libraries, "_version", lambda name: "" if name == "imageio-ffmpeg" else versions(name))
    _, findings = doctor("--only", "libraries")
    assert findings["[video]"]["sentence"] == "optional, without imageio-ffmpeg: pip install 'lime_planner[video]' brings it"


def test_advice_can_be_typed_in_a_folder_with_spaces(doctor: Doctor, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.setattr("lime_planner.doctor.machine.shipped_profile", lambda: tmp_path / "my limes" / "clouds.xml")
    _, findings = doctor("--only", "dds")
    words = shlex.split(findings["cloud profile"]["cure"])
    assert words == ["export", f"FASTRTPS_DEFAULT_PROFILES_FILE={tmp_path}/my limes/clouds.xml"]


def test_lines_fit_the_columns_that_are_asked_for(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    cli.main(["doctor", "--only", "machine"])
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 60 or " " not in line.strip() for line in lines) and any(line.startswith("  ") for line in lines)


def test_a_cache_that_cannot_be_written_is_no_fault(doctor: Doctor, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("LIME_PLANNER_CACHE_DIR", str(tmp_path / "file" / "cache"))
    code, findings = doctor("--only", "machine")
    assert (code, findings["kernel cache"]["level"]) == (0, "warning")
    assert_named(
        findings, "kernel cache", f"{tmp_path}/file/cache is not used (Not a directory), but {tmp_path}/lime_planner-", level="warning"
    )


def test_a_compiler_that_is_switched_off(doctor: Doctor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    code, findings = doctor("--only", "machine")
    assert code == 1
    assert_named(findings, "compiler", "NUMBA_DISABLE_JIT is '1'")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("/**/lime_planner:\n  ros__parameters: {stem_margin_m: -1}\n", ["stem_margin_m is -1"]),
        ("/**/lime_planner:\n  ros__parameters: {stem_margin: 0.01}\n", ["did you mean stem_margin_m"]),
        ("/other:\n  ros__parameters: {}\n", ["no section", "/other"]),
        ("/**:\n  parameters: {}\n", ["no `ros__parameters`"]),
        ("a: [\n", ["is not YAML"]),
        ("/**/lime_planner:\n  ros__parameters: {workspace_box: [0, 0, 0, -1, 1, 1]}\n", ["not below its maximum"]),
        (None, ["cannot be read"]),
    ],
)
def test_a_parameter_file_that_is_not_valid(doctor: Doctor, tmp_path: Path, text: str | None, words: list[str]) -> None:
    path = tmp_path / "planner.yaml"
    if text is not None:
        path.write_text(text)
    code, findings = doctor("--only", "robot", "--params", path)
    assert code == 1
    assert_named(findings, "parameters", str(path), *words)


def test_a_robot_that_cannot_be_loaded(doctor: Doctor) -> None:
    code, findings = doctor("--only", "robot", "--set", "robot=no_such.urdf")
    assert code == 1
    assert_named(findings, "robot", "no_such.urdf")


def test_the_shipped_parameter_files_are_valid() -> None:
    paths = sorted((Path(__file__).resolve().parents[2] / "config").glob("*.yaml"))
    assert [read_parameter_file(path).values["robot"] for path in paths] == ["kinova_j2n6s300", "kinova_j2s6s200", "kinova_j2s6s200"]


def test_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["doctor", "--only", "nothing"])
    assert "there is no group 'nothing'; there are libraries" in capsys.readouterr().err
    assert cli.main(["doctor", "--wait", "-1"]) == 1
