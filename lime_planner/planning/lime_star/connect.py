"""Paths quickly: two trees that grow towards each other (RRT-Connect, Kuffner and LaValle 2000), leaves solid or left out of account."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import copy_row, kernel
from lime_planner.core.types import Array, Int32, Int64
from lime_planner.planning.sampling import draw_between, draw_in_box
from lime_planner.planning.space import clamp, distance, edge, evaluate

CAPACITY = 4000
_ROUNDING = 1e-9  # share of a length that counts as nothing


class ConnectTree(NamedTuple):
    """One of the two trees: rows (capacity, n), parent (capacity,), size (1,)."""

    rows: Array
    parent: Int32
    size: Int64


def new_tree(n: int) -> ConnectTree:
    """An empty tree in n dimensions."""
    return ConnectTree(np.zeros((CAPACITY, n)), np.zeros(CAPACITY, np.int32), np.zeros(1, np.int64))


@kernel
def reset(tree: Any, root: Any) -> None:
    """Let a tree begin again with nothing but its root."""
    copy_row(root, tree.rows[0])
    tree.parent[0] = -1
    tree.size[0] = 1


@kernel
def _nearest(space: Any, tree: Any, q: Any) -> Any:
    best = np.inf
    at = 0
    for i in range(tree.size[0]):
        total = 0.0
        for k in range(q.shape[0]):
            gap = tree.rows[i, k] - q[k]
            total += gap * gap
            if total >= best:
                break
        if total < best:
            best = total
            at = i
    return at


@kernel
def _extend(space: Any, tree: Any, q: Any, step: float, solid: bool, trial: Any) -> Any:
    """Grow from the nearest node towards q by at most `step`; the new node, or -1. `trial` is left at where it ends."""
    near = _nearest(space, tree, q)
    gap = distance(space, tree.rows[near], q)
    for k in range(q.shape[0]):
        # The end exactly, not but for rounding: the trees meet where the distance is zero.
        trial[k] = q[k] if gap <= step else tree.rows[near, k] + step / gap * (q[k] - tree.rows[near, k])
    if gap == 0.0 or tree.size[0] >= tree.rows.shape[0]:
        return -1
    leaf = evaluate(space, trial)
    if leaf < 0.0 or (solid and leaf > 0.0):
        return -1
    if solid:
        bound = distance(space, tree.rows[near], trial) * (1.0 + _ROUNDING)
        if edge(space, tree.rows[near], trial, 1.0 / _ROUNDING, bound) > bound:
            return -1
    elif edge(space, tree.rows[near], trial, 0.0, np.inf) == np.inf:
        return -1
    at = tree.size[0]
    copy_row(trial, tree.rows[at])
    tree.parent[at] = near
    tree.size[0] = at + 1
    return at


@kernel
def connect(
    space: Any, from_start: Any, from_goal: Any, samples: int, step: float, bound: float, solid: bool, random: Any, trial: Any, path: Any
) -> tuple[int, int]:
    """Grow both trees until they meet.

    Args:
        space: the space.
        from_start, from_goal: the trees.
        samples: how many random configurations to draw at most.
        step: longest edge.
        bound: paths longer than this are not wanted; samples are drawn where shorter ones may pass.
        solid: edges must not touch leaves; otherwise they may, and leaves should not matter in the space, which is faster.
        random: generator state.
        trial: (2, n) scratch.
        path: (M, n) receives the path from start to goal.

    Returns:
        Number of waypoints of the path, 0 if the trees did not meet; samples drawn.
    """
    for drawn in range(samples):
        forward = drawn % 2 == 0
        growing = from_start if forward else from_goal
        other = from_goal if forward else from_start
        if draw_between(space, from_start.rows[0], from_goal.rows[0], bound, random, trial[0]) > 0.0:
            clamp(space, trial[0])
        else:
            draw_in_box(space, random, trial[0])
        new = _extend(space, growing, trial[0], step, solid, trial[1])
        if new < 0:
            continue
        while True:
            reached = _extend(space, other, growing.rows[new], step, solid, trial[1])
            if reached < 0:
                break
            if distance(space, other.rows[reached], growing.rows[new]) == 0.0:
                a = new if forward else reached
                b = reached if forward else new
                return _join(from_start, from_goal, a, b, path), drawn + 1
    return 0, samples


@kernel
def _join(from_start: Any, from_goal: Any, a: int, b: int, path: Any) -> int:
    """Write the path over node a of the start's tree and node b, at the same place, of the goal's tree."""
    count = 0
    at = a
    while at >= 0:
        count += 1
        at = from_start.parent[at]
    total = count
    at = from_goal.parent[b]
    while at >= 0:
        total += 1
        at = from_goal.parent[at]
    if total > path.shape[0]:
        return 0
    at = a
    for i in range(count - 1, -1, -1):
        copy_row(from_start.rows[at], path[i])
        at = from_start.parent[at]
    at = from_goal.parent[b]
    for i in range(count, total):
        copy_row(from_goal.rows[at], path[i])
        at = from_goal.parent[at]
    return total
