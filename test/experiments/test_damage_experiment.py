"""The damage experiment: its choice of grasps, its trials, its file, its tables, its command."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.errors import ParameterError
from lime_planner.experiments.damage import command as damage
from lime_planner.experiments.damage.figures import all_figures
from lime_planner.experiments.damage.report import failures, median_ratio, success_difference, table_text
from lime_planner.experiments.damage.trials import METHODS, DamageOptions, plan_of, tasks_of
from lime_planner.experiments.grasps import free_solutions, grasps_of, plant_spec, rng_of
from lime_planner.experiments.problems import pipeline_of, scene_of
from lime_planner.experiments.runs.results_file import Plan, collect, load_results

ARM = "kinova_j2s6s200"
SMALL = DamageOptions(plants=1, limes=1, densities=("medium",), iterations=400, methods=("ignored", "binary:leaf_weight=300"), seed=4)


def without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if k not in ("planning_time_s", "planning_cpu_s")}
    return [without_times(v) for v in value] if isinstance(value, list) else value


@pytest.fixture(scope="module")
def results(tmp_path_factory: Any) -> dict[str, Any]:
    return collect(plan_of(SMALL), tmp_path_factory.mktemp("damage") / "results.json", jobs=1, resume=False)[0]


def test_every_method_is_drawn(results: dict[str, Any], tmp_path: Path) -> None:
    done = {t["status"]: t for trial in results["trials"] for t in trial["methods"].values()}["SUCCEEDED"]
    trials = [trial | {"methods": dict.fromkeys(METHODS, done)} for trial in results["trials"] if trial["methods"]]
    every = results | {"options": results["options"] | {"methods": list(METHODS)}, "trials": trials}
    assert all(path.stat().st_size > 5000 for path in all_figures(every, tmp_path))


def test_grasps_touch_no_stem_and_do_not_depend_on_how_many_are_wanted() -> None:
    spec = plant_spec("medium", 4000)
    one, two = grasps_of(spec, 1, ARM), grasps_of(spec, 2, ARM)
    assert [g.number for g in two[:1]] == [g.number for g in one]
    scene, robot = scene_of(spec), pipeline_of(ARM).robot
    for grasp in two:
        free = free_solutions(robot, scene, grasp.pose, np.random.default_rng(1))
        centre = np.array(grasp.pose[:3])
        checker = ExactChecker(robot, scene.impermeable_points(centre, 0.06), point_radius_m=0.004, exclusion_centre=centre)
        assert len(free) and all(checker.stem_hit(q) is None for q in free)
        assert np.allclose(scene.fruit_centres[grasp.number], centre, atol=1e-6)


def test_trials_are_the_same_every_time(results: dict[str, Any], tmp_path: Path) -> None:
    again, complete = collect(plan_of(SMALL), tmp_path / "again.json", jobs=1, resume=False)
    assert complete
    assert without_times(again) == without_times(results) == without_times(json.loads((tmp_path / "again.json").read_text()))
    record = results["trials"][0]
    assert set(record["methods"]) == set(SMALL.methods)
    for outcome in record["methods"].values():
        assert outcome["status"] == "SUCCEEDED"
        assert len(outcome["leaves"]) >= record["leaves_at_best_goal"]
        assert (outcome["area_cm2"] > 0.0) == bool(outcome["leaves"])


def test_tables_and_plots_hold_every_method(results: dict[str, Any], tmp_path: Path) -> None:
    text = table_text(results)
    for words in ("leaves ignored", "default, binary cost, leaf_weight=300", "Against leaves ignored", "How plans ended", "- none"):
        assert words in text
    paths = all_figures(results, tmp_path)
    assert [p.name for p in paths] == ["damage.png", "damage_pairs.png"]
    assert all(p.stat().st_size > 5000 for p in paths)


def made_up(leaves: list[tuple[int | None, int | None]]) -> list[dict[str, Any]]:
    """Trials of plants with two grasps each: leaves touched by a and b, None for a failure."""

    def outcome(n: int | None) -> dict[str, Any]:
        return {"status": "NO_PATH"} if n is None else {"status": "SUCCEEDED", "leaves": list(range(n))}

    return [
        {"scene": f"p{i // 2}", "number": i % 2, "density": "dense", "target": 0, "methods": {"binary": outcome(a), "ignored": outcome(b)}}
        for i, (a, b) in enumerate(leaves)
    ]


def test_paired_statistics() -> None:
    trials = made_up([(1, 4), (2, 4), (0, 0), (3, None), (None, 2), (1, 0), (1, 4), (1, 2)])
    ratio = median_ratio(trials, "binary", "ignored", "leaves")  # of 0.25, 0.5, 1 (0 of 0), inf, 0.25, 0.5
    assert ratio.value == 0.5
    assert ratio.low >= 0.25
    assert success_difference(trials, "binary", "ignored").value == 0.0
    assert failures({"trials": trials}, ["binary"]) == ["p2/0: default, binary cost NO_PATH"]


def test_options_are_checked() -> None:
    for changes, words in (
        ({"plants": -1}, "plants must be at least 0"),
        ({"densities": ("jungle",)}, "'jungle' is none of sparse"),
        ({"methods": ("magic",)}, "'magic' is none of solid"),
        ({"methods": ("binary:leaf_weigt=1",)}, "leaf_weight"),
    ):
        with pytest.raises(ParameterError, match=words):
            dataclasses.replace(SMALL, **changes)
    assert len(tasks_of(DamageOptions())) == 17 * 4 * 3
    scenes = [s.name for s in DamageOptions(plants=2, seed=1).scenes()]
    assert scenes == ["sparse-1000", "medium-1000", "dense-1000", "sparse-1001", "medium-1001", "dense-1001"]


def test_finished_trials_survive_an_error_and_are_not_run_again(tmp_path: Path) -> None:
    path, run = tmp_path / "results.json", []

    def trial(task: int) -> dict[str, Any]:
        run.append(task)
        if task == 3 and run.count(3) == 1:
            raise OSError("the disk is full")
        return {"n": task}

    plan = Plan("numbers", {"seed": 0}, range(5), trial, lambda task: task, lambda record: record["n"])
    with pytest.raises(OSError, match="disk"):
        collect(plan, path, jobs=1, resume=False)
    assert load_results(path, "numbers")["trials"] == [{"n": 0}, {"n": 1}, {"n": 2}]
    with pytest.raises(ParameterError, match="--resume"):
        collect(plan, path, jobs=1, resume=False)
    with pytest.raises(ParameterError, match="another seed"):
        collect(dataclasses.replace(plan, description={"seed": 1}), path, jobs=1, resume=True)
    results, complete = collect(plan, path, jobs=1, resume=True)
    assert (complete, run, [t["n"] for t in results["trials"]]) == (True, [0, 1, 2, 3, 3, 4], [0, 1, 2, 3, 4])


def test_command(results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[DamageOptions] = []

    def recorded(options: DamageOptions, out: Path, **_: Any) -> bool:
        seen.append(options)
        (out / "table.md").write_text(table_text(results))
        return True

    monkeypatch.setattr(damage, "run_damage", recorded)
    parser = argparse.ArgumentParser()
    damage.add_arguments(parser)
    (tmp_path / "a.npz").touch()
    words = ["--out", str(tmp_path), "--plants", "2", "--methods", "binary", "graded", "--iterations", "50"]
    assert damage.run(parser.parse_args(words)) == 0
    assert (seen[0].plants, seen[0].methods, seen[0].iterations) == (2, ("binary", "graded"), 50)
    assert "# Leaves really touched" in capsys.readouterr().out
    with pytest.raises(ParameterError, match=r"no \.npz"):
        damage.run(parser.parse_args([*words, "--scans", str(tmp_path / "nothing")]))


def test_generators_differ_by_scene_and_purpose() -> None:
    draws = {float(rng_of(name, what).random()) for name in ("dense-1", "dense-2") for what in ("grasps", "plan")}
    assert len(draws) == 4
