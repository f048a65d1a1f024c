"""The generated parts of the reference, as Markdown: parameters, statuses and the command line, straight from the code."""

from __future__ import annotations

import argparse
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from lime_planner.cli import main as cli
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS, Parameter
from lime_planner.core.status import Status

POLICY = Path(__file__).resolve().parents[2] / "config" / "sros2_policy.xml"

#: What to do about each outcome, where there is something to be done.
CURES = {
    Status.SUCCEEDED: "Nothing.",
    Status.NO_TARGET: "Publish a fruit on `fruit_target` (or `grasp_candidates`, or a pose on `grasp_target`); in a file, give `target_pose`, `--fruit` or `--target`.",
    Status.NO_CLOUD: "Start the camera; look at `stem_cloud.received` in `/diagnostics`. A plant without stems: `allow_empty_stem_cloud`.",
    Status.NO_JOINT_STATE: "Start the arm's driver, or remap `joint_states` to its topic. The joints must have the names in `arm_joints`.",
    Status.STALE_INPUT: "The sentence names the input and its age. Look whether its publisher still runs; compare the clocks.",
    Status.BAD_INPUT: "The sentence names the field, what was found and what was expected. Correct the sender.",
    Status.TF_ERROR: "Publish the transform between the two frames named, or give it in `static_transforms`.",
    Status.START_INVALID: "Move the arm by hand or with its own software to a configuration within the limits and clear of itself.",
    Status.START_IN_STEM: "Back the arm out by hand. If nothing is there, the arm sees itself: raise `self_filter_padding_m`, or check the calibration.",
    Status.NO_IK_SOLUTION: "The target is out of reach, or its direction is: ask for the fruit, or set `grasp_freedom: cone`. +z of a target pose points out of the palm.",
    Status.GOAL_IN_STEM: "The sentence counts what became of the approaches and names the commonest obstacle. For an exact pose: ask for the fruit, or set `grasp_freedom: cone`. Points of the fruit's own stalk: `stalk_radius_m`, for an exact pose `target_exclusion_radius_m`.",
    Status.NO_PATH: "More `iterations`, another start, or another approach.",
    Status.TIMED_OUT: "More `time_budget_s`, another start, or another approach.",
    Status.LEAF_BUDGET_EXCEEDED: "Raise `max_leaf_contact_rad` above the contact named, or approach from another side.",
    Status.UNSEEN: "Look at the plant from another side (more views; `~/look` or `look_first` with a camera on the arm), raise `unseen_price`, or raise `max_unseen_contact_rad` above the length named.",
    Status.PATH_INVALID: "Ask again (another seed). If it stays: more `stem_margin_m`; after a preview, plan again, because the scene has changed.",
    Status.PREEMPTED: "Nothing: the newer request has its own answer.",
    Status.CANCELLED: "Nothing: somebody called `~/stop`, or pressed Ctrl-C.",
    Status.STEM_APPEARED: "Look at the place; then plan again, or set `replan_attempts`.",
    Status.EXECUTION_DEVIATED: "Look what holds the arm. If nothing does: a controller paused for longer than `progress_timeout_s`, or an arm that cannot keep up; lower `velocity_scaling`.",
    Status.NOTHING_TO_EXECUTE: "Call `~/preview` first; any other request discards its plan.",
    Status.ARM_MOVING: "Wait, or call `~/stop`. An arm that trembles: raise `stillness_rad`.",
    Status.NO_CONTROLLER: "Start the controller, or remap `joint_trajectory` to its topic; with `controller: jtc_action` set `trajectory_action`, and see why it rejects.",
    Status.MOTION_DISABLED: "Set `motion_enabled` to true when the arm may move.",
    Status.NOT_READY: "Wait: after an update the kernels compile for a minute or two. The sentence says what is going on.",
    Status.NOT_INSTALLED: "The sentence says what to install, such as `pip install 'lime_planner[experiments]'`; `lime-planner doctor` lists what is there.",
    Status.INTERNAL_ERROR: "A defect of ours. The log has the traceback; please report it.",
}


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, str) else str(value)


def parameter_table(table: dict[str, Parameter] | tuple[Parameter, ...]) -> str:
    """Return a Markdown table of parameters."""
    rows = table.values() if isinstance(table, dict) else table
    lines = ["| name | default | range | meaning |", "|---|---|---|---|"]
    for p in rows:
        fixed = " Set at start only." if p.read_only else ""
        span = "" if p.range_text == "any" else f"{p.range_text} {p.unit}".strip()
        lines.append(f"| `{p.name}` | `{_value(p.default)}` {p.unit} | {span} | {p.description}{fixed} |")
    return "\n".join(lines)


def planning_parameters() -> str:
    """Return the parameters of the pipeline."""
    return parameter_table(PARAMETERS)


def node_parameters() -> str:
    """Return the parameters of the node alone."""
    return parameter_table(NODE_PARAMETERS)


def statuses() -> str:
    """Return every outcome, what it means and what to do about it.

    Raises:
        KeyError: an outcome without advice.
    """
    lines = ["| code | means | what to do |", "|---|---|---|"]
    lines += [f"| `{status.name}` | {status.value} | {CURES[status]} |" for status in Status]
    return "\n".join(lines)


def commands() -> str:
    """Return the help of every command, as it is printed."""
    found = []
    for command in cli.COMMANDS:
        if cli._exists(command):
            text = _leaf(cli.build_parser([*command.words, "--help"]), command.words).format_help()
            found.append(f"## lime-planner {' '.join(command.words)}\n\n{_box(text)}\n")
    top = cli.build_parser([]).format_help()
    return f"{_box(top)}\n\n" + "\n".join(found)


def _leaf(parser: argparse.ArgumentParser, words: tuple[str, ...]) -> argparse.ArgumentParser:
    for word in words:
        [group] = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
        parser = group.choices[word]
    return parser


def _box(text: str) -> str:
    return "```text\n" + text.rstrip() + "\n```"


def security_rights() -> str:
    """Return what the SROS2 policy of the package allows the planner, and nothing else does."""
    profile = ET.parse(POLICY).getroot().find("./enclaves/enclave/profiles/profile")
    assert profile is not None
    lines = ["| may | names |", "|---|---|"]
    for words, kind, way in (
        ("publish", "topics", "publish"),
        ("subscribe to", "topics", "subscribe"),
        ("serve", "services", "reply"),
        ("call", "services", "request"),
    ):
        names = [f"`{(element.text or '').strip()}`" for group in profile.findall(kind) if group.get(way) == "ALLOW" for element in group]
        lines.append(f"| {words} | {', '.join(names) or 'nothing'} |")
    return "\n".join(lines)


#: What stands in a page as `{{ name }}`, alone on its line.
PARTS = {
    "security_rights": security_rights,
    "planning_parameters": planning_parameters,
    "node_parameters": node_parameters,
    "statuses": statuses,
    "commands": commands,
}


def fill(markdown: str) -> str:
    """Replace the placeholders of a page.

    Raises:
        KeyError: a placeholder that names no part.
    """
    return re.sub(r"^\{\{ (\w+) \}\}$", lambda match: PARTS[match[1]](), markdown, flags=re.MULTILINE)
