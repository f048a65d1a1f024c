"""The artificial potential field of the paper (section III-B): attraction, repulsion and the adaptive weight of equation 6."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array
from lime_planner.planning.space import clamp, distance, repulsion


class Field(NamedTuple):
    """Gains of the field, for compiled planners.

    Attributes:
        k_att: K_att of equation 3 [cost per square unit of configuration space].
        k_leaf: K_rep of equation 4 for permeable obstacles.
        k_stem: K_rep for impermeable obstacles.
        d_star: d*, reach of the repulsion [unit of the obstacles' distance].
        beta: β of equation 6, strength of the bias.
        explore_inside: True: inside an obstacle (distance 0 or less) λ = 1, as the paper's story has it; False: attraction acts
            there by itself.
        force_max: F_att_max of equation 6 for each goal: 2 K_att times the distance of the sampling box's farthest corner, (G,).
    """

    k_att: float
    k_leaf: float
    k_stem: float
    d_star: float
    beta: float
    explore_inside: bool
    force_max: Array


def farthest_corner(lower: Array, upper: Array, goals: Array) -> Array:
    """Return the distance from each goal (G, n) to the corner of the box that is farthest from it, (G,)."""
    return np.asarray(np.linalg.norm(np.maximum(goals - lower, upper - goals), axis=1))


@hot_kernel
def total_force(space: Any, field: Any, goals: Any, q: Any, force: Any) -> tuple[int, float, float]:
    """Write F_att + F_rep, the negative gradient of U_tot at q, to `force` (n,).

    Several goals attract one at a time: the nearest.

    Returns:
        The goal's index, the distance to the nearest obstacle (0 or less inside one, where its singular repulsion is left out), and
        F_total, the component of the force towards the goal.
    """
    goal, goal_distance = 0, np.inf
    for g in range(goals.shape[0]):
        d = distance(space, goals[g], q)
        if d < goal_distance:
            goal, goal_distance = g, d
    for i in range(q.shape[0]):
        force[i] = 2.0 * field.k_att * (goals[goal, i] - q[i])
    clearance = repulsion(space, q, field.d_star, field.k_leaf, field.k_stem, force)
    along, length = 0.0, 0.0
    for i in range(q.shape[0]):
        toward = goals[goal, i] - q[i]
        along += force[i] * toward
        length += toward * toward
    return goal, clearance, along / np.sqrt(length) if length > 0.0 else 0.0


@hot_kernel
def exploration_weight(field: Any, goal: int, clearance: float, f_total: float) -> Any:
    """Return λ of equation 6: 1 explores only, smaller values follow the field."""
    if clearance <= 0.0 and field.explore_inside:
        return 1.0
    return 1.0 / (field.beta * max(0.0, f_total) / field.force_max[goal] + 1.0)


@hot_kernel
def biased_direction(space: Any, field: Any, goals: Any, q_near: Any, q_rand: Any, force: Any, direction: Any) -> bool:
    """Write the unit vector of equation 5, λ v_r + (1 - λ) v_p normalised, to `direction` (n,); False where it does not exist."""
    goal, clearance, f_total = total_force(space, field, goals, q_near, force)
    weight = exploration_weight(field, goal, clearance, f_total)
    n = q_near.shape[0]
    random_length, force_length = 0.0, 0.0
    for i in range(n):
        random_length += (q_rand[i] - q_near[i]) ** 2
        force_length += force[i] ** 2
    random_length, force_length = np.sqrt(random_length), np.sqrt(force_length)
    total = 0.0
    for i in range(n):
        direction[i] = 0.0
        if random_length > 0.0:
            direction[i] += weight * (q_rand[i] - q_near[i]) / random_length
        if force_length > 0.0:
            direction[i] += (1.0 - weight) * force[i] / force_length
        total += direction[i] ** 2
    total = np.sqrt(total)
    if not total > 0.0:
        return False
    for i in range(n):
        direction[i] /= total
    return True


@hot_kernel
def shift_sample(space: Any, field: Any, goals: Any, q: Any, step: float, steps: int, force: Any) -> None:
    """Move a sample down the field, `steps` times by `step` along the unit force, then clip it to the sampling box (P-RRT*)."""
    n = q.shape[0]
    for _ in range(steps):
        total_force(space, field, goals, q, force)
        length = 0.0
        for i in range(n):
            length += force[i] ** 2
        length = np.sqrt(length)
        if not length > 0.0:
            break
        for i in range(n):
            q[i] += step * force[i] / length
    clamp(space, q)
