"""The lime experiment: its plants, its trials by both checkers, its tables, its figure."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.core.errors import ParameterError
from lime_planner.experiments.grasps import plant_spec
from lime_planner.experiments.lime import command as lime
from lime_planner.experiments.lime.figure import simulation_figure
from lime_planner.experiments.lime.report import cells_of, failures, overall, quantity, ranking, ratio, table_text
from lime_planner.experiments.lime.scenes import examine, find_scenes
from lime_planner.experiments.lime.trials import (
    ALGORITHMS,
    FIXED,
    VARIANTS,
    LimeOptions,
    Task,
    box_of,
    goals_of,
    obstacles_of,
    plan_of,
    plan_trial,
    run_trial,
    space_of,
)
from lime_planner.experiments.problems import pipeline_of, scene_of
from lime_planner.experiments.runs.results_file import collect
from lime_planner.experiments.swept_leaves import LeafTruth
from lime_planner.robot.model import home

ARM = "kinova_j2s6s200"
SMALL = LimeOptions(trials=3, plants=1, sensitivity_trials=0, iterations=600)


@pytest.fixture(scope="module")
def run(tmp_path_factory: Any) -> tuple[Any, dict[str, Any]]:
    plan = plan_of(SMALL)
    return plan, collect(plan, tmp_path_factory.mktemp("lime") / "results.json", jobs=1, resume=False)[0]


def test_plants_qualify_by_stems_and_leaves_alone() -> None:
    scenes = find_scenes(2, ARM)
    assert [s.seed for s in scenes] == [0, 1]
    truth = LeafTruth(pipeline_of(ARM).robot, scene_of(plant_spec("dense", 1)))
    assert min(scenes[1].leaves) > 0
    assert [len(truth.touched_at(q)) for q in scenes[1].goals] == list(scenes[1].leaves)
    lengths = [np.linalg.norm(np.array(q) - home(pipeline_of(ARM).robot)) for q in scenes[1].goals]
    assert lengths[0] == min(lengths)
    assert examine(2, ARM) is None  # its hidden lime cannot be grasped


def test_choices_are_those_of_the_page() -> None:
    options = LimeOptions()
    for algorithm in ALGORITHMS:
        planner = options.planner_options(algorithm, VARIANTS[FIXED])
        assert (planner.delta, planner.c_perm, planner.beta, planner.shift, planner.shift_steps) == (0.1, 100.0, 1.0, 0.1, 2)
        assert (planner.goal_bias, planner.inside_leaves, planner.cost, planner.propagate) == (0.05, "explore", "node", False)
        assert planner.goal_radius == pytest.approx(0.1 * 5.0 / 3.0)
    scene = find_scenes(1, ARM)[0]
    robot = pipeline_of(ARM).robot
    lower, upper = box_of(ARM, goals_of(scene, VARIANTS[FIXED]), VARIANTS[FIXED])
    ends = np.stack([home(robot), np.array(scene.goals[0])])
    assert np.allclose(np.maximum(ends.min(axis=0) - np.pi / 2, robot.lower), lower)
    assert np.allclose(np.minimum(ends.max(axis=0) + np.pi / 2, robot.upper), upper)
    assert obstacles_of(scene, options).world.margin == 0.0
    assert len(goals_of(scene, VARIANTS["all solutions as goals"])) == len(scene.goals)


def test_both_checkers_answer_alike(run: Any) -> None:
    scene = run[0].tasks[0].scene
    fast, goals = space_of(Task(SMALL, scene, FIXED, "rrt_star", 0))
    exact, _ = space_of(Task(LimeOptions(checker="fcl"), scene, FIXED, "rrt_star", 0))
    from lime_planner.planning.space import one

    rng = np.random.default_rng(0)
    near = goals[0] + rng.normal(0.0, 0.15, (60, 6))
    far = rng.uniform(fast.lower, fast.upper, (60, 6))
    answers = np.array([[one(space, q) for space in (fast, exact)] for q in np.concatenate([near, far])])
    assert (answers[:, 0] == answers[:, 1]).mean() >= 0.95  # within half a millimetre they may differ
    assert {-1.0, 0.0, 1.0} == set(answers[:, 1])
    record = run_trial(Task(LimeOptions(checker="fcl", iterations=60), scene, FIXED, "apf_rrt_star", 0))
    assert record["tree_nodes"] > 20


def test_a_trial_repeats_and_its_costs_add_up(run: Any) -> None:
    plan, results = run
    assert len(results["trials"]) == 2 * 3 * 3
    solved = [t for t in results["trials"] if t["cost"] is not None]
    assert solved
    for trial in solved:
        assert trial["cost"] == pytest.approx(trial["length"] + 100.0 * trial["nodes_inside"], abs=1e-3)
        assert trial["J"] is None or trial["J"] > trial["length"]
    task = next(
        task for task in plan.tasks if task.key[2:] == (solved[0]["algorithm"], solved[0]["trial"]) and task.key[0] == solved[0]["plant"]
    )
    again = run_trial(task)
    assert {k: v for k, v in again.items() if k != "time_s"} == {k: v for k, v in solved[0].items() if k != "time_s"}
    space, goals = space_of(task)
    path = plan_trial(task, space, goals).path
    assert path is not None and np.allclose(path[-1], task.scene.goals[0]) and np.allclose(path[0], home(pipeline_of(ARM).robot))
    assert len({task.seed for task in plan.tasks}) == len(plan.tasks)


def test_tables_and_figure(run: Any, tmp_path: Path) -> None:
    plan, results = run
    text = table_text(results)
    for words in ("822.75 (50.06)", "422.62 (36.98)", "886.77 (47.90)", "Default scene: dense plant 0", "geometric mean", "Ranking"):
        assert words in text
    [path] = simulation_figure(plan, results, tmp_path)
    assert path.stat().st_size > 50_000


def made_up(costs: dict[str, list[float | None]], plant: int) -> list[dict[str, Any]]:
    return [
        {"plant": plant, "variant": FIXED, "algorithm": a, "trial": i, "cost": c, "J": c}
        for a, row in costs.items()
        for i, c in enumerate(row)
    ]


def test_ratios_count_failures_and_leave_them_out() -> None:
    first = {"rrt_star": [200.0] * 8 + [None], "apf_rrt_star": [100.0] * 8 + [None], "p_rrt_star": [250.0] * 9}
    second = {"rrt_star": [100.0] * 9, "apf_rrt_star": [100.0] * 9, "p_rrt_star": [250.0] * 4 + [None] * 5}
    cells = cells_of({"trials": made_up(first, 0) + made_up(second, 1)})
    assert failures(cells[(0, FIXED, "rrt_star")]) == 1
    assert len(quantity(cells[(0, FIXED, "apf_rrt_star")])) == 8
    ratios = [ratio(cells, plant, FIXED, "rrt_star") for plant in (0, 1)]
    assert [r.value for r in ratios if r] == [0.5, 1.0]
    assert overall(ratios).value == pytest.approx(0.5**0.5)
    assert ratio(cells, 1, FIXED, "p_rrt_star") is None
    assert ranking(cells, [0, 1]) == ["apf_rrt_star", "rrt_star", "p_rrt_star"]


def test_planners_without_paths_are_not_ranked(run: Any) -> None:
    _, results = run
    nothing = {"cost": None, "J": None, "nodes_inside": None, "length": None}
    none = [{**trial, **nothing} for trial in results["trials"]]
    text = table_text({**results, "trials": none})
    assert "No ranking: there is no plant on which all three planners found a path." in text and "Ranking by" not in text
    assert "nan" not in text
    partly = cells_of({"trials": made_up({"rrt_star": [1.0], "apf_rrt_star": [2.0], "p_rrt_star": [None]}, 0)})
    assert ranking(partly, [0]) == []


def test_command_checks_its_numbers(tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    lime.add_arguments(parser)
    with pytest.raises(ParameterError, match="trials must be at least 1"):
        lime.run(parser.parse_args(["--out", str(tmp_path), "--trials", "0"]))
    with pytest.raises(SystemExit):
        parser.parse_args(["--out", str(tmp_path), "--jobs", "2", "--scheduler", "tcp://here:1"])
