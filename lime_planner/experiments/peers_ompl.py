"""OMPL's planners on our problems: same space, start, goals and cost, with our compiled checks behind its callbacks.

What decides whether OMPL gets a fair chance from Python (2.0.1):

- The edge cost must be overridden on `PathLengthOptimizationObjective`: overrides on `StateCostIntegralObjective` are ignored.
- That class takes its heuristics from the same method. Left alone, they would become the true cost of the straight line: not
  admissible, so that BIT* ends at its first path and informed sampling prunes good ones, and as dear as an edge. They are bound to the
  length, computed by OMPL itself without a Python frame in between.
- Edges must be checked by a `MotionValidator` of one's own, not state by state.
- An edge that OMPL asks about twice, once for its cost and once for its validity, is evaluated once.
"""

from __future__ import annotations

import contextlib
import functools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from lime_planner.errors import ParameterError
from lime_planner.experiments.compiled_checks import CompiledChecks
from lime_planner.experiments.planner_runs import CLOCKS, Curve, record
from lime_planner.experiments.problems import Problem

Array = npt.NDArray[np.float64]

OMPL_METHODS = ("rrt_star", "informed_rrt_star", "bit_star", "rrt_connect")
_REMEMBERED = 200_000  # edges kept
_POLL_S = 0.0005  # the best cost is asked for this often


class Callbacks:
    """What OMPL calls, and how long it takes.

    Attributes:
        checks: the compiled checks; leafless: the same without leaves, one count for both.
        calls: number of callbacks; callback_s: time spent in them [s].
    """

    def __init__(self, problem: Problem) -> None:
        space = problem.space()
        self.checks = CompiledChecks(space, problem.settings.weight)
        self.leafless = CompiledChecks(space._replace(own_leaves=False), 0.0)
        self.n = len(problem.start)
        self._all = slice(0, self.n)
        self._costs: dict[tuple[float, ...], float] = {}
        self.calls, self.callback_s = 0, 0.0

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
            if len(self._costs) >= _REMEMBERED:
                self._costs.clear()
            self._costs[key] = cost
            self._costs[(*second, *first)] = cost
        self.calls += 1
        self.callback_s += time.perf_counter() - began
        return cost

    def clear(self, a: Any, b: Any) -> bool:
        """Whether an edge is clear of everything hard, leaves left out of account: for planners that look for any path."""
        began = time.perf_counter()
        answer = self.leafless.cost(a[self._all], b[self._all]) < math.inf
        self.calls += 1
        self.callback_s += time.perf_counter() - began
        return answer

    @property
    def compiled_s(self) -> float:
        """Time spent in compiled checks [s]."""
        return self.checks.compiled_s + self.leafless.compiled_s


class _Motions(ob.MotionValidator):
    def __init__(self, information: Any, callbacks: Callbacks, *, costs: bool) -> None:
        super().__init__(information)
        self._callbacks, self._costs = callbacks, costs

    def checkMotion(self, a: Any, b: Any) -> bool:
        if self._costs:
            return self._callbacks.edge(a, b) < math.inf
        return self._callbacks.clear(a, b)


def _objective(information: Any, callbacks: Callbacks) -> Any:
    """J as OMPL's objective, with the length as its admissible heuristic."""
    length = ob.PathLengthOptimizationObjective(information)
    edge, make = callbacks.edge, ob.Cost

    def motion_cost(self: Any, a: Any, b: Any) -> Any:
        return make(edge(a, b))

    # Partial: OMPL's binding takes a bare function of its own for "not overridden", and a Python function would be slower.
    heuristic = staticmethod(functools.partial(length.motionCost))
    methods = {"motionCost": motion_cost, "motionCostHeuristic": heuristic, "motionCostBestEstimate": heuristic}
    objective = type("Cost", (ob.PathLengthOptimizationObjective,), methods)(information)
    objective.setCostThreshold(make(0.0))  # never good enough: planners go on until their time is over
    return objective


class _Setup:
    """One problem as OMPL sees it; keeps what must outlive the planner."""

    def __init__(self, problem: Problem, *, costs: bool = True) -> None:
        self.problem = problem
        self.callbacks = Callbacks(problem)
        n = self.n = len(problem.start)
        self.space = ob.RealVectorStateSpace(n)
        bounds = ob.RealVectorBounds(n)
        for i in range(n):
            bounds.setLow(i, float(problem.lower[i]))
            bounds.setHigh(i, float(problem.upper[i]))
        self.space.setBounds(bounds)
        self.information = ob.SpaceInformation(self.space)
        self.information.setStateValidityChecker(self.callbacks.valid)
        self.motions = _Motions(self.information, self.callbacks, costs=costs)
        self.information.setMotionValidator(self.motions)
        self.information.setup()
        self.objective = _objective(self.information, self.callbacks)
        self.goal = ob.GoalStates(self.information)
        self._states = []
        for row in problem.goals.configurations:
            state = self.state(row)
            self.goal.addState(state)
            self._states.append(state)

    def state(self, q: Array) -> Any:
        """A state of OMPL's with the numbers of q."""
        state = self.information.allocState()
        state[0 : self.n] = [float(v) for v in q]
        return state

    def definition(self) -> Any:
        """A fresh problem definition."""
        definition = ob.ProblemDefinition(self.information)
        definition.addStartState(self.state(self.problem.start))
        definition.setGoal(self.goal)
        definition.setOptimizationObjective(self.objective)
        return definition

    def rows(self, path: Any) -> Array:
        """A path of OMPL's as (M, n)."""
        return np.array([[float(v) for v in state[0 : self.n]] for state in path.getStates()])


