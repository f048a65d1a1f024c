"""A space from functions: whether a configuration is valid, what it costs, and how far two of them are apart.

Compiled planners call the functions through their addresses, so that one compilation serves all of them. A function may be

- a plain Python callable: convenient, about a microsecond per call, and it takes the GIL;
- the result of `numba.cfunc(...)`: as fast as a built-in space.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numba.core.types as nt
import numpy as np
import numpy.typing as npt

from lime_planner.core.c_structures import address_of, caller, reader, vector
from lime_planner.core.errors import ProblemError
from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array, Int64
from lime_planner.planning.prices import stretch_cost
from lime_planner.planning.space import N_EDGE_STATES, N_EDGES, N_STATES, SpaceFunctions, SpaceHandle, make_handle, space_functions

_VALID, _COST, _DISTANCE, _FIELD = range(4)

#: What a `numba.cfunc` for each function is declared with, and what a C function must look like.
ONE_CONFIGURATION = nt.float64(nt.CPointer(nt.float64), nt.int64)  #: validity (0 is invalid) and cost: f(q, n)
TWO_CONFIGURATIONS = nt.float64(nt.CPointer(nt.float64), nt.CPointer(nt.float64), nt.int64)  #: distance: f(a, b, n)
FIELD = nt.float64(nt.CPointer(nt.float64), nt.CPointer(nt.float64), nt.float64, nt.float64, nt.float64, nt.int64)
"""Field: f(q, force, d_star, k_leaf, k_stem, n); adds to force, returns the distance to the nearest obstacle."""

_POINTER = ctypes.POINTER(ctypes.c_double)
_C_TYPES = {
    _VALID: ctypes.CFUNCTYPE(ctypes.c_double, _POINTER, ctypes.c_int64),
    _COST: ctypes.CFUNCTYPE(ctypes.c_double, _POINTER, ctypes.c_int64),
    _DISTANCE: ctypes.CFUNCTYPE(ctypes.c_double, _POINTER, _POINTER, ctypes.c_int64),
    _FIELD: ctypes.CFUNCTYPE(ctypes.c_double, _POINTER, _POINTER, ctypes.c_double, ctypes.c_double, ctypes.c_double, ctypes.c_int64),
}


class _Callbacks:
    """Addresses of the functions, in memory that keeps the functions alive; exceptions in them are kept for the planner."""

    def __init__(self) -> None:
        self.addresses = np.zeros(4, dtype=np.int64)
        self.kept: list[Any] = []
        self.error: BaseException | None = None
        self.__array_interface__ = self.addresses.__array_interface__

    def add(self, slot: int, function: Any, configurations: int) -> None:
        if hasattr(function, "address"):  # numba.cfunc
            self.kept.append(function)
            self.addresses[slot] = int(function.address)
            return

        def call(*arguments: Any) -> float:
            if self.error is not None:
                return -1.0
            n = arguments[-1]
            try:
                arrays = [np.ctypeslib.as_array(pointer, shape=(n,)) for pointer in arguments[:configurations]]
                return float(function(*arrays, *arguments[configurations:-1]))
            except BaseException as error:  # nothing may pass through compiled code: raised again by `raise_pending`
                self.error = error
                return -1.0

        wrapped = _C_TYPES[slot](call)
        self.kept += [function, wrapped]
        self.addresses[slot] = ctypes.cast(wrapped, ctypes.c_void_p).value or 0


class FunctionSpace(NamedTuple):
    """A space whose answers come from functions; made by `function_space`.

    Attributes:
        lower: sampling box, (n,).
        upper: sampling box, (n,).
        counters: see `lime_planner.planning.space`, int64 (8,).
        addresses: of the four functions, int64 (4,); 0 where there is none. Its memory keeps the functions alive.
        edge_step: distance between the configurations at which an edge is looked at.
        scratch: working memory, (n,).
    """

    lower: Array
    upper: Array
    counters: Int64
    addresses: Int64
    edge_step: float
    scratch: Array

    def handle(self) -> SpaceHandle:
        """The space as planners take it."""
        return make_handle(self, _functions(bool(self.addresses[_DISTANCE])), _type())

    def raise_pending(self) -> None:
        """Raise the exception that one of the functions raised while compiled code called it, if any."""
        callbacks: Any = self.addresses.base
        while isinstance(callbacks, np.ndarray):
            callbacks = callbacks.base
        if isinstance(callbacks, _Callbacks) and callbacks.error is not None:
            error, callbacks.error = callbacks.error, None
            raise error


def function_space(
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    valid: Callable[[Array], bool] | Any,
    cost: Callable[[Array], float] | Any = None,
    distance: Callable[[Array, Array], float] | Any = None,
    field: Callable[[Array, Array, float, float, float], float] | Any = None,
    edge_step: float | None = None,
) -> FunctionSpace:
    """Make a space from functions of configurations (n,).

    Python callables get arrays that are only valid during the call. An exception in one ends the planning call and is raised there.

    Args:
        lower: sampling box, (n,).
        upper: sampling box, (n,).
        valid: f(q) is true where q is allowed; asked inside the box only.
        cost: f(q) is the leaf intensity, 0 in free space (default: 0 everywhere).
        distance: f(a, b), a metric (default: Euclidean). Edges are straight lines all the same.
        field: f(q, force, d_star, k_leaf, k_stem) adds the repulsive force at q to `force` and returns the distance to the nearest
            obstacle, 0 or less inside one (default: no repulsion).
        edge_step: spacing at which edges are looked at (default: 1/200 of the box's diagonal).

    Raises:
        ProblemError: a malformed box, a spacing that is not positive, or something that cannot be called.
    """
    low, high = np.array(lower, dtype=np.float64), np.array(upper, dtype=np.float64)
    if low.ndim != 1 or low.shape != high.shape or not len(low):
        raise ProblemError(f"lower and upper must be two lists of equal length, got shapes {low.shape} and {high.shape}")
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
        raise ProblemError(f"lower must be finite and below upper, got {low.tolist()} and {high.tolist()}")
    step = float(np.linalg.norm(high - low)) / 200.0 if edge_step is None else float(edge_step)
    if not step > 0.0:
        raise ProblemError(f"edge_step must be positive, got {step}")
    callbacks = _Callbacks()
    functions = ((_VALID, valid, "valid", 1), (_COST, cost, "cost", 1), (_DISTANCE, distance, "distance", 2), (_FIELD, field, "field", 2))
    for slot, function, name, configurations in functions:
        if function is None and slot != _VALID:
            continue
        if not (callable(function) or hasattr(function, "address")):
            raise ProblemError(f"{name} must be a callable or a numba.cfunc, got {function!r}")
        callbacks.add(slot, function, configurations)
    addresses = np.asarray(callbacks)  # its base is `callbacks`
    return FunctionSpace(low, high, np.zeros(8, dtype=np.int64), addresses, step, np.empty(len(low)))


_call_one = caller(nt.float64, "ii")
_call_two = caller(nt.float64, "iii")
_call_field = caller(nt.float64, "iidddi")


@hot_kernel
def _function_distance(space: Any, a: Any, b: Any) -> Any:
    if space.addresses[_DISTANCE] != 0:
        return _call_two(space.addresses[_DISTANCE], address_of(a), address_of(b), a.shape[0])
    total = 0.0
    for i in range(a.shape[0]):
        total += (a[i] - b[i]) ** 2
    return np.sqrt(total)


@hot_kernel
def _function_evaluate(space: Any, q: Any) -> Any:
    space.counters[N_STATES] += 1
    for i in range(q.shape[0]):
        if not (space.lower[i] <= q[i] <= space.upper[i]):
            return -1.0
    if not _call_one(space.addresses[_VALID], address_of(q), q.shape[0]) > 0.0:
        return -1.0
    if space.addresses[_COST] == 0:
        return 0.0
    return max(0.0, _call_one(space.addresses[_COST], address_of(q), q.shape[0]))


@hot_kernel
def _function_edge(space: Any, a: Any, b: Any, weight: Any, bound: Any) -> Any:
    space.counters[N_EDGES] += 1
    length = _function_distance(space, a, b)
    if length > bound:
        return length
    pieces = max(1, int(np.ceil(length / space.edge_step)))
    leaf = 0.0
    q = space.scratch
    for piece in range(pieces):  # the middles of equal pieces: the same configurations in both directions
        t = (piece + 0.5) / pieces
        for i in range(a.shape[0]):
            q[i] = (1.0 - t) * a[i] + t * b[i]
        space.counters[N_EDGE_STATES] += 1
        intensity = _function_evaluate(space, q)
        if intensity < 0.0:
            return np.inf
        leaf += intensity
        if stretch_cost(length, weight, length * leaf / pieces) > bound:
            break
    return stretch_cost(length, weight, length * leaf / pieces)


@hot_kernel
def _function_repulsion(space: Any, q: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
    if space.addresses[_FIELD] == 0:
        return np.inf
    return _call_field(space.addresses[_FIELD], address_of(q), address_of(force), d_star, k_leaf, k_stem, q.shape[0])


@functools.cache
def _type() -> Any:
    return numba.typeof(FunctionSpace(np.zeros(0), np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64), 1.0, np.zeros(0)))


_read = reader(_type)


def _evaluate_at(structure: Any, q: Any, n: Any) -> Any:
    return _function_evaluate(_read(structure), vector(q, n))


def _edge_at(structure: Any, a: Any, b: Any, n: Any, weight: Any, bound: Any) -> Any:
    return _function_edge(_read(structure), vector(a, n), vector(b, n), weight, bound)


def _repulsion_at(structure: Any, q: Any, n: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
    return _function_repulsion(_read(structure), vector(q, n), d_star, k_leaf, k_stem, vector(force, n))


def _distance_at(structure: Any, a: Any, b: Any, n: Any) -> Any:
    return _function_distance(_read(structure), vector(a, n), vector(b, n))


@functools.cache
def _functions(own_distance: bool) -> SpaceFunctions:
    return space_functions(_evaluate_at, _edge_at, _repulsion_at, _distance_at if own_distance else None)
