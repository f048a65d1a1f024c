"""Trees that look for the cheapest of several goals by J: samples where better paths may pass, and goals that are nodes like others."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.jit import hot_kernel, kernel
from lime_planner.planning.rrt_star.tree import add_node, rewire_node
from lime_planner.planning.sampling import below, draw_between, draw_in_box, uniform
from lime_planner.planning.space import distance, edge, evaluate, inside

_REDRAWN = 30  # times a sample that cannot be part of a better path is drawn again


@kernel
def draw(
    space: Any, start: Any, goals: Any, terminal: Any, best: float, goal_bias: float, random: Any, samples: Any, count: int, q: Any
) -> None:
    """Fill rows of `samples` (m, n): goals, or configurations through which a path cheaper than `best` may pass.

    Args:
        space: the space.
        start: (n,); goals: (G, n); terminal: (G,) what ending at each costs.
        best: cost of the best path; inf samples the whole box.
        goal_bias: share of the samples that are a goal.
        random: generator state.
        samples: receives them, in the first `count` rows.
        count: how many.
        q: (n,) scratch.
    """
    n = q.shape[0]
    for s in range(count):
        if uniform(random) < goal_bias:
            goal = below(random, goals.shape[0])
            for k in range(n):
                samples[s, k] = goals[goal, k]
            continue
        for _ in range(_REDRAWN):
            near, goal = 0, 0
            for g in range(goals.shape[0]):
                if distance(space, start, goals[g]) + terminal[g] < best:
                    near += 1
                    if below(random, near) == 0:
                        goal = g
            if not draw_between(space, start, goals[goal], best - terminal[goal], random, q) > 0.0:
                draw_in_box(space, random, q)
            ahead = np.inf
            for g in range(goals.shape[0]):
                ahead = min(ahead, distance(space, q, goals[g]) + terminal[g])
            if inside(space, q) and distance(space, start, q) + ahead < best:
                break
        for k in range(n):
            samples[s, k] = q[k]


@hot_kernel
def join_goal(space: Any, goals: Any, tree: Any, nodes: Any, g: int, parent: int, cost: float) -> None:
    """Make goal g a node below `parent`, by an edge of a cost, or hang its node there if that is cheaper."""
    if nodes[g] < 0:
        nodes[g] = add_node(tree, goals[g], max(0.0, evaluate(space, goals[g])), parent, cost)
    elif tree.cost[parent] + cost < tree.cost[nodes[g]]:
        rewire_node(tree, nodes[g], parent, cost, True)


@hot_kernel
def reach_goals(space: Any, rules: Any, goals: Any, terminal: Any, tree: Any, first: int, nodes: Any) -> Any:
    """Join goals to the nodes from number `first` on that are near, where that is the cheapest way to them.

    A goal that is reached becomes a node: later rewiring improves it as any other.

    Args:
        space: the space.
        rules: options of the tree; `goal_radius` says what is near.
        goals: (G, n); terminal: (G,) what ending at each costs.
        tree: with room for G more nodes.
        first: first node to look from.
        nodes: (G,) int64, each goal's node, -1 while it has none; written.

    Returns:
        The goal that costs least with what ending there costs, -1 while none is reached.
    """
    for j in range(first, tree.size[0]):
        for g in range(goals.shape[0]):
            length = distance(space, tree.rows[j], goals[g])
            known = tree.cost[nodes[g]] if nodes[g] >= 0 else np.inf
            if length > rules.goal_radius or not tree.cost[j] + length < known:
                continue
            if length == 0.0:
                nodes[g] = j
                continue
            cost = edge(space, tree.rows[j], goals[g], rules.weight, known - tree.cost[j])
            if tree.cost[j] + cost < known:
                join_goal(space, goals, tree, nodes, g, j, cost)
    cheapest, least = -1, np.inf
    for g in range(goals.shape[0]):
        if nodes[g] >= 0 and tree.cost[nodes[g]] + terminal[g] < least:
            cheapest, least = g, tree.cost[nodes[g]] + terminal[g]
    return cheapest


@hot_kernel
def add_path(space: Any, goals: Any, tree: Any, nodes: Any, path: Any, costs: Any, g: int) -> None:
    """Add the waypoints of a path from the start to goal g to the tree, each below the one before.

    Args:
        space: the space.
        goals: (G, n).
        tree: with room for M nodes; node 0 is the start.
        nodes: (G,) int64, each goal's node, -1 while it has none; written.
        path: (M, n) waypoints, the start and the goal included.
        costs: (M - 1,) of its edges.
        g: the goal.
    """
    parent = 0
    last = path.shape[0] - 1
    for i in range(1, last):
        parent = add_node(tree, path[i], max(0.0, evaluate(space, path[i])), parent, costs[i - 1])
    join_goal(space, goals, tree, nodes, g, parent, costs[last - 1])
