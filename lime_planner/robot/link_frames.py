"""Where an arm carries the links of its description, flanges and cameras among them, and what is bolted to these."""

from __future__ import annotations

import functools
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from lime_planner.core.geometry import clean_name
from lime_planner.core.types import Array
from lime_planner.robot.model import Robot
from lime_planner.robot.urdf import parse_urdf


@dataclass(frozen=True, eq=False)
class Carried:
    """Something that an arm carries.

    Attributes:
        link: of the description that it is bolted to.
        joint: of the arm that moves it, counted from 1; 0 for none: it stands still with the base.
        T_joint_thing: (4, 4) in that joint's frame.
    """

    link: str
    joint: int
    T_joint_thing: Array

    def at(self, robot: Robot, q: Array) -> Array:
        """Return T_base_thing (4, 4) at a configuration (n,) [rad]."""
        return np.asarray(robot.link_poses(q)[self.joint] @ self.T_joint_thing)

    def beyond(self, T_thing_other: Array) -> Carried:
        """Return what is bolted to this thing, (4, 4) in its frame."""
        return Carried(self.link, self.joint, self.T_joint_thing @ T_thing_other)


@functools.lru_cache(maxsize=8)
def carried_links(robot: Robot) -> dict[str, Carried]:
    """Return every link of an arm's description that stands where its joints put it, those nearest to the tool first.

    Links behind joints that are neither the arm's nor held, such as fingers, are left out: where they are is not known.
    """
    root = parse_urdf(robot.urdf)
    above = {_link(joint, "child"): joint for joint in root.iter("joint") if joint.find("child") is not None}
    held = dict(robot.held_joints)
    at_zero = robot.link_poses(np.zeros(robot.n))
    names = [link.get("name", "") for link in root.iter("link")]

    def way_to(link: str) -> list[ET.Element]:
        way: list[ET.Element] = []
        while link in above and len(way) <= len(names):
            way.append(above[link])
            link = _link(above[link], "parent")
        return way[::-1]

    before = [joint.get("name", "") for joint in way_to(robot.planning_frame)]
    T_root_planning = _product(way_to(robot.planning_frame), held)
    found: list[tuple[int, int, str, Carried]] = []
    for name in names:
        way = way_to(name)
        movers = [joint for joint in way if joint.get("type") != "fixed" and joint.get("name", "") not in before]
        own = [robot.joint_names.index(joint.get("name", "")) + 1 for joint in movers if joint.get("name", "") in robot.joint_names]
        if len(own) != sum(joint.get("name", "") not in held for joint in movers):
            continue
        number = max(own, default=0)
        T_base_link = np.linalg.inv(T_root_planning) @ _product(way, held)
        apart = 0 if clean_name(name) == clean_name(robot.tool_frame) else 1
        found.append((-number, apart, clean_name(name), Carried(clean_name(name), number, np.linalg.inv(at_zero[number]) @ T_base_link)))
    return {name: carried for _, _, name, carried in sorted(found, key=lambda entry: entry[:3])}


def _link(joint: ET.Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _numbers(element: ET.Element | None, name: str, default: str) -> Array:
    text = default if element is None else element.get(name, default)
    return np.array([float(word) for word in text.split()])


def _product(way: list[ET.Element], held: dict[str, float]) -> Array:
    """Multiply the transforms of joints, root first: held ones at their positions, the others at zero."""
    T = np.eye(4)
    for joint in way:
        origin = joint.find("origin")
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = _rotation(_numbers(origin, "rpy", "0 0 0")), _numbers(origin, "xyz", "0 0 0")
        position = held.get(joint.get("name", ""), 0.0)
        if position:
            axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
            axis /= np.linalg.norm(axis)
            moved = np.eye(4)
            if joint.get("type") == "prismatic":
                moved[:3, 3] = position * axis
            else:
                cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
                moved[:3, :3] += np.sin(position) * cross + (1.0 - np.cos(position)) * cross @ cross
            own = own @ moved
        T = T @ own
    return T


def _rotation(rpy: Array) -> Array:
    """The rotation (3, 3) of roll, pitch and yaw about fixed axes [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)
