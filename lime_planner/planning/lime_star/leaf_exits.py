"""Ways out of the leaves: short straight moves from a configuration in contact to one that touches nothing.

Almost all of a path's cost lies where a goal is in contact with leaves, and there it depends on little more than the direction in
which the arm leaves (or enters). Random directions, bounded by the best one so far, find a good one in milliseconds; small changes
of the best one then improve it. The search asks for the ways out of all goals first, and so knows which goals are cheap.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array
from lime_planner.planning.sampling import normal, uniform
from lime_planner.planning.space import clamp, edge, evaluate

_CHANGED = 0.4  # share of the trials that change the best way out instead of drawing a new one
_UP, _DOWN = 1.6, 0.87  # step control of those: the one-fifth success rule


class LeafExits(NamedTuple):
    """The best way out found for each of G configurations.

    Attributes:
        ends: (G, n) where it leads; cost: (G,) exact cost of the straight edge to there, inf if none is known.
        step: (G,) standard deviation of the next change [unit of the space].
        trial: (n,) scratch.
    """

    ends: Array
    cost: Array
    step: Array
    trial: Array


def new_exits(count: int, n: int, step: float) -> LeafExits:
    """Nothing known about `count` configurations in n dimensions; changes begin with standard deviation `step`."""
    return LeafExits(np.zeros((count, n)), np.full(count, np.inf), np.full(count, step), np.zeros(n))


@kernel
def improve(
    space: Any, exits: Any, g: int, origin: Any, trials: int, weight: float, bound: float, least: float, most: float, random: Any
) -> bool:
    """Look for a cheaper way out.

    Args:
        space: the space.
        exits: written at `g`.
        g: which one.
        origin: (n,) its configuration.
        trials: ends to try.
        weight: leaf weight of J.
        bound: ways out that cost more are of no use.
        least, most: shortest and longest way out that is drawn without regard to the best [unit of the space].
        random: generator state.

    Returns:
        Whether one was found.
    """
    n = origin.shape[0]
    q = exits.trial
    better = False
    for _ in range(trials):
        changed = exits.cost[g] < np.inf and uniform(random) < _CHANGED
        if changed:
            for k in range(n):
                q[k] = exits.ends[g, k] + exits.step[g] * normal(random)
        else:
            total = 0.0
            for k in range(n):
                q[k] = normal(random)
                total += q[k] * q[k]
            length = least * math.exp(uniform(random) * math.log(most / least)) / math.sqrt(max(total, 1e-12))
            for k in range(n):
                q[k] = origin[k] + length * q[k]
        clamp(space, q)
        good = evaluate(space, q) == 0.0
        if good:
            limit = min(exits.cost[g], bound)
            cost = edge(space, origin, q, weight, limit)
            good = cost < limit
            if good:
                exits.cost[g] = cost
                for k in range(n):
                    exits.ends[g, k] = q[k]
        if changed:
            exits.step[g] = max(0.1 * least, min(most, exits.step[g] * (_UP if good else _DOWN)))
        better = better or good
    return better
