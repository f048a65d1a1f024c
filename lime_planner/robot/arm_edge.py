"""The cost of a straight edge in the arm's joint space, with stems certified along it and no leaf missed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lime_planner.jit import hot_kernel
from lime_planner.robot.collision import LEAF, NEED, SELF, ZONE
from lime_planner.robot.engine import call_check

Array = npt.NDArray[np.float64]

MAX_EDGE_STATES = 2048
BIG_LEAF_STEP_RAD = 0.05  # inside leaves the intensity is sampled at least this often
SMALL_LEAF_STEP_RAD = 0.01  # and where contact begins or ends, the place is found to this
_SELF_STEP_M = 0.004  # between samples that clear each other this motion is accepted between the arm's own bodies
_ZONE_STEP_M = 0.002


class EdgeMemory(NamedTuple):
    """Memory for one edge: the states sampled along it and the intervals still open.

    Attributes:
        clear, leaf_clear: (S, B), misc: (S, 4), as in `State`, of sample s; at: (S,) where it lies on the edge, 0 to 1.
        left, right: (S,) int32, the open intervals' samples.
        motion: (B + 1,) how far each body can move along the whole edge, and relative to each other [m].
        q: (n,) a configuration.
    """

    clear: Array
    leaf_clear: Array
    misc: Array
    at: Array
    left: npt.NDArray[np.int32]
    right: npt.NDArray[np.int32]
    motion: Array
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
    relative = memory.motion[bodies] * share
    if memory.misc[a, SELF] + memory.misc[b, SELF] < relative and relative > _SELF_STEP_M:
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
        if leafless or part <= 2.0 * SMALL_LEAF_STEP_RAD:
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
    """`lime_planner.space.edge` for the arm: intervals are halved, widest first, until stems and leaves are settled in each."""
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
    relative = 0.0
    for body in range(bodies):
        motion = 0.0
        for i in range(n):
            motion += abs(b[i] - a[i]) * lever[i, body]
        memory.motion[body] = motion
    for i in range(1, n):  # joint 1 moves everything but the base alike
        relative += abs(b[i] - a[i]) * lever[i, bodies - 1]
    memory.motion[bodies] = relative + abs(b[0] - a[0]) * lever[0, bodies - 1]
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
            if length + weight * leaf > bound:
                return length + weight * leaf
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
        memory.left[tail % MAX_EDGE_STATES] = left
        memory.right[tail % MAX_EDGE_STATES] = samples
        tail += 1
        memory.left[tail % MAX_EDGE_STATES] = samples
        memory.right[tail % MAX_EDGE_STATES] = right
        tail += 1
        samples += 1
    return length + weight * leaf
