"""The programs `planner_node`, `scene_node` and `mock_arm_node`: their help, and a quiet end while Python still imports.

Nothing heavy is imported here: help comes at once, and a signal in the seconds that the libraries take to load ends the program without
a traceback, with code 0 like one that comes later (`lime_planner.ros.runtime`).
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import textwrap
from collections.abc import Sequence

from lime_planner.core.signals import ENDING

_ARGUMENTS = """
ROS arguments follow --ros-args:
  -p seed:=3                        a parameter
  --params-file FILE                parameters from a file; its keys are /**, a
                                    node's full name, or one with * and ** in it
  -r __ns:=/left                    a namespace, of the node and its topics
  -r stem_cloud:=/camera/stems      another topic
  {level}a level for this node alone
"""

_HELP = {
    "planner_node": """\
usage: planner_node [--help] [--ros-args ...]

Plans how the arm reaches a lime through its leaves, past its stems, and sends
the motion (node lime_planner).

listens to:  leaf_cloud and stem_cloud, or labelled_cloud; grasp_target;
             joint_states; robot_description (with -p robot:=topic)
publishes:   joint_trajectory, ~/status, ~/target, ~/tool_path, ~/markers,
             /diagnostics
serves:      ~/plan      plan and move            ~/execute  move as previewed
             ~/preview   plan, and show it        ~/retreat  back out again
             ~/preview_to  the same, to a pose    ~/stop     stop all of it
{arguments}
`lime-planner parameters` lists every parameter with its range, `lime-planner
doctor` tells what is missing.

examples:
  ros2 run lime_planner planner_node --ros-args -p robot:=kinova_j2n6s300
  ros2 run lime_planner planner_node --ros-args --params-file planner.yaml
  ros2 service call /lime_planner/preview std_srvs/srv/Trigger
""",
    "scene_node": """\
usage: scene_node [--help] [--ros-args ...]

Publishes a scene from a file, or a plant that it grows, in place of cameras
(node scene): leaf_cloud and stem_cloud, or labelled_cloud; grasp_target.
{arguments}
parameters:
{parameters}

examples:
  ros2 run lime_planner scene_node
  ros2 run lime_planner scene_node --ros-args -p file:=scan.ply -p rate_hz:=10.0
""",
    "mock_arm_node": """\
usage: mock_arm_node [--help] [--ros-args ...]

An arm without an arm, for trials (node mock_arm): carries joint_trajectory out
as its controller would, and publishes joint_states.
{arguments}
parameters:
{parameters}

examples:
  ros2 run lime_planner mock_arm_node --ros-args -p controller:=kinova
  ros2 run lime_planner mock_arm_node --ros-args -p lag_s:=0.1
""",
}
_NODES = {"planner_node": "lime_planner", "scene_node": "scene", "mock_arm_node": "mock_arm"}


def planner_node() -> int:
    """Run the planner; the program `planner_node`."""
    return _run("planner_node")


def scene_node() -> int:
    """Run the scene; the program `scene_node`."""
    return _run("scene_node")


def mock_arm_node() -> int:
    """Run the simulated arm; the program `mock_arm_node`."""
    return _run("mock_arm_node")


def _run(name: str) -> int:
    for number in ENDING:  # until the node has handlers of its own
        signal.signal(number, lambda *_: os._exit(0))
    code = answered(name, sys.argv[1:])
    if code is not None:
        return code
    code = importlib.import_module(f"lime_planner.ros.nodes.{name}").main()
    return int(code)


def answered(name: str, arguments: Sequence[str]) -> int | None:
    """Answer what needs no node: help, and arguments that mean nothing to it.

    Args:
        name: of the program.
        arguments: of its command line, without the program's own name.

    Returns:
        The exit code; None where the node is to run.
    """
    own = _own(arguments)
    if "-h" in own or "--help" in own:
        print(_help(name), end="")
        return 0
    if own:
        cure = f"parameters and topics follow --ros-args, as in: {name} --ros-args -p seed:=3"
        print(f"{name}: {own[0]!r} means nothing to it; {cure} (--help tells more)", file=sys.stderr)
        return 2
    return None


def _own(arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are not ROS's: those are between `--ros-args` and `--`, or the end."""
    own, ros = [], False
    for argument in arguments:
        if argument == "--ros-args":
            ros = True
        elif ros and argument == "--":
            ros = False
        elif not ros:
            own.append(argument)
    return own


def _help(name: str) -> str:
    table = ""
    if "{parameters}" in _HELP[name]:
        rows = importlib.import_module(f"lime_planner.ros.nodes.{name}").parameter_help()
        table = "\n".join(
            textwrap.fill(f"{row:<18} {text}", 80, initial_indent="  ", subsequent_indent=21 * " ", break_on_hyphens=False)
            for row, text in rows
        )
    return _HELP[name].format(arguments=_ARGUMENTS.format(level=f"--log-level {_NODES[name]}:=debug".ljust(34)), parameters=table)
