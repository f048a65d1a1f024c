"""Comparisons of planners: what is kept, how it is summed up, and the peers themselves."""

from __future__ import annotations

import itertools
import json
import math
import time

import numpy as np
import pytest

from lime_planner.cli import main
from lime_planner.errors import ParameterError
from lime_planner.experiments import comparison_report as report
from lime_planner.experiments import peers_pyroboplan
from lime_planner.experiments.comparison import Comparison, Run, carry_out, load_settings, missing_library
from lime_planner.experiments.comparison_figures import _curves, bands
from lime_planner.experiments.compiled_checks import CompiledChecks
from lime_planner.experiments.isolated import run_isolated
from lime_planner.experiments.peers_search import FINER, GRIDS, candidates, choose, finer_candidates, search_runs
from lime_planner.experiments.problem_sets import choose_problems, plant_specs
from lime_planner.experiments.problems import Problem, build_problem

PLANT = "sparse:4"
TRIAL_KEYS = {"problem", "method", "seed", "seconds", "checks", "curve", "cost"}


@pytest.fixture(scope="module")
def problem():
    return build_problem(choose_problems(plant_specs([PLANT]), 1)[0][0])


def test_planners_are_compared_and_the_comparison_continues(tmp_path, capsys):
    out = tmp_path / "planners"
    command = ["bench", "planners", "--plants", PLANT, "--targets", "1", "--marks", "0.05", "0.2", "--reference", "0.4"]
    command += ["--reference-seeds", "1", "--clock", "cpu", "--jobs", "1", "--out", str(out)]
    assert main([*command, "--seeds", "1"]) == 0
    assert "5 runs on 1 problems" in capsys.readouterr().err or missing_library("ompl_bit_star")
    first = json.loads((out / "results.json").read_text())
    assert first["experiment"] == "bench planners" and first["complete"]
    assert {"machine", "options", "problems", "refused", "methods", "trials"} <= first.keys()
    for trial in first["trials"]:
        assert trial.keys() >= TRIAL_KEYS and "path" not in trial
        assert all(a[2] > b[2] for a, b in zip(trial["curve"], trial["curve"][1:], strict=False))
    for name in ("table.md", "cost_against_time.png", "cost_against_time.svg"):
        assert (out / name).stat().st_size > 200
    assert "lime_star (default)" in (out / "table.md").read_text()
    assert main([*command, "--seeds", "1"]) == 1  # an earlier run is there
    assert "--resume" in capsys.readouterr().err
    assert main([*command, "--seeds", "2", "--resume", "--no-figures"]) == 0
    second = json.loads((out / "results.json").read_text())
    assert [t for t in second["trials"] if t in first["trials"]] == first["trials"]
    assert len(second["trials"]) == len(first["trials"]) + 3


def test_wrong_questions_are_refused(tmp_path, capsys):
    assert main(["bench", "planners", "--out", str(tmp_path)]) == 1
    assert "--scans" in capsys.readouterr().err
    assert main(["bench", "planners", "--plants", PLANT, "--methods", "dijkstra", "--targets", "1", "--out", str(tmp_path)]) == 1
    assert "method 'dijkstra' is none of" in capsys.readouterr().err
    spec = choose_problems(plant_specs([PLANT]), 1)[0]
    with pytest.raises(ParameterError, match="marks must be rising"):
        Comparison("x", spec, [], ["lime_star"], [1], (0.5, 0.1))
    with pytest.raises(ParameterError, match="holds no settings"):
        load_settings(tmp_path / "none.json")


def _trial(problem, method, seed, curve, seconds=5.0, **more):
    cost = curve[-1][2] if curve else None
    return {"problem": problem, "method": method, "seed": seed, "seconds": seconds, "checks": 1000, "curve": curve, "cost": cost, **more}


def _results(trials):
    machine = {"processor": "any", "cores": 2, "load": [0.0, 0.0, 0.0]}
    options = {"marks_s": [0.5, 5.0], "clock": "wall", "settings": {}, "min_checks": 0}
    names = sorted({t["problem"] for t in trials})
    methods = ["lime_star", "ompl_bit_star"]
    return {"machine": machine, "options": options, "methods": methods, "problems": names, "complete": True, "trials": trials}


