"""From a URDF's tree to one serial arm: which joints move, which are locked, and what hangs on them."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lime_planner.core.errors import RobotError
from lime_planner.core.types import Array, Bool, Int32
from lime_planner.robot.joint_limits import read_limits
from lime_planner.robot.kinematics import Chain, make_chain
from lime_planner.robot.mesh_files import collada_asset
from lime_planner.robot.meshes import LinkMesh, join_meshes, triangulate
from lime_planner.robot.plausibility import check_lengths, suspicious_joints

_TOOL_NAMES = ("end_effector", "tool0", "tool_frame", "tcp")
#: Words in the name of a link that is meant to reach a target, and in that of one that only looks.
_TOOL_WORDS = {"ee", "eef", "tcp", "tool", "endeffector", "grasp", "grip"}
_SENSOR_WORDS = {"camera", "cam", "optical", "depth", "color", "colour", "rgb", "rgbd", "infra", "infrared", "ir", "imu", "gyro", "accel"}
_SENSOR_WORDS |= {"lidar", "laser", "lens", "sensor", "realsense", "zed", "kinect", "ft", "wrench", "led", "light"}
_ONE_NUMBER = ("revolute", "continuous", "prismatic")
_MOVING = ("revolute", "continuous", "prismatic", "floating", "planar")


@dataclass(frozen=True)
class ArmTree:
    """What `read_tree` found; the fields are those of `lime_planner.robot.model.Robot`.

    `adjacent` holds the pairs of indices of `links` that meet in one joint; `held` is `held_joints`.
    """

    joint_names: tuple[str, ...]
    lower: Array
    upper: Array
    continuous: Bool
    velocity_limits: Array
    acceleration_limits: Array
    planning_frame: str
    tool_frame: str
    chain: Chain
    links: tuple[LinkMesh, ...]
    adjacent: frozenset[tuple[int, int]]
    held: tuple[tuple[str, float], ...]
    warnings: tuple[str, ...]


class _Joints:
    """The joint elements of a URDF, looked up by name and by child link."""

    def __init__(self, root: ET.Element) -> None:
        self.by_name: dict[str, ET.Element] = {j.get("name", ""): j for j in root.findall("joint")}
        self.above: dict[str, ET.Element] = {self.child(j): j for j in self.by_name.values()}
        self.links = [link.get("name", "") for link in root.findall("link")]

    @staticmethod
    def parent(joint: ET.Element) -> str:
        element = joint.find("parent")
        return "" if element is None else element.get("link", "")

    @staticmethod
    def child(joint: ET.Element) -> str:
        element = joint.find("child")
        return "" if element is None else element.get("link", "")

    def root(self) -> str:
        """Return the link that no joint moves."""
        return next(link for link in self.links if link not in self.above)

    def path_to(self, link: str) -> list[ET.Element]:
        """Return the joints from the root to a link, root first."""
        path = []
        while link in self.above:
            path.append(self.above[link])
            link = self.parent(self.above[link])
        return path[::-1]

    def held_between(self, base: str, tool: str, names: Sequence[str]) -> list[str]:
        """Return the joints between two links that may move, follow no other joint, and are none of these."""
        above = self.path_to(base)
        between = [j for j in self.path_to(tool) if j not in above and j.get("type") in _MOVING and j.find("mimic") is None]
        return [name for name in (j.get("name", "") for j in between) if name not in names]

    def movers_to(self, link: str) -> list[str]:
        """Return the names of the turning, unmimicked joints from the root to a link."""
        return [j.get("name", "") for j in self.path_to(link) if j.get("type") in ("revolute", "continuous") and j.find("mimic") is None]


def read_tree(
    root: ET.Element,
    text: str,
    *,
    joint_names: Sequence[str] | None,
    planning_frame: str | None,
    tool_frame: str | None,
    locked: Mapping[str, float],
) -> ArmTree:
    """Choose the arm in a URDF's tree and read its chain, limits and meshes.

    Args:
        root: the parsed URDF (see `lime_planner.robot.urdf.parse_urdf`).
        text: the same URDF with mesh files as absolute paths.
        joint_names: the arm's joints from base to tool, or None for all that turn on the way to the tool.
        planning_frame: a link that stands still, or None for the root link.
        tool_frame: a link that moves with the last arm joint, or None for the only one at the end of the longest chain.
        locked: positions of joints outside the arm.

    Raises:
        RobotError: see `lime_planner.robot.model.robot_from_urdf`.
    """
    import pinocchio as pin

    joints = _Joints(root)
    _check_names(joints, joint_names or ())
    tool_frame = tool_frame or _default_tool(joints, joint_names)
    if tool_frame not in joints.links:
        raise RobotError(f"the tool frame {tool_frame!r} is not a link of the robot; links are {', '.join(joints.links)}")
    names = _choose_joints(joints, joint_names, tool_frame, planning_frame)
    held = joints.held_between(planning_frame or joints.root(), tool_frame, names)
    if not joint_names and not set(held) <= set(locked):
        kind = joints.by_name[held[0]].get("type")
        raise RobotError(
            f"the joint {held[0]} ({kind}) moves between the planning frame and the tool, and only joints that turn are planned for: "
            f"set planning_frame to a link beyond it, or name the arm's joints, which holds it where its position is 0"
        )
    try:
        model = pin.buildModelFromXML(text)
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as error:
        # Pinocchio's messages about meshes begin with places in its own source.
        reason = " ".join(str(error).rpartition("message:")[2].split())
        raise RobotError(f"the robot description cannot be used: {reason}") from error
    reference = _locked_configuration(joints, model, names, locked)
    positions = _positions(model, reference, held)
    others = [j for j in range(1, model.njoints) if model.names[j] not in names]
    model, geometries = pin.buildReducedModel(model, [geometry], others, reference)
    geometry = geometries[0]

    frames = {f.name: f for f in model.frames if f.type == pin.FrameType.BODY}
    planning_frame = planning_frame or joints.root()
    if planning_frame not in frames or frames[planning_frame].parentJoint != 0:
        still = [name for name, f in frames.items() if f.parentJoint == 0]
        raise RobotError(f"the planning frame {planning_frame!r} must be a link that stands still: {', '.join(still)}")
    T_planning_root = frames[planning_frame].placement.inverse()
    chain, turns = _read_chain(model, T_planning_root, frames[tool_frame].placement)
    links, warnings = _read_links(geometry, model, T_planning_root, turns)
    warnings += check_lengths(chain, names, links)
    lower, upper, continuous, velocity, acceleration = read_limits(joints.by_name, names)
    warnings += suspicious_joints(names, lower, upper, velocity)
    return ArmTree(
        tuple(names),
        lower,
        upper,
        continuous,
        velocity,
        acceleration,
        planning_frame,
        tool_frame,
        chain,
        links,
        _adjacent(joints, links),
        positions,
        tuple(dict.fromkeys(warnings)),
    )


def _check_names(joints: _Joints, wanted: Sequence[str]) -> None:
    turning = [name for name, joint in joints.by_name.items() if joint.get("type") in ("revolute", "continuous")]
    for name in wanted:
        joint = joints.by_name.get(name)
        if joint is None:
            raise RobotError(f"the arm joint {name!r} is not in the robot description; joints that turn are {', '.join(turning)}")
        if joint.find("mimic") is not None:
            raise RobotError(f"the arm joint {name} mimics another joint and cannot be commanded")
        if name not in turning:
            kind = joint.get("type")
            raise RobotError(f"the arm joint {name} is {kind}; arm joints must turn (revolute or continuous): leave it out to lock it")
    if len(set(wanted)) != len(wanted):
        raise RobotError(f"an arm joint is named twice: {', '.join(wanted)}")


def _default_tool(joints: _Joints, joint_names: Sequence[str] | None) -> str:
    """Return the one link named like a tool frame, else the one at the end of the most turning joints.

    Beyond the last of `joint_names`, if given. A name counts for more than depth, for fingers turn, too.

    Raises:
        RobotError: there is more than one; it offers them, the likeliest first.
    """
    candidates = [link for link in joints.links if (joint_names[-1] in joints.movers_to(link) if joint_names else joints.movers_to(link))]
    named = [link for link in candidates if link.endswith(_TOOL_NAMES)]
    parents = {joints.parent(joint) for joint in joints.by_name.values()}
    ends = [link for link in candidates if link not in parents]
    most = max((len(joints.movers_to(link)) for link in ends), default=0)
    choice = named if len(named) == 1 else [link for link in ends if len(joints.movers_to(link)) == most]
    if len(choice) != 1:
        offered = [link for link in candidates if link in choice or _likelihood(link) == 0]
        raise RobotError(
            f"which link is the tool frame? Set tool_frame to one of {', '.join(sorted(offered or joints.links, key=_likelihood))}"
        )
    return choice[0]


def _likelihood(link: str) -> int:
    """Rank a link by its name: 0 for one that sounds like the tool, 2 for one that sounds like a sensor, else 1."""
    words = {word for word in re.split(r"[^a-z]+|(?<=[a-z])(?=\d)", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", link).lower()) if word}
    if words & _SENSOR_WORDS:
        return 2
    return 0 if words & _TOOL_WORDS or {"end", "effector"} <= words else 1


def _choose_joints(joints: _Joints, wanted: Sequence[str] | None, tool_frame: str, planning_frame: str | None) -> list[str]:
    to_tool = joints.movers_to(tool_frame)
    if not wanted:
        above_base = set(joints.movers_to(planning_frame)) if planning_frame else set()
        names = [name for name in to_tool if name not in above_base]
        if not names:
            raise RobotError(f"no joint turns between the planning frame and the tool frame {tool_frame}")
        return names
    for name in wanted:
        if name not in to_tool:
            raise RobotError(f"the arm joint {name} is not on the way to {tool_frame}; the joints that turn there are {', '.join(to_tool)}")
    ordered = [name for name in to_tool if name in wanted]
    if ordered != list(wanted):
        raise RobotError(f"the arm joints must be named from base to tool: {', '.join(ordered)}")
    return ordered


def _locked_configuration(joints: _Joints, model: Any, names: Sequence[str], locked: Mapping[str, float]) -> Array:
    """Return a full configuration of Pinocchio's model with every joint outside the arm where it is to stay."""
    import pinocchio as pin

    for name, position in locked.items():
        _check_locked(joints, names, name, position)

    def value(name: str, depth: int = 0) -> float:
        joint = joints.by_name[name]
        mimic = joint.find("mimic")
        if mimic is not None and name not in locked:
            source = mimic.get("joint", "")
            if source in names:
                raise RobotError(f"joint {name} mimics the arm joint {source}; links that move that way are not supported")
            if source not in joints.by_name or depth > len(joints.by_name):
                raise RobotError(f"joint {name} mimics {source!r}, which does not exist or mimics it in turn")
            return float(mimic.get("multiplier", 1.0)) * value(source, depth + 1) + float(mimic.get("offset", 0.0))
        limit = joint.find("limit")
        position = float(locked.get(name, 0.0))
        if limit is None or joint.get("type") == "continuous":
            return position
        return min(max(position, float(limit.get("lower", 0.0))), float(limit.get("upper", 0.0)))

    q: Array = np.array(pin.neutral(model), dtype=np.float64)
    for j in range(1, model.njoints):
        name, nq, start = model.names[j], model.joints[j].nq, model.joints[j].idx_q
        if name in names or joints.by_name[name].get("type") in ("floating", "planar"):
            continue
        position = value(name)
        q[start : start + nq] = [position] if nq == 1 else [np.cos(position), np.sin(position)]
    return q


