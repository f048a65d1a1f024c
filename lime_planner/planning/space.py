"""What a planner may ask of a configuration space, as compiled functions chosen by the space's type.

A space is a `NamedTuple` of arrays and scalars (its data), with at least

- `lower`, `upper`: float64 (n,), the sampling box [rad, or the plane's unit];
- `counters`: int64 (8,), written by the implementations: see `N_STATES`, `N_EDGES`, `N_EDGE_STATES`.

The functions below are stubs; a module that defines a space registers compiled implementations for its type with
`lime_planner.core.jit.overload` and `is_space`. Planners call the stubs inside kernels, so that one planner source serves the plane
and the arm with no Python in the inner loop, and Numba inlines what it needs.
"""

from __future__ import annotations

from typing import Any

import numba.types
import numpy as np

from lime_planner.core.jit import inline_kernel, kernel, overload
from lime_planner.core.types import Array

N_STATES = 0  #: counter: configurations evaluated one by one
N_EDGES = 1  #: counter: edges evaluated
N_EDGE_STATES = 2  #: counter: configurations evaluated inside edges


def is_space(numba_type: Any, space_class: type) -> bool:
    """Tell, inside an overload, whether the compile-time type is the named tuple `space_class`."""
    return isinstance(numba_type, numba.types.NamedTuple) and numba_type.instance_class is space_class


def evaluate(space: Any, q: Array) -> float:
    """Evaluate one configuration.

    Args:
        space: the space.
        q: configuration, (n,).

    Returns:
        -1.0 where q is invalid (an impermeable obstacle, out of limits), 0.0 in free space, otherwise the leaf intensity > 0 (1 for
        a touched leaf of permeability cost 1 under the binary leaf cost). The paper's C_perm(q) is c_perm times this (equation 1).
    """
    raise NotImplementedError("only inside compiled code; see lime_planner.planning.space")


def edge(space: Any, a: Array, b: Array, weight: float, bound: float) -> float:
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
    raise NotImplementedError("only inside compiled code; see lime_planner.planning.space")


def repulsion(space: Any, q: Array, d_star: float, k_leaf: float, k_stem: float, force: Array) -> float:
    """Add the repulsive force -∇U_rep at q (equation 4, a gain for each class) to `force` (n,) and return the smallest distance.

    The distance is the plane's, or the smallest workspace distance between arm and cloud [m]; it is 0 or less inside an obstacle,
    where the singular force is left out.
    """
    raise NotImplementedError("only inside compiled code; see lime_planner.planning.space")


def distance(space: Any, a: Array, b: Array) -> float:
    """Distance between two configurations; a metric, and a lower bound of every edge's cost."""
    raise NotImplementedError("only inside compiled code; see lime_planner.planning.space")


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


@overload(distance)
def _euclidean(space: Any, a: Any, b: Any) -> Any:
    # One metric serves every space here; a space with another one registers its own overload for its type before use.
    if getattr(getattr(space, "instance_class", None), "own_distance", False):
        return None

    def implementation(space: Any, a: Any, b: Any) -> Any:
        total = 0.0
        for i in range(a.shape[0]):
            total += (a[i] - b[i]) ** 2
        return np.sqrt(total)

    return implementation


@kernel
def one(space: Any, q: Any) -> Any:
    """Evaluate one configuration (`space.evaluate`)."""
    return evaluate(space, q)


@kernel
def line(space: Any, a: Any, b: Any, weight: float, bound: float) -> Any:
    """Evaluate one edge (`space.edge`)."""
    return edge(space, a, b, weight, bound)
