"""The launch files, with stand-ins for `launch` and `launch_ros`, which wheels do not bring: what they start, with what."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import pytest
from domains import DOMAIN

from lime_planner.ros.launching import flag, log_arguments, rviz_remappings

ROOT = Path(__file__).resolve().parents[2]
FILES = ("planner", "kinova", "demo")


class Argument:
    def __init__(self, name: str, *, default_value: str, description: str, choices: Any = None) -> None:
        self.name, self.default, self.description, self.choices = name, default_value, description, choices


class Configuration:
    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: dict[str, str]) -> str:
        return context[self.name]  # a KeyError: the file does not declare what it uses


def load(name: str, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The entities of a launch file."""
    modules = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": Argument,
            "OpaqueFunction": lambda function: function,
            "SetEnvironmentVariable": lambda *pair: pair,
        },
        "launch.substitutions": {"LaunchConfiguration": Configuration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": lambda **given: given},
        "launch_ros.parameter_descriptions": {"ParameterValue": lambda value, value_type: (value.name, value_type)},
    }
    for module, names in modules.items():
        stand_in = types.ModuleType(module)
        stand_in.__dict__.update(names)
        monkeypatch.setitem(sys.modules, module, stand_in)
    spec = importlib.util.spec_from_file_location(f"{name}_launch", ROOT / "launch" / f"{name}.launch.py")
    assert spec is not None and spec.loader is not None
    file = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(file)
    entities: list[Any] = file.generate_launch_description()
    return entities


def started(name: str, monkeypatch: pytest.MonkeyPatch, **given: str) -> dict[str, dict[str, Any]]:
    """The nodes that a launch file starts, by executable."""
    entities = load(name, monkeypatch)
    arguments = [entity for entity in entities if isinstance(entity, Argument)]
    context = {argument.name: argument.default for argument in arguments}
    assert given.keys() <= context.keys()
    [nodes] = [entity for entity in entities if isinstance(entity, types.FunctionType)]
    return {node["executable"]: node for node in nodes({**context, **given})}


@pytest.mark.parametrize("name", FILES)
def test_every_file_takes_the_common_arguments(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = {entity.name: entity for entity in load(name, monkeypatch) if isinstance(entity, Argument)}
    clouds = set() if name == "demo" else {"leaf_cloud", "stem_cloud", "labelled_cloud"}
    wanted = {"use_sim_time", "namespace", "log_level", "rviz"} | clouds
    assert wanted <= arguments.keys() and all(argument.description for argument in arguments.values())
    nodes = started(name, monkeypatch)
    assert "rviz2" not in nodes
    assert {**nodes["planner_node"]["parameters"][-1]}["use_sim_time"] is False
    nodes = started(name, monkeypatch, namespace="farm/left", log_level="debug", use_sim_time="true", rviz="true")
    planner = nodes["planner_node"]
    assert planner["namespace"] == "farm/left" and planner["parameters"][-1]["use_sim_time"] is True
    assert planner["arguments"] == ["--ros-args", "--log-level", "farm.left.lime_planner:=debug"]
    assert ("/lime_planner/markers", "/farm/left/lime_planner/markers") in nodes["rviz2"]["remappings"]
    assert Path(nodes["rviz2"]["arguments"][1]).is_file()
    with pytest.raises(ValueError, match="use_sim_time:=maybe"):
        started(name, monkeypatch, use_sim_time="maybe")


@pytest.mark.parametrize("name", ["planner", "kinova"])
def test_clouds_are_taken_from_given_topics(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = started(name, monkeypatch, stem_cloud="/camera/stems", labelled_cloud="seg", rviz="1", namespace="left")
    assert {("stem_cloud", "/camera/stems"), ("labelled_cloud", "seg")} <= set(nodes["planner_node"]["remappings"])
    assert not any(source == "leaf_cloud" for source, _ in nodes["planner_node"]["remappings"])
    assert ("/stem_cloud", "/camera/stems") in nodes["rviz2"]["remappings"]
    assert ("/leaf_cloud", "/left/leaf_cloud") in nodes["rviz2"]["remappings"]
    assert Path(nodes["planner_node"]["parameters"][0]).is_file()


def test_rviz_files_show_the_topics_that_are_remapped() -> None:
    for file in (ROOT / "rviz").iterdir():
        text = file.read_text()
        assert all(f"Value: {shown}\n" in text for shown, _ in rviz_remappings("left", {})), file


def test_flags_are_true_or_false() -> None:
    assert flag("rviz", "True") and not flag("rviz", " off ")


def test_the_log_level_is_that_of_the_node_alone() -> None:
    """The name of the logger is what rcl makes of namespace and node."""
    words = log_arguments("lime_planner", "/farm/left/", "debug")
    code = f"""
import rclpy
rclpy.init(args=["x", *{words!r}, "-r", "__ns:=/farm/left"], domain_id={DOMAIN})
node = rclpy.create_node("lime_planner")
print(node.get_logger().get_effective_level().name, rclpy.logging.get_logger("rcl").get_effective_level().name)
rclpy.shutdown()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["DEBUG", "INFO"]
