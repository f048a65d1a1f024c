"""The last part of polishing: the grasp itself slides along its manifold, while the path before it goes on being polished.

Which grasps are tried is settled before the search, a few hundred of them. Near the best one there are better ones: turned a little about
any axis that the target leaves open. Each step turns the grasp, goes on from the arm's configuration (a few Newton steps, so that no
branch changes), follows its straight stretch back and certifies it along every edge, and joins its beginning to the path. It is kept if
all of it together costs less: the path, the stretch, and what else a grasp's price holds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import Goals, sampling_box
from lime_planner.pipeline.grasps.approaches import around
from lime_planner.pipeline.grasps.search import Trials, cone_of
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.targets import Target
from lime_planner.planning.lime_star.polish import polish
from lime_planner.planning.lime_star.tracks import MAX_WAYPOINTS, load_track, new_tracks
from lime_planner.planning.planner import load_planner
from lime_planner.planning.sampling import random_state
from lime_planner.planning.space import line

SHARE = 0.15  # of the search's budget where even the cheapest grasp touches leaves
_TRIALS_PER_ITERATION = 0.015
_FIRST_RAD, _LEAST_RAD, _MOST_RAD = 0.1, 0.004, 0.3  # turns of the grasp
_UP, _DOWN = 1.8, 0.87  # of the turns: the one-fifth success rule
_JUMP_RAD = 0.5  # of a joint in one step: more is another branch
_POLISHED, _POLISHING = 8, 24  # steps between two times that the path is polished, and how many trials that are
_TOLERANCE, _LEAST_STEP, _MOST_STEP = 3e-4, 0.003, 0.05  # of the polishing; steps as shares of the box's diagonal
_CONTACT = 1.0  # a grasp that costs more than this touches leaves


@dataclass(frozen=True, eq=False)
class Slid:
    """A path to a grasp.

    Attributes:
        path: (M, n) to where the straight stretch begins.
        stretch: (K, n) from there to the grasp.
        pose: (4, 4) T_base_tool at the grasp.
        cost: J of both, with what the grasp's price holds besides.
        trials: grasps tried.
    """

    path: Array
    stretch: Array
    pose: Array
    cost: float
    trials: int


def worth_sliding(goals: Goals, target: Target, settings: Settings) -> bool:
    """Tell whether a target leaves something to slide along, even its cheapest grasp touches leaves, and J is what counts."""
    if target.exact or target.kind == "candidates" or not float(goals.costs.min(initial=np.inf)) > _CONTACT:
        return False
    return load_planner(settings.planner).metric(settings) == "integral" and settings.weight > 0.0


def trials_for(iterations: int) -> int:
    """How many grasps are tried where iterations limit the search."""
    return int(_TRIALS_PER_ITERATION * iterations)


def slide(
    obstacles: Obstacles,
    target: Target,
    goals: Goals,
    path: Array,
    q_start: Array,
    *,
    seed: int,
    trials: int | None,
    budget_s: float | None,
    should_stop: Callable[[], bool],
) -> Slid:
    """Let the grasp at the end of a path slide while that costs less.

    Equal arguments, seed and number of trials give an equal result.

    Args:
        obstacles: of the search, with its anchors.
        target: what was asked for: a fruit, or a pose with freedom.
        goals: of the search.
        path: (M, n) that ends at one of the goals.
        q_start: (n,) where the arm is [rad].
        seed: of the generator.
        trials: grasps to try, None for as many as there is time for.
        budget_s: time for it [s], None for no limit.
        should_stop: ends it early; what was found until then counts.
    """
    began_s = time.monotonic()
    which, stretch = goals.behind(path[-1])
    rng, random = np.random.default_rng(seed), random_state(seed)
    space = obstacles.space(*sampling_box(obstacles, q_start, goals.configurations)).handle()
    grasps = Trials.for_target(obstacles.with_anchors(np.zeros((0, len(q_start))), np.zeros(0)), target, q_start, rng, should_stop)
    weight, tracks = grasps.weight, new_tracks(1, len(q_start))
    diagonal = float(np.linalg.norm(np.asarray(space.upper) - np.asarray(space.lower)))
    pose, terminal, step = goals.poses[which], float(goals.costs[which]), _FIRST_RAD
    axis, cone_rad = cone_of(target, obstacles.settings)
    if len(path) > MAX_WAYPOINTS or not load_track(space, tracks, 0, path, len(path), terminal, weight, _MOST_STEP * diagonal, np.inf):
        return Slid(path, stretch, pose, np.inf, 0)
    tried = 0
    while (trials is None or tried < trials) and not should_stop():
        if budget_s is not None and time.monotonic() - began_s >= budget_s:
            break
        if tried % _POLISHED == 0:
            polish(space, tracks, 0, _POLISHING, weight, _LEAST_STEP * diagonal, _MOST_STEP * diagonal, _TOLERANCE, random)
        tried += 1
        size = int(tracks.size[0])
        before = tracks.points[0, size - 2]
        bound = float(tracks.cost[0] - tracks.segment[0, : size - 2].sum())  # of the last edge and what comes behind it
        rotation = around(pose[None, :3, :3], axis, cone_rad, step, rng)[0]
        moved = pose.copy()
        moved[:3, :3] = rotation
        found = grasps.neighbour(moved, stretch[-1], len(stretch), _JUMP_RAD, bound)
        cost = np.inf
        if found is not None:
            other, price = found
            length = float(np.linalg.norm(other[0] - before))
            if (other[0] >= space.lower).all() and (other[0] <= space.upper).all() and length + price < bound:
                cost = line(space, before, other[0], weight, bound - price) + price
        good = found is not None and cost < bound * (1.0 - 1e-9)
        step = min(_MOST_RAD, step * _UP) if good else max(_LEAST_RAD, step * _DOWN)
        if good and found is not None:
            stretch, terminal, pose = found[0], found[1], moved
            tracks.points[0, size - 1] = stretch[0]
            tracks.segment[0, size - 2] = cost - terminal
            tracks.terminal[0] = terminal
            tracks.cost[0] += cost - bound
    size = int(tracks.size[0])
    return Slid(tracks.points[0, :size].copy(), stretch, pose, float(tracks.cost[0]), tried)
