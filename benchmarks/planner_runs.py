"""One run of one of the package's own planners on one problem, as a record for JSON: best J against time and against checks."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lime_planner.core.errors import ParameterError
from lime_planner.core.planners import PLANNERS
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem
from lime_planner.planning.planner import Outcome, Planner, Query, load_planner

CLOCKS: dict[str, Callable[[], float]] = {"wall": time.monotonic, "cpu": time.thread_time}

#: Planners that comparisons know by a name of their own: the paper's as published; the planner's name and further settings.
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    f"{name}_paper": (name, {"paper": True}) for name in ("apf_rrt_star", "rrt_star", "p_rrt_star")
}

#: The package's own planners in comparisons: those of the table, and the variants.
OWN_METHODS = (*PLANNERS, *VARIANTS)

_READ_EVERY_S = 0.0005
_DIGITS = 6  # of a cost, behind the point


def seldom(clock: Callable[[], float]) -> Callable[[], float]:
    """The same clock, read at most every half millisecond [s]; the last reading is given in between.

    Reading a thread's own time is a system call of microseconds: a planner that asks in each iteration would be charged for that.
    """
    read_s, value_s = -math.inf, 0.0

    def reading() -> float:
        nonlocal read_s, value_s
        now_s = time.perf_counter()
        if now_s - read_s > _READ_EVERY_S:
            read_s, value_s = now_s, clock()
        return value_s

    return reading


@dataclass
class Curve:
    """Improvements of the best path while a planner runs: (time [s], configurations checked, J), J falling."""

    points: list[tuple[float, int, float]] = field(default_factory=list)

    def add(self, time_s: float, checks: int, cost: float) -> None:
        """Note a path's cost if it is the best so far, in the digits that are kept."""
        if math.isfinite(cost) and (not self.points or round(cost, _DIGITS) < round(self.points[-1][2], _DIGITS)):
            self.points.append((float(time_s), int(checks), float(cost)))

    def to_list(self) -> list[list[float]]:
        """JSON-ready."""
        return [[round(t, 5), n, round(c, _DIGITS)] for t, n, c in self.points]


def cost_at(curve: Sequence[Sequence[float]], mark: float, column: int = 0) -> float:
    """Best J of a curve up to a time (column 0) or a number of checks (column 1); inf before the first path."""
    best = math.inf
    for point in curve:
        if point[column] <= mark:
            best = min(best, point[2])
    return best


def record(
    method: str, problem: Problem, seed: int, curve: Curve, *, seconds: float, checks: int, path: Array | None, **more: Any
) -> dict[str, Any]:
    """A run's record: `cost` is the final path's J by the common measure, None without a path."""
    final = problem.cost(path)
    return {
        "problem": problem.spec.key,
        "method": method,
        "seed": seed,
        "seconds": seconds,
        "checks": int(checks),
        "curve": curve.to_list(),
        "cost": final if math.isfinite(final) else None,
        "path": None if path is None else np.round(path, 6).tolist(),
        **more,
    }


def planner_of(method: str) -> tuple[Planner[Any], dict[str, Any]]:
    """The planner that a method stands for, and further settings of the method.

    Raises:
        ParameterError: unknown method.
    """
    if method not in OWN_METHODS:
        raise ParameterError(f"method {method!r} is none of {', '.join(OWN_METHODS)}")
    name, changes = VARIANTS.get(method, (method, {}))
    return load_planner(name), changes


def options_of(problem: Problem, method: str) -> Any:
    """The options of the planner that a method stands for, from the problem's settings.

    Raises:
        ParameterError: unknown method.
    """
    planner, changes = planner_of(method)
    return planner.options(dataclasses.replace(problem.settings, planner=planner.name, **changes))


def is_anytime(method: str) -> bool:
    """Whether a method's best path never gets worse; the paper's planners minimise another cost than J.

    Raises:
        ParameterError: unknown method.
    """
    return planner_of(method)[0].anytime and method not in VARIANTS


def search(problem: Problem, method: str, seed: int, space: Any = None, **limits: Any) -> Outcome:
    """Run a method once, on a space of its own or a given one, within limits of `Query`."""
    space = problem.space() if space is None else space
    query = Query(space, problem.start, problem.goals.configurations, seed, **limits)
    return planner_of(method)[0].run(query, options_of(problem, method))


def run_anytime(problem: Problem, method: str, seed: int, seconds: float, clock: str = "wall") -> dict[str, Any]:
    """Run an anytime planner once; its history is the curve.

    Args:
        problem: the problem.
        method: one of `OWN_METHODS` whose planner is anytime.
        seed: of the planner.
        seconds: its budget.
        clock: `wall`, or `cpu`: the thread's own time, for a machine that others share.
    """
    space = problem.space()
    now = CLOCKS[clock]
    passed: list[tuple[float, float, int]] = []
    wall_s, began_s = time.monotonic(), now()

    def over() -> bool:
        spent_s = now() - began_s
        passed.append((time.monotonic() - wall_s, spent_s, int(space.counters[0] + space.counters[2])))
        return spent_s >= seconds

    outcome = search(problem, method, seed, space, should_stop=over)
    walls, spent, checks = np.array([(0.0, 0.0, 0), *passed]).T
    curve = Curve()
    for t, _, cost in outcome.history:
        curve.add(float(np.interp(t, walls, spent)), int(np.interp(t, walls, checks)), cost)
    return record(method, problem, seed, curve, seconds=seconds, checks=outcome.checks, path=outcome.path, iterations=outcome.iterations)


def run_marks(problem: Problem, method: str, seed: int, marks_s: Sequence[float], clock: str = "wall") -> dict[str, Any]:
    """Run a planner once for each mark, from the start: the curve holds what a user gets for that time.

    For a planner of another metric than J: a longer run may return a path of higher J; the curve keeps the best.
    """
    now = CLOCKS[clock]
    curve = Curve()
    checks, through_stem, path = 0, 0, None
    for mark in sorted(marks_s):
        began_s = now()

        def over(end_s: float = began_s + mark) -> bool:
            return now() >= end_s

        outcome = search(problem, method, seed, should_stop=over)
        checks = outcome.checks
        cost = problem.cost(outcome.path)
        through_stem += int(outcome.path is not None and not math.isfinite(cost))
        curve.add(mark, checks, cost)
        if math.isfinite(cost) and cost <= curve.points[-1][2]:
            path = outcome.path
    return record(method, problem, seed, curve, seconds=max(marks_s), checks=checks, path=path, paths_through_stem=through_stem)


def warm_up(problem: Problem, method: str) -> None:
    """Load or compile everything that a method passes through, so that no measured run pays for it."""
    search(problem, method, 0, iterations=planner_of(method)[0].warm_iterations)
    planner_of(method)[0].warm_up(problem.space())
    problem.cost(np.array([problem.start, problem.goals.configurations[0]]))


def run_own(problem: Problem, method: str, seed: int, marks_s: Sequence[float], clock: str = "wall") -> dict[str, Any]:
    """Run one of `OWN_METHODS` for the longest mark.

    Raises:
        ParameterError: unknown method.
    """
    if is_anytime(method):
        return run_anytime(problem, method, seed, max(marks_s), clock)
    return run_marks(problem, method, seed, marks_s, clock)
