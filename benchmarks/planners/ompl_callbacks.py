"""What OMPL calls back into: validity and cost of states and edges, and the question whether to stop."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ompl import base as ob
from ompl import geometric as og

from benchmarks.planners.compiled_checks import CompiledChecks
from lime_planner.experiments.problems import Problem

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


_REMEMBERED = 200_000  # edges kept
_POLL_S = 0.0005  # the clock is read and the best cost is asked for this often


class Callbacks:
    """What OMPL calls, and how long it takes.

    Attributes:
        checks: the compiled checks; leafless: the same without leaves, one count for both.
        calls: number of callbacks; callback_s: time spent in them [s], what it takes to get there left out.
        polls: how often OMPL asked whether to stop.
    """

    def __init__(self, problem: Problem) -> None:
        space = problem.space()
        self.checks = CompiledChecks(space, problem.settings.weight)
        self.leafless = CompiledChecks(space._replace(own_leaves=False), 0.0)
        self.n = len(problem.start)
        self._all = slice(0, self.n)
        self._costs: dict[tuple[float, ...], float] = {}
        self._clear: set[tuple[float, ...]] = set()
        self.calls, self.polls, self.callback_s = 0, 0, 0.0

    def valid(self, state: Any) -> bool:
        """Whether a state is valid."""
        began = time.perf_counter()
        answer = self.checks.valid(state[self._all])
        self.calls += 1
        self.callback_s += time.perf_counter() - began
        return answer

    def edge(self, a: Any, b: Any) -> float:
        """J of an edge, inf where it is blocked."""
        began = time.perf_counter()
        first, second = a[self._all], b[self._all]
        key = (*first, *second)
        cost = self._costs.get(key)
        if cost is None:
            cost = self.checks.cost(first, second)
            self._remember(key, (*second, *first), cost)
        self.calls += 1
        self.callback_s += time.perf_counter() - began
        return cost

    def clear(self, a: Any, b: Any) -> bool:
        """Whether an edge is clear of everything hard, leaves left out of account: for planners that look for any path."""
        began = time.perf_counter()
        first, second = a[self._all], b[self._all]
        key = (*first, *second)
        answer = key in self._clear or self._costs.get(key, math.inf) < math.inf
        if not answer and key not in self._costs:
            back = (*second, *first)
            answer = self.leafless.cost(first, second) < math.inf
            if answer:
                if len(self._clear) >= _REMEMBERED:
                    self._clear.clear()
                self._clear |= {key, back}
            else:
                self._remember(key, back, math.inf)  # what blocks it without leaves blocks it with them
        self.calls += 1
        self.callback_s += time.perf_counter() - began
        return answer

    def _remember(self, key: tuple[float, ...], back: tuple[float, ...], cost: float) -> None:
        if len(self._costs) >= _REMEMBERED:
            self._costs.clear()
        self._costs[key] = self._costs[back] = cost

    @property
    def compiled_s(self) -> float:
        """Time spent in compiled checks [s]."""
        return self.checks.compiled_s + self.leafless.compiled_s


def stopping(callbacks: Callbacks, over: Callable[[], bool], watch: Callable[[], float] = lambda: 0.0) -> Callable[[], bool]:
    """`over` for OMPL, which asks in every turn of its loops: carried out every half millisecond, with `watch` beside it.

    `watch` returns how much of its time is OMPL's own [s], which is not counted as a callback's.
    """
    asked_s, ended = -math.inf, False

    def stop() -> bool:
        nonlocal asked_s, ended
        callbacks.polls += 1
        now_s = time.perf_counter()
        if now_s - asked_s > _POLL_S:
            asked_s = now_s
            omitted_s = watch()
            ended = over()
            callbacks.callback_s += time.perf_counter() - now_s - omitted_s
        return ended

    return stop
