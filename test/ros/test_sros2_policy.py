"""The permissions file names what the planner node opens, and nothing else."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from domains import DOMAIN
from rclpy.parameter import Parameter
from ros_fakes import build_fake

from lime_planner.ros.nodes.planner_node import PlannerNode

PROFILE = ET.parse(Path(__file__).resolve().parents[2] / "config" / "sros2_policy.xml").getroot().find(".//profile")
#: Opened where tf2 is installed; the /clock and the description only when asked for.
SOMETIMES = {"/tf", "/tf_static"}
#: What another part of rclpy may or may not open, by its version.
BY_VERSION = {"/parameter_events", "/lime_planner/get_type_description"}


@pytest.fixture(scope="module")
def node() -> Iterator[PlannerNode]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    overrides = [Parameter("robot", value="topic"), Parameter("use_sim_time", value=True)]
    node = PlannerNode(build_fake, context=context, parameter_overrides=overrides)
    yield node
    node.shut_down()
    node.destroy_node()
    context.try_shutdown()


def listed(kind: str, way: str) -> set[str]:
    assert PROFILE is not None
    names = [entry.text or "" for group in PROFILE.findall(f"{kind}s[@{way}='ALLOW']") for entry in group]
    full = {name.replace("~", "/lime_planner") if name.startswith("~") else "/" + name.lstrip("/") for name in names}
    assert len(full) == len(names), "named twice"
    return full


@pytest.mark.parametrize(
    ("kind", "way", "look"),
    [
        ("topic", "publish", "get_publisher_names_and_types_by_node"),
        ("topic", "subscribe", "get_subscriber_names_and_types_by_node"),
        ("service", "reply", "get_service_names_and_types_by_node"),
    ],
)
def test_it_lists_what_the_node_opens(node: PlannerNode, kind: str, way: str, look: str) -> None:
    opened = {name for name, _ in getattr(node, look)("lime_planner", "/")}
    allowed = listed(kind, way)
    assert opened - allowed == set()
    assert allowed - opened <= SOMETIMES | BY_VERSION
    assert not {name for name in allowed if "*" in name}