def test_tables_follow_from_the_trials():
    trials = [
        _trial("a", "lime_star", 1, [[0.1, 100, 20.0], [0.4, 300, 10.0]]),
        _trial("a", "ompl_bit_star", 1, [[0.2, 50, 40.0], [3.0, 500, 12.0]], compiled_share=0.5, callback_share=0.6),
        _trial("b", "lime_star", 1, [[2.0, 100, 30.0]]),
        _trial("b", "ompl_bit_star", 1, [[0.1, 50, 25.0]], compiled_share=0.5, callback_share=0.6),
        _trial("b", "ompl_bit_star", 1000, [[9.0, 50, 20.0]], seconds=30.0),
        _trial("c", "lime_star", 1, []),
        _trial("c", "ompl_bit_star", 1, [], failure="crashed"),
    ]
    results = _results(trials)
    assert report.best_known(results) == {"a": 10.0, "b": 20.0, "c": math.inf}
    assert report.costs_at(results, "lime_star", 0.5) == {("a", 1): 10.0, ("b", 1): math.inf, ("c", 1): math.inf}
    assert report.ratios_at(results, "lime_star", 5.0) == {("a", 1): 1.0, ("b", 1): 1.5}
    assert report.costs_at(results, "ompl_bit_star", 60, report.CHECKS)[("a", 1)] == 40.0
    ahead, behind = report.lead_over_peers(results, 0.5, 5.0)
    assert ahead == ["a"]
    assert behind[0] == ("b", "ompl_bit_star", 25.0, math.inf) and behind[1][0] == "c"
    text = report.lead_text(results)
    assert "on 1 of 3 problems" in text and "| b | OMPL BIT* | 25.00 | ∞ | ∞ |" in text
    assert "| lime_star (default) | ∞ (33 %) | 30.0 (67 %) |" in report.cost_table(results, [0.5, 5.0], report.TIME, "s")
    assert "| OMPL BIT* | 200 | 50 % | 60 % | 1 | 0 |" in report.effort_table(results)
    results["trials"][1] |= {"heuristic_share": 0.3}
    assert "| OMPL BIT* | 200 | 50 % | 60 % (heuristic 30 %) | 1 | 0 |" in report.effort_table(results)
    assert "| OMPL BIT* | 1.00 (0.00 to 4.00), 33 % |" in report.paired_table(results, [0.5])


def test_equal_checks_count_only_runs_that_got_so_far():
    far = _trial("a", "lime_star", 1, [[0.1, 100, 20.0], [0.4, 900, 10.0]]) | {"checks": 5000}
    trials = [
        far,
        _trial("b", "lime_star", 1, [[0.1, 100, 30.0]]),  # ends at 1000 checks
        _trial("c", "lime_star", 1, [[0.1, 200, 50.0]]),
        _trial("a", "ompl_bit_star", 1, [[0.1, 100, 40.0]]) | {"checks": 999},
        _trial("b", "ompl_bit_star", 1, []) | {"checks": 2000},
        _trial("c", "ompl_bit_star", 1, [[0.1, 100, 60.0]]) | {"checks": 5000},
    ]
    results = _results(trials)
    table = report.cost_table(results, [500, 1000, 3000], report.CHECKS, "checks").splitlines()
    assert table[2] == "| lime_star (default) | 30.0 (100 %) | 30.0 (100 %) | – |"
    assert table[3] == "| OMPL BIT* | 60.0 (67 %) | ∞ (50 %) (2 of 3 runs) | – |"
    assert report.costs_at(results, "lime_star", 3000, report.CHECKS) == {("a", 1): 10.0}
    assert len(report.costs_at(results, "lime_star", 3000)) == 3  # time is the same for all
    curves = _curves(results, "ompl_bit_star", np.array([500.0, 1000.0, 3000.0]), report.CHECKS)
    np.testing.assert_array_equal(curves, [[4.0, np.nan, np.nan], [np.inf, np.inf, np.nan], [1.2, 1.2, 1.2]])
    quartiles, solved = bands(curves)
    np.testing.assert_allclose(solved, [2 / 3, 0.5, np.nan])
    assert quartiles[1, 0] == 4.0 and np.isnan(quartiles[:, 2]).all()


