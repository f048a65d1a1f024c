"""ROS parameter files, read without ROS: what they set for the planner node, by rcl's rules.

A file is one map. Above `ros__parameters` stand node names, whole or split into namespaces: `/left/lime_planner`, or `left` with
`lime_planner` below it. `*` stands for one part of a name, `**` for any number of parts, none included. Every section that matches the
node's full name counts, in the order of the file, a later one over an earlier one. What is set for other nodes is passed over, and so are
parameters that a shared section sets for them.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS, parse_assignment, read_yaml, settings_from, unknown_names, validate
from lime_planner.core.validation import TextFileError, read_text

NODE = "lime_planner"

_VALUES = "ros__parameters"
_PART = re.compile(r"\*{1,2}|[A-Za-z0-9_]+")


@dataclass(frozen=True)
class ParameterFile:
    """What a file sets.

    Attributes:
        values: checked values of the planner's own parameters, by name.
        use_sim_time: whether the node takes its time from `/clock`.
        warnings: a sentence for each value that means nothing to the planner node, as the node logs it.
    """

    values: Mapping[str, Any]
    use_sim_time: bool = False
    warnings: tuple[str, ...] = ()


def read_parameter_file(path: Path, namespace: str = "", node: str = NODE) -> ParameterFile:
    """Read what a ROS parameter file sets for a node, and check it.

    Args:
        path: the file.
        namespace: of the node, with or without its slash.
        node: its name.

    Raises:
        ParameterError: the file cannot be read, rcl would refuse it, it holds nothing for the node, or a value that is not allowed.
    """
    import yaml

    name = "/".join(["", *namespace.strip("/").split("/"), node] if namespace.strip("/") else ["", node])
    try:
        content = read_yaml(read_text(path))
    except TextFileError as error:
        raise ParameterError(f"{path}: cannot be read ({error})") from None
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        problem = str(getattr(error, "problem", None) or "it cannot be read on from there")
        where = "" if mark is None else f" (line {mark.line + 1}, column {mark.column + 1}: {problem})"
        raise ParameterError(f"{path}: is not YAML{where}") from None
    try:
        sections = list(_sections(content))
        mine = [values for key, values in sections if matches(key, name)]
        if not mine:
            there = ", ".join(key for key, _ in sections) or "none"
            hint = f"; --namespace tells which {node} is meant" if any(key.endswith(f"/{node}") for key, _ in sections) else ""
            raise ParameterError(f"has no section for {name}, such as `/**` with `{_VALUES}`; its sections are {there}{hint}")
        given = {str(key): value for values in mine for key, value in _flat(values)}
        warnings = unknown_names(given)
        checked = {key: validate(key, value) for key, value in given.items() if key in PARAMETERS or key in NODE_PARAMETERS}
        settings_from(checked)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None
    return ParameterFile(checked, bool(given.get("use_sim_time", False)), tuple(warnings))


def given_parameters(args: argparse.Namespace) -> dict[str, Any]:
    """Return what `--params` with `--namespace`, `--set` and `--label-field` set together, the later over the former.

    Warnings about the file go to standard error.

    Raises:
        ParameterError: see `read_parameter_file` and `parse_assignment`.
    """
    values: dict[str, Any] = {}
    if args.params is not None:
        file = read_parameter_file(args.params, args.namespace)
        values |= file.values
        for sentence in file.warnings:
            print(f"{args.params}: {sentence}", file=sys.stderr)
    values |= dict(parse_assignment(text) for text in args.assignments)
    field = getattr(args, "label_field", None)
    return values if field is None else {**values, "label_field": field}


def matches(key: str, name: str) -> bool:
    """Tell whether a section is for a node.

    Args:
        key: of the section, its slash in front or not.
        name: the node's full name, with its slash.

    Raises:
        ParameterError: the key is no name.
    """
    parts = key.removeprefix("/").split("/")
    for part in parts:
        if not _PART.fullmatch(part):
            what = "an empty part" if not part else f"{part!r}"
            raise ParameterError(f"the section {key} has {what} where a name, * or ** belongs")
    pattern = "".join(r"(?:/\w+)*" if part == "**" else r"/\w+" if part == "*" else f"/{re.escape(part)}" for part in parts)
    return re.fullmatch(pattern, name) is not None


def _sections(content: Any, above: str = "") -> Iterator[tuple[str, Mapping[Any, Any]]]:
    """Yield every node's key and values.

    Raises:
        ParameterError: a value where a node's name belongs, or a section that holds both values and names.
    """
    if not isinstance(content, dict) or not content:
        where = f"the section {above}" if above else "it"
        raise ParameterError(f"{where} has no `{_VALUES}`")
    if _VALUES in content:
        if not above:
            raise ParameterError(f"`{_VALUES}` stands at the top; it belongs below a node's name, or below `/**`")
        if len(content) > 1:
            others = ", ".join(str(key) for key in content if key != _VALUES)
            raise ParameterError(f"the section {above} has {others} beside `{_VALUES}`")
        if not isinstance(content[_VALUES], dict):
            raise ParameterError(f"the section {above} has no values in its `{_VALUES}`")
        yield above, content[_VALUES]
        return
    for key, below in content.items():
        yield from _sections(below, f"{above}/{str(key).removeprefix('/')}" if above else str(key))


def _flat(values: Mapping[Any, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield parameters, those in maps as `outer.inner`."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value
