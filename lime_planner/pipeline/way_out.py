"""The first move of an arm that almost touches something where it stands.

Nearer to something hard than the fast model may be wrong, the search cannot tell which way leads off it. There the exact check looks for a
short straight move to where the fast model can be believed again, and the search begins at its end.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lime_planner.collision.exact import ExactChecker
from lime_planner.collision.self_contact import SELF_CLEARANCE_M
from lime_planner.core.geometry import unit
from lime_planner.core.types import Array
from lime_planner.pipeline.certify import hit_of
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.goals import MODEL_ERROR_M, measure
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.robot.kinematics import forward_kinematics, tool_jacobian
from lime_planner.robot.model import Robot

_LENGTHS_RAD = (0.03, 0.06, 0.12, 0.24)  # of the move, the shortest that will do
_SCATTER = 100  # directions tried at each length around the steepest one, and a quarter of it around each of the hand's
_LOOKED_AT = 8  # of them exactly, those that lead farthest off
_STEP_RAD = 0.001  # of the exact check along the move: a few tenths of a millimetre at the hand
_GRADIENT_RAD = 0.002


def way_out(
    obstacles: Obstacles, checker: ExactChecker, q_start: Array, rng: np.random.Generator, should_stop: Callable[[], bool]
) -> Array | None:
    """Find where the arm should first move to from a start that almost touches something.

    Args:
        obstacles: the scene, for the fast model.
        checker: the scene, exactly.
        q_start: (n,) within the joint limits, clear by the exact check [rad].
        rng: draws directions.
        should_stop: cancels.

    Returns:
        The end (n,) of a straight move, clear by the exact check, where the fast model can be believed; None where the start needs no
        such move, or none was found.

    Raises:
        Refusal: CANCELLED.
    """
    space, robot = obstacles.measuring_space(), obstacles.robot

    def clearance(q: Array) -> float:
        clear, own, _ = measure(space, q)
        return min(clear - MODEL_ERROR_M, own - SELF_CLEARANCE_M)

    here = clearance(q_start)
    if here >= 0.0:
        return None
    gradient = np.array([clearance(q_start + step) - clearance(q_start - step) for step in _GRADIENT_RAD * np.eye(robot.n)])
    courses = [unit(gradient), *_hand_courses(robot, q_start)]
    best, found = 0.0, None
    for length in _LENGTHS_RAD:
        scatter = np.linspace(0.0, 2.0, _SCATTER)[:, None] * unit(rng.normal(size=(_SCATTER, robot.n)))
        ways = unit(np.concatenate([course + (scatter if i == 0 else scatter[: _SCATTER // 4]) for i, course in enumerate(courses)]))
        ends = np.clip(q_start + length * ways, robot.lower, robot.upper)
        ranked = sorted(((clearance(end), i) for i, end in enumerate(ends)), reverse=True)
        for reached, i in ranked[:_LOOKED_AT]:
            if reached <= best:
                break
            if hit_of(checker, sample_path(np.stack([q_start, ends[i]]), _STEP_RAD)[0], should_stop) is None:
                best, found = reached, ends[i]
                break
        if best >= MODEL_ERROR_M:
            break
    return found


def _hand_courses(robot: Robot, q: Array) -> list[Array]:
    """Return the joints' courses, each of length 1, that move the hand along its own axes, backwards first, without turning it."""
    jacobian, poses = np.zeros((6, robot.n)), np.empty((robot.n + 1, 3, 4))
    forward_kinematics(robot.chain, q, poses)
    tool_jacobian(robot.chain, poses, jacobian)
    axes = robot.forward(q)[:3, :3].T
    return [unit(np.linalg.pinv(jacobian, rcond=1e-2) @ np.append(axis, np.zeros(3))) for axis in (-axes[2], *axes[:2], *-axes[:2])]
