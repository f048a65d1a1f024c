"""The arm's joint space as a planner sees it: validity, leaf intensity, edge cost and the repulsive field, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lime_planner import space as protocol
from lime_planner.jit import hot_kernel, overload
from lime_planner.robot.collision import CAP_M, LEAF, NEED, SELF, SELF_CLEARANCE_M, ZONE, Scratch, State, World, check, make_scratch, make_state
from lime_planner.robot.kinematics import Chain
from lime_planner.robot.shapes import Shapes
from lime_planner.scene.fields import sample

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


class ArmSpace(NamedTuple):
    """Joint space of an arm in front of a plant; one for each thread, since it holds scratch memory.

    Attributes:
        lower, upper: (n,) sampling box, inside the joint limits [rad].
        counters: (8,) int64, see `lime_planner.space`.
        chain, shapes, world: the arm, its bodies, the obstacles.
        scratch, state, memory: this thread's memory.
        own_leaves: False where leaves do not matter (their weight is zero).
    """

    lower: Array
    upper: Array
    counters: npt.NDArray[np.int64]
    chain: Chain
    shapes: Shapes
    world: World
    scratch: Scratch
    state: State
    memory: EdgeMemory
    own_leaves: bool


def make_arm_space(lower: Array, upper: Array, chain: Chain, shapes: Shapes, world: World, *, leaves: bool = True) -> ArmSpace:
    """Put a space together, with fresh memory for one thread.

    Args:
        lower, upper: (n,) sampling box [rad]; configurations outside it are invalid.
        chain, shapes: the arm.
        world: the obstacles.
        leaves: False to leave leaves out of account.
    """
    bodies = len(shapes.spacing)
    memory = EdgeMemory(
        np.zeros((MAX_EDGE_STATES, bodies)),
        np.zeros((MAX_EDGE_STATES, bodies)),
        np.zeros((MAX_EDGE_STATES, 4)),
        np.zeros(MAX_EDGE_STATES),
        np.zeros(MAX_EDGE_STATES, np.int32),
        np.zeros(MAX_EDGE_STATES, np.int32),
        np.zeros(bodies + 1),
        np.zeros(len(lower)),
    )
    return ArmSpace(
        np.ascontiguousarray(lower, dtype=np.float64),
        np.ascontiguousarray(upper, dtype=np.float64),
        np.zeros(8, np.int64),
        chain,
        shapes,
        world,
        make_scratch(shapes, world.fields),
        make_state(bodies),
        memory,
        bool(leaves),
    )


def own_thread(space: ArmSpace) -> ArmSpace:
    """The same space with memory of its own, for another thread."""
    return make_arm_space(space.lower, space.upper, space.chain, space.shapes, space.world, leaves=space.own_leaves)


@hot_kernel
def within_box(space: ArmSpace, q: Array) -> bool:
    """Whether q lies in the sampling box."""
    for i in range(q.shape[0]):
        if not (space.lower[i] - 1e-9 <= q[i] <= space.upper[i] + 1e-9):
            return False
    return True


@hot_kernel
def arm_evaluate(space: ArmSpace, q: Array) -> float:
    """`lime_planner.space.evaluate` for the arm."""
    space.counters[0] += 1
    if not within_box(space, q):
        return -1.0
    if not check(space.chain, space.shapes, space.world, space.scratch, q, space.own_leaves, np.inf, space.state):
        return -1.0
    return float(space.state.misc[LEAF])


@hot_kernel
def _store(space, s, t):  # type: ignore[no-untyped-def]
    memory = space.memory
    memory.at[s] = t
    for b in range(space.state.clear.shape[0]):  # element by element: assigning a row would allocate
        memory.clear[s, b] = space.state.clear[b]
        memory.leaf_clear[s, b] = space.state.leaf_clear[b]
    for k in range(space.state.misc.shape[0]):
        memory.misc[s, k] = space.state.misc[k]


@hot_kernel
def _open_interval(space, a, b, length, bodies):  # type: ignore[no-untyped-def]
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
    if space.world.exclusion[3] > 0.0:
        zone_a = memory.misc[a, ZONE]
        zone_b = memory.misc[b, ZONE]
        if (zone_a > 0.0) != (zone_b > 0.0) or abs(zone_a) + abs(zone_b) < reach:
            if reach > _ZONE_STEP_M:
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
def arm_edge(space: ArmSpace, a: Array, b: Array, weight: float, bound: float) -> float:
    """`lime_planner.space.edge` for the arm: intervals are halved, widest first, until stems and leaves are settled in each."""
    counters = space.counters
    counters[1] += 1
    n = a.shape[0]
    memory = space.memory
    bodies = memory.clear.shape[1]
    lever = space.shapes.lever
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
        if not within_box(space, q) or not check(
            space.chain, space.shapes, space.world, space.scratch, q, space.own_leaves, np.inf, space.state
        ):
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
        if not check(space.chain, space.shapes, space.world, space.scratch, memory.q, space.own_leaves, np.inf, space.state):
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


@hot_kernel
def arm_repulsion(space: ArmSpace, q: Array, d_star: float, k_leaf: float, k_stem: float, force: Array) -> float:
    """`lime_planner.space.repulsion` for the arm.

    d_obs is the shortest workspace distance between the arm's spheres and the cloud of each class (paper, section V); the force is
    -dU/dd times its gradient, through the Jacobian of the closest sphere. Distances in metres, forces per radian.
    """
    from_check = check(space.chain, space.shapes, space.world, space.scratch, q, False, -np.inf, space.state)
    shapes = space.shapes
    poses = space.scratch.poses
    fields = space.world.fields
    h = 0.5 * fields.spacing_m
    nearest = CAP_M
    for channel in range(2):
        gain = k_stem if channel == 0 else k_leaf
        radius = space.world.stem_radius if channel == 0 else space.world.leaf_radius
        best = np.inf
        body = -1
        px = py = pz = 0.0
        for b in range(1, shapes.spacing.shape[0]):
            pose = poses[b]
            for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
                sphere = shapes.coarse[c]
                x = pose[0, 0] * sphere[0] + pose[0, 1] * sphere[1] + pose[0, 2] * sphere[2] + pose[0, 3]
                y = pose[1, 0] * sphere[0] + pose[1, 1] * sphere[1] + pose[1, 2] * sphere[2] + pose[1, 3]
                z = pose[2, 0] * sphere[0] + pose[2, 1] * sphere[1] + pose[2, 2] * sphere[2] + pose[2, 3]
                if sample(fields, x, y, z)[channel] - sphere[3] - radius >= min(best, d_star):
                    continue
                for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
                    sphere = shapes.fine[f]
                    x = pose[0, 0] * sphere[0] + pose[0, 1] * sphere[1] + pose[0, 2] * sphere[2] + pose[0, 3]
                    y = pose[1, 0] * sphere[0] + pose[1, 1] * sphere[1] + pose[1, 2] * sphere[2] + pose[1, 3]
                    z = pose[2, 0] * sphere[0] + pose[2, 1] * sphere[1] + pose[2, 2] * sphere[2] + pose[2, 3]
                    d = sample(fields, x, y, z)[channel] - sphere[3] - radius
                    if d < best:
                        best = d
                        body = b
                        px = x
                        py = y
                        pz = z
        if body < 0:
            continue
        nearest = min(nearest, best)
        if best <= 1e-4 or best > d_star:
            continue
        gx = (sample(fields, px + h, py, pz)[channel] - sample(fields, px - h, py, pz)[channel]) / (2.0 * h)
        gy = (sample(fields, px, py + h, pz)[channel] - sample(fields, px, py - h, pz)[channel]) / (2.0 * h)
        gz = (sample(fields, px, py, pz + h)[channel] - sample(fields, px, py, pz - h)[channel]) / (2.0 * h)
        strength = gain * (1.0 / best - 1.0 / d_star) / (best * best)
        for j in range(body):
            pose = poses[j + 1]
            zx = pose[0, 2]
            zy = pose[1, 2]
            zz = pose[2, 2]
            if space.chain.prismatic[j]:
                slope = zx * gx + zy * gy + zz * gz
            else:
                rx = px - pose[0, 3]
                ry = py - pose[1, 3]
                rz = pz - pose[2, 3]
                slope = (zy * rz - zz * ry) * gx + (zz * rx - zx * rz) * gy + (zx * ry - zy * rx) * gz
            force[j] += strength * slope
    return nearest if from_check else min(nearest, 0.0)


@overload(protocol.evaluate)
def _evaluate(space: Any, q: Any) -> Any:
    if not protocol.is_space(space, ArmSpace):
        return None

    def implementation(space: Any, q: Any) -> Any:
        return arm_evaluate(space, q)

    return implementation


@overload(protocol.edge)
def _edge(space: Any, a: Any, b: Any, weight: Any, bound: Any) -> Any:
    if not protocol.is_space(space, ArmSpace):
        return None

    def implementation(space: Any, a: Any, b: Any, weight: Any, bound: Any) -> Any:
        return arm_edge(space, a, b, weight, bound)

    return implementation


@overload(protocol.repulsion)
def _repulsion(space: Any, q: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
    if not protocol.is_space(space, ArmSpace):
        return None

    def implementation(space: Any, q: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
        return arm_repulsion(space, q, d_star, k_leaf, k_stem, force)

    return implementation


__all__ = ["SELF_CLEARANCE_M", "ArmSpace", "EdgeMemory", "arm_edge", "arm_evaluate", "arm_repulsion", "make_arm_space", "own_thread", "within_box"]
