"""OMPL as it is given to the comparison: valid paths, simplified in its own time, bounds that are none too high."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import pytest

from benchmarks.isolated import run_isolated
from benchmarks.planners.comparison import Run, carry_out, load_settings
from benchmarks.problem_sets import choose_problems, plant_specs
from lime_planner.experiments.problems import build_problem

PLANT = "sparse:4"
TRIAL_KEYS = {"problem", "method", "seed", "seconds", "checks", "curve", "cost"}

pytestmark = pytest.mark.timed  # OMPL's planners run by the clock


@pytest.fixture(scope="module")
def problem():
    return build_problem(choose_problems(plant_specs([PLANT]), 1)[0][0])


def _simplified(problem, method, share, poll_s=0.0005, interrupted_s=0.0):
    from benchmarks.planners import ompl as peers_ompl
    from benchmarks.planners import ompl_callbacks as peers_callbacks
    from benchmarks.planners import ompl_simplifier as peers_simplifier

    spent, plain = [0.0], peers_simplifier.shorten

    def timed(*values):
        began_s = time.thread_time()
        plain(*values)
        time.sleep(interrupted_s)
        spent[0] += time.thread_time() - began_s

    peers_simplifier.shorten = timed
    peers_callbacks._POLL_S = poll_s
    settings = {name: value for name, value in load_settings()[f"ompl_{method}"].items() if not name.startswith("simplify_")}
    settings |= {"simplify_share": share}
    began_s = time.thread_time()
    record = peers_ompl.run_ompl(problem, method, 3, 0.6, settings, clock="cpu")
    return record, spent[0] / (time.thread_time() - began_s)


def _a_straight_way(problem):
    from benchmarks.planners import ompl as peers_ompl

    setup = peers_ompl._Setup(problem)
    goal = setup.state(problem.start + 0.01)
    start = setup.state(problem.start)
    path = peers_ompl.og.PathGeometric(setup.information)
    path.append(start)
    path.append(goal)
    simplifier = peers_ompl.og.PathSimplifier(setup.information, setup.goal, setup.objective)
    peers_ompl.shorten(simplifier, path, 0.4)
    rng = np.random.default_rng(0)
    above = []
    for _ in range(300):
        a = problem.start + rng.normal(0.0, 0.1, 6)
        ends = setup.state(a), setup.state(a + rng.normal(0.0, 0.1, 6))
        above.append(setup.objective.motionCost(*ends).value() >= setup.objective.motionCostHeuristic(*ends).value())
    return path.getStateCount(), all(above)


def _heuristics(problem):
    from benchmarks.planners import ompl as peers_ompl

    setup = peers_ompl._Setup(problem)
    a, b = setup.state(problem.start), setup.state(problem.goals.configurations[0])
    definition = setup.definition()
    planner = peers_ompl._planner(setup, "bit_star", {"samples_per_batch": 50})
    planner.setProblemDefinition(definition)
    planner.setup()
    asked = [0]

    def over():
        asked[0] += 1
        return asked[0] > 3000

    planner.solve(peers_ompl.ob.PlannerTerminationCondition(over))
    objective = setup.objective
    before = setup.length.cache_info().misses
    assert before > 1000  # calls of BIT*
    objective.motionCostHeuristic(a, b)
    assert setup.length.cache_info().misses == before + 1
    return objective.motionCostHeuristic(a, b).value(), objective.motionCost(a, b).value(), int(planner.numBatches())


def _evaluations(problem):
    from benchmarks.planners import ompl as peers_ompl

    setup = peers_ompl._Setup(problem, costs=False)
    callbacks, shortening = setup.callbacks, [False]
    asked = {"with leaves": [], "without": [], "without, while shortening": []}

    def noting(checks, name):
        plain = checks.cost

        def cost(a, b):
            key = frozenset((tuple(a), tuple(b)))
            asked[name].append(key)
            if shortening[0] and name == "without":
                asked["without, while shortening"].append(key)
            return plain(a, b)

        checks.cost = cost

    noting(callbacks.checks, "with leaves")
    noting(callbacks.leafless, "without")

    class Simplifier(peers_ompl.og.PathSimplifier):
        def partialShortcutPath(self, path):
            shortening[0] = True
            changed = super().partialShortcutPath(path)
            shortening[0] = False
            return changed

    peers_ompl.og.PathSimplifier = Simplifier
    over = itertools.count()
    costs = []
    settings = {"range": 3.0, "shorten_rounds": 3}
    peers_ompl._connect_and_shorten(setup, settings, lambda: next(over) > 400, lambda _, cost: costs.append(cost))
    # A way back is found in the memory, whoever asked first.
    a, b = setup.state(problem.start), setup.state(problem.goals.configurations[0])
    for function in (callbacks.clear, callbacks.edge):
        function(a, b)
        before = sum(map(len, asked.values()))
        assert function(b, a) == function(a, b)
        assert sum(map(len, asked.values())) == before
    before = len(asked["without"])
    callbacks._clear.clear()
    assert callbacks.clear(a, b) == (callbacks.edge(a, b) < math.inf)
    assert len(asked["without"]) == before
    return {name: (len(keys), len(set(keys))) for name, keys in asked.items()}, costs


def _assert_checks_are_part_of_callbacks(record):
    parts = record["compiled_share"] + record["heuristic_share"]
    numbers = {name: value for name, value in record.items() if name not in ("curve", "path")}
    assert record["callback_share"] > parts or record["callback_share"] == 1.0, numbers


def test_ompl_gives_valid_paths_and_keeps_improving(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    settings = load_settings()
    for method in ("ompl_rrt_star", "ompl_informed_rrt_star", "ompl_bit_star", "ompl_rrt_connect"):
        values = tuple(settings[method].items())
        record = carry_out(Run(problem.spec, method, 1, 0.6, (0.6,), "cpu", values, keep_path=True))
        assert "failure" not in record, record
        assert record["checks"] > 100 and 0.0 < record["compiled_share"] < record["callback_share"] <= 1.0
        _assert_checks_are_part_of_callbacks(record)
        if method == "ompl_bit_star":
            assert record["heuristic_share"] > 0.0 and record["heuristics"] > 1000 and record["polls"] > 10
        if method in ("ompl_bit_star", "ompl_rrt_connect"):
            assert record["cost"] is not None
        if record["cost"] is not None:
            path = np.array(record["path"])
            np.testing.assert_allclose(path[0], problem.start, atol=1e-6)
            assert np.abs(problem.goals.configurations - path[-1]).max(axis=1).min() < 1e-6
            assert record["cost"] == pytest.approx(record["curve"][-1][2], rel=1e-6)


@pytest.mark.parametrize("method", ["rrt_star", "informed_rrt_star", "bit_star"])
def test_ompl_simplifies_paths_as_they_come_and_in_its_own_time(problem, method):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    with_it, share = run_isolated(_simplified, problem, method, 0.5, timeout_s=120.0)
    without, none = run_isolated(_simplified, problem, method, 0.0, timeout_s=120.0)
    assert none == 0.0 < share < 0.7
    assert 0.6 <= with_it["spent_s"] < 1.2
    assert with_it["cost"] == pytest.approx(with_it["curve"][-1][2], rel=1e-6)
    assert problem.cost(np.array(with_it["path"])) == pytest.approx(with_it["cost"], rel=1e-4)
    assert len(with_it["curve"]) >= 2 and len(without["curve"]) >= 1
    assert 0.0 < with_it["compiled_share"] < with_it["callback_share"] <= 1.0


def test_rounds_of_the_simplifier_outside_a_callback_are_not_taken_off_the_callbacks(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    # Hardly a question whether to stop, so that most rounds are those after a path, and each of them long, as on a busy machine.
    record, _ = run_isolated(_simplified, problem, "bit_star", 0.8, 0.2, 0.1, timeout_s=120.0)
    assert record["compiled_share"] > 0.0
    _assert_checks_are_part_of_callbacks(record)


def test_ompl_may_bend_a_single_edge_and_no_bound_is_above_a_cost(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    states, above = run_isolated(_a_straight_way, problem, timeout_s=120.0)
    assert states >= 3 and above


def test_ompl_is_given_an_admissible_heuristic(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    heuristic, cost, batches = run_isolated(_heuristics, problem, timeout_s=120.0)
    length = float(np.linalg.norm(problem.goals.configurations[0] - problem.start))
    assert heuristic == pytest.approx(length) and cost >= length
    assert batches >= 2  # with the true cost for a heuristic BIT* ends at its first path


def test_ompl_evaluates_no_edge_twice(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    counts, costs = run_isolated(_evaluations, problem, timeout_s=120.0)
    assert len(costs) >= 1
    assert counts["with leaves"][0] == counts["with leaves"][1] > 100
    assert counts["without"][0] == counts["without"][1] > 10
    assert counts["without, while shortening"] == (0, 0)
