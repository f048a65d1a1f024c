"""The arm's joint space as a planner sees it: validity, leaf intensity, edge cost and the repulsive field, compiled."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numba
import numpy as np

from lime_planner.collision.compiled_check import call_check, call_repulsion, empty_parts, make_engine
from lime_planner.collision.edge_cost import EdgeMemory, arm_check, arm_edge, make_edge_memory, within_box
from lime_planner.collision.fast import LEAF, State, make_scratch, make_state
from lime_planner.collision.leaves.sweep import Sweep
from lime_planner.collision.link_shapes import Shapes
from lime_planner.collision.world import World
from lime_planner.core.c_structures import reader, vector
from lime_planner.core.jit import hot_kernel, kernel
from lime_planner.core.types import Array, Int64
from lime_planner.planning.prices import with_unseen
from lime_planner.planning.space import SpaceFunctions, SpaceHandle, make_handle, space_functions
from lime_planner.robot.kinematics import Chain


class ArmSpace(NamedTuple):
    """Joint space of an arm in front of a plant; one for each thread, since it holds scratch memory.

    Attributes:
        lower, upper: (n,) sampling box, inside the joint limits [rad].
        counters: (8,) int64, see `lime_planner.planning.space`.
        engine: (4,) addresses, see `lime_planner.collision.compiled_check`.
        state, q, force, open, memory, sweep: this thread's memory.
        lever: (n, B) how far a body moves at most for each radian of a joint [m/rad].
        pairs: (P, 2) bodies that can touch each other.
        zoned: whether there is an approach zone.
        own_leaves: False where leaves do not matter (their weight is zero).
        unseen: (4,) addresses like `engine`, of the world of unseen space (`world.unseen_world`); zeros where everything is seen.
        unseen_state: what its check found.
        unseen_price: price of unseen space, as a share of a leaf's; 0 where everything is seen, or where that costs nothing.
    """

    lower: Array
    upper: Array
    counters: Int64
    engine: Int64
    state: State
    q: Array
    force: Array
    open: Int64
    memory: EdgeMemory
    sweep: Sweep
    lever: Array
    pairs: Int64
    zoned: bool
    own_leaves: bool
    unseen: Int64
    unseen_state: State
    unseen_price: float

    def handle(self) -> SpaceHandle:
        """The space as planners take it."""
        return make_handle(self, _functions(), _type())


def make_arm_space(
    lower: Array,
    upper: Array,
    chain: Chain,
    shapes: Shapes,
    world: World,
    *,
    leaves: bool = True,
    unseen: World | None = None,
    unseen_price: float = 0.0,
) -> ArmSpace:
    """Put a space together, with fresh memory for one thread.

    Args:
        lower, upper: (n,) sampling box [rad]; configurations outside it are invalid.
        chain, shapes: the arm.
        world: the obstacles.
        leaves: False to leave leaves out of account.
        unseen: space that no camera has seen, as `world.unseen_world` makes it.
        unseen_price: what being in it costs, as a share of a leaf's price.
    """
    memory = make_edge_memory(len(lower), len(shapes.spacing), len(shapes.pairs))
    state = make_state(shapes)
    scratch = make_scratch(shapes, world.fields)
    hidden, hidden_state = np.zeros(4, np.int64), make_state(shapes)
    if unseen is not None and unseen_price > 0.0:
        # The same functions in another world, with the edge and the configuration of this one: nothing is compiled for it.
        memory_there = make_scratch(shapes, unseen.fields)._replace(q=scratch.q, sweep=scratch.sweep)
        hidden = make_engine(chain, shapes, unseen, memory_there, hidden_state)
    return ArmSpace(
        np.ascontiguousarray(lower, dtype=np.float64),
        np.ascontiguousarray(upper, dtype=np.float64),
        np.zeros(8, np.int64),
        make_engine(chain, shapes, world, scratch, state),
        state,
        scratch.q,
        scratch.force,
        scratch.open,
        memory,
        scratch.sweep,
        np.ascontiguousarray(shapes.lever),
        np.ascontiguousarray(shapes.pairs),
        bool(world.exclusion[3] > 0.0),
        bool(leaves),
        hidden,
        hidden_state,
        0.0 if unseen is None else float(unseen_price),
    )


@hot_kernel
def arm_evaluate(space: ArmSpace, q: Array) -> float:
    """`lime_planner.planning.space.evaluate` for the arm."""
    space.counters[0] += 1
    if not within_box(space, q):
        return -1.0
    if not arm_check(space, q, space.own_leaves):
        return -1.0
    price = float(space.state.misc[LEAF])
    if space.unseen_price > 0.0:
        call_check(space.unseen[1], space.unseen[0], 1, np.inf)
        price = with_unseen(price, space.unseen_price, float(space.unseen_state.misc[LEAF]))
    return price


@kernel
def measure(space: ArmSpace, q: Array, floor: float = -np.inf) -> Any:
    """Check a configuration of any clearance completely; the figures are in space.state. Whether it is valid."""
    for i in range(q.shape[0]):
        space.q[i] = q[i]
    return call_check(space.engine[1], space.engine[0], 1, floor) != 0


@hot_kernel
def arm_repulsion(space: ArmSpace, q: Array, d_star: float, k_leaf: float, k_stem: float, force: Array) -> Any:
    """`lime_planner.planning.space.repulsion` for the arm."""
    for i in range(q.shape[0]):
        space.q[i] = q[i]
        space.force[i] = 0.0
    nearest = call_repulsion(space.engine[2], space.engine[0], space.engine[1], d_star, k_leaf, k_stem)
    for i in range(q.shape[0]):
        force[i] += space.force[i]
    return nearest


@functools.cache
def _type() -> Any:
    parts = empty_parts()
    return numba.typeof(make_arm_space(np.zeros(0), np.zeros(0), parts.chain, parts.shapes, parts.world))


_read = reader(_type)


def _evaluate_at(structure: Any, q: Any, n: Any) -> Any:
    return arm_evaluate(_read(structure), vector(q, n))


def _edge_at(structure: Any, a: Any, b: Any, n: Any, weight: Any, bound: Any) -> Any:
    return arm_edge(_read(structure), vector(a, n), vector(b, n), weight, bound)


def _repulsion_at(structure: Any, q: Any, n: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
    return arm_repulsion(_read(structure), vector(q, n), d_star, k_leaf, k_stem, vector(force, n))


@functools.cache
def _functions() -> SpaceFunctions:
    return space_functions(_evaluate_at, _edge_at, _repulsion_at)
