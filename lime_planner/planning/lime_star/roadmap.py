"""A growing roadmap whose edges are evaluated only when a best-first search from the goals wants them.

The cost of a path lies where the leaves are, close to the goals; free space costs next to nothing. Searching from the goals
towards the start therefore meets the expensive part first, and the straight distance to the start guides it through the rest.
Every vertex is joined to its k nearest, k growing with log(N) as in PRM*; an evaluated edge is never evaluated again.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import copy_row, kernel
from lime_planner.core.types import Array, Int32, Int64, UInt8
from lime_planner.planning.space import distance, edge, evaluate


@kernel
def passes(a: Any, b: Any, balls: Any) -> bool:
    """Whether a straight line meets one of the balls (B, n + 1): centre and radius."""
    n = a.shape[0]
    for i in range(balls.shape[0]):
        along = 0.0
        length = 0.0
        for k in range(n):
            along += (balls[i, k] - a[k]) * (b[k] - a[k])
            length += (b[k] - a[k]) ** 2
        share = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
        gap = 0.0
        for k in range(n):
            gap += (a[k] + share * (b[k] - a[k]) - balls[i, k]) ** 2
        if gap < balls[i, n] ** 2:
            return True
    return False


UNKNOWN, EXACT, AT_LEAST, BLOCKED = 0, 1, 2, 3  # what is known of an edge's cost
START = 0  # vertex number; the goals follow
MAX_NEIGHBOURS = 24


class Roadmap(NamedTuple):
    """Vertices and edges, with room for more; V vertices, E edges.

    Attributes:
        size: (4,) int64: vertices, edges, goals, entries of the queue.
        rows: (V, n); columns: (n, V) the same for scans; leaf: (V,) intensities.
        ends: (E, 2) int32; length, cost: (E,); known: (E,) uint8.
        first: (V,) head of a vertex's list of half edges, -1; after: (2 E,) next half edge. Half edge 2 e + s leads from ends[e, s].
        terminal: (V,) what ending at a goal costs; only the goals' places count.
        to_come: (V,) cost from the vertex over the cheapest goal as found, its terminal cost included.
        via: (V,) half edge that leads there, -1.
        key, item: the queue: a heap of (estimated total, half edge that leads to the vertex reached last).
        near, near_distance: scratch of a scan.
    """

    size: Int64
    rows: Array
    columns: Array
    leaf: Array
    ends: Int32
    length: Array
    cost: Array
    known: UInt8
    first: Int32
    after: Int32
    terminal: Array
    to_come: Array
    via: Int32
    key: Array
    item: Int32
    near: Int32
    near_distance: Array


def new_roadmap(vertices: int, n: int) -> Roadmap:
    """Make room for `vertices` vertices in n dimensions and for the edges that come with them."""
    edges = vertices * (MAX_NEIGHBOURS // 2 + 8)
    queue = 4 * edges
    return Roadmap(
        np.zeros(4, np.int64),
        np.zeros((vertices, n)),
        np.zeros((n, vertices)),
        np.zeros(vertices),
        np.zeros((edges, 2), np.int32),
        np.zeros(edges),
        np.zeros(edges),
        np.zeros(edges, np.uint8),
        np.full(vertices, -1, np.int32),
        np.full(2 * edges, -1, np.int32),
        np.zeros(vertices),
        np.full(vertices, np.inf),
        np.full(vertices, -1, np.int32),
        np.zeros(queue),
        np.zeros(queue, np.int32),
        np.zeros(MAX_NEIGHBOURS, np.int32),
        np.zeros(MAX_NEIGHBOURS),
    )


def enlarged(roadmap: Roadmap) -> Roadmap:
    """A copy with twice the room; the queue is not kept."""
    larger = new_roadmap(2 * len(roadmap.rows), roadmap.rows.shape[1])
    vertices, edges = int(roadmap.size[0]), int(roadmap.size[1])
    larger.size[:] = roadmap.size
    larger.size[3] = 0
    larger.columns[:, :vertices] = roadmap.columns[:, :vertices]
    for name in ("rows", "leaf", "first", "terminal"):
        getattr(larger, name)[:vertices] = getattr(roadmap, name)[:vertices]
    for name in ("ends", "length", "cost", "known"):
        getattr(larger, name)[:edges] = getattr(roadmap, name)[:edges]
    larger.after[: 2 * edges] = roadmap.after[: 2 * edges]
    return larger


@kernel
def add_edge(roadmap: Any, a: int, b: int, length: float) -> Any:
    """Join two vertices; the edge's number, -1 when there is no room."""
    e = roadmap.size[1]
    if e >= roadmap.length.shape[0]:
        return -1
    roadmap.size[1] = e + 1
    roadmap.ends[e, 0] = a
    roadmap.ends[e, 1] = b
    roadmap.length[e] = length
    roadmap.cost[e] = length
    roadmap.known[e] = UNKNOWN
    roadmap.after[2 * e] = roadmap.first[a]
    roadmap.first[a] = 2 * e
    roadmap.after[2 * e + 1] = roadmap.first[b]
    roadmap.first[b] = 2 * e + 1
    return e


