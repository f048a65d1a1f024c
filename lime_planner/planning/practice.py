"""A small search of each planner, so that its kernels are compiled (or read from the cache) before a real one is timed.

Planners are compiled for every space at once (`lime_planner.planning.space`): this one is made of Python functions and needs no arm.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np

from lime_planner.core.parameters import settings_from
from lime_planner.core.types import Array, Int64
from lime_planner.planning.planner import Planner, Query
from lime_planner.planning.space import SpaceFunctions, SpaceHandle, make_handle

_N = 6
_WALL = (0.4, 0.6)  # of the first coordinate: a stem where the second is below 0.5, leaves above


class _Box(NamedTuple):
    lower: Array
    upper: Array
    counters: Int64


@dataclass(frozen=True)
class _Function:
    """A Python function at an address."""

    called: Any

    @property
    def address(self) -> int:
        return int(ctypes.cast(self.called, ctypes.c_void_p).value or 0)


def _at(address: int, n: int) -> Array:
    return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), shape=(n,))


def _evaluate(_: int, q: int, n: int) -> float:
    x, y = _at(q, n)[:2]
    return 0.0 if not _WALL[0] < x < _WALL[1] else -1.0 if y < 0.5 else 1.0


def _edge(_: int, a: int, b: int, n: int, weight: float, bound: float) -> float:
    p, q = _at(a, n), _at(b, n)
    ways = np.linspace(0.0, 1.0, 9)[:, None] * (q - p) + p
    within = (ways[:, 0] > _WALL[0]) & (ways[:, 0] < _WALL[1])
    if (within & (ways[:, 1] < 0.5)).any():
        return float("inf")
    return float(np.linalg.norm(q - p)) * (1.0 + weight * float(within.mean()))


def _repulsion(_: int, q: int, n: int, d_star: float, k_leaf: float, k_stem: float, force: int) -> float:
    return 0.5 * d_star


def practice_space() -> SpaceHandle:
    """The unit box in six dimensions with a wall in the middle, half stem, half leaves."""
    real, whole = ctypes.c_double, ctypes.c_int64
    functions = SpaceFunctions(
        _Function(ctypes.CFUNCTYPE(real, whole, whole, whole)(_evaluate)),
        _Function(ctypes.CFUNCTYPE(real, whole, whole, whole, whole, real, real)(_edge)),
        _Function(ctypes.CFUNCTYPE(real, whole, whole, whole, real, real, real, whole)(_repulsion)),
    )
    box = _Box(np.zeros(_N), np.ones(_N), np.zeros(8, np.int64))
    return make_handle(box, functions, numba.typeof(box))


def practise(planner: Planner[Any]) -> None:
    """Run a planner through all of its parts."""
    space = practice_space()
    start, goals = np.full(_N, 0.2), np.array([[0.9] * _N, [0.9, *[0.3] * (_N - 1)]])
    planner.run(
        Query(space, start, goals, 1, iterations=planner.warm_iterations), planner.options(settings_from({"planner": planner.name}))
    )
    planner.warm_up(space)
