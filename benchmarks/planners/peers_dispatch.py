"""What OMPL's calls into Python cost besides the functions called: finding the method, wrapping two states, taking the result.

No clock inside a function sees that. It is measured on a path of OMPL's own states, as its planners' are: each call has to wrap them anew.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ompl import base as ob
from ompl import geometric as og

_EDGES = 200
_REPEATS = 40


class Dispatch(NamedTuple):
    """Times of one call [s], each beyond what OMPL would need for its own length.

    Attributes:
        heuristic_s: of the heuristic, counting left out; count_s: of counting it.
        function_s: of a Python function that does nothing but make a cost; poll_s: of one that reads a wall clock besides.
    """

    heuristic_s: float
    count_s: float
    function_s: float
    poll_s: float


def counted(function: Callable[[Any, Any], Any]) -> Any:
    """A function of OMPL's as an override that counts its calls (`cache_info().misses`) without a Python frame.

    OMPL's binding takes a bare function of its own for "not overridden". A cache of size 0 keeps nothing and is written in C.
    What the counting costs is `Dispatch.count_s`, and is to be given back.
    """
    return functools.lru_cache(maxsize=0)(function)


def _edge_times(path: Any, objectives: Sequence[Any]) -> list[float]:
    """Least time that each objective takes for an edge [s]; by turns, so that a busy moment falls on all of them."""
    best = [math.inf] * len(objectives)
    for _ in range(_REPEATS):
        for i, objective in enumerate(objectives):
            began = time.perf_counter()
            path.cost(objective)
            best[i] = min(best[i], time.perf_counter() - began)
    return [value / _EDGES for value in best]


def dispatch_times(information: Any, a: Any, b: Any) -> Dispatch:
    """Measure them, in about 10 ms.

    Args:
        information: OMPL's, of the space.
        a, b: two states; no edge between them is checked.
    """
    path = og.PathGeometric(information)
    for i in range(_EDGES + 1):
        path.append(b if i % 2 else a)
    length = ob.PathLengthOptimizationObjective(information)
    make = ob.Cost

    def nothing(self: Any, a: Any, b: Any) -> Any:
        return make(0.0)

    def poll(self: Any, a: Any, b: Any) -> Any:
        time.perf_counter()
        return make(0.0)

    methods = (staticmethod(functools.partial(length.motionCost)), staticmethod(counted(length.motionCost)), nothing, poll)
    objectives = [type("Cost", (ob.PathLengthOptimizationObjective,), {"motionCost": method})(information) for method in methods]
    own_s, *times = _edge_times(path, [length, *objectives])
    plain_s, counted_s, function_s, poll_s = (max(value - own_s, 0.0) for value in times)
    return Dispatch(plain_s, max(counted_s - plain_s, 0.0), function_s, poll_s)
