"""The arm: joints, limits, kinematic chain and collision meshes, read from a URDF through Pinocchio.

Joint frames are the URDF's, turned where needed so that every axis is +z (`lime_planner.robot.kinematics.make_chain`).
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import RobotError
from lime_planner.core.types import Array, Bool
from lime_planner.robot.builtin import BUILTIN_ARMS, TOOL_RPY, read_builtin, share_directories
from lime_planner.robot.kinematics import Chain, forward_kinematics, tool_pose
from lime_planner.robot.mesh_files import resolve_meshes
from lime_planner.robot.meshes import LinkMesh, bvh_of
from lime_planner.robot.serial_chain import ArmTree, read_tree
from lime_planner.robot.stored_arms import stored
from lime_planner.robot.urdf import fix_joint, loosen_joint, parse_urdf, read_urdf_file, set_joint_rpy

__all__ = ["LinkMesh", "Robot", "home", "load_robot", "robot_from_urdf"]


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A serial arm of n turning joints. Compared by identity, so that it may be a key.

    Attributes:
        name: built-in name, or the URDF's.
        joint_names: (n), from base to tool.
        lower: (n,) lower joint limits [rad], -inf for continuous joints.
        upper: (n,) upper joint limits [rad], inf for continuous joints.
        continuous: (n,) bool.
        velocity_limits: (n,) [rad/s].
        acceleration_limits: (n,) [rad/s²].
        planning_frame: the frame everything is expressed in, called base in the code.
        tool_frame: the frame that must reach the target.
        chain: the kinematic chain, for kernels.
        links: links with collision geometry.
        collision_pairs: pairs of indices of `links` to be checked for self-collision.
        reach_m: no point of the arm gets farther from the planning frame's origin.
        urdf: the description as used, tool frame included.
        held_joints: joints between planning frame and tool that are not planned for, and where they must stay [rad or m].
        locked: joints outside the arm that were put somewhere, such as fingers, and where [rad or m].
        warnings: sentences about what in the description is suspicious but usable.
    """

    name: str
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
    collision_pairs: tuple[tuple[int, int], ...]
    reach_m: float
    urdf: str
    held_joints: tuple[tuple[str, float], ...] = ()
    locked: tuple[tuple[str, float], ...] = ()
    warnings: tuple[str, ...] = ()

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str], **options: Any) -> Robot:
        """Load a built-in arm or a URDF file.

        Args:
            name_or_path: a built-in name (`kinova_j2s6s200`, `kinova_j2n6s300`) or the path of a URDF file.
            **options: `joint_names`, `planning_frame`, `tool_frame`, `locked` of `lime_planner.robot.model.load_robot`.

        Raises:
            RobotError: no such robot or file, or a description that cannot be used.
        """
        if not isinstance(name_or_path, (str, os.PathLike)):
            raise RobotError(f"a robot is loaded by the name of a built-in arm or the path of a URDF file, got {name_or_path!r}")
        return load_robot(os.fspath(name_or_path), **options)

    def __repr__(self) -> str:
        return f"<Robot {self.name}: {self.n} joints, from {self.planning_frame} to {self.tool_frame}>"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def home(self) -> Array:
        """A ready configuration within the limits and free of self-collision, (n,) [rad]; see `home`."""
        return home(self)

    def link_poses(self, q: npt.ArrayLike) -> Array:
        """Return T_base_joint of every joint frame, (n + 1, 4, 4); the first is the base's identity.

        Args:
            q: configuration, (n,) [rad].
        """
        poses = np.empty((self.n + 1, 3, 4))
        forward_kinematics(self.chain, self._configuration(q), poses)
        full = np.zeros((self.n + 1, 4, 4))
        full[:, :3] = poses
        full[:, 3, 3] = 1.0
        return full

    def forward(self, q: npt.ArrayLike) -> Array:
        """Return T_base_tool, (4, 4), of configuration q (n,) [rad]."""
        poses = np.empty((self.n + 1, 3, 4))
        forward_kinematics(self.chain, self._configuration(q), poses)
        T_base_tool = np.eye(4)
        tool_pose(self.chain, poses, T_base_tool[:3])
        return T_base_tool

    def within_limits(self, q: npt.ArrayLike, tolerance_rad: float = 1e-9) -> bool:
        """Tell whether q (n,) [rad] is finite and within the joint limits."""
        values = self._configuration(q)
        inside = (values >= self.lower - tolerance_rad) & (values <= self.upper + tolerance_rad)
        return bool(np.isfinite(values).all() and inside.all())

    def limit_violation(self, q: npt.ArrayLike, tolerance_rad: float = 1e-9) -> str | None:
        """Return a sentence about the first joint of q (n,) outside its limits, or None."""
        for name, value, low, high in zip(self.joint_names, self._configuration(q), self.lower, self.upper, strict=True):
            if not np.isfinite(value):
                return f"{name} is {value}"
            if value < low - tolerance_rad or value > high + tolerance_rad:
                return f"{name} is at {value:.4f} rad, outside its limits {low:.4f} to {high:.4f} rad"
        return None

    def _configuration(self, q: npt.ArrayLike) -> Array:
        values = np.ascontiguousarray(q, dtype=np.float64)
        if values.shape != (self.n,):
            raise RobotError(f"{self.name} has {self.n} joints; the configuration has shape {values.shape}")
        return values


