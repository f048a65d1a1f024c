"""The loop of the paper's algorithm 1, compiled once for all three planners; their differences are the small functions on top.

Everything here is called by `lime_planner.planning.rrt_star.planner`, in slices of a few milliseconds.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array
from lime_planner.planning.rrt_star.potential_field import biased_direction, shift_sample
from lime_planner.planning.rrt_star.tree import add_node, nearest, neighbours, rewire_node
from lime_planner.planning.space import distance, edge, evaluate

RRT_STAR, APF_RRT_STAR, P_RRT_STAR = 0, 1, 2

NEIGHBOUR_SLACK = 1e-9  # added to the squared radius: steps of exactly δ must not lose their own parent to rounding
IMPROVEMENT = 1e-9  # a rewiring must lower the stored cost by more


class Rules(NamedTuple):
    """`PaperOptions` in the form that compiled code takes; see there for the meanings."""

    algorithm: int
    delta: float
    full_step: bool
    c_perm: float
    weight: float
    integral: bool
    certify: bool
    propagate: bool
    near_is_neighbour: bool
    rrg_gamma: float
    radius_limit: float
    free_samples: bool
    goal_radius: float
    shift: float
    shift_steps: int


class Scratch(NamedTuple):
    """Working memory of one planner, each (n,)."""

    sample: Array
    new: Array
    force: Array
    direction: Array


@hot_kernel
def extend(space: Any, field: Any, rules: Any, goals: Any, q_near: Any, q_rand: Any, reach: float, scratch: Any) -> Any:
    """Write q_new to `scratch.new` (algorithm 1, line 5); False where there is no direction to go.

    Args:
        space: the space.
        field: the potential field.
        rules: the options.
        goals: (G, n).
        q_near: node to extend, (n,).
        q_rand: sample, (n,).
        reach: distance from q_near to q_rand.
        scratch: working memory.
    """
    n = q_near.shape[0]
    if rules.algorithm == APF_RRT_STAR:
        if not biased_direction(space, field, goals, q_near, q_rand, scratch.force, scratch.direction):
            return False
        step = rules.delta if rules.full_step else min(rules.delta, reach)
        for i in range(n):
            scratch.new[i] = q_near[i] + step * scratch.direction[i]
        return step > 0.0
    if not reach > 0.0:
        return False
    if reach <= rules.delta and not rules.full_step:
        for i in range(n):
            scratch.new[i] = q_rand[i]
    else:
        for i in range(n):
            scratch.new[i] = q_near[i] + rules.delta * ((q_rand[i] - q_near[i]) / reach)
    return True


@hot_kernel
def edge_cost(space: Any, rules: Any, a: Any, b: Any, length: float, intensity_a: float, bound: float) -> Any:
    """Cost of going from node a on to b: equation 2, or the integral along the edge; inf where it is blocked or above `bound`.

    Equation 2 charges C_perm of the node that is left, so that the cost depends on the edge's direction.
    """
    cost = length + rules.c_perm * intensity_a
    if not rules.integral:
        if cost > bound:
            return np.inf
        if not rules.certify:
            return cost
    # One call for both uses: each call of `edge` is compiled where it stands.
    along = edge(space, a, b, rules.weight if rules.integral else 0.0, bound if rules.integral else np.inf)
    if rules.integral:
        return along if along <= bound else np.inf
    return cost if along < np.inf else np.inf


@hot_kernel
def neighbour_radius(rules: Any, size: int, n: int) -> Any:
    """Return δ, or with a positive `rrg_gamma` max(δ, γ (ln size / size)^(1/n)), the radius of RRT* and RRG, up to its limit."""
    if rules.rrg_gamma > 0.0 and size > 1:
        return max(rules.delta, min(rules.radius_limit, rules.rrg_gamma * (np.log(size) / size) ** (1.0 / n)))
    return rules.delta


@hot_kernel
def find_neighbours(space: Any, rules: Any, tree: Any, q_new: Any, near: int) -> int:
    """Collect the nodes around q_new in `tree.found` and return their number; q_near joins them if the rules say so."""
    radius = neighbour_radius(rules, tree.size[0], q_new.shape[0])
    count = neighbours(space, tree, q_new, radius, NEIGHBOUR_SLACK)
    if rules.near_is_neighbour or count == 0:
        for k in range(count):
            if tree.found[k] == near:
                return count
        tree.found[count] = near
        tree.found_distance[count] = distance(space, tree.rows[near], q_new)
        count += 1
    return count


@hot_kernel
def best_parent(space: Any, rules: Any, tree: Any, q_new: Any, count: int) -> tuple[int, float]:
    """Return the neighbour with the cheapest way to q_new and that edge's cost (line 10); -1 where every edge is blocked."""
    best, best_edge, best_cost = -1, np.inf, np.inf
    edges_cost_time = rules.integral or rules.certify
    for first in range(count):
        if edges_cost_time:  # then the most promising first: the distance bounds every edge from below, and few need a look
            promising, lowest = first, np.inf
            for k in range(first, count):
                lower = tree.cost[tree.found[k]] + tree.found_distance[k]
                if lower < lowest:
                    promising, lowest = k, lower
            if lowest >= best_cost:
                break
            tree.found[first], tree.found[promising] = tree.found[promising], tree.found[first]
            length = tree.found_distance[promising]
            tree.found_distance[promising] = tree.found_distance[first]
            tree.found_distance[first] = length
        j, length = tree.found[first], tree.found_distance[first]
        if tree.cost[j] + length >= best_cost:
            continue
        cost = edge_cost(space, rules, tree.rows[j], q_new, length, tree.intensity[j], best_cost - tree.cost[j])
        if tree.cost[j] + cost < best_cost:
            best, best_edge, best_cost = j, cost, tree.cost[j] + cost
    return best, best_edge


