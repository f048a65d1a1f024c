"""The wall experiment: its table against the yardstick in few trials, its files, interruption and resumption."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.core.errors import ParameterError, SceneError
from lime_planner.experiments.analysis.tables import values
from lime_planner.experiments.runs.parallel import run_trials
from lime_planner.experiments.runs.results_file import load_results
from lime_planner.experiments.wall import command as wall
from lime_planner.experiments.wall import trials as wall_trials
from lime_planner.experiments.wall.reference import MARKS, ROWS
from lime_planner.experiments.wall.report import claims, statistics_text, table_text, tolerance, yardstick
from lime_planner.experiments.wall.trials import WallOptions, collect, options_from
from lime_planner.planning.spaces.plane import load_world, random_wall, wall_g

TRIALS = 20


@pytest.fixture(scope="module", params=[False, True], ids=["stale", "propagated"])
def results(request: Any, tmp_path_factory: Any) -> dict[str, Any]:
    changes = {"propagate": True} if request.param else {}
    path = tmp_path_factory.mktemp("wall") / "results.json"
    return collect(WallOptions(trials=TRIALS, seed=1, changes=changes), path, jobs=1, resume=False)[0]


def test_table_reproduces_the_yardstick(results: dict[str, Any]) -> None:
    expected, costs = yardstick(results), values(results)
    assert expected is not None
    assert set(costs) == {row.key for row in ROWS}
    for key, row in expected.items():
        for i, (mean, sd) in enumerate(row):
            found = costs[key][:, i]
            assert abs(np.nanmean(found) - mean) <= tolerance(sd, TRIALS), (key, MARKS[i])
            assert np.isnan(found).sum() <= 1


def test_claims_that_hold_hold(results: dict[str, Any]) -> None:
    held = {claim: ok for claim, ok, _ in claims(results)}
    assert held["costs differ between iterations, p < .001"]
    assert held["costs differ between RRT* and APF-RRT* (β = 1), p < .001"]
    assert held["APF-RRT* (β = 1) below P-RRT* at 5000, p < .001"]
    costs = values(results)
    assert (np.nanmean(costs["apf_rrt_star_1"], axis=0) < np.nanmean(costs["rrt_star"], axis=0)).all()


def test_reports_hold_every_row_and_test(results: dict[str, Any]) -> None:
    table, statistics = table_text(results), statistics_text(results)
    for row in ROWS:
        assert f"| {row.label} |" in table
    assert table.count("yardstick, 1000 trials") == 5
    assert "paper, 100 trials" in table
    for words in ("Two-way mixed", "Greenhouse-Geisser", "p (Holm)", "Hedges g", "95 % CI", "Welch", "does not hold"):
        assert words in statistics


def test_record_of_a_trial(results: dict[str, Any]) -> None:
    trial = results["trials"][0]
    assert set(trial) == {"algorithm", "trial", "seed", "marks", "failures", "time_s", "curve"}
    assert set(trial["marks"]) == {"1000", "2500", "5000"}
    assert {"cost", "stored_cost", "J", "length", "nodes_inside", "time_s"} <= set(trial["marks"]["5000"])
    seeds = [t["seed"] for t in results["trials"]]
    assert len(set(seeds)) == len(seeds) == 5 * TRIALS


def small(**changes: Any) -> WallOptions:
    settings = {"trials": 2, "iterations": 600, "marks": (300, 600), "rows": ROWS[:2]}
    return WallOptions(**{**settings, **changes})


def without_times(results: dict[str, Any]) -> str:
    def strip(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: strip(v) for k, v in value.items() if k != "time_s"}
        return [strip(v) for v in value] if isinstance(value, list) else value

    return json.dumps(strip(results), sort_keys=True)


def test_processes_do_not_change_results_and_resume_adds_only_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone, _ = collect(small(), tmp_path / "a.json", jobs=1, resume=False)
    parallel, complete = collect(small(), tmp_path / "b.json", jobs=2, resume=False)
    assert complete
    assert without_times(alone) == without_times(parallel) == without_times(load_results(tmp_path / "b.json", "wall"))
    with pytest.raises(ParameterError, match="--resume"):
        collect(small(), tmp_path / "a.json", jobs=1, resume=False)
    with pytest.raises(ParameterError, match="another seed"):
        collect(small(seed=1), tmp_path / "a.json", jobs=1, resume=True)
    with pytest.raises(ParameterError, match="another planners"):
        collect(small(changes={"propagate": True}), tmp_path / "a.json", jobs=1, resume=True)
    run: list[tuple[str, int]] = []
    original = wall_trials.run_trial
    monkeypatch.setattr(wall_trials, "run_trial", lambda task: run.append((task.row.key, task.trial)) or original(task))
    more, _ = collect(small(trials=3), tmp_path / "a.json", jobs=1, resume=True)
    assert run == [("rrt_star", 2), ("apf_rrt_star_1", 2)]
    assert len(more["trials"]) == 6
    assert options_from(more) == small(trials=3)


def test_a_cluster_is_asked_where_one_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def on_cluster(function: Any, tasks: Any, on_result: Any, *, scheduler: str, description: str) -> bool:
        asked.append(scheduler)
        return run_trials(function, list(reversed(tasks)), on_result, jobs=1, description=description)

    monkeypatch.setattr("lime_planner.experiments.runs.cluster.run_on_cluster", on_cluster)
    alone, _ = collect(small(), tmp_path / "a.json", jobs=1, resume=False)
    arguments = ["--scheduler", "tcp://here:8786", "--trials", "2", "--iterations", "600", "--marks", "300", "600", "--no-figures"]
    args = parse(*arguments)
    args.out = tmp_path / "out"
    assert wall.run(args) == 0
    assert asked == ["tcp://here:8786"]
    everything = load_results(args.out / "results.json", "wall")
    rows = [t for t in everything["trials"] if t["algorithm"] in alone["options"]["planners"]]
    assert without_times({"trials": rows}) == without_times({"trials": alone["trials"]})
    with pytest.raises(SystemExit):
        parse("--jobs", "2", "--scheduler", "tcp://here:8786")


def test_interruption_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    original, calls = wall_trials.run_trial, []

    def interrupted(task: Any) -> Any:
        calls.append(task)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return original(task)

    monkeypatch.setattr(wall_trials, "run_trial", interrupted)
    arguments = ["--out", str(tmp_path / "out"), "--trials", "3", "--iterations", "400", "--jobs", "1", "--no-figures"]
    parser = argparse.ArgumentParser()
    wall.add_arguments(parser)
    assert wall.run(parser.parse_args(arguments)) == 130
    assert "Stopped by ctrl-C" in capsys.readouterr().err
    kept = load_results(tmp_path / "out" / "results.json", "wall")
    assert (len(kept["trials"]), kept["complete"]) == (2, False)
    assert "**Incomplete**" in (tmp_path / "out" / "table.md").read_text()
    monkeypatch.setattr(wall_trials, "run_trial", original)
    assert wall.run(parser.parse_args([*arguments, "--resume"])) == 0
    finished = load_results(tmp_path / "out" / "results.json", "wall")
    assert (len(finished["trials"]), finished["complete"]) == (15, True)


def test_ctrl_c_reaches_parallel_runs(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", "import argparse, sys; from lime_planner.experiments.wall import command as wall\n"
               "p = argparse.ArgumentParser(); wall.add_arguments(p); sys.exit(wall.run(p.parse_args()))",
               "--out", str(out), "--trials", "100000", "--jobs", "2", "--no-figures"]  # fmt: skip
    # A new session, so that the signal does not reach the process that runs the tests.
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline_s = time.monotonic() + 300.0
    try:
        while not (out / "results.json").exists() and time.monotonic() < deadline_s and process.poll() is None:
            time.sleep(0.2)  # written for the first time after seconds of trials
        os.killpg(process.pid, signal.SIGINT)  # to all its processes, as a terminal does
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, errors
    assert "Stopped by ctrl-C" in errors
    assert len(load_results(out / "results.json", "wall")["trials"]) >= 1


def test_figures_of_another_wall(tmp_path: Path) -> None:
    options = WallOptions(world=random_wall(1), trials=1, iterations=1500, marks=(800, 1500), rows=ROWS)
    assert wall.run_wall(options, tmp_path, jobs=1)
    names = {"trees", "paths", "c_perm_1", "cost_iterations", "cost_time", "j_iterations"}
    for name in names:
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (tmp_path / f"{name}.svg").read_text()[:2000]
    assert "paper, 100 trials" not in (tmp_path / "table.md").read_text()
    assert "Too few trials" in (tmp_path / "statistics.md").read_text()


def parse(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    wall.add_arguments(parser)
    return parser.parse_args(["--out", "unused", *arguments])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--option", "speed=3"), "--option takes NAME=VALUE"),
        (("--option", "delta=fast"), "--option delta takes a float, got 'fast'"),
        (("--option", "certify_edges=perhaps"), "takes a bool"),
        (("--trials", "0"), "trials must be at least 1"),
        (("--marks", "100", "9000"), "marks must rise between 1 and the 5000"),
        (("--wall", "absent.json"), "cannot read the wall file"),
        (("--wall", "a.json", "--random-wall", "1"), "not both"),
        (("--option", "algorithm=rrt_star"), "unknown planner option 'algorithm'"),
    ],
)
def test_wrong_arguments_are_refused(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    args = parse(*arguments)
    args.out = tmp_path
    with pytest.raises((ParameterError, SceneError), match=words):
        wall.run(args)


def test_a_wall_that_leaves_no_way_is_refused_and_its_folder_stays_free(tmp_path: Path) -> None:
    world = wall_g().to_dict() | {"impermeable": [[[80, 40], [100, 40], [100, 60], [80, 60]]]}
    (tmp_path / "w.json").write_text(json.dumps(world))
    args = parse("--wall", str(tmp_path / "w.json"), "--trials", "1", "--iterations", "100", "--jobs", "1", "--no-figures")
    args.out = tmp_path / "out"
    with pytest.raises(SceneError, match=r"w\.json: goal \[90, 50\] lies in impermeable\[0\]"):
        wall.run(args)
    with pytest.raises(SceneError, match=r"^start \[1, 2\] lies in impermeable\[0\]"):
        WallOptions(world=replace(wall_g(), start=(1.0, 2.0), impermeable=(((0.0, 0.0), (9.0, 0.0), (0.0, 9.0)),)))
    assert not args.out.exists()


def test_the_wall_of_the_help_is_one(tmp_path: Path) -> None:
    text = wall._EPILOG
    (tmp_path / "w.json").write_text(text[text.index("{") : text.rindex("}") + 1])
    read = load_world(tmp_path / "w.json")
    assert len(read.permeable) == len(read.impermeable) == 1 and read.name == "w"
    outcome = wall_trials.run_trial(wall_trials.Task(small(world=read), ROWS[0], 0))
    assert set(outcome["marks"]) == {"300", "600"}


def test_options_from_the_command_line() -> None:
    assert wall._changes(["cost=integral", "shift_steps=3", "goal_bias=0.1", "certify_edges=true", "weight=7"]) == {
        "cost": "integral",
        "shift_steps": 3,
        "goal_bias": 0.1,
        "certify_edges": True,
        "weight": 7.0,
    }


def test_foreign_results_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    for text, words in (("{", "not JSON"), ("{}", "does not hold the experiment 'wall'")):
        path.write_text(text)
        with pytest.raises(SceneError, match=words):
            load_results(path, "wall")
    with pytest.raises(SceneError, match="cannot read"):
        load_results(tmp_path / "absent.json", "wall")


def test_errors_in_trials_are_not_swallowed() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        run_trials(int, ["1", "x"], lambda _: None, jobs=2, description="")
