"""Writes docs/reference/interfaces.md from the running nodes: what they open, as the ROS graph reports it.

python docs/tools/interfaces.py           # write the page
python docs/tools/interfaces.py --check   # fail when the page is not what the nodes open

The three nodes run in this process, on this machine only; the planner gets no robot, so nothing is compiled.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", str(60 + os.getpid() % 40))

import rclpy
from rclpy.node import Node

from lime_planner.core.errors import RobotError
from lime_planner.ros.nodes.mock_arm_node import TABLE, MockArmNode
from lime_planner.ros.nodes.planner_node import PlannerNode
from lime_planner.ros.nodes.scene_node import _PARAMETERS as SCENE_PARAMETERS
from lime_planner.ros.nodes.scene_node import SceneNode

sys.path.insert(0, str(Path(__file__).resolve().parent))
from reference import parameter_table

PAGE = Path(__file__).resolve().parent.parent / "reference" / "interfaces.md"
FRAME = Path(__file__).resolve().parent / "interfaces.in.md"

#: What each name is for. A name that a node opens and that is missing here, or the other way round, is an error.
MEANINGS: dict[str, dict[str, str]] = {
    "lime_planner": {
        "leaf_cloud": "Leaf points: touching them costs. Optional float field `permeability_cost` (0 or more, default 1) multiplies the leaf weight.",
        "stem_cloud": "Stems, branches, wires, stakes, other fruit: never touched.",
        "labelled_cloud": "Instead of the two: one cloud with an integer field, see `label_field`. Labels that are neither leaf nor ignored are never touched.",
        "grasp_target": "The pose that the tool frame must reach at the fruit; +z points out of the palm. `grasp_freedom` says what it leaves open. Of the three kinds of target the newest counts; a bad one clears the one before.",
        "fruit_target": "The centre of a fruit; the planner chooses how to grasp it.",
        "grasp_candidates": "A grasp detector's list, up to 2,000 poses of the tool: any of them will do.",
        "joint_states": "The measured arm. Further joints and any order are normal.",
        "robot_description": "A URDF; read only with `robot: topic`, never during a plan or a motion.",
        "joint_trajectory": "The motion, see below. Never latched.",
        "~/status": "`plan_id`, `phase`, code and sentence of the newest request, target, every figure of the plan; `execution_code` when the motion has ended.",
        "~/target": "The target pose as accepted, or the grasp that was chosen.",
        "~/tool_path": "Tool poses along the newest plan.",
        "~/markers": "Clouds as used, path coloured by leaf contact, target, the approaches that were tried by what became of them, exclusion sphere, keep-out boxes; only made while somebody subscribes.",
        "/diagnostics": "Health, once a second: age and counts of every input, state of the worker, last answer.",
        "~/plan": "**Moves the arm.** Plans to the newest target from where the arm rests, and sends the motion.",
        "~/preview": "Plans and shows the path; moves nothing.",
        "~/preview_to": "The same for the goal in the request (its start is ignored); returns the tool path, empty when there is none.",
        "~/execute": "**Moves the arm.** Checks the previewed plan again, against the newest clouds and joint state, and sends it.",
        "~/plan_and_wait": "**Moves the arm.** As `~/plan`, but answers when the arm rests again: with the motion's verdict (`execution_code`) where one was sent.",
        "~/look": "**Moves the arm.** Looks with the camera on the arm (`camera_frame`) at what is unseen on the way to the target.",
        "~/retreat": "**Moves the arm.** Backs out along the motion executed last, checked again.",
        "~/stop": "Ends planning and motion. Succeeds when nothing runs, too.",
    },
    "mock_arm": {
        "joint_trajectory": "The motion to play.",
        "joint_states": "The simulated state, fingers included.",
        "~/true_joint_states": "Where the arm really is, without noise, delay and drops; for simulated cameras.",
    },
    "scene": {
        "leaf_cloud": "Leaf points (not with `labelled`).",
        "stem_cloud": "Stem points and fruit other than the target's (not with `labelled`).",
        "grasp_target": "The scene's target, where it does not know its fruit, or with `approach:=fixed`.",
        "fruit_target": "The target's fruit, where the scene knows it.",
    },
}
#: Topics that exist with certain parameters only.
ON_DEMAND = {("lime_planner", "robot_description"): "robot:=topic"}

#: Every ROS node's own, and those of tf2 where its messages are installed.
_COMMON = ("/rosout", "/parameter_events", "/clock", "/tf", "/tf_static")


def _no_robot(*_: object) -> Any:
    raise RobotError("none is needed here")


def short(node: Node, name: str) -> str:
    """Return a resolved name as the package's own documents write it."""
    private = f"/{node.get_name()}/"
    if name.startswith(private):
        return "~/" + name.removeprefix(private)
    return name if name == "/diagnostics" else name.removeprefix("/")


