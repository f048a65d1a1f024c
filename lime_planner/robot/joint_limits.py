"""The limits of an arm's joints, as a URDF gives them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np

from lime_planner.core.errors import RobotError
from lime_planner.core.types import Array, Bool

#: Where the URDF gives no acceleration limit [rad/s²]: the default of MoveIt's time parameterisation, slow for any arm.
DEFAULT_ACCELERATION = 1.0
#: Where the URDF gives no velocity limit [rad/s].
DEFAULT_VELOCITY = 0.5

_SOFT = ("soft_lower_limit", "soft_upper_limit")


def read_limits(joints: Mapping[str, ET.Element], names: Sequence[str]) -> tuple[Array, Array, Bool, Array, Array]:
    """Return lower and upper limits (n,) [rad], which joints are continuous (n,), velocity [rad/s] and acceleration limits [rad/s²].

    Args:
        joints: a URDF's joint elements by name, checked by `lime_planner.robot.urdf.parse_urdf`.
        names: (n) of the arm's joints.

    Raises:
        RobotError: limits that leave a joint no room, or a negative one.
    """
    n = len(names)
    lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    continuous = np.zeros(n, dtype=np.bool_)
    velocity, acceleration = np.full(n, DEFAULT_VELOCITY), np.full(n, DEFAULT_ACCELERATION)
    for i, name in enumerate(names):
        limit = joints[name].find("limit")
        continuous[i] = joints[name].get("type") == "continuous"
        given = dict(limit.attrib) if limit is not None else {}
        values = {key: float(given[key]) for key in ("lower", "upper", "velocity", "acceleration") if key in given}
        if not continuous[i]:
            lower[i], upper[i] = values.get("lower", 0.0), values.get("upper", 0.0)
            if not lower[i] < upper[i]:
                raise RobotError(f"joint {name} has the limits {lower[i]} to {upper[i]} rad; lower must be less than upper")
            lower[i], upper[i] = _soft_limits(joints[name], lower[i], upper[i])
        # A velocity of 0 stands for "unknown" in many descriptions, and so does an infinite one.
        velocity[i] = _known(values.get("velocity", 0.0)) or DEFAULT_VELOCITY
        acceleration[i] = _known(values.get("acceleration", 0.0)) or DEFAULT_ACCELERATION
        if velocity[i] < 0.0 or acceleration[i] < 0.0:
            raise RobotError(f"joint {name} has a negative velocity or acceleration limit")
    return lower, upper, continuous, velocity, acceleration


def _known(limit: float) -> float:
    return limit if np.isfinite(limit) else 0.0


def _soft_limits(joint: ET.Element, lower: float, upper: float) -> tuple[float, float]:
    """Return a joint's limits within the soft ones of its safety controller, beyond which the controller pushes back.

    One that is left out, and the pair 0 and 0, which stands for none in many descriptions, do not count.
    """
    name, safety = joint.get("name"), joint.find("safety_controller")
    given = {} if safety is None else {key: float(safety.attrib[key]) for key in _SOFT if key in safety.attrib}
    if not any(given.values()):
        return lower, upper
    low, high = max(lower, given.get(_SOFT[0], lower)), min(upper, given.get(_SOFT[1], upper))
    if not low < high:
        raise RobotError(
            f"joint {name} has the limits {lower} to {upper} rad, and its safety controller the soft limits "
            f"{given.get(_SOFT[0], lower)} to {given.get(_SOFT[1], upper)} rad, which leave it no room"
        )
    return low, high
