"""The arguments that several commands share, and what they name: topics, parameters, scenes, recordings, the arm."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS, Settings, parse_assignment

if TYPE_CHECKING:
    from lime_planner.robot.model import Robot
    from lime_planner.scene.from_recording import RecordedScene
    from lime_planner.scene.scene import Scene

#: The node's parameters that say how a file's labels are read.
LABEL_PARAMETERS = ("label_field", "leaf_labels", "stem_labels", "fruit_labels", "ignored_labels", "class_costs")
#: And how a base that moves is taken: recordings know of it.
OF_RECORDINGS = ("fixed_frame", "max_base_motion_m", "viewpoints")

#: Option, input of the planner, what comes there.
_TOPICS = (
    ("--leaf", "leaf_cloud", "leaf points"),
    ("--stem", "stem_cloud", "stem points"),
    ("--labelled", "labelled_cloud", "points with labels, instead of these two"),
    ("--target", "grasp_target", "the grasp pose"),
    ("--joint-states", "joint_states", "the arm's state"),
)


_NAME = r"[A-Za-z_][A-Za-z0-9_]*"


def _topic(text: str) -> str:
    """Parse the name of a topic."""
    if not re.fullmatch(rf"(~?/)?{_NAME}(/{_NAME})*", text):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no name of a topic: letters, digits and _, parts divided by /, none begins with a digit"
        )
    return text


def _namespace(text: str) -> str:
    """Parse a namespace, with or without slashes around it."""
    if text.strip("/") and not re.fullmatch(rf"/?{_NAME}(/{_NAME})*/?", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no namespace: letters, digits and _, parts divided by /, none begins with a digit")
    return text


def add_parameters(parser: argparse.ArgumentParser, *, live: bool = True) -> None:
    """Declare the options for the planner's parameters.

    Args:
        parser: the command's.
        live: the namespace is that of a running planner's topics, too.
    """
    parser.add_argument("--params", type=Path, metavar="FILE", help="the planner's ROS parameter file")
    what = "namespace of the planner and its topics" if live else "with --params: namespace of the planner whose section counts"
    parser.add_argument("--namespace", default="", type=_namespace, metavar="NS", help=what)
    parser.add_argument(
        "--set", action="append", default=[], metavar="PARAMETER=VALUE", dest="assignments", help="set any parameter; repeatable"
    )


def add_label_field(parser: argparse.ArgumentParser) -> None:
    """Declare the option that names the label of PLY and PCD files: the parameter `label_field`, for those who need no other."""
    parser.add_argument("--label-field", metavar="NAME", help="field of the label in PLY and PCD files (default label)")


def add_topics(parser: argparse.ArgumentParser, *, without: tuple[str, ...] = ()) -> None:
    """Declare the options for the topics.

    Args:
        parser: the command's.
        without: inputs that have no option.
    """
    for option, name, what in _TOPICS:
        if name not in without:
            parser.add_argument(option, type=_topic, metavar="TOPIC", dest=f"topic_{name}", help=f"{what} (default {name})")


def topics_of(args: argparse.Namespace) -> dict[str, str]:
    """Return the topics that were given, by input."""
    given = {name: getattr(args, f"topic_{name}", None) for _, name, _ in _TOPICS}
    return {name: topic for name, topic in given.items() if topic}


def add_bag(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bag", type=Path, metavar="BAG", help="a recording (rosbag2 folder, .mcap, .db3)")
    parser.add_argument("--at", type=float, metavar="S", help="moment of the recording, from its beginning [s] (default: its end)")


def read_bag(
    path: Path, values: Mapping[str, Any], robot: Robot, padding_m: float, topics: Mapping[str, str], at_s: float | None
) -> RecordedScene:
    """Read one moment of a recording.

    Args:
        path: the recording.
        values: parameters that were set; those of the labels, of a moving base and of the cameras are used.
        robot: the arm, whose own points are removed.
        padding_m: how close to the arm these are.
        topics: topics by input, where they were given.
        at_s: which moment [s]; None for the end.

    Raises:
        SceneError: see `read_recording`.
        ParameterError: two classes share a label.
    """
    from lime_planner.collision.arm_filter import make_arm_filter
    from lime_planner.core.parameters import frozen
    from lime_planner.scene.from_clouds import Labels
    from lime_planner.scene.from_recording import Frame, read_recording

    of = label_options(values)
    classes = (tuple(of[name]) for name in ("leaf_labels", "stem_labels", "fruit_labels", "ignored_labels", "class_costs"))
    labels = Labels(of["label_field"], *classes)
    given = frozen({name: values[name] for name in OF_RECORDINGS if name in values})
    frame = Frame(robot.planning_frame, robot.joint_names, make_arm_filter(robot), padding_m, **given)
    return read_recording(path, frame, topics=topics, at_s=at_s, labels=labels)


def read_parameters(args: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters that the options set: `--set` wins over the file, an option of its own over both.

    Raises:
        ParameterError: unknown, out of range, or one that is set here and means nothing here; a node's file may hold such.
    """
    from lime_planner.cli.parameter_file import given_parameters

    values = given_parameters(args)
    for name in ("planner", "iterations", "seed"):
        if getattr(args, name) is not None:
            values[name] = getattr(args, name)
    if getattr(args, "freedom", None) is not None:
        values["grasp_freedom"] = args.freedom
    if args.time is not None:
        values["time_budget_s"], values["iterations"] = args.time, 0
    used = (*LABEL_PARAMETERS, *(OF_RECORDINGS if getattr(args, "bag", None) is not None else ()))
    assigned = dict(parse_assignment(text) for text in args.assignments)
    idle = [name for name in assigned if name in NODE_PARAMETERS and name not in used]
    if idle:
        raise ParameterError(f"{', '.join(idle)}: only the node has a use for this parameter")
    return values


def label_options(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the parameters say about labels, as `Scene.load` takes it.

    Raises:
        ParameterError: two classes share a label.
    """
    from lime_planner.scene.labels import fruit_in_force

    of = {name: values.get(name, NODE_PARAMETERS[name].default) for name in LABEL_PARAMETERS}
    classes = {name: value for name, value in of.items() if name != "label_field"}
    return {**of, "fruit_labels": fruit_in_force(**classes)}


def read_scene(args: argparse.Namespace, values: dict[str, Any]) -> Scene:
    """Load the scene with the labels that the parameters name; its frame is empty where the file names none.

    Raises:
        SceneError: see `Scene.load`.
        ParameterError: see `label_options`.
    """
    from lime_planner.scene.scene import Scene

    return Scene.load(args.scene, scale=args.scale, offset=args.offset, **label_options(values))


def load_arm(settings: Settings) -> Robot:
    """Load the arm of the settings, and say on standard error what is suspicious about its description.

    Raises:
        RobotError: see `load_robot`.
        ParameterError: `robot` is `topic`.
    """
    from lime_planner.output.console import warn
    from lime_planner.robot.model import load_robot

    if settings.robot == "topic":
        raise ParameterError("robot: `topic` needs ROS; name a built-in model or a URDF file")
    robot = load_robot(
        settings.robot,
        joint_names=settings.arm_joints or None,
        planning_frame=settings.planning_frame or None,
        tool_frame=settings.tool_frame or None,
        locked=settings.locked,
    )
    for sentence in robot.warnings:
        warn(sentence)
    return robot
