"""OMPL's planners on our problems: same space, start, goals and cost, with our compiled checks behind its callbacks.

What decides whether OMPL gets a fair chance from Python (2.0.1):

- The edge cost must be overridden on `PathLengthOptimizationObjective`: overrides on `StateCostIntegralObjective` are ignored.
- That class takes its heuristics from the same method. Left alone, they would become the true cost of the straight line: not
  admissible, so that BIT* ends at its first path and informed sampling prunes good ones, and as dear as an edge. They are bound to the
  length, computed by OMPL itself without a Python frame in between. No class of OMPL's has this heuristic and a cost of one's own
  without a way through Python: its dispatch is measured before each run, and what the calls cost is reported (`ompl_callbacks`).
- Edges must be checked by a `MotionValidator` of one's own, not state by state.
- An edge that OMPL asks about twice, once for its cost and once for its validity, is evaluated once. RRT-Connect's trees leave leaves
  out of account, which is cheaper; only the few edges of a path that they find are evaluated again, for its cost.
- Reading the clock in every turn of a planner's loop costs more than many such turns: it is read every half millisecond.
- OMPL's path simplifier, under our cost, shortens paths faster than most planners rewire them. Each planner may have it: RRT-Connect after
  each path, the optimising ones for a share of their time (`peers_simplifier`).
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from benchmarks.planner_runs import CLOCKS, Curve, record
from benchmarks.planners.ompl_callbacks import Callbacks, counted, dispatch_times, stopping
from benchmarks.planners.ompl_simplifier import Simplification, shorten
from lime_planner.core.errors import ParameterError
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem

#: How much of the time may be credited at most, lest a calibration on a busy machine gives a planner time without end.
_MOST_CREDIT = 0.7

#: By which edges cost more than they do. Rounding puts many an ulp below their length, and where a bound is above the cost, BIT* prunes
#: what its own path is made of, and crashes.
_ABOVE_ROUNDING = 1.0 + 1e-9

OMPL_METHODS = ("rrt_star", "informed_rrt_star", "bit_star", "rrt_connect")


class _Motions(ob.MotionValidator):
    """Validity of edges.

    Attributes:
        costs: answer from their costs, which will be asked for as well; otherwise leaves are left out of account.
    """

    def __init__(self, information: Any, callbacks: Callbacks, *, costs: bool) -> None:
        super().__init__(information)
        self._callbacks, self.costs = callbacks, costs

    def checkMotion(self, a: Any, b: Any) -> bool:
        if self.costs:
            return self._callbacks.edge(a, b) < math.inf
        return self._callbacks.clear(a, b)


def _objective(information: Any, callbacks: Callbacks, length: Callable[[Any, Any], Any]) -> Any:
    """J as OMPL's objective, with the length as its admissible heuristic."""
    edge, make = callbacks.edge, ob.Cost

    def motion_cost(self: Any, a: Any, b: Any) -> Any:
        return make(edge(a, b) * _ABOVE_ROUNDING)

    heuristic = staticmethod(length)
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
        self.length = counted(ob.PathLengthOptimizationObjective(self.information).motionCost)
        self.objective = _objective(self.information, self.callbacks, self.length)
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


def _optimise(
    setup: _Setup,
    method: str,
    settings: Mapping[str, Any],
    over: Callable[[], bool],
    note: Callable[[float], None],
    spent: Callable[[], float],
) -> Array | None:
    """Run an optimising planner with the simplifier beside it until `over`; `note` is told the best cost now and then. The best path."""
    definition = setup.definition()
    planner = _planner(setup, method, {k: v for k, v in settings.items() if not k.startswith("simplify_")})
    planner.setProblemDefinition(definition)
    planner.setup()
    simplification = Simplification(setup.information, setup.goal, setup.objective, settings, spent, note)
    if simplification.share > 0.0 and method == "bit_star":
        planner.setStopOnSolnImprovement(True)  # exactly then, not some iterations later
    noted, offered = math.inf, math.inf

    def watch() -> float:
        nonlocal noted
        cost = float(planner.bestCost().value())
        if cost < noted:
            noted = cost
            note(cost)
        return simplification.go_on()

    def pause() -> bool:
        return over() or (simplification.share > 0.0 and method != "bit_star" and noted < offered)

    while True:
        planner.solve(ob.PlannerTerminationCondition(stopping(setup.callbacks, pause, watch)))  # goes on where it was
        watch()
        if over() or not noted < offered:  # or the planner has nothing left to find
            break
        offered = noted
        if definition.hasExactSolution():
            simplification.offer(definition.getSolutionPath())  # there is none to be had while the planner runs
    if definition.hasExactSolution() and noted < simplification.cost:
        return setup.rows(definition.getSolutionPath())
    return None if simplification.path is None else setup.rows(simplification.path)


