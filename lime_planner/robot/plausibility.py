"""What a robot description says that no arm is like: lengths in millimetres, angles in degrees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lime_planner.core.errors import RobotError
from lime_planner.core.types import Array
from lime_planner.robot.kinematics import Chain
from lime_planner.robot.meshes import LinkMesh

_ABSURD_M = 10.0  #: no link that moves with an arm is larger, and no joint farther from the last one
_LARGE_M = 2.0  #: beyond this, a link that is several times longer than all the joints' distances is suspicious
_LONGER = 3.0
_TINY_M = 0.001  #: nothing that could be touched is smaller
_SHORT_M = 0.05  #: nor is an arm
_TURNS_RAD = 8.0 * np.pi  #: no limit of a joint lies beyond four turns
_FAST_RAD_S = 20.0  #: about three turns a second, more than any arm's joint makes


def check_lengths(chain: Chain, names: Sequence[str], links: Sequence[LinkMesh]) -> list[str]:
    """Refuse what is as large as a hall, and return sentences about what is merely odd.

    Args:
        chain: of n joints.
        names: (n) of the joints, from base to tool.
        links: with their meshes [m].

    Raises:
        RobotError: a moving link, a standing one, or a distance between joints beyond 10 m.
    """
    distances = np.linalg.norm(chain.placements[:, :, 3], axis=1)
    tool = float(np.linalg.norm(chain.tool[:, 3]))
    for name, distance in zip(names[1:], distances[1:], strict=True):
        if distance > _ABSURD_M:
            raise RobotError(f"joint {name} is {distance:.4g} m away from the joint before it: {_unit(distance)}")
    if tool > _ABSURD_M:
        raise RobotError(f"the tool frame is {tool:.4g} m away from the last joint: {_unit(tool)}")
    warnings = []
    if distances[0] > _ABSURD_M:
        warnings.append(f"the arm's first joint is {distances[0]:.4g} m away from the planning frame: set planning_frame to the arm's base")
    length = float(distances[1:].sum()) + tool
    for link in links:
        size = float(np.ptp(link.vertices, axis=0).max())
        if size > _ABSURD_M and link.joint == 0:
            raise RobotError(
                f"link {link.name} is {size:.4g} m across: {_unit(size)} "
                "A floor or a hall is no part of the arm: leave it out, and set floor_z_m, keep_out_boxes or workspace_box"
            )
        if link.joint == 0:
            continue
        size = max(size, float(np.abs(link.vertices).max()))
        if size > _ABSURD_M:
            raise RobotError(
                f"link {link.name} extends over {size:.4g} m: {_unit(size)} A mesh is brought to metres by scale, as in "
                f'<mesh filename="…" scale="0.001 0.001 0.001"/>'
            )
        if size > max(_LARGE_M, _LONGER * length):
            warnings.append(
                f"link {link.name} extends over {size:.3g} m on an arm whose joints span {length:.3g} m: is its mesh in metres?"
            )
        elif size < _TINY_M:
            warnings.append(f"link {link.name} is only {1000 * size:.2g} mm large: is its mesh in metres, or scaled twice?")
    moving = [float(np.ptp(link.vertices, axis=0).max()) for link in links if link.joint > 0]
    if length + max(moving, default=0.0) < _SHORT_M:
        warnings.append(f"the whole arm spans {1000 * (length + max(moving, default=0.0)):.2g} mm: is the description in metres?")
    return warnings


def _unit(size: float) -> str:
    return "is that in millimetres?" if size >= 50.0 else "is that in centimetres, inches or millimetres?"


def suspicious_joints(names: Sequence[str], lower: Array, upper: Array, velocity: Array) -> list[str]:
    """Return sentences about limits that look like degrees.

    Args:
        names: (n) of the joints.
        lower: (n,) [rad], -inf for continuous joints.
        upper: (n,) [rad], inf for continuous joints.
        velocity: (n,) [rad/s].
    """
    found = []
    for name, low, high, speed in zip(names, lower, upper, velocity, strict=True):
        if np.isfinite([low, high]).all() and max(abs(low), abs(high)) > _TURNS_RAD:
            found.append(f"joint {name} has limits from {low:g} to {high:g} rad: are they in degrees?")
        if speed > _FAST_RAD_S:
            found.append(f"joint {name} may turn at {speed:g} rad/s: is that in degrees per second?")
    return found
