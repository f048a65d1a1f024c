"""The search tree as a structure of arrays, and what planners do with it inside compiled code.

Nodes are numbers in the order in which they were added; node 0 is the start. Configurations are stored twice: by rows, which is
how a space wants them, and by columns, which is how a scan over all nodes runs through memory. Up to about 10,000 nodes such a
scan beats every search structure; above, its cost per iteration grows with the tree.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array, Int32, Int64
from lime_planner.planning.planner import SearchTree
from lime_planner.planning.space import distance, own_distance

_BLOCK = 256  # nodes whose distances are computed together, in vector instructions


class Tree(NamedTuple):
    """Arrays of a tree with room for `capacity` nodes in n dimensions; the first `size[0]` are in use.

    Attributes:
        size: number of nodes, int64 (1,).
        rows: configurations, (capacity, n).
        columns: the same, (n, capacity).
        parent: parent of each node, -1 for the start, int32.
        first_child: head of the list of a node's children, -1 where there is none, int32.
        next_sibling: next in the list of the parent's children, or -1, int32.
        previous_sibling: previous in that list, or -1, int32.
        cost: stored cost-to-come of each node; not the true one where costs are not propagated.
        edge_cost: cost of the edge from the parent, what the parent itself adds included.
        intensity: leaf intensity at each node (`lime_planner.planning.space.evaluate`).
        squared: working memory of a scan, (_BLOCK,).
        found: working memory: neighbours, int32 (capacity,).
        found_distance: working memory: their distances, (capacity,).
    """

    size: Int64
    rows: Array
    columns: Array
    parent: Int32
    first_child: Int32
    next_sibling: Int32
    previous_sibling: Int32
    cost: Array
    edge_cost: Array
    intensity: Array
    squared: Array
    found: Int32
    found_distance: Array


def new_tree(capacity: int, n: int) -> Tree:
    """Return an empty tree with room for `capacity` nodes in n dimensions."""

    def links() -> Int32:
        return np.full(capacity, -1, dtype=np.int32)

    return Tree(
        size=np.zeros(1, dtype=np.int64),
        rows=np.zeros((capacity, n)),
        columns=np.zeros((n, capacity)),
        parent=links(),
        first_child=links(),
        next_sibling=links(),
        previous_sibling=links(),
        cost=np.zeros(capacity),
        edge_cost=np.zeros(capacity),
        intensity=np.zeros(capacity),
        squared=np.zeros(_BLOCK),
        found=links(),
        found_distance=np.zeros(capacity),
    )


def enlarged(tree: Tree, capacity: int) -> Tree:
    """Return a copy of a tree with room for more nodes."""
    larger = new_tree(capacity, tree.rows.shape[1])
    size = int(tree.size[0])
    larger.size[0] = size
    larger.columns[:, :size] = tree.columns[:, :size]
    for name in ("rows", "parent", "first_child", "next_sibling", "previous_sibling", "cost", "edge_cost", "intensity"):
        getattr(larger, name)[:size] = getattr(tree, name)[:size]
    return larger


def trace(tree: Tree, node: int) -> Array:
    """Return the configurations from the start to a node, (M, n).

    Raises:
        RuntimeError: the parents form a cycle, which a correct planner cannot make.
    """
    nodes = []
    while node >= 0:
        nodes.append(node)
        node = int(tree.parent[node])
        if len(nodes) > tree.size[0]:
            raise RuntimeError("the tree has a cycle")
    return np.array(tree.rows[nodes[::-1]])


def search_tree(tree: Tree) -> SearchTree:
    """Return the edges from each node's parent to it; they are leafy where the node touches leaves."""
    size = int(tree.size[0])
    children = np.flatnonzero(tree.parent[:size] >= 0)
    ends = np.stack([tree.parent[children].astype(np.int64), children], axis=1)
    return SearchTree(tree.rows[:size], ends, np.asarray(tree.intensity[children] > 0.0))


@hot_kernel
def link(tree: Any, node: int, parent: int) -> None:
    """Put a node into the list of its parent's children."""
    tree.parent[node] = parent
    head = tree.first_child[parent]
    tree.next_sibling[node] = head
    tree.previous_sibling[node] = -1
    if head >= 0:
        tree.previous_sibling[head] = node
    tree.first_child[parent] = node


@hot_kernel
def unlink(tree: Any, node: int) -> None:
    """Take a node out of the list of its parent's children."""
    before, after = tree.previous_sibling[node], tree.next_sibling[node]
    if before >= 0:
        tree.next_sibling[before] = after
    else:
        tree.first_child[tree.parent[node]] = after
    if after >= 0:
        tree.previous_sibling[after] = before


