"""The cost of a straight edge in the arm's joint space, with stems certified along it and no leaf missed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.collision.compiled_check import call_charge, call_check
from lime_planner.collision.fast import NEED, ZONE
from lime_planner.collision.leaves.sweep import FINEST_RAD, set_bends
from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array, Int64
from lime_planner.planning.prices import stretch_cost, with_unseen

MAX_EDGE_STATES = 2048
_SELF_STEP_M = 0.004  # between samples that clear each other this motion is accepted between the arm's own bodies
_ZONE_STEP_M = 0.002


class EdgeMemory(NamedTuple):
    """Memory for one edge: the intervals still open, and how far bodies move.

    Attributes:
        left, right: (S,) the open intervals, as shares of the edge; open: (S, 2) int64 the bodies and pairs that are open there, like
            `Scratch.open`.
        motion: (B,) how far each body can move along the whole edge, relative: (P,) and one body of each pair past the other [m].
        q: (n,) a configuration.
    """

    left: Array
    right: Array
    open: Int64
    motion: Array
    relative: Array
    q: Array


def make_edge_memory(n: int, bodies: int, pairs: int) -> EdgeMemory:
    """Allocate one thread's memory."""
    return EdgeMemory(
        np.zeros(MAX_EDGE_STATES),
        np.zeros(MAX_EDGE_STATES),
        np.zeros((MAX_EDGE_STATES, 2), np.int64),
        np.zeros(bodies),
        np.zeros(pairs),
        np.zeros(n),
    )


@hot_kernel
def arm_check(space: Any, q: Array, leaves: bool) -> Any:
    """Check one configuration, with leaves or without; the result in space.state is complete where it is True."""
    for i in range(q.shape[0]):
        space.q[i] = q[i]
    return call_check(space.engine[1], space.engine[0], 1 if leaves else 0, np.inf) != 0


@hot_kernel
def within_box(space: Any, q: Array) -> bool:
    """Whether q lies in the sampling box."""
    for i in range(q.shape[0]):
        if not (space.lower[i] - 1e-9 <= q[i] <= space.upper[i] + 1e-9):
            return False
    return True


@hot_kernel
def _left_open(space: Any, half: float, bodies: int, pairs: int) -> Any:
    """Bodies and pairs of those given that may meet something within `half` of the edge on either side of the configuration checked last.

    Its clearances, less a tolerance below the requirement, must cover the motion of each body (conservative advancement), so that
    nothing can hide in between whatever the sampling. The motion is bounded by the levers of the joints, and by the body's speed there
    and a bound on its acceleration, whichever is less.
    """
    state = space.state
    memory = space.memory
    need = state.misc[NEED]
    floor = need - max(0.00025, min(0.002, 0.5 * need))
    reach = 0.0
    bodies_left = 0
    pairs_left = 0
    for body in range(memory.motion.shape[0]):
        motion = min(memory.motion[body] * half, (state.speed[body] + 0.5 * space.sweep.bend[body] * half) * half)
        reach = max(reach, motion)
        if state.clear[body] - floor < motion:
            bodies_left |= 1 << (body & 63)
    for p in range(memory.relative.shape[0]):
        motion = memory.relative[p] * half
        if state.own[p] < motion and 2.0 * motion > _SELF_STEP_M:
            pairs_left |= 1 << (p & 63)
    if space.zoned and abs(state.misc[ZONE]) < reach and 2.0 * reach > _ZONE_STEP_M:
        return bodies, pairs_left & pairs  # what blocks a body is another thing on either side of the zone's border
    return bodies_left & bodies, pairs_left & pairs


@hot_kernel
def _begin(space: Any, a: Array, b: Array) -> Any:
    """Tell the sweep about an edge; its length."""
    total = 0.0
    for i in range(a.shape[0]):
        space.sweep.start[i] = a[i]
        space.sweep.along[i] = b[i] - a[i]
        total += (b[i] - a[i]) ** 2
    set_bends(space.lever, space.sweep)
    return math.sqrt(total)


