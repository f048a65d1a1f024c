"""Where an arm carries the links of its description, flanges and cameras among them, and what is bolted to these."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from lime_planner.core.geometry import clean_name
from lime_planner.core.types import Array
from lime_planner.robot.model import Robot


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
    import pinocchio as pin

    model = pin.buildModelFromXML(robot.urdf)
    q, held = pin.neutral(model), dict(robot.held_joints)
    for name, position in held.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = [position] if joint.nq == 1 else [np.cos(position), np.sin(position)]
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    moved_by = {f.name: [model.names[j] for j in model.supports[f.parentJoint] if j] for f in model.frames if f.type == pin.FrameType.BODY}
    T_root_link = {name: data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous for name in moved_by}
    at_zero = robot.link_poses(np.zeros(robot.n))
    T_planning_root = np.linalg.inv(T_root_link[robot.planning_frame])
    found: list[tuple[int, int, str, Carried]] = []
    for link, joints in moved_by.items():
        movers = [name for name in joints if name not in moved_by[robot.planning_frame]]
        own = [robot.joint_names.index(name) + 1 for name in movers if name in robot.joint_names]
        if len(own) != sum(name not in held for name in movers):
            continue
        number = max(own, default=0)
        apart = 0 if clean_name(link) == clean_name(robot.tool_frame) else 1
        T_joint_link = np.linalg.inv(at_zero[number]) @ T_planning_root @ T_root_link[link]
        found.append((-number, apart, clean_name(link), Carried(clean_name(link), number, T_joint_link)))
    return {name: carried for _, _, name, carried in sorted(found, key=lambda entry: entry[:3])}
