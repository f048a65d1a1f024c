"""Whether any straight grasp of a fruit is free, by a dense trial with the exact meshes; what the planner is measured against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.types import Array
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.grasps import kernels
from lime_planner.pipeline.grasps.approaches import in_cone, nearest_earlier, spread
from lime_planner.pipeline.grasps.search import joint_window, random_configurations
from lime_planner.robot.model import Robot

STEP_RAD = 0.01  # between two configurations that are checked
_BATCH = 250  # approaches between two looks at whether one was free
_STARTED, _STARTS = 12, 96
_STEPS = 8


@dataclass(frozen=True)
class Dense:
    """Outcome of a dense trial.

    Attributes:
        tried: approaches until one was free, or all of them.
        stretch: (K, n) a free one from its beginning to the grasp; None where there is none.
    """

    tried: int
    stretch: Array | None


def dense_trial(
    robot: Robot, checker: ExactChecker, centre: Array, q_start: Array, *, directions: int, length_m: float, cone_rad: float, seed: int
) -> Dense:
    """Look for a free straight grasp among many approaches, all branches of the arm.

    Args:
        robot: the arm.
        checker: of the scene with its fruit, exact meshes.
        centre: (3,) of the fruit [m].
        q_start: (n,) whose window of turns counts [rad].
        directions: how many approaches.
        length_m: of the straight stretch.
        cone_rad: around the ray from the base.
        seed: of the trial.
    """
    rng = np.random.default_rng(seed)
    turned = in_cone(centre / np.linalg.norm(centre), cone_rad, spread(directions, rng))
    lower, upper = joint_window(robot, q_start)
    memory = kernels.make_memory(robot.n)
    for first in range(0, directions, _BATCH):
        batch = turned[first : first + _BATCH]
        targets = np.ascontiguousarray(np.concatenate([batch, np.broadcast_to(centre[:, None], (len(batch), 3, 1))], axis=2))
        solutions, counts = np.zeros((len(batch), kernels.MAX_BRANCHES, robot.n)), np.zeros(len(batch), np.int64)
        starts = random_configurations(robot, _STARTS, rng)
        kernels.solve_poses(robot.chain, targets, 0, len(batch), nearest_earlier(batch, 2), starts, _STARTED, solutions, counts, memory)
        for p, target in enumerate(targets):
            for q in solutions[p, : counts[p]]:
                if not kernels.unwrap(q, q_start, lower, upper) or checker.stem_hit(q) is not None:
                    continue
                nodes = np.zeros((_STEPS + 1, robot.n))
                nodes[0] = q
                steps = range(1, _STEPS + 1)
                if all(kernels.step_back(robot.chain, target, length_m * k / _STEPS, nodes, k, lower, upper, memory) for k in steps):
                    stretch = nodes[::-1].copy()
                    if checker.certify(sample_path(stretch, STEP_RAD)[0]).ok:
                        return Dense(first + p + 1, stretch)
    return Dense(directions, None)