@kernel
def _scan(roadmap: Any, q: Any, k: int) -> int:
    """Find the k nearest vertices, nearest first, into `near`; their number."""
    count = 0
    worst = np.inf
    n = q.shape[0]
    for v in range(roadmap.size[0]):
        total = 0.0
        for i in range(n):
            gap = roadmap.columns[i, v] - q[i]
            total += gap * gap
        if total >= worst:
            continue
        at = count if count < k else k - 1
        while at > 0 and roadmap.near_distance[at - 1] > total:
            roadmap.near_distance[at] = roadmap.near_distance[at - 1]
            roadmap.near[at] = roadmap.near[at - 1]
            at -= 1
        roadmap.near_distance[at] = total
        roadmap.near[at] = v
        count = min(count + 1, k)
        if count == k:
            worst = roadmap.near_distance[k - 1]
    return count


@kernel
def add_vertex(space: Any, roadmap: Any, q: Any, leaf: float) -> Any:
    """Add a valid configuration and join it to its nearest; the vertex's number, -1 when there is no room."""
    v = roadmap.size[0]
    n = q.shape[0]
    if v >= roadmap.rows.shape[0]:
        return -1
    k = min(MAX_NEIGHBOURS, int(math.ceil(math.e * (1.0 + 1.0 / n) * math.log(v + 2.0))))
    count = _scan(roadmap, q, k)
    roadmap.size[0] = v + 1
    for i in range(n):
        roadmap.rows[v, i] = q[i]
        roadmap.columns[i, v] = q[i]
    roadmap.leaf[v] = leaf
    roadmap.first[v] = -1
    for j in range(count):
        length = distance(space, q, roadmap.rows[roadmap.near[j]])
        if length > 0.0:
            add_edge(roadmap, v, roadmap.near[j], length)
    return v


@kernel
def add_path(space: Any, roadmap: Any, points: Any, segments: Any, count: int, goal: int) -> None:
    """Add the waypoints of a known path from the start to goal vertex `goal`, joined by edges of known cost."""
    before = START
    for i in range(1, count):
        if i == count - 1:
            at = goal
        else:
            at = add_vertex(space, roadmap, points[i], max(0.0, evaluate(space, points[i])))
            if at < 0:
                return
        e = add_edge(roadmap, before, at, distance(space, points[i - 1], points[i]))
        if e < 0:
            return
        roadmap.cost[e] = segments[i - 1]
        roadmap.known[e] = EXACT
        before = at


@kernel
def add_known(space: Any, roadmap: Any, q: Any, to: int, cost: float) -> None:
    """Add a valid configuration in free space that is joined to vertex `to` by an edge of known cost."""
    v = add_vertex(space, roadmap, q, 0.0)
    if v < 0:
        return
    e = add_edge(roadmap, v, to, distance(space, q, roadmap.rows[to]))
    if e >= 0:
        roadmap.cost[e] = cost
        roadmap.known[e] = EXACT


@kernel
def _push(roadmap: Any, key: float, item: int) -> bool:
    i = roadmap.size[3]
    if i >= roadmap.key.shape[0]:
        return False
    roadmap.size[3] = i + 1
    while i > 0:
        up = (i - 1) // 2
        if roadmap.key[up] <= key:
            break
        roadmap.key[i] = roadmap.key[up]
        roadmap.item[i] = roadmap.item[up]
        i = up
    roadmap.key[i] = key
    roadmap.item[i] = item
    return True


@kernel
def _pop(roadmap: Any) -> Any:
    top = roadmap.item[0]
    last = roadmap.size[3] - 1
    roadmap.size[3] = last
    key = roadmap.key[last]
    item = roadmap.item[last]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= last:
            break
        if child + 1 < last and roadmap.key[child + 1] < roadmap.key[child]:
            child += 1
        if roadmap.key[child] >= key:
            break
        roadmap.key[i] = roadmap.key[child]
        roadmap.item[i] = roadmap.item[child]
        i = child
    roadmap.key[i] = key
    roadmap.item[i] = item
    return top