def load_robot(
    name_or_path: str,
    *,
    joint_names: Sequence[str] | None = None,
    planning_frame: str | None = None,
    tool_frame: str | None = None,
    locked: Mapping[str, float] | None = None,
) -> Robot:
    """Load a built-in arm or a URDF file.

    Args:
        name_or_path: a built-in name (`kinova_j2s6s200`, `kinova_j2n6s300`) or the path of a URDF file.
        joint_names: the arm's joints from base to tool; by default all that move between planning and tool frame.
        planning_frame: a link that stands still; the root link by default.
        tool_frame: a link that moves with the last arm joint; for built-in arms `<prefix>_end_effector` by default.
        locked: positions of joints outside the arm, such as fingers [rad or m]; by default 0, moved into the limits, mimic joints
            following theirs, and a built-in arm's fingers open.

    Raises:
        RobotError: no such robot or file, or a description that cannot be used.
    """
    arm = BUILTIN_ARMS.get(name_or_path)
    if arm is not None:
        text, folder = read_builtin(name_or_path)
        root = parse_urdf(text)
        set_joint_rpy(root, arm.tool_frame, TOOL_RPY)
        for finger in arm.fingers:
            loosen_joint(root, finger)
        robot = robot_from_urdf(
            ET.tostring(root, encoding="unicode"),
            name=name_or_path,
            joint_names=joint_names or arm.joint_names,
            planning_frame=planning_frame,
            tool_frame=tool_frame or arm.tool_frame,
            locked={**arm.fingers, **(locked or {})},
            base_dir=folder,
        )
        positions = dict(robot.locked)
        for finger in arm.fingers:
            fix_joint(root, finger, positions[finger])
        return replace(robot, urdf=ET.tostring(root, encoding="unicode"), locked=tuple(sorted((locked or {}).items())))
    path = Path(name_or_path).expanduser()
    if not path.is_file():
        raise RobotError(f"robot {name_or_path!r} is neither a built-in arm ({', '.join(BUILTIN_ARMS)}) nor a URDF file that exists")
    text = read_urdf_file(path)
    return robot_from_urdf(
        text, joint_names=joint_names, planning_frame=planning_frame, tool_frame=tool_frame, locked=locked, base_dir=path.resolve().parent
    )


def robot_from_urdf(
    text: str,
    *,
    name: str | None = None,
    joint_names: Sequence[str] | None = None,
    planning_frame: str | None = None,
    tool_frame: str | None = None,
    locked: Mapping[str, float] | None = None,
    base_dir: Path | None = None,
) -> Robot:
    """Build a robot from a URDF's text, as published on `robot_description`.

    Args:
        text: the URDF.
        name: name to give the robot; the URDF's by default.
        joint_names: see `load_robot`.
        planning_frame: see `load_robot`.
        tool_frame: see `load_robot`; by default the one link at the end of the longest chain of moving joints.
        locked: see `load_robot`.
        base_dir: where relative mesh paths start; the working directory by default.

    Raises:
        RobotError: a description that cannot be used; the text names the joint, link or file and the alternatives.
    """
    root = parse_urdf(text)
    resolved = resolve_meshes(root, base_dir, share_directories())

    def read() -> tuple[ArmTree, tuple[tuple[int, int], ...]]:
        tree = read_tree(root, resolved, joint_names=joint_names, planning_frame=planning_frame, tool_frame=tool_frame, locked=locked or {})
        return tree, find_collision_pairs(tree.chain, tree.links, tree.adjacent, tree.lower, tree.upper)

    whole = ET.tostring(root, encoding="unicode")  # limits are read from it, which `resolved` is without
    choices = (whole, list(joint_names or ()), planning_frame, tool_frame, sorted((locked or {}).items()))
    tree, pairs = stored(resolved, choices, read)
    return Robot(
        name=name or root.get("name") or "robot",
        joint_names=tree.joint_names,
        lower=tree.lower,
        upper=tree.upper,
        continuous=tree.continuous,
        velocity_limits=tree.velocity_limits,
        acceleration_limits=tree.acceleration_limits,
        planning_frame=tree.planning_frame,
        tool_frame=tree.tool_frame,
        chain=tree.chain,
        links=tree.links,
        collision_pairs=pairs,
        reach_m=_reach(tree.chain, tree.links),
        urdf=text,
        held_joints=tree.held,
        locked=tuple(sorted((locked or {}).items())),
        warnings=tree.warnings,
    )


