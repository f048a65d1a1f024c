"""What a planner may ask of a configuration space, whatever it is, inside compiled code.

A space is a `NamedTuple` of arrays and scalars (its data), with at least

- `lower`, `upper`: float64 (n,), the sampling box [rad, or the plane's unit];
- `counters`: int64 (8,), written by the implementations: see `N_STATES`, `N_EDGES`, `N_EDGE_STATES`;
- a method `handle()`, which returns the `SpaceHandle` that planners work with, made by `make_handle`.

Its implementations are C functions (`space_functions`) that find the data in memory; the functions below call them by their address.
So every planner is compiled once, for all spaces, no space is compiled into any planner, and a new space compiles nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numba.types as nt
import numpy as np

from lime_planner.core.c_structures import address_of, caller, to_memory
from lime_planner.core.jit import c_function, inline_kernel, kernel
from lime_planner.core.types import Array, Int64

N_STATES = 0  #: counter: configurations evaluated one by one
N_EDGES = 1  #: counter: edges evaluated
N_EDGE_STATES = 2  #: counter: configurations evaluated inside edges


@dataclass(frozen=True)
class SpaceFunctions:
    """The implementations of one kind of space as C functions.

    Attributes:
        evaluate: f(structure, q, n); edge: f(structure, a, b, n, weight, bound).
        repulsion: f(structure, q, n, d_star, k_leaf, k_stem, force), None for a space without a field.
        distance: f(structure, a, b, n), None where it is Euclidean.
    """

    evaluate: Any
    edge: Any
    repulsion: Any = None
    distance: Any = None


def space_functions(evaluate: Any, edge: Any, repulsion: Any = None, distance: Any = None) -> SpaceFunctions:
    """Compile the implementations of one kind of space; see `SpaceFunctions`.

    Each takes the address of the space's structure first (`c_structures.reader`), and addresses for configurations
    (`c_structures.vector`).
    """
    real, whole = nt.float64, nt.int64
    return SpaceFunctions(
        c_function(real(whole, whole, whole), evaluate),
        c_function(real(whole, whole, whole, whole, real, real), edge),
        None if repulsion is None else c_function(real(whole, whole, whole, real, real, real, whole), repulsion),
        None if distance is None else c_function(real(whole, whole, whole, whole), distance),
    )


class SpaceHandle(NamedTuple):
    """Any space, to planners; its arrays keep the space alive. As little a thing of one thread as the space itself.

    Attributes:
        lower, upper, counters: the space's.
        calls: (5,) addresses of the space's structure and of its functions; 0 for one that it does not have.
    """

    lower: Array
    upper: Array
    counters: Int64
    calls: Int64

    def handle(self) -> SpaceHandle:
        """This handle."""
        return self


_STRUCTURE, _EVALUATE, _EDGE, _REPULSION, _DISTANCE = range(5)


class _Calls:
    """The addresses in memory; an array made of it keeps alive what they point to."""

    def __init__(self, space: Any, functions: SpaceFunctions, expected: Any) -> None:
        self.kept = (space, functions, to_memory(space, expected))
        called = (functions.evaluate, functions.edge, functions.repulsion, functions.distance)
        addresses = [self.kept[2].ctypes.data, *(0 if f is None else int(f.address) for f in called)]
        self.addresses = np.array(addresses, np.int64)
        self.__array_interface__ = self.addresses.__array_interface__


def make_handle(space: Any, functions: SpaceFunctions, expected: Any) -> SpaceHandle:
    """Make the handle of a space, whose compile-time type is `expected`.

    Raises:
        TypeError: it has another type (a defect).
    """
    return SpaceHandle(space.lower, space.upper, space.counters, np.asarray(_Calls(space, functions, expected)))


_call_evaluate = caller(nt.float64, "iii")
_call_edge = caller(nt.float64, "iiiidd")
_call_repulsion = caller(nt.float64, "iiidddi")
_call_distance = caller(nt.float64, "iiii")


@inline_kernel
def evaluate(space: SpaceHandle, q: Array) -> Any:
    """Evaluate one configuration.

    Args:
        space: the space.
        q: configuration, (n,).

    Returns:
        -1.0 where q is invalid (an impermeable obstacle, out of limits), 0.0 in free space, otherwise the leaf intensity > 0 (1 for
        a touched leaf of permeability cost 1 under the binary leaf cost). The paper's C_perm(q) is c_perm times this (equation 1).
    """
    return _call_evaluate(space.calls[_EVALUATE], space.calls[_STRUCTURE], address_of(q), q.shape[0])


@inline_kernel
def edge(space: SpaceHandle, a: Array, b: Array, weight: float, bound: float) -> Any:
    """Integrate the cost of the straight edge a → b: J = length + weight · ∫ leaf intensity ds, stems certified along it.

    Args:
        space: the space.
        a: first configuration, (n,), itself valid.
        b: last configuration, (n,), itself valid.
        weight: cost of one unit of length at leaf intensity 1 [1/rad] (C_perm / δ by default).
        bound: the caller has no use for a cost above this; the evaluation may stop early.

    Returns:
        The cost; inf where the edge is blocked; any value > bound where it stopped early (a lower bound of the true cost then).
    """
    return _call_edge(space.calls[_EDGE], space.calls[_STRUCTURE], address_of(a), address_of(b), a.shape[0], weight, bound)


@inline_kernel
def repulsion(space: SpaceHandle, q: Array, d_star: float, k_leaf: float, k_stem: float, force: Array) -> Any:
    """Add the repulsive force -∇U_rep at q (equation 4, a gain for each class) to `force` (n,) and return the smallest distance.

    The distance is the plane's, or the smallest workspace distance between arm and cloud [m]; it is 0 or less inside an obstacle,
    where the singular force is left out.
    """
    if space.calls[_REPULSION] == 0:
        return np.inf
    n = q.shape[0]
    return _call_repulsion(space.calls[_REPULSION], space.calls[_STRUCTURE], address_of(q), n, d_star, k_leaf, k_stem, address_of(force))


@inline_kernel
def own_distance(space: SpaceHandle) -> bool:
    """Tell whether the distance is another one than the Euclidean."""
    return space.calls[_DISTANCE] != 0  # type: ignore[no-any-return]


@inline_kernel
def distance(space: SpaceHandle, a: Array, b: Array) -> Any:
    """Distance between two configurations; a metric, and a lower bound of every edge's cost."""
    if space.calls[_DISTANCE] != 0:
        return _call_distance(space.calls[_DISTANCE], space.calls[_STRUCTURE], address_of(a), address_of(b), a.shape[0])
    total = 0.0
    for i in range(a.shape[0]):
        total += (a[i] - b[i]) ** 2
    return np.sqrt(total)


