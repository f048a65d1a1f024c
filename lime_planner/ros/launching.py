"""What the launch files have in common, without `launch`: topics, log level and picture of a planner in its namespace."""

from __future__ import annotations

from collections.abc import Mapping

#: Inputs whose topics are arguments of the launch files.
CLOUDS = ("leaf_cloud", "stem_cloud", "labelled_cloud")
LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
#: Topics that the RViz files show, as a planner without a namespace has them.
_SHOWN = ("/lime_planner/markers", "/lime_planner/tool_path", "/lime_planner/target", "/leaf_cloud", "/stem_cloud")


def full_namespace(namespace: str) -> str:
    """Return a namespace with its slash in front and none at its end; empty for the root."""
    words = namespace.strip("/ ")
    return f"/{words}" if words else ""


def log_arguments(node: str, namespace: str, level: str) -> list[str]:
    """Return the arguments that set the log level of one node, and of nothing else in its process.

    Args:
        node: its name.
        namespace: its namespace, with or without slashes.
        level: one of `LOG_LEVELS`.

    Raises:
        ValueError: no such level.
    """
    if level not in LOG_LEVELS:
        raise ValueError(f"log_level:={level}: there are {', '.join(LOG_LEVELS)}")
    logger = ".".join([*full_namespace(namespace).split("/")[1:], node])
    return ["--ros-args", "--log-level", f"{logger}:={level}"]


def flag(name: str, value: str) -> bool:
    """Return a launch argument as true or false.

    Raises:
        ValueError: it is neither.
    """
    known = {"true": True, "1": True, "yes": True, "on": True, "false": False, "0": False, "no": False, "off": False}
    if value.strip().lower() not in known:
        raise ValueError(f"{name}:={value}: it is true or false")
    return known[value.strip().lower()]


def cloud_remappings(topics: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the remappings of the inputs that have a topic of another name.

    Args:
        topics: topic by input; empty where it has the input's own name.
    """
    return [(name, topic) for name, topic in topics.items() if topic]


def rviz_remappings(namespace: str, topics: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the remappings that show a planner's own topics in RViz.

    Args:
        namespace: of the planner.
        topics: see `cloud_remappings`; relative ones are in the namespace.
    """
    space = full_namespace(namespace)
    pairs = []
    for shown in _SHOWN:
        topic = topics.get(shown[1:]) or shown[1:]
        actual = topic if topic.startswith("/") else f"{space}/{topic}"
        if actual != shown:
            pairs.append((shown, actual))
    return pairs