def _planner(setup: _Setup, method: str, settings: Mapping[str, Any]) -> Any:
    """Make a planner and apply its settings; a name is OMPL's parameter name."""
    kinds: dict[str, Callable[[Any], Any]] = {
        "rrt_star": og.RRTstar,
        "informed_rrt_star": og.InformedRRTstar,
        "bit_star": og.BITstar,
        "rrt_connect": og.RRTConnect,
    }
    planner = kinds[method](setup.information)
    for name, value in settings.items():
        setter = getattr(planner, "set" + "".join(part.capitalize() for part in name.split("_")), None)
        if setter is None:
            raise ParameterError(f"OMPL's {method} has no setting {name!r}")
        setter(value)
    return planner


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    yield


def _optimise(setup: _Setup, method: str, settings: Mapping[str, Any], over: Callable[[], bool], note: Callable[[float], None]) -> Any:
    """Run an optimising planner until `over`; `note` is told the best cost now and then. The path or None."""
    definition = setup.definition()
    planner = _planner(setup, method, settings)
    planner.setProblemDefinition(definition)
    planner.setup()
    asked_s = 0.0

    def stop() -> bool:
        nonlocal asked_s
        now_s = time.perf_counter()
        if now_s - asked_s > _POLL_S:
            asked_s = now_s
            note(float(planner.bestCost().value()))
        return over()

    planner.solve(ob.PlannerTerminationCondition(stop))
    note(float(planner.bestCost().value()))
    return setup.rows(definition.getSolutionPath()) if definition.hasExactSolution() else None


def _connect_and_shorten(
    setup: _Setup, settings: Mapping[str, Any], over: Callable[[], bool], keep: Callable[[Array, float], None]
) -> Array | None:
    """RRT-Connect again and again until `over`, each path shortened by OMPL's simplifier under our cost; the best one."""
    best: tuple[float, Array] | None = None
    own = {k: v for k, v in settings.items() if not k.startswith("shorten_")}
    rounds = int(settings.get("shorten_rounds", 3))
    share = float(settings.get("shorten_step", 0.3))
    objective, information = setup.objective, setup.information
    while not over():
        definition = setup.definition()
        planner = _planner(setup, "rrt_connect", own)
        planner.setProblemDefinition(definition)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(over))
        if not definition.hasExactSolution():
            break
        path = definition.getSolutionPath()
        simplifier = og.PathSimplifier(information, setup.goal, objective)
        for turn in range(rounds + 1):
            cost = float(path.cost(objective).value())
            if best is None or cost < best[0]:
                best = (cost, setup.rows(path))
                keep(best[1], cost)
            if over() or turn == rounds:
                break
            simplifier.partialShortcutPath(path)
            simplifier.perturbPath(path, share)
    return None if best is None else best[1]


def run_ompl(
    problem: Problem, method: str, seed: int, seconds: float, settings: Mapping[str, Any], *, clock: str = "wall", min_checks: int = 0
) -> dict[str, Any]:
    """Run one of OMPL's planners once. The seed is honoured only in a process that has not used OMPL before.

    Args:
        problem: the problem.
        method: of `OMPL_METHODS`.
        seed: of OMPL's generators, at least 1.
        seconds: its budget.
        settings: OMPL's parameters by name, and `shorten_...` for the shortcutting after RRT-Connect.
        clock: `wall` or `cpu`.
        min_checks: go on until so many configurations are checked, at most four times as long.

    Returns:
        A record like those of our own planners, with `callback_share` (of the time, in our callbacks) and `compiled_share` (of the
        time, in compiled checks); what is missing to 1 is OMPL's own work, the difference between the two is Python's.
    """
    if method not in OMPL_METHODS:
        raise ParameterError(f"OMPL method {method!r} is none of {', '.join(OMPL_METHODS)}")
    with _quiet():
        ou.RNG.setSeed(max(1, int(seed)))
    setup = _Setup(problem, costs=method != "rrt_connect")
    callbacks, now = setup.callbacks, CLOCKS[clock]
    curve = Curve()
    wall_s = time.perf_counter()
    began_s = now()

    def over() -> bool:
        spent_s = now() - began_s
        return spent_s >= seconds and (callbacks.checks.checks >= min_checks or spent_s >= 4.0 * seconds)

    def note(cost: float) -> None:
        curve.add(now() - began_s, callbacks.checks.checks, cost)

    if method == "rrt_connect":
        path = _connect_and_shorten(setup, settings, over, lambda _, cost: note(cost))
    else:
        path = _optimise(setup, method, settings, over, note)
    total_s = time.perf_counter() - wall_s
    return record(
        f"ompl_{method}",
        problem,
        seed,
        curve,
        seconds=seconds,
        checks=callbacks.checks.checks,
        path=path,
        edges=callbacks.checks.edges,
        callbacks=callbacks.calls,
        callback_share=round(callbacks.callback_s / total_s, 4),
        compiled_share=round(callbacks.compiled_s / total_s, 4),
        spent_s=round(now() - began_s, 4),
    )