def test_settings_of_peers_are_chosen_by_cost_over_all_problems():
    for method in GRIDS:
        assert len({str(c) for c in candidates(method)}) == len(candidates(method)) > 1
    one, two = {"range": 0.3}, {"range": 0.8}
    trials = [
        _trial("a", "m", 1, [[0.1, 1, 10.0]], settings=one),
        _trial("a", "m", 1, [[0.1, 1, 20.0]], settings=two),
        _trial("b", "m", 1, [], settings=one),
        _trial("b", "m", 1, [[0.1, 1, 5.0]], settings=two),
    ]
    found = choose("m", trials, 5.0)
    assert found["settings"] == two
    assert [entry["score"] for entry in found["tried"]] == [pytest.approx(math.sqrt(2.0), abs=1e-3), pytest.approx(10.0)]
    kept = load_settings()
    assert kept.keys() >= GRIDS.keys()
    for method, settings in kept.items():
        assert settings.keys() <= GRIDS[method].keys() | FINER.get(method, {}).keys()


def test_finer_settings_change_one_thing_at_a_time(problem):
    for method in FINER:
        best = candidates(method)[0]
        finer = finer_candidates(method, best)
        assert method == "pyroboplan" or {"simplify_share": 0.0}.items() <= finer[0].items()  # without the simplifier is a choice
        for one in finer:
            assert len({*one.items()} - {*best.items()}) == 1
    assert finer_candidates("ompl_rrt_connect", {"range": 3.0}) == []
    runs = search_runs("ompl_rrt_star", [{"range": 1.0}, {"range": 2.0}], [problem.spec], 2, 1.0, "cpu")
    assert [(run.seed, dict(run.settings)["range"]) for run in runs] == [(1, 1.0), (2, 1.0), (1, 2.0), (2, 2.0)]


