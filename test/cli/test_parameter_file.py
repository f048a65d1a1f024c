"""Parameter files set for a node what rcl sets for it: the same sections count, and what rcl refuses is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import rclpy
from domains import DOMAIN
from rclpy.node import Node

from lime_planner.cli.main import main
from lime_planner.cli.parameter_file import matches, read_parameter_file
from lime_planner.core.errors import ParameterError

TWO_ROBOTS = """\
/left/lime_planner:
  ros__parameters: {robot: kinova_j2s6s200, planning_frame: base}
/right/lime_planner:
  ros__parameters: {robot: kinova_j2n6s300, planning_frame: j2n6s300_link_base}
"""
SHARED = """\
/**:
  ros__parameters: {robot_ip: 192.0.2.10, stem_margin_m: 0.02}
"""

KEYS = (
    *("/**", "/*", "/**/lime_planner", "/*/lime_planner", "lime_planner", "/lime_planner", "/left/lime_planner", "left/lime_planner"),
    *("/left/*", "/left/**", "/left/*/lime_planner", "/a/left/lime_planner", "*", "**", "/**/left/lime_planner", "/left/**/lime_planner"),
    *("/*/*", "/a/*/lime_planner", "/a/**", "/**/*", "/right/lime_planner", "/left/other", "/lefty/lime_planner", "/lime_planner/left"),
)


def by_rcl(path: Path, namespace: str) -> dict[str, object]:
    """The parameters that a node takes from a file."""
    context = rclpy.Context()
    given = ["-r", f"__ns:={namespace}"] if namespace else []
    rclpy.init(args=["node", "--ros-args", "--params-file", str(path), *given], context=context, domain_id=DOMAIN)
    node = Node("lime_planner", context=context, enable_rosout=False, start_parameter_services=False)
    try:
        return {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize("namespace", ["", "/left", "/a/left"])
def test_sections_match_as_in_rcl(tmp_path: Path, namespace: str) -> None:
    path = tmp_path / "keys.yaml"
    path.write_text("".join(f"'{key}':\n  ros__parameters: {{key_{number}: 1}}\n" for number, key in enumerate(KEYS)))
    taken = by_rcl(path, namespace)
    for number, key in enumerate(KEYS):
        assert matches(key, f"{namespace}/lime_planner") == (f"key_{number}" in taken), key


@pytest.mark.parametrize(
    "key", ["/l*/lime_planner", "/lime_*", "/left//lime_planner", "//lime_planner", "/left/lime_planner/", "/le ft/x", "***"]
)
def test_keys_that_rcl_refuses(tmp_path: Path, key: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(f"'{key}':\n  ros__parameters: {{seed: 1}}\n")
    with pytest.raises(ParameterError, match="where a name"):
        read_parameter_file(path)
    with pytest.raises(Exception, match="parse params file"):
        by_rcl(path, "")


@pytest.mark.parametrize(
    "text",
    [
        "/**:\n  ros__parameters: {seed: 2}\n/left/lime_planner:\n  ros__parameters: {seed: 1}\n",
        "/left/lime_planner:\n  ros__parameters: {seed: 1}\n/**:\n  ros__parameters: {seed: 2}\n",
        "/*/lime_planner:\n  ros__parameters: {seed: 3}\n/**:\n  ros__parameters: {seed: 2, c_perm: 5.0}\n",
        "left:\n  lime_planner:\n    ros__parameters: {seed: 4}\n  other:\n    ros__parameters: {seed: 5}\n",
        "/**:\n  ros__parameters: {seed: 2}\n/**:\n  ros__parameters: {c_perm: 7.0}\n",
        "/**:\n  ros__parameters: {motion_enabled: off, seed: 0x10}\n",
    ],
)
def test_values_are_those_of_rcl(tmp_path: Path, text: str) -> None:
    path = tmp_path / "values.yaml"
    path.write_text(text)
    assert dict(read_parameter_file(path, "left").values) == by_rcl(path, "/left")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("/lime_planner: {seed: 1}\n", "has no `ros__parameters`"),
        ("/other: {seed: 1}\n/lime_planner:\n  ros__parameters: {seed: 2}\n", "/other/seed has no"),
        ("ros__parameters: {seed: 1}\n", "stands at the top"),
        ("/left:\n  ros__parameters: {seed: 1}\n  lime_planner:\n    ros__parameters: {seed: 2}\n", "lime_planner beside"),
        ("/**:\n", "has no `ros__parameters`"),
        ("/**:\n  ros__parameters:\n", "no values"),
    ],
)
def test_files_that_rcl_refuses(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match=words):
        read_parameter_file(path, "left")
    with pytest.raises(Exception, match="parse params file"):
        by_rcl(path, "/left")


def test_two_robots_in_one_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "two_robots.yaml"
    path.write_text(TWO_ROBOTS)
    assert {name: read_parameter_file(path, name).values["robot"] for name in ("left", "/right/")} == {
        "left": "kinova_j2s6s200",
        "/right/": "kinova_j2n6s300",
    }
    assert main(["plan", "no_such.npz", "--params", str(path)]) != 0
    assert "--namespace tells which lime_planner is meant" in capsys.readouterr().err


def test_a_shared_file_is_taken_with_a_warning(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "shared.yaml"
    path.write_text(SHARED)
    file = read_parameter_file(path)
    assert file.values == {"stem_margin_m": 0.02}
    assert file.warnings == ("there is no parameter 'robot_ip'; its value is ignored",)
    for command in (["plan", "no_such.npz"], ["view", "no_such.npz", "--no-browser"]):
        assert main([*command, "--params", str(path)]) != 0
        told = capsys.readouterr().err
        assert "no parameter 'robot_ip'; its value is ignored" in told and "no_such.npz" in told
    slip = tmp_path / "slip.yaml"
    slip.write_text("/**:\n  ros__parameters: {stem_margn_m: 0.02}\n")
    with pytest.raises(ParameterError, match="did you mean stem_margin_m"):
        read_parameter_file(slip)
