"""Where a URDF's meshes are, and in which unit and with which axis up a COLLADA file is written."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from lime_planner.core.errors import RobotError
from lime_planner.core.types import Array
from lime_planner.robot.urdf import parse_xml

#: R_zup_file for each `<up_axis>`: x to the right, z up, y away from the viewer, as COLLADA 1.4 defines right, up and in.
_UP_AXES: dict[str, Array] = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z_UP": np.eye(3),
}


#: What is read of a link and of a joint, and which attributes hold several numbers.
_USED = {"collision", "origin", "axis", "parent", "child", "limit", "mimic"}
_VECTORS = {"xyz", "rpy", "size", "scale"}


def resolve_meshes(root: ET.Element, base_dir: Path | None, shares: Iterable[Path]) -> str:
    """Return the URDF's text with every collision mesh's file name made absolute, and with nothing in it that is not used here.

    The URDF library refuses a whole description for an inertia, an effort or a colour that it cannot read.

    `package://NAME/REST` is looked for as NAME/REST in each of `shares`, as REST in one of them that is called NAME itself, and in
    the folders around the URDF; a relative name starts at `base_dir`. Percent escapes are resolved where no file has them in its
    name.

    Raises:
        RobotError: a mesh that is not there; the text names link and file.
    """
    copy = ET.fromstring(ET.tostring(root))
    folders = list(shares)
    copy.attrib = {"name": root.get("name") or "robot"}
    for child in list(copy):
        if child.tag not in ("link", "joint"):
            copy.remove(child)
    for part in copy:
        for child in list(part):
            if child.tag not in _USED:
                part.remove(child)
        for element in part.iter():
            for key in _VECTORS.intersection(element.attrib):
                element.set(key, " ".join(element.attrib[key].split()))  # spaces are all that it takes between numbers
        for limit in part.findall("limit"):
            limit.attrib.update(velocity="1", effort="1")
    for link in copy.findall("link"):
        for mesh in link.findall("collision/geometry/mesh"):
            name = mesh.get("filename", "").strip()
            path = _find_mesh(name, base_dir, folders)
            if path is None:
                raise RobotError(f"the collision mesh {name!r} of link {link.get('name')} was not found; {_advice(name)}")
            mesh.set("filename", str(path))
    return ET.tostring(copy, encoding="unicode")


def collada_asset(path: str | os.PathLike[str]) -> Array:
    """Return what turns a COLLADA file's coordinates into metres with z up, (3, 3): `<unit>` times the rotation of `<up_axis>`.

    Files of other kinds have neither: for them it is the identity.

    Raises:
        RobotError: a COLLADA file that is not well-formed, or whose unit is not a positive number or whose axis is none of three.
    """
    path = Path(path)
    if path.suffix.lower() != ".dae":
        return np.eye(3)
    root = parse_xml(path.read_bytes(), f"the mesh {path}")
    names = {"": "", "a": root.tag.rpartition("}")[0].lstrip("{")}
    prefix = "a:" if names["a"] else ""
    unit = root.find(f"{prefix}asset/{prefix}unit", names)
    axis = root.findtext(f"{prefix}asset/{prefix}up_axis", "Y_UP", names).strip().upper()
    text = "1" if unit is None else unit.get("meter", "1")
    try:
        metres = float(text)
    except ValueError:
        metres = math.nan
    if not (math.isfinite(metres) and metres > 0.0):
        raise RobotError(f"the mesh {path} gives the unit of {text!r} metres, which is no positive number")
    if axis not in _UP_AXES:
        raise RobotError(f"the mesh {path} has the up_axis {axis!r}; it must be one of {', '.join(_UP_AXES)}")
    return metres * _UP_AXES[axis]


def _split(name: str) -> tuple[str, str]:
    """Return scheme and rest of a mesh's address; `#` and `?` are characters like others in it."""
    scheme, colon, rest = name.partition(":")
    if not colon or len(scheme) < 2 or not scheme.isalnum():  # `C:` is a drive
        return "", name
    return scheme.lower(), rest.removeprefix("//")


def _find_mesh(name: str, base_dir: Path | None, shares: list[Path]) -> Path | None:
    if not name:
        return None
    for spelling in dict.fromkeys((name, unquote(name), name.replace("\\", "/"))):
        for path in _candidates(spelling, base_dir or Path(), shares):
            if path.is_file():
                return path.resolve()
    return None


def _candidates(name: str, base_dir: Path, shares: list[Path]) -> Iterator[Path]:
    scheme, rest = _split(name)
    if scheme in ("package", "model"):
        package, _, inside = rest.lstrip("/").partition("/")
        for share in shares:
            yield share / package / inside
            if share.name == package:
                yield share / inside
        # A description that lies in its own package, in a workspace that is not sourced.
        for parent in base_dir.resolve().parents if package else ():
            yield parent / package / inside
        for folder in (base_dir.resolve(), *base_dir.resolve().parents):
            if folder.name == package:
                yield folder / inside
    elif scheme == "file":
        host, slash, path = rest.partition("/")
        yield Path("/" + path) if host in ("", "localhost") and slash else base_dir / rest
    elif not scheme:
        yield base_dir / name


def _advice(name: str) -> str:
    if "$(" in name or "${" in name:
        return "this is xacro's: run xacro on it first"
    scheme, rest = _split(name)
    if scheme in ("package", "model"):
        package = rest.lstrip("/").partition("/")[0]
        return f"source the workspace that holds the package {package}, or add its parent folder to ROS_PACKAGE_PATH"
    if scheme in ("", "file"):
        return "check the path"
    return f"addresses that begin with {scheme}:// are not supported"
