"""The hidden-stems experiment: what cameras see, how motions are judged, and how the tables count."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from arm_helpers import pipeline_of, plant, robot_named, settings

from benchmarks.results_page.kept_results import keep, restore
from lime_planner.core.errors import ParameterError
from lime_planner.experiments.hidden import report, trials
from lime_planner.experiments.hidden.trials import HiddenOptions, arm_points, fixed_views, plan_of, run_trial, tasks_of
from lime_planner.experiments.swept_leaves import surface_of
from lime_planner.experiments.swept_stems import StemTruth
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.pipeline.targets import fruit_target
from lime_planner.robot.model import home
from lime_planner.scene.scene import Scene


def test_points_on_the_arm_lie_on_its_meshes() -> None:
    robot, q = robot_named(), home(robot_named()) + 0.3
    points = arm_points(pipeline_of(), q)
    assert len(points) > 1000
    frames, nearest = robot.link_poses(q), np.full(len(points), np.inf)
    for link in robot.links:
        pose = frames[link.joint]
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        nearest = np.minimum(nearest, surface_of(link).compute_distance(np.float32(local)).numpy())
    assert nearest.max() < 0.002


def test_a_stem_that_no_camera_saw_is_judged_touched() -> None:
    """A twig across the way that a plan took: the whole plant's judge finds it, and nothing without it."""
    scene, aim = plant(5), fruit_target([0.5, 0.1, 0.5], 0.025)
    result = pipeline_of().plan(scene, aim, home(robot_named()), settings(iterations=800), seed=2)
    assert result.succeeded and result.trajectory is not None, result.message
    spot, used = aim.spot(scene, settings()), settings()
    assert len(StemTruth(robot_named(), scene).touched(result.trajectory, spot, used)) == 0
    middle = robot_named().forward(result.waypoints[len(result.waypoints) // 2])[:3, 3]
    twig = middle + np.linspace(-0.05, 0.05, 40)[:, None] * np.array([0.0, 0.0, 1.0])
    hidden = Scene.from_points(np.concatenate([scene.stem_points, twig]), np.ones(len(scene.stem_points) + 40))
    touched = StemTruth(robot_named(), hidden).touched(result.trajectory, spot, used)
    assert len(touched) and (touched >= len(scene.stem_points)).all()


def test_options_are_checked() -> None:
    for wrong in ({"methods": ("two-free",)}, {"densities": ("bare",)}, {"plants": 0}, {"methods": ("one-free:unseen=1",)}):
        with pytest.raises(ParameterError):
            HiddenOptions(**wrong)
    assert HiddenOptions().settings("one-free").unseen_price == 0.0 < HiddenOptions().settings("priced-free").unseen_price
    assert len(tasks_of(HiddenOptions(plants=2, limes=3))) == 18


def test_one_lime_by_two_states_of_knowledge(tmp_path: Path) -> None:
    options = HiddenOptions(plants=1, limes=1, densities=("sparse",), first_plant=3, time_s=0.2, methods=("three-fixed", "looks-free"))
    record = run_trial(tasks_of(options)[0])
    assert record["target"] is not None and json.loads(json.dumps(record)) == record
    for entry in record["methods"].values():
        assert 0.0 < entry["stems_known"] < 1.0 and entry["stems"] >= entry["stems_on_looks"] >= 0
    assert record["methods"]["three-fixed"]["looks"] == 0 and record["methods"]["looks-free"]["looks"] <= 3
    results = {"experiment": "hidden", "options": plan_of(options).description, "trials": [record], "complete": True}
    assert "1 generated plants" in report.table_text(restore(keep(results)))


def entry(stems: int, status: str = "SUCCEEDED", **values: float) -> dict[str, object]:
    figures = {"leaves": 2, "unseen_contact_rad": 0.1, "duration_s": 5.0}
    base = {"status": status, "stems": stems, "stems_known": 0.4, "looks": 1, "look_cpu_s": [0.2], "planning_cpu_s": 1.0}
    return base | (figures if status == "SUCCEEDED" else {}) | values


def test_tables_count_motions_that_touch() -> None:
    """Ten limes on five plants: nine motions sent of the ten, three touch; full knowledge reaches eight of the same."""
    records = []
    for k in range(10):
        methods = {
            "full-free": entry(0, "SUCCEEDED" if k < 8 else "NO_PATH", leaves=1),
            "looks-free": entry(7 if k < 3 else 0, "SUCCEEDED" if k else "TIMED_OUT"),
        }
        records.append({"scene": f"dense-{k // 2}", "density": "dense", "number": k % 2, "target": k, "methods": methods})
    options = {"methods": {"full-free": 0.3, "looks-free": 0.3}, "densities": ["dense"], "first_plant": 0, "time_s": 0.5, "max_looks": 3}
    results = {"options": options, "trials": records}
    found = report.touching(records, "looks-free")
    assert found.value == pytest.approx(2 / 9) and found.low <= found.value <= found.high
    none = report.touching(records, "full-free")
    assert (none.value, none.low) == (0.0, 0.0) and none.high == pytest.approx(1.0 - 0.025 ** (1 / 8)), "eight motions without one"
    assert report.reached(records, "looks-free", "full-free").value == pytest.approx(7 / 8)
    assert report.leaves_ratio(records, "looks-free", "full-free").value == pytest.approx(2.0)
    row = report.table(results, "free").splitlines()[-1]
    assert "| 9 of 10 (88 %) | 2 of 9 |" in row and "1 TIMED_OUT" in report.failures(results)
    # What was sent without full knowledge: all with 0.1 rad unseen, three of nine touch.
    assert [line.split(" | ")[1:3] for line in report.by_unseen(results).splitlines()[2:]] == [
        ["0", "0"],
        ["9", "2"],
        ["0", "0"],
        ["0", "0"],
    ]


def test_equal_plans_are_made_once_and_pictures_taken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two methods with the same knowledge and settings share the first plan; the fixed views of a plant are the same for all its limes."""
    options = HiddenOptions(plants=1, limes=2, densities=("sparse",), first_plant=4, iterations=300, max_looks=0)
    tasks = tasks_of(options)
    assert fixed_views(tasks[0].scene, 0) is fixed_views(tasks[1].scene, 0)
    plans, taken = [], []
    monkeypatch.setattr(Pipeline, "plan", lambda self, *a, _plan=Pipeline.plan, **k: plans.append(1) or _plan(self, *a, **k))
    monkeypatch.setattr(trials, "take_picture", lambda *a, _take=trials.take_picture, **k: taken.append(1) or _take(*a, **k))
    for task in tasks:
        both = dataclasses.replace(task, options=dataclasses.replace(options, methods=("priced-free", "looks-free", "one-free")))
        record = run_trial(both)["methods"]
        assert record["priced-free"] == record["looks-free"] and record["one-free"]["stems_known"] == record["priced-free"]["stems_known"]
    assert (len(plans), len(taken)) == (4, 1), "two limes, two plans each; one view of the plant"
