"""The cost of a straight edge in the arm's joint space, with stems certified along it and no leaf missed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.collision.compiled_check import call_check
from lime_planner.collision.fast import LEAF, NEED, ZONE
from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array, Int32
from lime_planner.planning.prices import stretch_cost

MAX_EDGE_STATES = 2048
BIG_LEAF_STEP_RAD = 0.05  # inside leaves the intensity is sampled at least this often
SMALL_LEAF_STEP_RAD = 0.01  # and where contact begins or ends, the place is found to this
_SELF_STEP_M = 0.004  # between samples that clear each other this motion is accepted between the arm's own bodies
_ZONE_STEP_M = 0.002


class EdgeMemory(NamedTuple):
    """Memory for one edge: the states sampled along it and the intervals still open.

    Attributes:
        clear, leaf_clear: (S, B), own: (S, P), misc: (S, 4), as in `State`, of sample s; at: (S,) where it lies on the edge, 0 to 1.
        left, right: (S,) int32, the open intervals' samples.
        motion: (B,) how far each body can move along the whole edge, relative: (P,) and one body of each pair past the other [m].
        q: (n,) a configuration.
    """

    clear: Array
    leaf_clear: Array
    own: Array
    misc: Array
    at: Array
    left: Int32
    right: Int32
    motion: Array
    relative: Array
    q: Array


@hot_kernel
def arm_check(space: Any, q: Array) -> Any:
    """Check one configuration; the result in space.state is complete where it is True."""
    for i in range(q.shape[0]):
        space.q[i] = q[i]
    return call_check(space.engine[1], space.engine[0], 1 if space.own_leaves else 0, np.inf) != 0


@hot_kernel
def within_box(space: Any, q: Array) -> bool:
    """Whether q lies in the sampling box."""
    for i in range(q.shape[0]):
        if not (space.lower[i] - 1e-9 <= q[i] <= space.upper[i] + 1e-9):
            return False
    return True


@hot_kernel
def _store(space: Any, s: Any, t: Any) -> Any:
    memory = space.memory
    memory.at[s] = t
    for b in range(space.state.clear.shape[0]):  # element by element: assigning a row would allocate
        memory.clear[s, b] = space.state.clear[b]
        memory.leaf_clear[s, b] = space.state.leaf_clear[b]
    for p in range(space.state.own.shape[0]):
        memory.own[s, p] = space.state.own[p]
    for k in range(space.state.misc.shape[0]):
        memory.misc[s, k] = space.state.misc[k]


@hot_kernel
def _open_interval(space: Any, a: Any, b: Any, length: Any, bodies: Any) -> Any:
    """Decide one interval between two samples: leaf length · intensity where it is settled, -1 where it must be halved.

    Stems: the clearances of the two ends, less a tolerance below the requirement, must cover the motion of each body between them
    (conservative advancement), so that nothing can hide in between whatever the sampling.
    """
    memory = space.memory
    share = memory.at[b] - memory.at[a]
    tolerance = max(0.00025, min(0.002, 0.5 * min(memory.misc[a, NEED], memory.misc[b, NEED])))
    floor = min(memory.misc[a, NEED], memory.misc[b, NEED]) - tolerance
    leafless = True
    reach = 0.0
    for body in range(bodies):
        motion = memory.motion[body] * share
        reach = max(reach, motion)
        if memory.clear[a, body] + memory.clear[b, body] - 2.0 * floor < motion:
            return -1.0
        if memory.leaf_clear[a, body] + memory.leaf_clear[b, body] < motion:
            leafless = False
    for p in range(memory.relative.shape[0]):
        motion = memory.relative[p] * share
        if memory.own[a, p] + memory.own[b, p] < motion and motion > _SELF_STEP_M:
            return -1.0
    if space.zoned:
        zone_a = memory.misc[a, ZONE]
        zone_b = memory.misc[b, ZONE]
        if ((zone_a > 0.0) != (zone_b > 0.0) or abs(zone_a) + abs(zone_b) < reach) and reach > _ZONE_STEP_M:
            return -1.0
    leaf_a = memory.misc[a, LEAF]
    leaf_b = memory.misc[b, LEAF]
    part = length * share
    if leaf_a == 0.0 and leaf_b == 0.0:
        if leafless or part <= BIG_LEAF_STEP_RAD:
            return 0.0
        return -1.0
    if leaf_a > 0.0 and leaf_b > 0.0:
        if part <= BIG_LEAF_STEP_RAD:
            return 0.5 * (leaf_a + leaf_b) * part
        return -1.0
    if part <= SMALL_LEAF_STEP_RAD:
        return 0.5 * (leaf_a + leaf_b) * part
    return -1.0


@hot_kernel
def arm_edge(space: Any, a: Array, b: Array, weight: float, bound: float) -> Any:
    """`lime_planner.planning.space.edge` for the arm: intervals are halved, widest first, until stems and leaves are settled in each."""
    counters = space.counters
    counters[1] += 1
    n = a.shape[0]
    memory = space.memory
    bodies = memory.clear.shape[1]
    lever = space.lever
    total = 0.0
    for i in range(n):
        total += (b[i] - a[i]) ** 2
    length = math.sqrt(total)
    if length > bound:
        return length
    for body in range(bodies):
        motion = 0.0
        for i in range(n):
            motion += abs(b[i] - a[i]) * lever[i, body]
        memory.motion[body] = motion
    for p in range(memory.relative.shape[0]):
        motion = 0.0
        for i in range(space.pairs[p, 0], space.pairs[p, 1]):  # only the joints between the two
            motion += abs(b[i] - a[i]) * lever[i, space.pairs[p, 1]]
        memory.relative[p] = motion
    for s in range(2):
        q = a if s == 0 else b
        counters[2] += 1
        if not within_box(space, q) or not arm_check(space, q):
            return np.inf
        _store(space, s, float(s))
    if length == 0.0:
        return 0.0
    memory.left[0] = 0
    memory.right[0] = 1
    head = 0
    tail = 1
    samples = 2
    leaf = 0.0
    while head < tail:
        left = memory.left[head % MAX_EDGE_STATES]
        right = memory.right[head % MAX_EDGE_STATES]
        head += 1
        settled = _open_interval(space, left, right, length, bodies)
        if settled >= 0.0:
            leaf += settled
            if stretch_cost(length, weight, leaf) > bound:
                return stretch_cost(length, weight, leaf)
            continue
        if samples >= MAX_EDGE_STATES:
            return np.inf
        t = 0.5 * (memory.at[left] + memory.at[right])
        for i in range(n):
            memory.q[i] = a[i] + t * (b[i] - a[i])
        counters[2] += 1
        if not arm_check(space, memory.q):
            return np.inf
        _store(space, samples, t)
        for half in range(2):
            first = left if half == 0 else samples
            last = samples if half == 0 else right
            if memory.misc[first, LEAF] > 0.0 and memory.misc[last, LEAF] > 0.0:
                head -= 1  # among leaves: at once, so that a bound on the cost ends the work soon
                at = head % MAX_EDGE_STATES
            else:
                at = tail % MAX_EDGE_STATES
                tail += 1
            memory.left[at] = first
            memory.right[at] = last
        samples += 1
    return stretch_cost(length, weight, leaf)