def home(robot: Robot) -> Array:
    """Return a ready configuration within the limits and free of self-collision, (n,) [rad].

    A built-in arm's is documented with it. Any other arm's is the middle of its limits (0 for continuous joints), or where the arm
    touches itself there, the first of a fixed sequence of random configurations where it does not.

    Raises:
        RobotError: none of 1000 configurations is free of self-collision.
    """
    arm = BUILTIN_ARMS.get(robot.name)
    if arm is not None and robot.joint_names == arm.joint_names:
        return np.array(arm.home)
    low, high = np.where(robot.continuous, -np.pi, robot.lower), np.where(robot.continuous, np.pi, robot.upper)
    rng, q = np.random.default_rng(0), 0.5 * (low + high)
    for _ in range(1000):
        if not touches_itself(robot.chain, robot.links, robot.collision_pairs, q):
            return q
        q = rng.uniform(low, high)
    raise RobotError(f"{robot.name} touches itself in every one of 1000 configurations; is its collision geometry right?")


def _reach(chain: Chain, links: Sequence[LinkMesh]) -> float:
    """Bound the distance from the planning frame's origin to any point of the arm: the lengths of all offsets, stretched out."""
    offsets = np.concatenate([[0.0], np.cumsum(np.linalg.norm(chain.placements[:, :, 3], axis=1))])
    reach = float(offsets[-1] + np.linalg.norm(chain.tool[:, 3]))
    for link in links:
        reach = max(reach, float(offsets[link.joint] + np.linalg.norm(link.vertices, axis=1).max()))
    return reach


_SAMPLES = 200
_ALWAYS = 0.95  # as in MoveIt's setup assistant: more often in contact than this is contact by design


def find_collision_pairs(
    chain: Chain, links: Sequence[LinkMesh], adjacent: frozenset[tuple[int, int]], lower: Array, upper: Array
) -> tuple[tuple[int, int], ...]:
    """Return the pairs of links to check for self-collision, as indices (i < j) of `links`.

    Left out are links on the same joint, links that meet in a joint (`adjacent`), and pairs in contact in more than 95 % of
    configurations drawn from a fixed seed within the limits, which are in contact by design. Pairs that never met in the sample
    are kept: a sample proves nothing, and a far pair costs next to nothing.

    Args:
        chain: the kinematic chain of n joints.
        links: the links' meshes.
        adjacent: pairs of indices of links that meet in a joint.
        lower: (n,) lower limits [rad], -inf for continuous joints.
        upper: (n,) upper limits [rad].
    """
    import fcl

    pairs = [
        (i, j) for i in range(len(links)) for j in range(i + 1, len(links)) if links[i].joint != links[j].joint and (i, j) not in adjacent
    ]
    objects = [fcl.CollisionObject(bvh_of(link)) for link in links]
    rng = np.random.default_rng(0)
    low, high = np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)
    poses = np.empty((len(lower) + 1, 3, 4))
    request, touching = fcl.CollisionRequest(), np.zeros(len(pairs), dtype=int)
    free = 0.0
    undecided = list(range(len(pairs)))
    for _ in range(_SAMPLES):
        forward_kinematics(chain, rng.uniform(low, high), poses)
        for link, thing in zip(links, objects, strict=True):
            thing.setTransform(fcl.Transform(poses[link.joint, :, :3], poses[link.joint, :, 3]))
        for k in undecided:
            i, j = pairs[k]
            touching[k] += fcl.collide(objects[i], objects[j], request, fcl.CollisionResult()) > 0
        free += 1
        # A pair seen apart more often than 5 % of all samples allow is decided.
        undecided = [k for k in undecided if free - touching[k] <= (1.0 - _ALWAYS) * _SAMPLES]
        if not undecided:
            break
    return tuple(pair for k, pair in enumerate(pairs) if k not in set(undecided))


def touches_itself(chain: Chain, links: Sequence[LinkMesh], pairs: Sequence[tuple[int, int]], q: Array) -> bool:
    """Tell whether any of `pairs` is in contact at configuration q (n,) [rad], by the exact meshes."""
    import fcl

    poses = np.empty((len(q) + 1, 3, 4))
    forward_kinematics(chain, q, poses)
    objects = [fcl.CollisionObject(bvh_of(k), fcl.Transform(poses[k.joint, :, :3], poses[k.joint, :, 3])) for k in links]
    return any(fcl.collide(objects[i], objects[j], fcl.CollisionRequest(), fcl.CollisionResult()) > 0 for i, j in pairs)
