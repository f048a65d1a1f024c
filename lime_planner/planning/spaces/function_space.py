"""A space from functions: whether a configuration is valid, what it costs, and how far two of them are apart.

Compiled planners call the functions through their addresses, so that one compilation serves all of them. A function may be

- a plain Python callable: convenient, about a microsecond per call, and it takes the GIL;
- the result of `numba.cfunc(...)`: as fast as a built-in space.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

import numba.core.types as nt
import numpy as np
import numpy.typing as npt
from llvmlite import ir  # type: ignore[import-untyped]
from numba.extending import intrinsic

from lime_planner.core.errors import ProblemError
from lime_planner.core.jit import overload
from lime_planner.core.types import Array, Int64
from lime_planner.planning.prices import stretch_cost
from lime_planner.planning.space import N_EDGE_STATES, N_EDGES, N_STATES, distance, edge, evaluate, is_space, repulsion

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

    def raise_pending(self) -> None:
        """Raise the exception that one of the functions raised while compiled code called it, if any."""
        callbacks: Any = self.addresses.base
        while isinstance(callbacks, np.ndarray):
            callbacks = callbacks.base
        if isinstance(callbacks, _Callbacks) and callbacks.error is not None:
            error, callbacks.error = callbacks.error, None
            raise error


FunctionSpace.own_distance = True  # type: ignore[attr-defined]  # `lime_planner.planning.space.distance` is asked, not assumed


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


def _calling(kinds: str) -> Any:
    """Return the code of an intrinsic f(address, *arguments): each kind is p (pointer, given as int64), d (double) or i (int64)."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        types = {"p": ir.DoubleType().as_pointer(), "d": ir.DoubleType(), "i": ir.IntType(64)}
        arguments = [builder.inttoptr(v, types["p"]) if kind == "p" else v for kind, v in zip(kinds, values[1:], strict=True)]
        function_type = ir.FunctionType(ir.DoubleType(), [types[kind] for kind in kinds])
        return builder.call(builder.inttoptr(values[0], function_type.as_pointer()), arguments)

    return generate


@intrinsic
def _call_one(typing_context: Any, address: Any, q: Any, n: Any) -> Any:
    return nt.float64(nt.int64, nt.int64, nt.int64), _calling("pi")


@intrinsic
def _call_two(typing_context: Any, address: Any, a: Any, b: Any, n: Any) -> Any:
    return nt.float64(nt.int64, nt.int64, nt.int64, nt.int64), _calling("ppi")


@intrinsic
def _call_field(typing_context: Any, address: Any, q: Any, force: Any, d_star: Any, k_leaf: Any, k_stem: Any, n: Any) -> Any:
    return nt.float64(nt.int64, nt.int64, nt.int64, nt.float64, nt.float64, nt.float64, nt.int64), _calling("ppdddi")


@overload(distance)
def _distance(space: Any, a: Any, b: Any) -> Any:
    if not is_space(space, FunctionSpace):
        return None

    def implementation(space: Any, a: Any, b: Any) -> Any:
        if space.addresses[_DISTANCE] != 0:
            return _call_two(space.addresses[_DISTANCE], a.ctypes.data, b.ctypes.data, a.shape[0])
        total = 0.0
        for i in range(a.shape[0]):
            total += (a[i] - b[i]) ** 2
        return np.sqrt(total)

    return implementation


@overload(evaluate)
def _evaluate(space: Any, q: Any) -> Any:
    if not is_space(space, FunctionSpace):
        return None

    def implementation(space: Any, q: Any) -> Any:
        space.counters[N_STATES] += 1
        for i in range(q.shape[0]):
            if not (space.lower[i] <= q[i] <= space.upper[i]):
                return -1.0
        if not _call_one(space.addresses[_VALID], q.ctypes.data, q.shape[0]) > 0.0:
            return -1.0
        if space.addresses[_COST] == 0:
            return 0.0
        return max(0.0, _call_one(space.addresses[_COST], q.ctypes.data, q.shape[0]))

    return implementation


@overload(edge)
def _edge(space: Any, a: Any, b: Any, weight: Any, bound: Any) -> Any:
    if not is_space(space, FunctionSpace):
        return None

    def implementation(space: Any, a: Any, b: Any, weight: Any, bound: Any) -> Any:
        space.counters[N_EDGES] += 1
        length = distance(space, a, b)
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
            intensity = evaluate(space, q)
            if intensity < 0.0:
                return np.inf
            leaf += intensity
            if stretch_cost(length, weight, length * leaf / pieces) > bound:
                break
        return stretch_cost(length, weight, length * leaf / pieces)

    return implementation


@overload(repulsion)
def _repulsion(space: Any, q: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
    if not is_space(space, FunctionSpace):
        return None

    def implementation(space: Any, q: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
        if space.addresses[_FIELD] == 0:
            return np.inf
        return _call_field(space.addresses[_FIELD], q.ctypes.data, force.ctypes.data, d_star, k_leaf, k_stem, q.shape[0])

    return implementation
