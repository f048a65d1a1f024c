"""Comparisons of planners: what is kept, how it is summed up, and the peers themselves."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest

from benchmarks.isolated import run_isolated
from benchmarks.planners import pyroboplan as peers_pyroboplan
from benchmarks.planners import report
from benchmarks.planners.comparison import Comparison, Run, carry_out, load_settings, missing_library
from benchmarks.planners.compiled_checks import CompiledChecks
from benchmarks.planners.figures import _curves, bands
from benchmarks.planners.peer_settings_search import FINER, GRIDS, candidates, choose, finer_candidates, search_runs
from benchmarks.problem_sets import choose_problems, plant_specs
from lime_planner.cli.main import main
from lime_planner.core.errors import ParameterError
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
    assert "6 runs on 1 problems" in capsys.readouterr().err or missing_library("ompl_bit_star")
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
    assert len(second["trials"]) == len(first["trials"]) + 4


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
        if "simplify_share" in best:
            assert {"simplify_share": 0.0}.items() <= finer[0].items()  # without the simplifier is a choice
        for one in finer:
            assert len({*one.items()} - {*best.items()}) == 1
    assert finer_candidates("lime_star", {"range": 3.0}) == []
    runs = search_runs("ompl_rrt_star", [{"range": 1.0}, {"range": 2.0}], [problem.spec], 2, 1.0, "cpu")
    assert [(run.seed, dict(run.settings)["range"]) for run in runs] == [(1, 1.0), (2, 1.0), (1, 2.0), (2, 2.0)]


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
