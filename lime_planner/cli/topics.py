"""The arguments of the commands that listen to a running system: where its topics are, and which parameters the planner has."""

from __future__ import annotations

import argparse
from pathlib import Path

#: Option, input of the planner, what comes there.
_TOPICS = (
    ("--leaf", "leaf_cloud", "leaf points"),
    ("--stem", "stem_cloud", "stem points"),
    ("--labelled", "labelled_cloud", "points with labels, instead of these two"),
    ("--target", "grasp_target", "the grasp pose"),
    ("--joint-states", "joint_states", "the arm's state"),
)


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Declare the options for the planner's parameters."""
    parser.add_argument("--params", type=Path, metavar="FILE", help="the planner's ROS parameter file")
    parser.add_argument(
        "--set", action="append", default=[], metavar="PARAMETER=VALUE", dest="assignments", help="set any parameter; repeatable"
    )


def add_topics(parser: argparse.ArgumentParser, *, live: bool = True, without: tuple[str, ...] = ()) -> None:
    """Declare the options for the topics.

    Args:
        parser: the command's.
        live: with the namespace of a running planner.
        without: inputs that have no option.
    """
    if live:
        parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the planner and its topics")
    for option, name, what in _TOPICS:
        if name not in without:
            parser.add_argument(option, metavar="TOPIC", dest=f"topic_{name}", help=f"{what} (default {name})")


def topics_of(args: argparse.Namespace) -> dict[str, str]:
    """Return the topics that were given, by input."""
    given = {name: getattr(args, f"topic_{name}", None) for _, name, _ in _TOPICS}
    return {name: topic for name, topic in given.items() if topic}