def _connect_and_shorten(
    setup: _Setup, settings: Mapping[str, Any], over: Callable[[], bool], keep: Callable[[Array, float], None]
) -> Array | None:
    """RRT-Connect again and again until `over`, each path shortened by OMPL's simplifier under our cost; the best one."""
    best: tuple[float, Array] | None = None
    own = {k: v for k, v in settings.items() if not k.startswith("shorten_")}
    rounds = int(settings.get("shorten_rounds", 3))
    share = float(settings.get("shorten_step", 0.3))
    longest = bool(settings.get("shorten_max", False))
    objective = setup.objective
    simplifier = og.PathSimplifier(setup.information, setup.goal, objective)
    condition = ob.PlannerTerminationCondition(stopping(setup.callbacks, over))
    while not over():
        definition = setup.definition()
        planner = _planner(setup, "rrt_connect", own)
        planner.setProblemDefinition(definition)
        planner.setup()
        setup.motions.costs = False
        planner.solve(condition)
        if not definition.hasExactSolution():
            break
        path = definition.getSolutionPath()
        setup.motions.costs = True  # the simplifier asks for the validity and for the cost of an edge
        for turn in range(rounds + 1):
            cost = float(path.cost(objective).value())
            if best is None or cost < best[0]:
                best = (cost, setup.rows(path))
                keep(best[1], cost)
            if over() or turn == rounds:
                break
            if longest and turn == 0:
                simplifier.simplify(path, condition, True)
            shorten(simplifier, path, share)
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
        settings: OMPL's parameters by name, `shorten_...` for the shortcutting after RRT-Connect, and `simplify_...` for that beside the
            others: its share of the time (0: none), the rounds without gain that end its work on a path, its step.
        clock: `wall` or `cpu`.
        min_checks: go on until so many configurations are checked, at most four times as long.

    Returns:
        A record like those of our own planners, with `callback_share` (of the time, in our callbacks and on the way there and back, the
        heuristic's way through Python included), `heuristic_share` (that way alone) and `compiled_share` (in compiled checks); what is
        missing to 1 is OMPL's own work, the difference between callbacks and compiled checks is Python's.
    """
    if method not in OMPL_METHODS:
        raise ParameterError(f"OMPL method {method!r} is none of {', '.join(OMPL_METHODS)}")
    with _quiet():
        ou.RNG.setSeed(max(1, int(seed)))
    setup = _Setup(problem, costs=method != "rrt_connect")
    callbacks, now = setup.callbacks, CLOCKS[clock]
    dispatch = dispatch_times(setup.information, setup.state(problem.start), setup.state(problem.goals.configurations[0]))
    curve = Curve()
    wall_s, cpu_s = time.perf_counter(), time.thread_time()
    began_s = now()

    def spent() -> float:
        # The counting is ours, and the heuristic's way through Python is the bindings': a C++ program would not pay for either.
        elapsed_s = now() - began_s
        return float(
            elapsed_s - min(setup.length.cache_info().misses * (dispatch.count_s + dispatch.heuristic_s), _MOST_CREDIT * elapsed_s)
        )

    def over() -> bool:
        spent_s = spent()
        return spent_s >= seconds and (callbacks.checks.checks >= min_checks or spent_s >= 4.0 * seconds)

    def note(cost: float) -> None:
        curve.add(spent(), callbacks.checks.checks, cost)

    if method == "rrt_connect":
        path = _connect_and_shorten(setup, settings, over, lambda _, cost: note(cost))
    else:
        path = _optimise(setup, method, settings, over, note, spent)
    spent_s, wall_s, cpu_s = spent(), time.perf_counter() - wall_s, time.thread_time() - cpu_s
    heuristics = setup.length.cache_info().misses
    # What was timed on the way holds other processes' turns, as all of the wall time does; what is counted and calibrated does not.
    heuristic_share = heuristics * dispatch.heuristic_s / cpu_s
    others_share = (callbacks.calls * dispatch.function_s + callbacks.polls * dispatch.poll_s) / cpu_s
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
        heuristics=heuristics,
        polls=callbacks.polls,
        callback_share=round(min(callbacks.callback_s / wall_s + others_share + heuristic_share, 1.0), 4),
        heuristic_share=round(heuristic_share, 4),
        compiled_share=round(callbacks.compiled_s / wall_s, 4),
        spent_s=round(spent_s, 4),
    )
