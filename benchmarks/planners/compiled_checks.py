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

import numpy as np

from lime_planner.collision.joint_space import ArmSpace


class CompiledChecks:
    """Validity and edge cost J of one space, called from Python with lists of numbers.

    Attributes:
        space: the space; its counters say how many configurations were checked.
        compiled_s: time spent in compiled code so far [s].
    """

    def __init__(self, space: ArmSpace, weight: float) -> None:
        n = len(space.lower)
        self.space, self.weight, self.compiled_s = space, float(weight), 0.0
        self._handle = space.handle()
        self._a, self._b = (np.zeros(n) for _ in range(2))
        structure, evaluate_function, edge_function = (int(v) for v in self._handle.calls[:3])
        real, whole, pointer = ctypes.c_double, ctypes.c_int64, ctypes.c_void_p
        ends = (self._a.ctypes.data, self._b.ctypes.data, n)
        self._edge = functools.partial(ctypes.CFUNCTYPE(real, whole, pointer, pointer, whole, real, real)(edge_function), structure, *ends)
        self._evaluate = functools.partial(ctypes.CFUNCTYPE(real, whole, pointer, whole)(evaluate_function), structure, ends[0], n)

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
        leaf = self._evaluate()
        self.compiled_s += time.perf_counter() - began
        return bool(leaf >= 0.0)

    def cost(self, a: Sequence[float], b: Sequence[float], bound: float = math.inf) -> float:
        """J of the straight edge a → b, inf where it is blocked; see `lime_planner.planning.space.edge`."""
        self._a[:] = a
        self._b[:] = b
        began = time.perf_counter()
        value = self._edge(self.weight, bound)
        self.compiled_s += time.perf_counter() - began
        return float(value)