def test_ompl_gives_valid_paths_and_keeps_improving(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    settings = load_settings()
    for method in ("ompl_rrt_star", "ompl_informed_rrt_star", "ompl_bit_star", "ompl_rrt_connect"):
        values = tuple(settings[method].items())
        record = carry_out(Run(problem.spec, method, 1, 0.6, (0.6,), "cpu", values, keep_path=True))
        assert "failure" not in record, record
        assert record["checks"] > 100 and 0.0 < record["compiled_share"] < record["callback_share"] <= 1.0
        assert record["callback_share"] == 1.0 or record["callback_share"] > record["compiled_share"] + record["heuristic_share"]
        if method == "ompl_bit_star":
            assert record["heuristic_share"] > 0.0 and record["heuristics"] > 1000 and record["polls"] > 10
        if method in ("ompl_bit_star", "ompl_rrt_connect"):
            assert record["cost"] is not None
        if record["cost"] is not None:
            path = np.array(record["path"])
            np.testing.assert_allclose(path[0], problem.start, atol=1e-6)
            assert np.abs(problem.goals.configurations - path[-1]).max(axis=1).min() < 1e-6
            assert record["cost"] == pytest.approx(record["curve"][-1][2], rel=1e-6)


def _simplified(problem, method, share):
    from lime_planner.experiments import peers_ompl, peers_simplifier

    spent, plain = [0.0], peers_simplifier.shorten

    def timed(*values):
        began_s = time.thread_time()
        plain(*values)
        spent[0] += time.thread_time() - began_s

    peers_simplifier.shorten = timed
    settings = {name: value for name, value in load_settings()[f"ompl_{method}"].items() if not name.startswith("simplify_")}
    settings |= {"simplify_share": share}
    return peers_ompl.run_ompl(problem, method, 3, 0.6, settings, clock="cpu"), spent[0]


@pytest.mark.parametrize("method", ["rrt_star", "informed_rrt_star", "bit_star"])
def test_ompl_simplifies_paths_as_they_come_and_in_its_own_time(problem, method):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    with_it, spent_s = run_isolated(_simplified, problem, method, 0.5, timeout_s=120.0)
    without, none_s = run_isolated(_simplified, problem, method, 0.0, timeout_s=120.0)
    assert none_s == 0.0 < spent_s < 0.6 * with_it["spent_s"]
    assert 0.6 <= with_it["spent_s"] < 0.8
    assert with_it["cost"] == pytest.approx(with_it["curve"][-1][2], rel=1e-6)
    assert problem.cost(np.array(with_it["path"])) == pytest.approx(with_it["cost"], rel=1e-4)
    assert len(with_it["curve"]) > len(without["curve"])
    assert 0.0 < with_it["compiled_share"] < with_it["callback_share"] <= 1.0


def _a_straight_way(problem):
    from lime_planner.experiments import peers_ompl

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


def test_ompl_may_bend_a_single_edge_and_no_bound_is_above_a_cost(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    states, above = run_isolated(_a_straight_way, problem, timeout_s=120.0)
    assert states >= 3 and above


def _heuristics(problem):
    from lime_planner.experiments import peers_ompl

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


def test_ompl_is_given_an_admissible_heuristic(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    heuristic, cost, batches = run_isolated(_heuristics, problem, timeout_s=120.0)
    length = float(np.linalg.norm(problem.goals.configurations[0] - problem.start))
    assert heuristic == pytest.approx(length) and cost >= length
    assert batches >= 2  # with the true cost for a heuristic BIT* ends at its first path


def _evaluations(problem):
    from lime_planner.experiments import peers_ompl

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


def test_ompl_evaluates_no_edge_twice(problem):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    counts, costs = run_isolated(_evaluations, problem, timeout_s=120.0)
    assert len(costs) >= 1
    assert counts["with leaves"][0] == counts["with leaves"][1] > 100
    assert counts["without"][0] == counts["without"][1] > 10
    assert counts["without, while shortening"] == (0, 0)


def test_peers_are_compared(tmp_path, capsys):
    pytest.importorskip("ompl", reason="OMPL is not installed: pip install 'lime_planner[bench]'")
    out = tmp_path / "peers"
    command = ["bench", "peers", "--plants", PLANT, "--targets", "1", "--seeds", "1", "--marks", "0.1", "0.3", "--clock", "cpu"]
    command += ["--methods", "ompl_bit_star", "--min-checks", "2000", "--jobs", "1", "--out", str(out), "--keep-paths"]
    assert main(command) == 0
    results = json.loads((out / "results.json").read_text())
    assert [t["method"] for t in results["trials"]] == ["lime_star", "ompl_bit_star"]
    assert all("path" in t for t in results["trials"])
    table = (out / "table.md").read_text()
    assert "Equal numbers of checked configurations" in table and "In callbacks" not in table
    assert (out / "cost_against_checks.png").stat().st_size > 5000
    assert "Written to" in capsys.readouterr().out


def test_pyroboplan_gives_valid_paths(problem):
    if not peers_pyroboplan.installed():
        pytest.skip("pyroboplan is not installed: pip install meshcat && pip install --no-deps pyroboplan")
    record = carry_out(Run(problem.spec, "pyroboplan", 1, 0.6, (0.6,), "cpu", (("max_connection_dist", 1.0),), keep_path=True))
    assert "failure" not in record, record
    assert record["cost"] is not None and record["checks"] > 10


def _pyroboplan(problem):
    calls = {"space": 0, "cost": 0}

    def counting(name):
        plain = getattr(Problem, name)

        def function(*values):
            calls[name] += 1
            return plain(*values)

        return function

    for name in calls:
        setattr(Problem, name, counting(name))
    settings = {"max_connection_dist": 1.0}
    return peers_pyroboplan.run_pyroboplan(problem, 1, 0.2, settings, clock="cpu", min_checks=60_000), calls


def test_pyroboplan_is_not_charged_for_our_measuring(problem):
    if not peers_pyroboplan.installed():
        pytest.skip("pyroboplan is not installed: pip install meshcat && pip install --no-deps pyroboplan")
    record, calls = run_isolated(_pyroboplan, problem, timeout_s=120.0)
    assert calls == {"space": 3, "cost": 1}  # its checks, our costs and the final path's measure; none of them for each path
    assert record["cost"] == pytest.approx(record["curve"][-1][2], rel=1e-4)
    assert record["checks"] >= 60_000 or record["spent_s"] >= 0.8


def test_costs_of_paths_are_summed_up_to_a_bound(problem):
    checks = CompiledChecks(problem.space(), problem.settings.weight)
    path = np.linspace(problem.start, problem.goals.configurations[0], 5) + 0.02 * np.eye(5, 6)
    whole = sum(checks.cost(a, b) for a, b in itertools.pairwise(path.tolist()))
    assert peers_pyroboplan._cost(checks, path, math.inf) == pytest.approx(whole)
    edges = checks.edges
    assert peers_pyroboplan._cost(checks, path, 1e-3) >= 1e-3
    assert checks.edges == edges + 1