@kernel
def _estimate(roadmap: Any, e: int, weight: float) -> Any:
    """What an edge may cost: the true cost where known, else its length and the leaves that both ends touch."""
    if roadmap.known[e] == UNKNOWN:
        both = min(roadmap.leaf[roadmap.ends[e, 0]], roadmap.leaf[roadmap.ends[e, 1]])
        return roadmap.length[e] * (1.0 + weight * both)
    return roadmap.cost[e]


@kernel
def _expand(space: Any, roadmap: Any, v: int, weight: float, best: float, balls: Any) -> None:
    """Queue the edges at a vertex that may be part of a path cheaper than `best` and meet none of the balls."""
    start = roadmap.rows[START]
    half = roadmap.first[v]
    while half >= 0:
        e = half // 2
        if roadmap.known[e] != BLOCKED:
            u = roadmap.ends[e, 1 - half % 2]
            reach = roadmap.to_come[v] + _estimate(roadmap, e, weight)
            if reach < roadmap.to_come[u]:
                key = reach + distance(space, roadmap.rows[u], start)
                if key < best and not passes(roadmap.rows[v], roadmap.rows[u], balls):
                    # The half edge that leads from u back to v.
                    _push(roadmap, key, 2 * e + (1 - half % 2))
        half = roadmap.after[half]


@kernel
def begin_search(space: Any, roadmap: Any, weight: float, best: float, balls: Any) -> None:
    """Start a search of the whole roadmap for a path cheaper than `best` that meets none of the balls (B, n + 1)."""
    roadmap.size[3] = 0
    for v in range(roadmap.size[0]):
        roadmap.to_come[v] = np.inf
        roadmap.via[v] = -1
    for g in range(1, 1 + roadmap.size[2]):
        roadmap.to_come[g] = roadmap.terminal[g]
    for g in range(1, 1 + roadmap.size[2]):
        _expand(space, roadmap, g, weight, best, balls)


@kernel
def continue_search(space: Any, roadmap: Any, weight: float, best: float, balls: Any, quota: int) -> bool:
    """Evaluate at most `quota` edges; True when the search has ended (`to_come[START]` is the result)."""
    start = roadmap.rows[START]
    evaluated = 0
    while roadmap.size[3] > 0:
        if evaluated >= quota:
            return False
        limit = min(best, roadmap.to_come[START])
        if roadmap.key[0] >= limit:
            roadmap.size[3] = 0
            break
        half = _pop(roadmap)
        e = half // 2
        u = roadmap.ends[e, half % 2]
        v = roadmap.ends[e, 1 - half % 2]
        rest = distance(space, roadmap.rows[u], start)
        if roadmap.to_come[v] + max(roadmap.length[e], roadmap.cost[e]) >= roadmap.to_come[u]:
            continue
        if roadmap.known[e] != EXACT:
            if roadmap.known[e] == BLOCKED:
                continue
            bound = min(roadmap.to_come[u], limit - rest) - roadmap.to_come[v]
            if roadmap.known[e] == AT_LEAST and roadmap.cost[e] >= bound:
                continue
            evaluated += 1
            c = edge(space, roadmap.rows[u], roadmap.rows[v], weight, bound)
            if c == np.inf:
                roadmap.known[e] = BLOCKED
                continue
            roadmap.cost[e] = c
            if c > bound:
                roadmap.known[e] = AT_LEAST
                continue
            roadmap.known[e] = EXACT
        reach = roadmap.to_come[v] + roadmap.cost[e]
        if reach < roadmap.to_come[u] and reach + rest < limit:
            roadmap.to_come[u] = reach
            roadmap.via[u] = half
            if u != START:
                _expand(space, roadmap, u, weight, limit, balls)
    return True


@kernel
def read_path(roadmap: Any, path: Any) -> int:
    """Write the path from the start to a goal; the number of its waypoints, 0 if there is none or no room."""
    if roadmap.to_come[START] == np.inf:
        return 0
    v = START
    count = 0
    while True:
        if count >= path.shape[0]:
            return 0
        copy_row(roadmap.rows[v], path[count])
        count += 1
        half = roadmap.via[v]
        if half < 0:
            return count
        v = roadmap.ends[half // 2, 1 - half % 2]
