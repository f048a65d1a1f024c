"""The text of a URDF: its encoding, checks that name the culprit, and the tool frame's convention."""

from __future__ import annotations

import codecs
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

import numpy as np

from lime_planner.core.errors import RobotError

_SHAPES: dict[str, dict[str, int]] = {"mesh": {}, "box": {"size": 3}, "cylinder": {"radius": 1, "length": 1}, "sphere": {"radius": 1}}
#: Numbers of a joint that are used here; a velocity may be infinite, an effort whatever it likes.
_JOINT_NUMBERS = {
    "limit": ("lower", "upper", "velocity", "acceleration"),
    "safety_controller": ("soft_lower_limit", "soft_upper_limit"),
    "mimic": ("multiplier", "offset"),
}
_JOINTS = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")


#: Byte order marks, longest first: that of UTF-32 begins with that of UTF-16.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
#: How `<?` begins without a mark where a character is more than one byte.
_BEGINNINGS = (
    (b"<\0\0\0", "utf-32-le"),
    (b"\0\0\0<", "utf-32-be"),
    (b"<\0", "utf-16-le"),
    (b"\0<", "utf-16-be"),
)
_DECLARATION = re.compile(rb"""^\s*<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._:-]+)["']""")
#: Elements of xacro that old files wrote without its prefix, and that no URDF has at the top.
_OLD_XACRO = ("macro", "property", "include", "if", "unless", "arg", "insert_block")
_RUN_XACRO = "run xacro on it first (xacro arm.urdf.xacro > arm.urdf)"


def read_urdf_file(path: Path) -> str:
    """Return the text of a URDF file, in the encoding that its byte order mark or its XML declaration names, else UTF-8.

    Raises:
        RobotError: the file cannot be read, or its bytes are not what it declares.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RobotError(f"the URDF file {path} cannot be read: {error.strerror or error}") from error
    encoding, declared = _encoding_of(content)
    try:
        return content.decode(encoding)
    except LookupError:
        raise RobotError(f"the URDF file {path} declares the encoding {encoding!r}, which is unknown here; save it as UTF-8") from None
    except UnicodeDecodeError as error:
        where = f"byte {error.start + 1}, 0x{content[error.start]:02x}, is not" if error.start < len(content) else "it is not"
        advice = (
            "correct that or save it as UTF-8" if declared else 'name its encoding in the first line: <?xml version="1.0" encoding="…"?>'
        )
        raise RobotError(f"the URDF file {path} cannot be read: {where} {encoding}; {advice}") from error


def _encoding_of(content: bytes) -> tuple[str, bool]:
    """Return a document's encoding, and whether the document says so itself."""
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            return encoding, True
    for beginning, encoding in _BEGINNINGS:
        if content.startswith(beginning):
            return encoding, True
    match = _DECLARATION.match(content)
    if match is None:
        return "utf-8", False
    declared = match.group(1).decode("ascii")
    # What declares itself wide in single bytes was converted since, by an editor that left the line alone.
    return ("utf-8", False) if declared.lower().startswith(("utf-16", "utf16", "utf-32", "ucs-", "iso-10646")) else (declared, True)


def parse_urdf(text: str) -> ET.Element:
    """Parse a URDF and check what the URDF library would drop without a word.

    Raises:
        RobotError: not XML, not a URDF, unprocessed xacro, names used twice or not declared, not one tree, or a collision shape
            that is not a mesh, box, cylinder or sphere (dropped, the arm would be thinner than it is).
    """
    root = parse_xml(text.lstrip("\ufeff \t\r\n"), "the robot description")
    namespace, _, plain = root.tag.rpartition("}")
    if plain != "robot":
        raise RobotError(f"the robot description's outermost element is <{plain}>, not <robot>")
    if namespace:  # xmlns on the outermost element names every element below it
        for element in root.iter():
            if isinstance(element.tag, str):
                element.tag = element.tag.removeprefix(namespace + "}")
    old = next((child.tag for child in root if child.tag in _OLD_XACRO), None)
    if old is not None:
        raise RobotError(f"the robot description still holds the xacro element <{old}>: {_RUN_XACRO}")
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


def parse_xml(text: str | bytes, what: str) -> ET.Element:
    """Parse XML without document types, entities and unexpanded xacro; comments may hold what they like.

    Args:
        text: the document; bytes are read in the encoding that they declare.
        what: it is, for the sentences.

    Raises:
        RobotError: not well-formed, or one of those.
    """
    prefixes: list[str] = []

    def refuse_type(*_: object) -> None:
        raise RobotError(f"{what} declares a document type or entities, which is not allowed")

    def see_element(name: str, attributes: dict[str, str]) -> None:
        prefixes.extend(key[6:] for key, value in attributes.items() if key.startswith("xmlns:") and "xacro" in value.lower())
        prefix = name.partition(":")[0] if ":" in name else ""
        if prefix and (prefix == "xacro" or prefix in prefixes):
            raise RobotError(f"{what} still holds the xacro element <{name}>: {_RUN_XACRO}")

    # Without namespaces first, so that a prefix that is not declared is told from one that is.
    scan = expat.ParserCreate("utf-8" if isinstance(text, str) else None)
    scan.StartDoctypeDeclHandler = refuse_type
    scan.EntityDeclHandler = refuse_type
    scan.StartElementHandler = see_element
    try:
        scan.Parse(text, True)
        return ET.fromstring(text)
    except RobotError:
        raise
    except (ET.ParseError, expat.ExpatError) as error:
        raise RobotError(f"{what} is not well-formed XML: {error}") from error
    except (ValueError, LookupError) as error:  # an encoding that the parser does not know
        raise RobotError(f"{what} cannot be read: {error}") from error


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
    for tag, keys in _JOINT_NUMBERS.items():
        element = joint.find(tag)
        for key in keys if element is not None else ():
            if element is not None and key in element.attrib:
                _numbers(name, element, key, 1)


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
    if "${" in text or "$(" in text:
        raise RobotError(f"{name} has the {key} {text!r} in its {element.tag}, which is xacro's: {_RUN_XACRO}")
    endless = key in ("velocity", "acceleration") and values == [math.inf]
    if len(values) != count or not (endless or all(map(math.isfinite, values))):
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


def loosen_joint(root: ET.Element, name: str) -> None:
    """Let a fixed joint turn about its axis within its limits, in place."""
    for joint in root.findall("joint"):
        if joint.get("name") == name and joint.find("limit") is not None:
            joint.set("type", "revolute")
            return
    raise RobotError(f"the robot description has no joint {name} with limits")


def fix_joint(root: ET.Element, name: str, position_rad: float) -> None:
    """Fix a turning joint where it is at a position, in place."""
    from scipy.spatial.transform import Rotation

    joint = next(joint for joint in root.findall("joint") if joint.get("name") == name)
    joint.set("type", "fixed")
    origin, axis = joint.find("origin"), joint.find("axis")
    if position_rad != 0.0 and origin is not None and axis is not None:
        about = Rotation.from_rotvec(position_rad * np.array([float(v) for v in axis.get("xyz", "1 0 0").split()]))
        before = Rotation.from_euler("xyz", [float(v) for v in origin.get("rpy", "0 0 0").split()])
        origin.set("rpy", " ".join(repr(float(v)) for v in (before * about).as_euler("xyz")))
