"""The text of a URDF: checks that name the culprit, the tool frame's convention, and where the meshes are."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote, urlparse

from lime_planner.core.errors import RobotError

_SHAPES: dict[str, dict[str, int]] = {"mesh": {}, "box": {"size": 3}, "cylinder": {"radius": 1, "length": 1}, "sphere": {"radius": 1}}
_JOINTS = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")


def parse_urdf(text: str) -> ET.Element:
    """Parse a URDF and check what the URDF library would drop without a word.

    Raises:
        RobotError: not XML, not a URDF, unprocessed xacro, names used twice or not declared, not one tree, or a collision shape
            that is not a mesh, box, cylinder or sphere (dropped, the arm would be thinner than it is).
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise RobotError("the URDF declares a document type or entities, which is not allowed")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise RobotError(f"the robot description is not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise RobotError(f"the robot description's outermost element is <{root.tag}>, not <robot>")
    if "<xacro:" in text:
        raise RobotError("the robot description still holds xacro elements: run xacro on it first")
    links = _names(root, "link")
    _names(root, "joint")
    if not links:
        raise RobotError("the robot description has no link")
    for joint in root.findall("joint"):
        _check_joint(joint)
    _check_tree(root, links)
    for link_element in root.findall("link"):
        for collision in link_element.findall("collision"):
            _check_collision(link_element.get("name", ""), collision)
    return root


def _check_tree(root: ET.Element, links: set[str]) -> None:
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        ends = []
        for end in ("parent", "child"):
            element = joint.find(end)
            link = "" if element is None else element.get("link", "")
            if link not in links:
                raise RobotError(f"joint {joint.get('name')} has the {end} link {link!r}, which is not declared")
            ends.append(link)
        if ends[1] in parents:
            raise RobotError(f"link {ends[1]} is the child of two joints; a URDF must be a tree")
        parents[ends[1]] = ends[0]
    roots = sorted(links - set(parents))
    if len(roots) != 1:
        raise RobotError(f"the robot description must have one root link; it has {len(roots)}{': ' * bool(roots)}{', '.join(roots)}")
    for link in sorted(links):
        above, steps = link, 0
        while above in parents and steps <= len(links):
            above, steps = parents[above], steps + 1
        if above != roots[0]:
            raise RobotError(f"link {link} is its own ancestor; a URDF must be a tree")


def _check_joint(joint: ET.Element) -> None:
    name, kind = f"joint {joint.get('name')}", joint.get("type", "")
    if kind not in _JOINTS:
        raise RobotError(f"{name} is of type {kind!r}; it must be one of {', '.join(_JOINTS)}")
    _check_origin(name, joint)
    axis = joint.find("axis")
    if axis is not None and kind in ("revolute", "continuous", "prismatic") and not any(_numbers(name, axis, "xyz", 3)):
        raise RobotError(f"{name} has an axis of length 0")
    limit = joint.find("limit")
    if kind in ("revolute", "prismatic") and limit is None:
        raise RobotError(f"{name} is {kind} and needs limits")
    if limit is not None:
        for key in ("lower", "upper", "velocity", "effort", "acceleration"):
            if key in limit.attrib:
                _numbers(name, limit, key, 1)


def _check_collision(link: str, collision: ET.Element) -> None:
    name = f"link {link}"
    _check_origin(name, collision)
    kinds = [child.tag for geometry in collision.findall("geometry") for child in geometry]
    if len(kinds) != 1 or kinds[0] not in _SHAPES:
        raise RobotError(f"{name} has the collision shape {' and '.join(kinds) or 'nothing'}; it must be one of {', '.join(_SHAPES)}")
    shape = collision.find(f"geometry/{kinds[0]}")
    for key, count in _SHAPES[kinds[0]].items():
        if shape is None or min(_numbers(name, shape, key, count)) <= 0.0:
            raise RobotError(f"{name} has a {kinds[0]} whose {key} is not positive")
    if shape is not None and "scale" in shape.attrib and not all(_numbers(name, shape, "scale", 3)):
        raise RobotError(f"{name} has a mesh of scale 0")


def _check_origin(name: str, element: ET.Element) -> None:
    origin = element.find("origin")
    for key in ("xyz", "rpy"):
        if origin is not None and key in origin.attrib:
            _numbers(name, origin, key, 3)


def _numbers(name: str, element: ET.Element, key: str, count: int) -> list[float]:
    text = element.get(key, "")
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise RobotError(f"{name} has the {key} {text!r} in its {element.tag}, which should be {count} finite number{'s' * (count > 1)}")
    return values


def _names(root: ET.Element, tag: str) -> set[str]:
    names: set[str] = set()
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise RobotError(f"the robot description has a {tag} without a name")
        if name in names:
            raise RobotError(f"the robot description has two {tag}s named {name}")
        names.add(name)
    return names


def set_joint_rpy(root: ET.Element, child_link: str, rpy: str) -> None:
    """Turn the fixed joint above `child_link` to another `rpy`, in place (re-tooling)."""
    for joint in root.findall("joint"):
        child, origin = joint.find("child"), joint.find("origin")
        if child is not None and origin is not None and child.get("link") == child_link:
            origin.set("rpy", rpy)
            return
    raise RobotError(f"the robot description has no joint with an origin above {child_link}")


def resolve_meshes(root: ET.Element, base_dir: Path | None, shares: Iterable[Path]) -> str:
    """Return the URDF's text with every collision mesh's file name made absolute and the visuals left out.

    `package://NAME/REST` is looked for as NAME/REST in each of `shares`; a relative name starts at `base_dir`.

    Raises:
        RobotError: a mesh that is not there; the text names link and file.
    """
    copy = ET.fromstring(ET.tostring(root))
    folders = list(shares)
    for link in copy.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for mesh in link.findall("collision/geometry/mesh"):
            name = mesh.get("filename", "")
            path = _find_mesh(name, base_dir, folders)
            if path is None:
                raise RobotError(f"the collision mesh {name!r} of link {link.get('name')} was not found; {_advice(name)}")
            mesh.set("filename", str(path))
    return ET.tostring(copy, encoding="unicode")


def _find_mesh(name: str, base_dir: Path | None, shares: list[Path]) -> Path | None:
    address = urlparse(name)
    if address.scheme in ("package", "model"):
        candidates = [share / address.netloc / unquote(address.path).lstrip("/") for share in shares]
    elif address.scheme == "file":
        candidates = [Path(unquote(address.path))]
    elif address.scheme or not name:
        candidates = []
    else:
        candidates = [(base_dir or Path()) / name]
    return next((path.resolve() for path in candidates if path.is_file()), None)


def _advice(name: str) -> str:
    address = urlparse(name)
    if address.scheme in ("package", "model"):
        return f"source the workspace that holds the package {address.netloc}, or add its parent folder to ROS_PACKAGE_PATH"
    if address.scheme in ("", "file"):
        return "check the path"
    return f"addresses that begin with {address.scheme}:// are not supported"