@hot_kernel
def rewire(space: Any, rules: Any, tree: Any, new: int, count: int) -> None:
    """Hang the neighbours below the new node where that makes them cheaper (line 11)."""
    for k in range(count):
        j = tree.found[k]
        bound = tree.cost[j] - IMPROVEMENT - tree.cost[new]
        if tree.found_distance[k] >= bound:
            continue
        cost = edge_cost(space, rules, tree.rows[new], tree.rows[j], tree.found_distance[k], tree.intensity[new], bound)
        if cost < bound:
            rewire_node(tree, j, new, cost, rules.propagate)


@hot_kernel
def grow(space: Any, field: Any, rules: Any, goals: Any, tree: Any, samples: Any, scratch: Any) -> None:
    """Run one iteration of algorithm 1 for each row of `samples` (m, n); the tree has room for m more nodes."""
    n = goals.shape[1]
    q_rand = scratch.sample
    for s in range(samples.shape[0]):
        for i in range(n):
            q_rand[i] = samples[s, i]
        if rules.free_samples and evaluate(space, q_rand) < 0.0:
            continue
        if rules.algorithm == P_RRT_STAR:
            shift_sample(space, field, goals, q_rand, rules.shift, rules.shift_steps, scratch.force)
        near, reach = nearest(space, tree, q_rand)
        if not extend(space, field, rules, goals, tree.rows[near], q_rand, reach, scratch):
            continue
        intensity = evaluate(space, scratch.new)
        if intensity < 0.0:
            continue
        count = find_neighbours(space, rules, tree, scratch.new, near)
        parent, cost = best_parent(space, rules, tree, scratch.new, count)
        if parent < 0:
            continue
        new = add_node(tree, scratch.new, intensity, parent, cost)
        rewire(space, rules, tree, new, count)


@hot_kernel
def best_goal(space: Any, rules: Any, goals: Any, terminal: Any, tree: Any) -> tuple[int, int, float]:
    """Return node, goal and stored cost of the cheapest way from a node within the goal radius to a goal; node -1: none.

    What a goal costs, `terminal` (G,), is part of the choice and of the stored cost.
    """
    best, best_index, best_cost = -1, -1, np.inf
    for g in range(goals.shape[0]):
        for j in range(tree.size[0]):
            length = distance(space, tree.rows[j], goals[g])
            come = tree.cost[j] + terminal[g]
            if length > rules.goal_radius or come + length >= best_cost:
                continue
            bound = best_cost - come
            cost = edge_cost(space, rules, tree.rows[j], goals[g], length, tree.intensity[j], bound)
            if come + cost < best_cost:
                best, best_index, best_cost = j, g, come + cost
    return best, best_index, best_cost


@hot_kernel
def measure(space: Any, path: Any, weight: float) -> tuple[float, float, int, float]:
    """Return a path's length, the sum of its nodes' leaf intensities, the number of nodes in leaves, and its integral cost J."""
    length, intensities, inside, integral = 0.0, 0.0, 0, 0.0
    for i in range(path.shape[0]):
        intensity = evaluate(space, path[i])
        if intensity > 0.0:
            intensities += intensity
            inside += 1
        if i > 0:
            length += distance(space, path[i - 1], path[i])
            integral += edge(space, path[i - 1], path[i], weight, np.inf)
    return length, intensities, inside, integral
