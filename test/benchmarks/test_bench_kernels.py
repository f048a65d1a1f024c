"""Problems, checks and runs of the benchmarks, at sizes that take seconds."""

from __future__ import annotations

import json
import os
import time
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.isolated import IsolatedError, run_isolated
from benchmarks.planner_runs import Curve, cost_at, run_anytime, run_own, warm_up
from benchmarks.planners.compiled_checks import CompiledChecks
from benchmarks.problem_sets import NARROW_M, choose_problems, plant_specs, scan_specs
from lime_planner.cli.main import main
from lime_planner.core.errors import ParameterError
from lime_planner.experiments.problems import ProblemSpec, SceneSpec, build_problem, find_problem
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.goals import measure
from lime_planner.planning.lime_star import planner as lime_star
from lime_planner.planning.lime_star import run as lime_run
from lime_planner.planning.lime_star.options import LimeOptions
from lime_planner.planning.lime_star.planner import plan_lime
from lime_planner.planning.space import line, one
from lime_planner.planning.spaces.plane import random_wall

PLANT = "sparse:4"


@pytest.fixture(scope="module")
def problem():
    return build_problem(choose_problems(plant_specs([PLANT]), 1)[0][0])


def test_a_problem_goes_through_json_and_comes_back_the_same(problem):
    spec = ProblemSpec.from_dict(json.loads(json.dumps(problem.spec.to_dict())))
    assert spec == problem.spec
    again, reason = find_problem(spec)
    assert reason == ""
    np.testing.assert_array_equal(again.goals.configurations, problem.goals.configurations)
    np.testing.assert_array_equal([again.lower, again.upper], [problem.lower, problem.upper])


def test_problems_are_the_same_every_time_and_goals_hold_the_tool_at_the_target(problem):
    first = choose_problems(plant_specs([PLANT, "sparse:5"]), 4)[0]
    assert first == choose_problems(plant_specs([PLANT, "sparse:5"]), 4)[0]
    assert [s.scene.name for s in first] == ["sparse-4", "sparse-5", "sparse-4", "sparse-5"]
    for q in problem.goals.configurations:
        assert np.linalg.norm(problem.obstacles.robot.forward(q)[:3, 3] - problem.spec.pose[:3]) < 1e-3


def test_hard_cases_are_what_they_are_called():
    plants = plant_specs(["medium:1", "dense:1"])
    for case in ("leaf_start", "far", "narrow"):
        found = choose_problems(plants, 1, (case,))[0]
        if case == "narrow" and not found:
            continue  # not every plant has a lime that is hard to get at
        assert len(found) == 1, case
        problem = build_problem(found[0])
        space = problem.obstacles.measuring_space()
        if case == "leaf_start":
            clear, _, leaf = measure(space, problem.start)
            assert leaf > 0.0 and clear > 0.0
        elif case == "far":
            assert np.linalg.norm(problem.goals.configurations - problem.start, axis=1).min() > 2.0
        else:
            assert max(measure(space, q)[0] for q in problem.goals.configurations) < NARROW_M


def test_wrong_names_are_refused():
    with pytest.raises(ParameterError, match="DENSITY:SEED"):
        SceneSpec.plant("dense")
    with pytest.raises(ParameterError, match="thick"):
        SceneSpec.plant("thick:1")
    with pytest.raises(ParameterError, match="case 'easy' is none of"):
        choose_problems(plant_specs([PLANT]), 1, ("easy",))


def test_scans_stand_in_front_of_the_arm(shared_data):
    specs = scan_specs(shared_data)
    assert len(specs) >= 1
    for spec in specs:
        points = spec.load().leaf_points
        assert 0.25 < np.ptp(points[:, 2]) < 1.0  # a seedling is enlarged
        assert abs(np.median(points[:, 0]) - 0.55) < 0.3


def test_cost_of_a_path_is_its_length_and_its_leaves(problem):
    goal = problem.goals.configurations[0]
    warm_up(problem, "lime_star")
    outcome = run_anytime(problem, "lime_star", 1, 0.2, "cpu")
    assert outcome["cost"] is not None
    path = np.array(outcome["path"])
    rows, lengths = sample_path(path, 0.0005)
    space = problem.obstacles.measuring_space()
    figures = np.array([measure(space, q) for q in np.ascontiguousarray(rows)])
    assert figures[:, 0].min() >= problem.settings.stem_margin_m - 0.002  # as closely as edges are certified between samples
    leaf = figures[:, 2]
    along = float((0.5 * (leaf[1:] + leaf[:-1]) * np.diff(lengths)).sum())
    expected = lengths[-1] + problem.settings.weight * along
    assert outcome["cost"] == pytest.approx(expected, abs=0.001 * problem.settings.weight, rel=0.02)
    assert problem.cost(None) == np.inf
    assert problem.cost(np.array([problem.start + 0.01, goal])) == np.inf
    assert problem.cost(np.array([problem.start, goal + 0.01])) == np.inf


