"""The kernels that find grasps, run once for an arm in a space that needs no obstacles, so that they are compiled."""

from __future__ import annotations

import numpy as np

from lime_planner.pipeline.grasps import kernels
from lime_planner.pipeline.grasps.approaches import nearest_earlier
from lime_planner.pipeline.grasps.search import joint_window, random_configurations
from lime_planner.planning.practice import practice_space
from lime_planner.robot.model import Robot, home


def practise_grasps(robot: Robot) -> None:
    """Call them with arguments of the types that `lime_planner.pipeline.grasps.search` gives them."""
    q = home(robot)
    targets = np.ascontiguousarray(robot.forward(q)[None, :3])
    memory = kernels.make_memory(robot.n)
    lower, upper = joint_window(robot, q)
    space, close_space = practice_space(), practice_space()
    solutions, counts = np.zeros((1, kernels.MAX_BRANCHES, robot.n)), np.zeros(1, np.int64)
    starts = random_configurations(robot, 1, np.random.default_rng(0))
    parents = nearest_earlier(np.ascontiguousarray(targets[:, :, :3]), 2)
    kernels.solve_poses(robot.chain, targets, 0, 1, parents, starts, 1, solutions, counts, memory)
    kernels.solve_from(robot.chain, targets, solutions, counts, memory)
    nodes, figures = np.zeros((1, kernels.MAX_BRANCHES, 2, robot.n)), np.zeros((1, kernels.MAX_BRANCHES, 3))
    codes = np.full((1, kernels.MAX_BRANCHES), kernels.LIMITS)
    totals, ways, cheapest = np.full(codes.shape, np.inf), np.full(codes.shape, np.inf), np.full(4, np.inf)
    kernels.begin(solutions, counts, q, lower, upper, nodes, ways)
    lengths, limits = (0.01, 0.0), (lower, upper)
    spaces = (space, close_space, robot.chain)
    rows = np.zeros((1, 2), np.int64)
    kernels.look_at(*spaces, targets, rows, q, *lengths, 1.0, *limits, 1.0, memory, nodes, figures, codes, totals, cheapest)
    one = np.zeros((2, robot.n))
    kernels.stretch_back(*spaces, targets[0], *lengths, *limits, one, 1.0, q, np.inf, memory, figures[0, 0])
    kernels.price(space, one, 1, 1.0, np.inf)
