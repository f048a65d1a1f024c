"""How cost grows: one small measurement, arms of any number of joints, and tables from made-up records."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.scale import report
from benchmarks.scale.cases import ScaleTask, chain_urdf, labelled_cloud, run_task
from lime_planner.cli.main import main
from lime_planner.robot.model import home, robot_from_urdf


def test_clouds_are_measured_and_more_can_be_added(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["bench", "scale", "--leaves", "--joints", "--budget", "0", "--jobs", "1", "--out", str(tmp_path)]
    assert main([*command, "--points", "1000", "--no-figures"]) == 0
    assert main([*command, "--points", "1000", "3000", "--resume"]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert [t["value"] for t in results["trials"]] == [1000.0, 3000.0]
    for trial in results["trials"]:
        assert 0.0 < trial["scene_s"] < 1.0 and 0.0 < trial["obstacles_s"] < 5.0
        assert 0 < trial["kept"] < trial["value"] and 1e8 < trial["peak_bytes"] < 4e9
    assert (tmp_path / "scale.png").stat().st_size > 10_000
    assert "| 3,000 |" in (tmp_path / "table.md").read_text()
    assert main([*command, "--points", "10", "--resume"]) == 1
    assert "--points must be at least 1000" in capsys.readouterr().err


def test_a_cloud_has_labels_noise_and_gaps() -> None:
    points, labels = labelled_cloud(5000)
    assert points.shape == (5000, 3) and points.dtype == np.float32
    assert set(labels) == {0, 1, 2}
    assert np.isnan(points).any(axis=1).sum() == 5


def test_arms_of_any_number_of_joints() -> None:
    for joints in (3, 8):
        robot = robot_from_urdf(chain_urdf(joints))
        assert robot.n == joints
        assert robot.forward(np.zeros(joints))[2, 3] == pytest.approx(0.95, abs=1e-3)
        assert np.array_equal(home(robot), np.zeros(joints))


def test_leaves_are_measured() -> None:
    record = run_task(ScaleTask("leaves", 20.0, 3))
    assert record["check_s"] is None or 1e-7 < record["check_s"] < 1e-3
    assert 1 <= len(record["searches"]) <= 3 and record["points"] > 1000
    for search in record["searches"]:
        assert search["checks"] > 100
        assert (search["first_s"] is None) == (search["cost"] is None)


def made_up() -> dict[str, Any]:
    points = {"axis": "points", "number": 0, "problem": "", "obstacles_s": 0.1, "kept": 900, "peak_bytes": 5e8}
    budget = {"axis": "budget", "value": 0.5, "problem": "a"}
    trials = [
        {**points, "value": 100_000.0, "scene_s": 0.2},
        {**points, "value": 5_000_000.0, "scene_s": 2.0, "peak_bytes": 5e9},
        {**budget, "number": 0, "curve": [[0.01, 10, 30.0], [0.3, 300, 20.0]]},
        {**budget, "number": 1, "curve": [[0.2, 200, 40.0]]},
        {"axis": "joints", "value": 3.0, "number": 0, "problem": "", "check_s": 2e-6, "first_s": None, "checks": 1000, "cost": None},
    ]
    return {"machine": {"processor": "any", "cores": 2, "load": [0.5, 0.5, 0.5]}, "complete": True, "trials": trials}


def test_tables_follow_from_the_records() -> None:
    results = made_up()
    assert report.targets_missed(results) == ["100,000 points take longer than 0.15 s", "5,000,000 points take more than 4 GB"]
    assert report.budget_ratios(results, 0.5) == [1.0, 2.0]
    assert report.budget_ratios(results, 0.05) == [1.5, np.inf]
    assert report.budget_table(results).splitlines()[-1].endswith("| 2.000 | 2.000 | 2 of 2 |")
    assert "| 3 | 2.00 | ∞ | 1,000 | ∞ | 0 of 1 |" in report.search_table(results, "joints", "joints")
    assert "| 100,000 | 200.0 | 150 | 900 | 100 | 0.50 |" in report.points_table(results)
