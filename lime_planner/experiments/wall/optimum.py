"""The cheapest path of a planar world under J = length + weight × length inside leaves, by a method no planner uses.

Inside a region of constant cost a cheapest path is straight, so it bends only on outlines: by refraction where it enters or leaves a
leaf, and at corners. A graph over the corners, the outlines' crossings and closely spaced points on every outline, with every pair
joined by its exactly integrated straight edge, therefore comes as close as the spacing; the error falls with its square, because J
is stationary at the best crossing points. Rounds with finer points around the path so far make the spacing as small as wanted.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array
from lime_planner.planning.space import edge, evaluate
from lime_planner.planning.spaces.plane import PlaneWorld


@dataclass(frozen=True)
class PlaneOptimum:
    """The cheapest path.

    Attributes:
        cost: J of the path, an upper bound of the optimum [map units]; inf where the goal cannot be reached.
        path: start to goal, (M, 2); empty where there is none.
        first_cost: J before refinement: the difference tells how far the spacing mattered.
    """

    cost: float
    path: Array = field(repr=False)
    first_cost: float


@kernel
def _edge_cost(space: Any, a: Any, b: Any, weight: float) -> Any:
    return edge(space, a, b, weight, np.inf)


@kernel
def _allowed(space: Any, points: Any, allowed: Any) -> None:
    for i in range(points.shape[0]):
        allowed[i] = evaluate(space, points[i]) >= 0.0


@kernel
def _shortest(space: Any, points: Any, weight: float, cost: Any, parent: Any) -> None:
    """A* from point 0 to point 1 over all pairs of points; edges are integrated only when they could still matter."""
    n = points.shape[0]
    done = np.zeros(n, np.bool_)
    to_goal = np.empty(n)
    for i in range(n):
        cost[i], parent[i] = np.inf, -1
        to_goal[i] = np.hypot(points[i, 0] - points[1, 0], points[i, 1] - points[1, 1])
    cost[0] = 0.0
    while True:
        current, smallest = -1, np.inf
        for i in range(n):
            if not done[i] and cost[i] + to_goal[i] < smallest:
                current, smallest = i, cost[i] + to_goal[i]
        if current < 0 or current == 1:
            return
        done[current] = True
        for i in range(n):
            if done[i]:
                continue
            length = np.hypot(points[i, 0] - points[current, 0], points[i, 1] - points[current, 1])
            lower = cost[current] + length
            if lower >= cost[i] or lower + to_goal[i] >= cost[1]:
                continue
            total = cost[current] + edge(space, points[current], points[i], weight, cost[i] - cost[current])
            if total < cost[i]:
                cost[i], parent[i] = total, current


def _segments(world: PlaneWorld) -> Array:
    """Return the sides of all polygons and of the map, (S, 2, 2)."""
    (x0, y0), (x1, y1) = world.lower, world.upper
    border = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    outlines = [np.asarray(p, dtype=np.float64) for p in (*world.permeable, *world.impermeable, border)]
    return np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in outlines])


def _crossings(segments: Array) -> Array:
    """Return the points where sides cross, (K, 2)."""
    a, d = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = a[None, :] - a[:, None]
    cross = d[:, None, 0] * d[None, :, 1] - d[:, None, 1] * d[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset[..., 0] * d[None, :, 1] - offset[..., 1] * d[None, :, 0]) / cross
        u = (offset[..., 0] * d[:, None, 1] - offset[..., 1] * d[:, None, 0]) / cross
        hit = (np.abs(cross) > 1e-12) & (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    i, _ = np.nonzero(np.triu(hit))
    return np.asarray(a[i] + t[np.triu(hit)][:, None] * d[i])


def _search(world: PlaneWorld, weight: float, points: Array) -> tuple[float, Array]:
    space = world.space().handle()
    points = points[((points >= world.lower) & (points <= world.upper)).all(axis=1)]
    points = np.concatenate([[world.start, world.goal], np.unique(points.round(12), axis=0)])
    allowed = np.zeros(len(points), dtype=np.bool_)
    _allowed(space, points, allowed)
    if not allowed[:2].all():
        return float("inf"), np.empty((0, 2))
    points = np.ascontiguousarray(points[allowed])
    cost, parent = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
    _shortest(space, points, weight, cost, parent)
    if not np.isfinite(cost[1]):
        return float("inf"), np.empty((0, 2))
    nodes = [1]
    while nodes[-1] != 0:
        nodes.append(int(parent[nodes[-1]]))
    return float(cost[1]), _without_straight_points(points[nodes[::-1]])


def _without_straight_points(path: Array) -> Array:
    """Leave out the points at which a path does not bend."""
    kept = [path[0]]
    for before, here, after in zip(path, path[1:], path[2:], strict=False):
        a, b = here - before, after - here
        if abs(a[0] * b[1] - a[1] * b[0]) > 1e-9 * np.linalg.norm(a) * np.linalg.norm(b):
            kept.append(here)
    return np.array([*kept, path[-1]])


def plane_optimum(world: PlaneWorld, weight: float, *, spacing: float = 1.0, rounds: int = 5) -> PlaneOptimum:
    """Find the cheapest path of a planar world.

    Args:
        world: the world.
        weight: leaf weight of J (C_perm / δ).
        spacing: distance between points on outlines in the first search [map units].
        rounds: number of refinements; each divides the spacing around the path by 5.
    """
    segments = _segments(world)
    fixed = np.concatenate([segments[:, 0], _crossings(segments)])
    dense = [fixed]
    for a, b in segments:
        pieces = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        dense.append(a + np.linspace(0.0, 1.0, pieces + 1)[:, None] * (b - a))
    first_cost, path = _search(world, weight, np.concatenate(dense))
    cost = first_cost
    for _ in range(rounds):
        if not len(path):
            break
        spacing /= 5.0
        around = [fixed, path]
        for a, b in segments:
            direction = (b - a) / np.linalg.norm(b - a)
            along = (path - a) @ direction
            near = np.linalg.norm(path - a - along[:, None] * direction, axis=1) < 1e-6
            for position in along[near]:
                offsets = position + spacing * np.arange(-8, 9)
                offsets = offsets[(offsets > 0.0) & (offsets < np.linalg.norm(b - a))]
                around.append(a + offsets[:, None] * direction)
        cost, path = _search(world, weight, np.concatenate(around))
    return PlaneOptimum(cost, path, first_cost)


def straight_cost(world: PlaneWorld, weight: float) -> float:
    """Return J of the straight line from start to goal, inf where it is blocked."""
    return float(_edge_cost(world.space().handle(), np.array(world.start), np.array(world.goal), weight))
