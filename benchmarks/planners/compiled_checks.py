"""The arm's compiled checks as plain C functions, so that planners written elsewhere pay next to nothing for calling them.

Calling a Numba kernel from Python with a space of many arrays costs 4 µs before it starts, three times the check itself. A C function
that finds the space at an address costs 0.3 µs: a peer that calls back into Python must not lose a comparison to that.
"""

from __future__ import annotations

import ctypes
import functools
import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numba
import numba.core.types as nt
import numpy as np
from numba.extending import intrinsic

from lime_planner.collision.edge_cost import arm_edge
from lime_planner.collision.joint_space import ArmSpace, arm_evaluate
from lime_planner.core.jit import c_function, kernel
from lime_planner.core.types import Array


class _Call(NamedTuple):
    """A space and the two configurations that a call is about."""

    space: ArmSpace
    a: Array
    b: Array


@intrinsic
def _write(typing_context: Any, call: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        builder.store(values[0], builder.inttoptr(values[1], context.get_value_type(call).as_pointer()))
        return context.get_dummy_value()

    return nt.void(call, nt.int64), generate


@intrinsic
def _size(typing_context: Any, call: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return context.get_constant(nt.int64, context.get_abi_sizeof(context.get_value_type(call)))

    return nt.int64(call), generate


@kernel
def _write_call(call: Any, address: int) -> None:
    _write(call, address)


@kernel
def _size_of(call: Any) -> Any:
    return _size(call)


_TYPES: list[Any] = []  # the type of a call: all spaces of the arm have the same one


@intrinsic
def _read(typing_context: Any, address: Any) -> Any:
    call_type = _TYPES[0]

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load(builder.inttoptr(values[0], context.get_value_type(call_type).as_pointer()))

    return call_type(nt.int64), generate


def _edge_at(handle: Any, weight: Any, bound: Any) -> Any:
    call = _read(handle)
    return arm_edge(call.space, call.a, call.b, weight, bound)


def _evaluate_at(handle: Any) -> Any:
    call = _read(handle)
    return arm_evaluate(call.space, call.a)


@functools.cache
def _functions(call_type: Any) -> tuple[Any, Any]:
    if _TYPES and _TYPES[0] != call_type:
        raise TypeError(f"a space of another type than before: {call_type}")
    _TYPES[:] = [call_type]
    real, whole = nt.float64, nt.int64
    return c_function(real(whole, real, real), _edge_at), c_function(real(whole), _evaluate_at)


class CompiledChecks:
    """Validity and edge cost J of one space, called from Python with lists of numbers.

    Attributes:
        space: the space; its counters say how many configurations were checked.
        compiled_s: time spent in compiled code so far [s].
    """

    def __init__(self, space: ArmSpace, weight: float) -> None:
        n = len(space.lower)
        self.space, self.weight, self.compiled_s = space, float(weight), 0.0
        call = _Call(space, np.zeros(n), np.zeros(n))
        self._kept = (call, _functions(numba.typeof(call)))
        self._buffer = np.zeros(_size_of(call) // 8 + 8)
        self._handle = self._buffer.ctypes.data
        _write_call(call, self._handle)
        vector = ctypes.c_double * n
        self._a: Any = vector.from_address(call.a.ctypes.data)
        self._b: Any = vector.from_address(call.b.ctypes.data)
        edge_function, evaluate_function = self._kept[1]
        real, whole = ctypes.c_double, ctypes.c_int64
        self._edge: Any = ctypes.CFUNCTYPE(real, whole, real, real)(edge_function.address)
        self._evaluate: Any = ctypes.CFUNCTYPE(real, whole)(evaluate_function.address)

    @property
    def checks(self) -> int:
        """Configurations checked so far, inside edges included."""
        return int(self.space.counters[0] + self.space.counters[2])

    @property
    def edges(self) -> int:
        """Edges evaluated so far."""
        return int(self.space.counters[1])

    def valid(self, q: Sequence[float]) -> bool:
        """Whether a configuration is in the box and clear of everything hard."""
        self._a[:] = q
        began = time.perf_counter()
        leaf = self._evaluate(self._handle)
        self.compiled_s += time.perf_counter() - began
        return bool(leaf >= 0.0)

    def cost(self, a: Sequence[float], b: Sequence[float], bound: float = math.inf) -> float:
        """J of the straight edge a → b, inf where it is blocked; see `lime_planner.planning.space.edge`."""
        self._a[:] = a
        self._b[:] = b
        began = time.perf_counter()
        value = self._edge(self._handle, self.weight, bound)
        self.compiled_s += time.perf_counter() - began
        return float(value)
