"""ROS parameter files, read without ROS: what they set for the planner node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import PARAMETERS, read_yaml, settings_from, validate

NODE = "lime_planner"

#: Parameters that every ROS node has.
_OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides")


@dataclass(frozen=True)
class ParameterFile:
    """What a file sets.

    Attributes:
        values: checked values of the planner's own parameters, by name.
        use_sim_time: whether the node takes its time from `/clock`.
    """

    values: Mapping[str, Any]
    use_sim_time: bool = False


def read_parameter_file(path: Path, node: str = NODE) -> ParameterFile:
    """Read what a ROS parameter file sets for a node, whatever its namespace, and check it.

    Raises:
        ParameterError: the file cannot be read, holds nothing for the node, or a value that is not allowed.
    """
    import yaml

    try:
        content = read_yaml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    except yaml.YAMLError as error:
        raise ParameterError(f"{path}: is not YAML ({' '.join(str(error).split())})") from None
    given: dict[str, Any] = {}
    sections = [(str(key), value) for key, value in content.items()] if isinstance(content, dict) else []
    mine = [(key, section) for key, section in sections if key.rsplit("/", 1)[-1] in (node, "**")]
    if not mine:
        there = ", ".join(key for key, _ in sections) or "none"
        raise ParameterError(f"{path}: has no section `/**/{node}` or `/**` with `ros__parameters`; its sections are {there}")
    for key, section in mine:
        values = section.get("ros__parameters") if isinstance(section, dict) else None
        if not isinstance(values, dict):
            raise ParameterError(f"{path}: the section {key} has no `ros__parameters`")
        given.update({str(name): value for name, value in values.items()})
    own = {name: value for name, value in given.items() if name.split(".")[0] not in _OF_EVERY_NODE}
    try:
        checked = {name: validate(name, value) for name, value in own.items()}
        settings_from({name: value for name, value in checked.items() if name in PARAMETERS})
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None
    return ParameterFile(checked, bool(given.get("use_sim_time", False)))
