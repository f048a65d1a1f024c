"""pyroboplan's RRT on our problems, with our compiled checks in place of its own.

pyroboplan knows no cost but length. It is run as RRT-Connect with two trees, each path shortened by its own shortcutting, again and
again from goal to goal until the time is over; the path of lowest J counts. Its releases demand one exact version of Pinocchio and of
others, so it is no extra of this package: `pip install --no-deps pyroboplan` beside `pip install meshcat` does.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.planner_runs import CLOCKS, Curve, record, seldom
from benchmarks.planners.compiled_checks import CompiledChecks
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem

_UNLIMITED_STEP_RAD = 1e6  # edges are certified whole: there is nothing to discretise
_ATTEMPT_S = 1.0  # for one goal before the next one's turn


def installed() -> bool:
    """Whether pyroboplan can be imported."""
    try:
        import pyroboplan.planning.rrt  # noqa: F401
    except ImportError:
        return False
    return True


class _Model:
    """What pyroboplan asks of a Pinocchio model: limits to sample in."""

    def __init__(self, problem: Problem) -> None:
        self.lowerPositionLimit, self.upperPositionLimit = problem.lower, problem.upper

    def createData(self) -> Any:
        return SimpleNamespace()


@contextlib.contextmanager
def _our_checks(problem: Problem, now: Callable[[], float]) -> Iterator[CompiledChecks]:
    """Put stems along whole edges in place of pyroboplan's checks of single states, and our clock in place of its own; keep it quiet."""
    from pyroboplan.planning import path_shortcutting, rrt, utils

    checks = CompiledChecks(problem.space()._replace(own_leaves=False), 0.0)

    def state_hit(model: Any, collision_model: Any, q: Any, *_: Any, **__: Any) -> bool:
        return not checks.valid(q)

    def path_hit(model: Any, collision_model: Any, rows: Any, *_: Any, **__: Any) -> bool:
        return any(checks.cost(a, b) == math.inf for a, b in itertools.pairwise(rows))

    def free(a: Any, b: Any, *_: Any, **__: Any) -> bool:
        return checks.cost(a, b) < math.inf

    before: list[tuple[Any, str, Any]] = []
    patches: dict[str, Callable[..., Any]] = {
        "check_collisions_at_state": state_hit,
        "check_collisions_along_path": path_hit,
        "has_collision_free_path": free,
    }
    for module, (name, function) in itertools.product((rrt, utils, path_shortcutting), patches.items()):
        if hasattr(module, name):
            before.append((module, name, getattr(module, name)))
            setattr(module, name, function)
    before.append((rrt, "time", rrt.time))
    rrt.time = SimpleNamespace(time=now)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield checks
    finally:
        for module, name, function in before:
            setattr(module, name, function)


def _cost(checks: CompiledChecks, path: Array, bound: float) -> float:
    """J of a path (M, n), edge by edge; anything not below the bound once it has come so far."""
    total = 0.0
    for a, b in itertools.pairwise(path.tolist()):
        total += checks.cost(a, b, bound - total)
        if not total < bound:
            break
    return total


def run_pyroboplan(
    problem: Problem, seed: int, seconds: float, settings: Mapping[str, Any], *, clock: str = "wall", min_checks: int = 0
) -> dict[str, Any]:
    """Run pyroboplan until the time is over.

    J of its paths is evaluated by compiled checks that are made before the clock starts, and that do not count among its own.

    Args:
        problem: the problem.
        seed: of NumPy's global generator, which pyroboplan uses.
        seconds: the budget.
        settings: options of its planner by name, and `shorten_iterations`.
        clock: `wall` or `cpu`.
        min_checks: go on until so many configurations are checked, at most four times as long.
    """
    from pyroboplan.planning.path_shortcutting import shortcut_path
    from pyroboplan.planning.rrt import RRTPlanner, RRTPlannerOptions

    values = dict(settings)
    shorten = int(values.pop("shorten_iterations", 200))
    now, model, curve = CLOCKS[clock], _Model(problem), Curve()
    best: tuple[float, Array | None] = (math.inf, None)
    goals = problem.goals.configurations
    costs = CompiledChecks(problem.space(), problem.settings.weight)
    with _our_checks(problem, seldom(now)) as checks:
        wall_s, began_s = time.perf_counter(), now()
        for attempt in itertools.count():
            limit_s = seconds if checks.checks >= min_checks else 4.0 * seconds
            left_s = limit_s - (now() - began_s)
            if left_s <= 0.0:
                break
            options = RRTPlannerOptions(
                rng_seed=seed * 100_003 + attempt,
                max_step_size=_UNLIMITED_STEP_RAD,
                max_planning_time=min(left_s, _ATTEMPT_S),
                rrt_connect=True,
                bidirectional_rrt=True,
                **values,
            )
            rows = RRTPlanner(model, model, options).plan(problem.start, goals[attempt % len(goals)])
            if not rows:
                continue
            shortened = list(rows)  # a copy: the shortcutting overwrites waypoints of the list that it is given
            shortened = shortcut_path(model, model, shortened, max_iters=shorten, max_step_size=_UNLIMITED_STEP_RAD)
            for path in (rows, shortened):
                found = np.array(path)
                cost = _cost(costs, found, best[0])
                if cost < best[0]:
                    best = (cost, found)
                    curve.add(now() - began_s, checks.checks, cost)
    total_s = time.perf_counter() - wall_s
    return record(
        "pyroboplan",
        problem,
        seed,
        curve,
        seconds=seconds,
        checks=checks.checks,
        path=best[1],
        edges=checks.edges,
        compiled_share=round(checks.compiled_s / total_s, 4),
        spent_s=round(now() - began_s, 4),
    )