@inline_kernel
def clamp(space: Any, q: Any) -> None:
    """Move q, (n,), into the sampling box, coordinate by coordinate."""
    for k in range(q.shape[0]):
        q[k] = min(max(q[k], space.lower[k]), space.upper[k])


@inline_kernel
def inside(space: Any, q: Any) -> bool:
    """Tell whether q, (n,), lies in the sampling box."""
    for k in range(q.shape[0]):
        if not space.lower[k] <= q[k] <= space.upper[k]:
            return False
    return True


def raise_pending(space: Any) -> None:
    """Raise what a caller's own function raised while compiled code called it, in a space that is made of such functions."""
    if (pending := getattr(space, "raise_pending", None)) is not None:
        pending()


@kernel
def _one(space: Any, q: Any) -> Any:
    return evaluate(space, q)


@kernel
def _line(space: Any, a: Any, b: Any, weight: float, bound: float) -> Any:
    return edge(space, a, b, weight, bound)


def one(space: Any, q: Array) -> float:
    """Evaluate one configuration (`space.evaluate`), of a space or, for many questions, of its handle."""
    return float(_one(space.handle(), q))


def line(space: Any, a: Array, b: Array, weight: float, bound: float) -> float:
    """Evaluate one edge (`space.edge`), of a space or, for many questions, of its handle."""
    return float(_line(space.handle(), a, b, weight, bound))