@hot_kernel
def arm_charge(space: Any, a: Array, b: Array, finest: float) -> Any:
    """∫ price ds along an edge [rad] and what it may be wrong by, whatever else is in the way.

    Args:
        space: the space; a, b: (n,); finest: contact with a leaf of price 1 that is shorter than this may be missed or be too much [rad].
    """
    length = _begin(space, a, b)
    if length == 0.0:
        return 0.0, 0.0
    space.sweep.doubt[0] = 0.0
    charged = call_charge(space.engine[3], space.engine[0], finest / length, np.inf)
    return length * charged, length * space.sweep.doubt[0]


@hot_kernel
def _set_motions(space: Any) -> Any:
    """Bound how far bodies move along the edge, each by itself and past another one, by the levers of the joints."""
    memory = space.memory
    along = space.sweep.along
    lever = space.lever
    for body in range(memory.motion.shape[0]):
        motion = 0.0
        for i in range(along.shape[0]):
            motion += abs(along[i]) * lever[i, body]
        memory.motion[body] = motion
    for p in range(memory.relative.shape[0]):
        motion = 0.0
        for i in range(space.pairs[p, 0], space.pairs[p, 1]):  # only the joints between the two
            motion += abs(along[i]) * lever[i, space.pairs[p, 1]]
        memory.relative[p] = motion


@hot_kernel
def arm_edge(space: Any, a: Array, b: Array, weight: float, bound: float) -> Any:
    """`lime_planner.planning.space.edge` for the arm: the leaves first, which end most edges early, then the stems.

    An interval is looked at in its middle and halved, widest first, until nothing hard can hide in any; bodies that nothing can meet
    in an interval, and pairs of them, are not looked at in its halves.
    """
    counters = space.counters
    counters[1] += 1
    memory = space.memory
    length = _begin(space, a, b)
    if length > bound:
        return length
    if not within_box(space, a) or not within_box(space, b):
        return np.inf
    charged = 0.0
    if weight > 0.0 and length > 0.0 and (space.own_leaves or space.unseen_price > 0.0):
        enough = (bound - length) / (weight * length)
        if space.own_leaves:
            charged = call_charge(space.engine[3], space.engine[0], FINEST_RAD / length, enough)
        share = space.unseen_price
        if share > 0.0 and charged <= enough:
            finest = FINEST_RAD / (share * length)
            unseen = call_charge(space.unseen[3], space.unseen[0], finest, (enough - charged) / share)
            charged = with_unseen(charged, share, unseen)
        if charged > enough:  # it may have stopped: never to be taken for the whole, whatever rounding does
            return max(stretch_cost(length, weight, length * charged), bound * (1.0 + 1e-15))
    _set_motions(space)
    memory.left[0] = 0.0
    memory.right[0] = 1.0
    memory.open[0, 0] = memory.open[0, 1] = -1
    head = 0
    tail = 1
    samples = 0
    while head < tail:
        at = head % MAX_EDGE_STATES
        left = memory.left[at]
        right = memory.right[at]
        bodies = memory.open[at, 0]
        pairs = memory.open[at, 1]
        head += 1
        if samples >= MAX_EDGE_STATES:
            return np.inf
        middle = 0.5 * (left + right)
        for i in range(a.shape[0]):
            memory.q[i] = a[i] + middle * (b[i] - a[i])
        samples += 1
        counters[2] += 1
        space.open[0] = bodies
        space.open[1] = pairs
        valid = arm_check(space, memory.q, False)
        space.open[0] = space.open[1] = -1
        if not valid:
            return np.inf
        bodies, pairs = _left_open(space, right - middle, bodies, pairs)
        if bodies == 0 and pairs == 0:
            continue
        for later in range(2):
            at = tail % MAX_EDGE_STATES
            memory.left[at] = left if later == 0 else middle
            memory.right[at] = middle if later == 0 else right
            memory.open[at, 0] = bodies
            memory.open[at, 1] = pairs
            tail += 1
    return stretch_cost(length, weight, length * charged)