@hot_kernel
def add_node(tree: Any, q: Any, intensity: float, parent: int, edge_cost: float) -> Any:
    """Append a node below `parent` (-1 for the start) and return its number; the caller has made room."""
    node = tree.size[0]
    tree.size[0] = node + 1
    for i in range(q.shape[0]):
        tree.rows[node, i] = q[i]
        tree.columns[i, node] = q[i]
    tree.intensity[node] = intensity
    tree.edge_cost[node] = edge_cost
    if parent >= 0:
        tree.cost[node] = tree.cost[parent] + edge_cost
        link(tree, node, parent)
    return node


@hot_kernel
def rewire_node(tree: Any, node: int, parent: int, edge_cost: float, propagate: bool) -> None:
    """Hang a node below another parent, and hand its new cost on to all descendants if `propagate`."""
    unlink(tree, node)
    link(tree, node, parent)
    tree.edge_cost[node] = edge_cost
    tree.cost[node] = tree.cost[parent] + edge_cost
    if not propagate:
        return
    current = tree.first_child[node]
    while current >= 0:  # depth first along the links; ends when the climb is back at `node`
        tree.cost[current] = tree.cost[tree.parent[current]] + tree.edge_cost[current]
        if tree.first_child[current] >= 0:
            current = tree.first_child[current]
            continue
        while current != node and tree.next_sibling[current] < 0:
            current = tree.parent[current]
        if current == node:
            break
        current = tree.next_sibling[current]


@hot_kernel
def _squared_block(tree: Any, q: Any, first: int, count: int) -> None:
    """Write the squared Euclidean distances of nodes first to first + count - 1 to `tree.squared`."""
    squared = tree.squared
    for i in range(q.shape[0]):
        column = tree.columns[i, first : first + count]
        value = q[i]
        for j in range(np.uint64(count)):  # unsigned: no wrap-around to allow for, so that the loop becomes vector instructions
            gap = column[j] - value
            squared[j] = gap * gap if i == 0 else squared[j] + gap * gap


@hot_kernel
def _block_minimum(squared: Any, count: int) -> float:
    """Smallest of the first `count` numbers, in four lanes: one comparison after another would wait for each other."""
    low0, low1, low2, low3 = np.inf, np.inf, np.inf, np.inf
    whole = count // 4 * 4
    for j in range(np.uint64(0), np.uint64(whole), np.uint64(4)):
        low0 = squared[j] if squared[j] < low0 else low0
        low1 = squared[j + np.uint64(1)] if squared[j + np.uint64(1)] < low1 else low1
        low2 = squared[j + np.uint64(2)] if squared[j + np.uint64(2)] < low2 else low2
        low3 = squared[j + np.uint64(3)] if squared[j + np.uint64(3)] < low3 else low3
    for j in range(np.uint64(whole), np.uint64(count)):
        low0 = squared[j] if squared[j] < low0 else low0
    return min(min(low0, low1), min(low2, low3))


@hot_kernel
def nearest(space: Any, tree: Any, q: Any) -> tuple[int, float]:
    """Return the nearest node and its distance (the first of several)."""
    size = tree.size[0]
    best, best_squared = 0, np.inf
    if own_distance(space):
        best_distance = np.inf
        for j in range(size):
            d = distance(space, tree.rows[j], q)
            if d < best_distance:
                best, best_distance = j, d
        return best, best_distance
    for first in range(0, size, _BLOCK):
        count = min(_BLOCK, size - first)
        _squared_block(tree, q, first, count)
        smallest = _block_minimum(tree.squared, count)
        if smallest < best_squared:
            best_squared = smallest
            for j in range(np.uint64(count)):
                if tree.squared[j] == smallest:
                    best = first + j
                    break
    return best, np.sqrt(best_squared)


@hot_kernel
def neighbours(space: Any, tree: Any, q: Any, radius: float, slack: float) -> int:
    """Write all nodes with distance² <= radius² + slack and their distances to `tree.found*`; return their number."""
    size = tree.size[0]
    limit = radius * radius + slack
    found = 0
    if own_distance(space):
        for j in range(size):
            d = distance(space, tree.rows[j], q)
            if d * d <= limit:
                tree.found[found] = j
                tree.found_distance[found] = d
                found += 1
        return found
    for first in range(0, size, _BLOCK):
        count = min(_BLOCK, size - first)
        _squared_block(tree, q, first, count)
        for j in range(np.uint64(count)):
            if tree.squared[j] <= limit:
                tree.found[found] = first + np.int64(j)
                tree.found_distance[found] = np.sqrt(tree.squared[j])
                found += 1
    return found