def _check_locked(joints: _Joints, names: Sequence[str], name: str, position: float) -> None:
    """Refuse a joint that cannot be put somewhere, or a place beyond its limits."""
    joint = joints.by_name.get(name)
    if name in names:
        raise RobotError(f"no position can be given for {name!r}: it is a joint of the arm, which is planned for")
    if joint is None or joint.get("type") not in _ONE_NUMBER:
        others = [other for other, j in joints.by_name.items() if other not in names and j.get("type") in _ONE_NUMBER]
        why = "there is none of this name" if joint is None else f"it is {joint.get('type')}"
        raise RobotError(f"no position can be given for {name!r}: {why}; joints outside the arm: {', '.join(others) or 'none that move'}")
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return
    low, high = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
    if not low <= position <= high:
        raise RobotError(f"the joint {name!r} cannot be at {position:g}: its limits are {low:g} to {high:g}")


def _positions(model: Any, reference: Array, names: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Return where joints of one degree of freedom are in a full configuration [rad or m]."""
    found = []
    for name in names:
        joint = model.joints[model.getJointId(name)]
        q = reference[joint.idx_q : joint.idx_q + joint.nq]
        if joint.nv == 1:
            found.append((name, float(q[0]) if joint.nq == 1 else float(np.arctan2(q[1], q[0]))))
    return tuple(found)


def _read_chain(model: Any, T_planning_root: Any, T_last_tool: Any) -> tuple[Chain, Array]:
    n = model.njoints - 1
    placements, axes = np.empty((n, 3, 4)), np.empty((n, 3))
    for j in range(1, model.njoints):
        placement = T_planning_root * model.jointPlacements[j] if j == 1 else model.jointPlacements[j]
        placements[j - 1] = placement.homogeneous[:3]
        axes[j - 1] = np.asarray(model.joints[j].createData().S).reshape(6)[3:]
    return make_chain(placements, axes, np.zeros(n, dtype=np.uint8), T_last_tool.homogeneous[:3])


def _read_links(geometry: Any, model: Any, T_planning_root: Any, turns: Array) -> tuple[tuple[LinkMesh, ...], list[str]]:
    """Return the links that have geometry, and sentences about what was done to it."""
    parts: dict[str, list[tuple[Array, Int32]]] = {}
    joint_of: dict[str, int] = {}
    warnings = []
    for shape in geometry.geometryObjects:
        link = model.frames[shape.parentFrame].name
        joint = int(shape.parentJoint)
        placement = T_planning_root * shape.placement if joint == 0 else shape.placement
        vertices, triangles = triangulate(shape.geometry, link)
        scale = np.asarray(shape.meshScale, dtype=np.float64)
        asset = collada_asset(shape.meshPath)
        if not np.array_equal(asset, np.eye(3)):  # Coal leaves the asset's unit and axis out, and has applied the scale already
            vertices = (vertices / scale) @ asset.T * scale
            if not np.array_equal(asset / asset.max(), np.eye(3)):
                warnings.append(
                    f"the mesh {shape.meshPath} of link {link} is not written z-up and was turned as its up_axis says (RViz does not)"
                )
        if np.prod(scale) < 0.0:  # mirrored: the outside must stay outside
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        vertices = vertices @ placement.rotation.T + placement.translation
        if joint > 0 and not np.array_equal(turns[joint - 1], np.eye(3)):
            vertices = vertices @ turns[joint - 1].T
        parts.setdefault(link, []).append((vertices, triangles))
        joint_of[link] = joint
    if not any(joint_of.values()):
        raise RobotError("no moving link of the robot description has collision geometry, so nothing could be checked")
    last = model.njoints - 1
    links = tuple(LinkMesh(name, joint_of[name], *join_meshes(parts[name]), gripper=joint_of[name] == last) for name in parts)
    return links, warnings


def _adjacent(joints: _Joints, links: Sequence[LinkMesh]) -> frozenset[tuple[int, int]]:
    """Return the pairs of links that meet in a joint, links without geometry between them passed over."""
    index = {link.name: i for i, link in enumerate(links)}
    pairs = set()
    for name, i in index.items():
        above = name
        while above in joints.above:
            above = joints.parent(joints.above[above])
            if above in index:
                pairs.add((min(i, index[above]), max(i, index[above])))
                break
    return frozenset(pairs)