def profile(info: Any) -> str:
    """Return a quality of service in words."""
    qos = info.qos_profile
    return f"{qos.reliability.name.lower().replace('_', ' ')}, {qos.durability.name.lower().replace('_', ' ')}"


def endpoints(node: Node) -> list[tuple[str, str, str, str]]:
    """Return (direction, name, type, quality of service) of everything that a node opens, its own parameters' services left out."""
    found: set[tuple[str, str, str, str]] = set()
    here = (node.get_name(), node.get_namespace())
    lists = (
        ("in", node.get_subscriber_names_and_types_by_node, node.get_subscriptions_info_by_topic),
        ("out", node.get_publisher_names_and_types_by_node, node.get_publishers_info_by_topic),
    )
    for direction, names, infos in lists:
        for topic, types in names(*here):
            if topic not in _COMMON:
                offers = sorted({profile(info) for info in infos(topic) if info.node_name == node.get_name()})
                found.add((direction, short(node, topic), types[0], "; ".join(offers)))
    standard = ("rcl_interfaces/", "type_description_interfaces/")
    for service, types in node.get_service_names_and_types_by_node(*here):
        if not types[0].startswith(standard):
            found.add(("service", short(node, service), types[0], ""))
    return sorted(found)


def table(node: Node) -> str:
    """Return what a node opens as a Markdown table, in the order of `MEANINGS`.

    Raises:
        SystemExit: a name is missing in `MEANINGS`, or too many there.
    """
    opened = endpoints(node)
    meanings = MEANINGS[node.get_name()]
    known = {name for _, name, _, _ in opened}
    if known != set(meanings):
        sys.exit(f"{node.get_name()}: without a meaning {sorted(known - set(meanings))}, not opened {sorted(set(meanings) - known)}")
    order = list(meanings)
    lines = ["| | name and type | QoS | meaning |", "|---|---|---|---|"]
    for direction, name, kind, offer in sorted(opened, key=lambda row: (("in", "out", "service").index(row[0]), order.index(row[1]))):
        extra = ON_DEMAND.get((node.get_name(), name))
        note = f" (only with `{extra}`)" if extra else ""
        kind = kind.replace("/msg/", "/").replace("/srv/", "/")
        lines.append(f"| {direction} | **`{name}`**<br>`{kind}` | {offer} | {meanings[name]}{note} |")
    return "\n".join(lines)


def scene_parameters() -> str:
    """Return the scene node's parameters as a Markdown table."""
    rows = [f"| `{name}` | `{default!r}` | {meaning} |" for name, default, meaning in SCENE_PARAMETERS]
    return "\n".join(["| parameter | default | meaning |", "|---|---|---|", *rows])


def page() -> str:
    """Start the nodes and write the page's text."""
    silent = ["--ros-args", "--log-level", "fatal"]
    rclpy.init(args=[*silent, "-p", "robot:=topic"])
    planner = PlannerNode(_no_robot)
    texts = {"planner": table(planner)}
    planner.shut_down()
    planner.destroy_node()
    rclpy.shutdown()
    rclpy.init(args=[*silent, "-p", "density:=sparse"])
    for name, make in (("mock", MockArmNode), ("scene", SceneNode)):
        node = make()
        texts[name] = table(node)
        node.destroy_node()
    rclpy.shutdown()
    texts |= {"mock_parameters": parameter_table(TABLE), "scene_parameters": scene_parameters()}
    return re.sub(r"^\{\{ (\w+) \}\}$", lambda match: texts[match[1]], FRAME.read_text(encoding="utf-8"), flags=re.MULTILINE)


def main() -> int:
    """Write the page, or compare it."""
    text = page()
    if "--check" not in sys.argv:
        PAGE.write_text(text, encoding="utf-8")
        return 0
    if PAGE.read_text(encoding="utf-8") != text:
        print(f"{PAGE.name} is not what the nodes open; run: python docs/tools/interfaces.py", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