def test_compiled_checks_are_the_kernels_own(problem):
    space = problem.space()
    checks, rng = CompiledChecks(space, 1000.0), np.random.default_rng(3)
    goals = problem.goals.configurations
    finite = 0
    for _ in range(60):
        a = goals[rng.integers(len(goals))] + rng.normal(0.0, 0.2, 6)
        b = a + rng.normal(0.0, 0.2, 6)
        expected = line(problem.space(), a, b, 1000.0, np.inf)
        assert checks.cost(a.tolist(), b.tolist()) == expected
        assert checks.valid(a.tolist()) == (one(problem.space(), a) >= 0.0)
        finite += np.isfinite(expected)
    assert finite > 5
    assert checks.edges == 60 and checks.checks == int(space.counters[0] + space.counters[2]) >= 60
    assert checks.compiled_s > 0.0


def test_a_curve_keeps_improvements_only():
    curve = Curve()
    for time_s, checks, cost in ((0.1, 10, 5.0), (0.2, 20, 7.0), (0.3, 30, np.inf), (0.4, 40, 4.0)):
        curve.add(time_s, checks, cost)
    assert curve.to_list() == [[0.1, 10, 5.0], [0.4, 40, 4.0]]
    assert [cost_at(curve.to_list(), t) for t in (0.05, 0.1, 0.39, 9.0)] == [np.inf, 5.0, 5.0, 4.0]
    assert cost_at(curve.to_list(), 39, column=1) == 5.0


def test_own_planners_give_records_with_falling_curves(problem):
    for method in ("lime_star", "apf_rrt_star", "apf_rrt_star_paper"):
        record = run_own(problem, method, 1, (0.05, 0.2), "cpu")
        costs = [c for _, _, c in record["curve"]]
        assert costs == sorted(costs, reverse=True)
        assert all(t <= 0.35 for t, _, _ in record["curve"])
        if record["cost"] is not None:
            assert record["cost"] == pytest.approx(costs[-1], rel=1e-4)
            assert problem.cost(record["path"]) == np.inf or problem.cost(record["path"]) == pytest.approx(costs[-1], rel=0.05)
    with pytest.raises(ParameterError, match="method 'dijkstra' is none of"):
        run_own(problem, "dijkstra", 1, (0.1,))


def _fail(how):
    if how == "raise":
        raise ValueError("by intent")
    if how == "crash":
        os._exit(3)
    time.sleep(30.0)


def test_a_child_process_keeps_crashes_and_hangs_to_itself():
    rng = np.random.default_rng(0)
    big = rng.random(200_000)  # more than a pipe holds
    np.testing.assert_array_equal(run_isolated(np.sort, big, timeout_s=20.0), np.sort(big))
    with pytest.raises(IsolatedError, match="ValueError: by intent"):
        run_isolated(_fail, "raise", timeout_s=20.0)
    with pytest.raises(IsolatedError, match="exit status 3"):
        run_isolated(_fail, "crash", timeout_s=20.0)
    began = time.monotonic()
    with pytest.raises(IsolatedError, match="no answer within 0 s"):
        run_isolated(_fail, "hang", timeout_s=0.3)
    assert time.monotonic() - began < 10.0


def test_kernels_are_timed_beside_their_targets(tmp_path, capsys):
    file = tmp_path / "kernels.json"
    assert main(["bench", "kernels", "--targets", "1", "--seeds", "1", "--repeats", "2", "--json", str(file)]) == 0
    results = json.loads(file.read_text())
    rows = {row["name"]: row for row in results["kernels"]}
    named = {"reference", "forward_kinematics", "check", "check_mixed", "edge", "fields", "obstacles", "paper_mode", "first_path"}
    named |= {"seen_map_1_100000", "seen_map_5_100000", "seen_map_1_5000000", "look"}
    assert named <= rows.keys()
    targets = {name: row["target_s"] for name, row in rows.items() if row["target_s"] is not None}
    views = {"seen_map_1_100000": 0.06, "seen_map_5_100000": 0.3, "look": 0.3}
    assert targets == {"check": 2e-6, "fields": 0.12, "paper_mode": 0.025, "first_path": 0.05} | views
    for name, row in rows.items():
        assert row["median_s"] is None or 0.0 < row["q05_s"] <= row["median_s"], name
        assert row["met"] in (None, True, False)
    assert rows["reference"]["ratio"] == pytest.approx(1.0)
    assert rows["forward_kinematics"]["median_s"] < rows["check"]["median_s"] < rows["edge"]["median_s"] < rows["fields"]["median_s"]
    printed = capsys.readouterr().out
    assert "full check near the" in printed and max(map(len, printed.splitlines())) <= 80
    assert main(["bench", "kernels", "--repeats", "0"]) == 1


def test_times_are_counted_from_the_call(monkeypatch):
    now = [100.0]

    class SlowRun(lime_run.Run):
        def __init__(self, *values):
            now[0] += 7.0  # checks of start and goals, and the run's memory
            super().__init__(*values)

    world = random_wall(3)
    problem = (world.space(), world.start, world.goal, LimeOptions(weight=30.0), 1)
    expected = plan_lime(*problem, iterations=300)
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(lime_run, "time", clock)
    monkeypatch.setattr(lime_star, "time", clock)
    monkeypatch.setattr(lime_star, "Run", SlowRun)
    outcome = plan_lime(*problem, iterations=300)
    assert outcome.first_path_s == 7.0 and (outcome.history[:, 0] == 7.0).all()
    np.testing.assert_array_equal(outcome.path, expected.path)
    np.testing.assert_array_equal(outcome.history[:, 1:], expected.history[:, 1:])
    assert (outcome.cost, outcome.states_checked) == (expected.cost, expected.states_checked)
