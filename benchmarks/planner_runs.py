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
from lime_planner.core.parameters import settings_from
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem
from lime_planner.pipeline.search import paper_options
from lime_planner.planning.lime_star.planner import LimeOptions, plan_lime
from lime_planner.planning.rrt_star.planner import PaperOptions, plan_paper

CLOCKS: dict[str, Callable[[], float]] = {"wall": time.monotonic, "cpu": time.thread_time}

_WARM_ITERATIONS = 800  # enough to pass through every part of a search

#: The package's own planners in comparisons: the default, the paper's as published, and the paper's with the integral cost.
OWN_METHODS = ("lime_star", "apf_rrt_star", "apf_rrt_star_integral", "rrt_star", "p_rrt_star")


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


def run_lime(problem: Problem, seed: int, seconds: float, clock: str = "wall", options: LimeOptions | None = None) -> dict[str, Any]:
    """Run the default planner once; its history is the curve.

    Args:
        problem: the problem.
        seed: of the planner.
        seconds: its budget.
        clock: `wall`, or `cpu`: the thread's own time, for a machine that others share.
        options: of the planner.
    """
    space = problem.space()
    now = CLOCKS[clock]
    passed: list[tuple[float, float, int]] = []
    wall_s, began_s = time.monotonic(), now()

    def watch() -> bool:
        spent_s = now() - began_s
        passed.append((time.monotonic() - wall_s, spent_s, int(space.counters[0] + space.counters[2])))
        return spent_s >= seconds

    options = options or LimeOptions(weight=problem.settings.weight)
    outcome = plan_lime(space, problem.start, problem.goals.configurations, options, seed, should_stop=watch)
    walls, spent, checks = np.array([(0.0, 0.0, 0), *passed]).T
    curve = Curve()
    for t, _, cost in outcome.history:
        curve.add(float(np.interp(t, walls, spent)), int(np.interp(t, walls, checks)), cost)
    return record(
        "lime_star", problem, seed, curve, seconds=seconds, checks=outcome.states_checked, path=outcome.path, iterations=outcome.iterations
    )


def paper_settings(problem: Problem, method: str) -> PaperOptions:
    """The paper's planner that a method's name stands for."""
    options = paper_options(settings_from({"planner": method.removesuffix("_integral")}))
    if method.endswith("_integral"):
        options = dataclasses.replace(options, cost="integral", propagate=True)
    return options


def run_paper(problem: Problem, method: str, seed: int, marks_s: Sequence[float], clock: str = "wall") -> dict[str, Any]:
    """Run a planner of the paper once for each mark, from the start: the curve holds what a user gets for that time.

    Its own cost is the node metric, so that a longer run may return a path of higher J; the curve keeps the best.
    """
    options, now = paper_settings(problem, method), CLOCKS[clock]
    curve = Curve()
    checks, through_stem, path = 0, 0, None
    for mark in sorted(marks_s):
        space, began_s = problem.space(), now()

        def over(end_s: float = began_s + mark) -> bool:
            return now() >= end_s

        outcome = plan_paper(space, problem.start, problem.goals.configurations, options, seed, should_stop=over)
        checks = int(outcome.counters[0] + outcome.counters[2])
        cost = problem.cost(outcome.path)
        through_stem += int(outcome.path is not None and not math.isfinite(cost))
        curve.add(mark, checks, cost)
        if math.isfinite(cost) and cost <= curve.points[-1][2]:
            path = outcome.path
    return record(method, problem, seed, curve, seconds=max(marks_s), checks=checks, path=path, paths_through_stem=through_stem)


def warm_up(problem: Problem, method: str) -> None:
    """Load or compile everything that a method passes through, so that no measured run pays for it."""
    goals = problem.goals.configurations
    if method == "lime_star":
        plan_lime(problem.space(), problem.start, goals, LimeOptions(weight=problem.settings.weight), 0, iterations=_WARM_ITERATIONS)
    else:
        plan_paper(problem.space(), problem.start, goals, paper_settings(problem, method), 0, iterations=_WARM_ITERATIONS // 10)
    problem.cost(np.array([problem.start, goals[0]]))


def run_own(problem: Problem, method: str, seed: int, marks_s: Sequence[float], clock: str = "wall") -> dict[str, Any]:
    """Run one of `OWN_METHODS` for the longest mark.

    Raises:
        ParameterError: unknown method.
    """
    if method not in OWN_METHODS:
        raise ParameterError(f"method {method!r} is none of {', '.join(OWN_METHODS)}")
    if method == "lime_star":
        return run_lime(problem, seed, max(marks_s), clock)
    return run_paper(problem, method, seed, marks_s, clock)
