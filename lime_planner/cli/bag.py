"""The arguments of the commands that read recordings, and the reading."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lime_planner.robot.model import Robot
    from lime_planner.scene.from_recording import RecordedScene


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
        values: parameters that were set; those of the labels and of a moving base are used.
        robot: the arm, whose own points are removed.
        padding_m: how close to the arm these are.
        topics: topics by input, where they were given.
        at_s: which moment [s]; None for the end.

    Raises:
        SceneError: see `read_recording`.
        ParameterError: two classes share a label.
    """
    from lime_planner.cli.plan import OF_RECORDINGS, label_options
    from lime_planner.collision.arm_filter_live import make_arm_filter
    from lime_planner.scene.from_clouds import Labels
    from lime_planner.scene.from_recording import Frame, read_recording

    of = label_options(values)
    classes = (tuple(of[name]) for name in ("leaf_labels", "stem_labels", "fruit_labels", "ignored_labels", "class_costs"))
    labels = Labels(of["label_field"], *classes)
    moving = {name: values[name] for name in OF_RECORDINGS if name in values}
    frame = Frame(robot.planning_frame, robot.joint_names, make_arm_filter(robot), padding_m, **moving)
    return read_recording(path, frame, topics=topics, at_s=at_s, labels=labels)
