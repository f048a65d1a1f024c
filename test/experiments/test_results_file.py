"""The results file of an experiment: what a later run takes over, what it refuses, and what a killed one leaves."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT

from benchmarks.results_page.kept_results import keep
from lime_planner.core.errors import ParameterError
from lime_planner.experiments.runs import results_file as collection
from lime_planner.experiments.runs.results_file import Plan, collect, load_results, machine_text


def record_of(number: int) -> dict[str, Any]:
    return {"n": number}


def plan(numbers: Sequence[int], **extra: Any) -> Plan[int]:
    return Plan("numbers", {"seed": 0}, numbers, record_of, lambda task: task, lambda record: record["n"], extra)


def numbers_in(trials: Sequence[dict[str, Any]]) -> list[int]:
    return [trial["n"] for trial in trials]


def test_trials_that_are_not_asked_for_are_put_aside_and_come_back(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    collect(plan(range(4)), path, jobs=1, resume=False)
    fewer, complete = collect(plan([3, 1]), path, jobs=1, resume=True)
    assert complete and numbers_in(fewer["trials"]) == [3, 1] and numbers_in(fewer["aside"]) == [0, 2]
    assert json.loads(path.read_text()) == fewer
    more, _ = collect(plan([0, 1, 2, 5]), path, jobs=1, resume=True)
    assert numbers_in(more["trials"]) == [0, 1, 2, 5] and numbers_in(more["aside"]) == [3]


def test_what_was_put_aside_is_not_published() -> None:
    assert "aside" not in keep({"experiment": "bench scale", "options": {}, "trials": [], "aside": [{"n": 1}]})


def test_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "results.json"
    monkeypatch.setattr(collection, "__version__", "0.0.9")
    collect(plan(range(2)), path, jobs=1, resume=False)
    before = path.read_bytes()
    monkeypatch.setattr(collection, "__version__", "0.1.7")
    with pytest.raises(ParameterError, match=r"made by lime_planner 0\.0\.9, this is 0\.1\.7"):
        collect(plan(range(3)), path, jobs=1, resume=True)
    assert path.read_bytes() == before


def test_every_machine_stays_on_the_list(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    machines = [{"processor": name, "cores": 2, "load": [0.5, 0.0, 0.0]} for name in ("slow", "fast", "idle")]
    collect(plan(range(2), machine=machines[0]), path, jobs=1, resume=False)
    results, _ = collect(plan(range(4), machine=machines[1]), path, jobs=1, resume=True)
    assert (results["machine"], results["machines"]) == (machines[0], machines[:2])
    results, _ = collect(plan(range(4), machine=machines[2]), path, jobs=1, resume=True)  # nothing was left to do on it
    assert results["machines"] == machines[:2]
    assert machine_text(results) == "slow, 2 cores, load 0.5 at the start (continued on fast, 2 cores, load 0.5)"


def test_a_run_that_fails_at_once_leaves_no_file_in_the_way(tmp_path: Path) -> None:
    path = tmp_path / "results.json"

    def fails(number: int) -> dict[str, Any]:
        if number == 1:
            raise ValueError("no good")
        return {"n": number}

    with pytest.raises(ValueError, match="no good"):
        collect(replace(plan([1, 2]), run=fails), path, jobs=1, resume=False)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="no good"):
        collect(replace(plan([2, 1]), run=fails), path, jobs=1, resume=False)
    assert numbers_in(load_results(path, "numbers")["trials"]) == [2]


KILLED = """\
import os, signal, sys
from pathlib import Path
from test_results_file import plan
from lime_planner.experiments.runs import results_file as collection
import dataclasses

def run(task):
    if task == 4:  # long before the next time at which the whole file is written
        os.kill(os.getpid(), signal.SIGKILL)
    return {"n": task}

collection._SAVE_EVERY_S = 1e6
collection.collect(dataclasses.replace(plan(range(6)), run=run), Path(sys.argv[1]), jobs=1, resume=False)
"""


def test_a_killed_run_keeps_every_finished_trial(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    folders = (ROOT, ROOT / "test", ROOT / "test" / "helpers", Path(__file__).parent)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    died = subprocess.run([sys.executable, "-c", KILLED, str(path)], env=environment, cwd=tmp_path, timeout=120, check=False)
    assert died.returncode == -signal.SIGKILL
    assert numbers_in(json.loads(path.read_text())["trials"]) == [0]
    assert numbers_in(load_results(path, "numbers")["trials"]) == [0, 1, 2, 3]
    journal = tmp_path / "results.json.journal"
    with journal.open("a") as lines:
        lines.write('{"n": 3}\n{"n"')  # one that is there twice, and one that was not written to its end
    done, _ = collect(plan(range(6)), path, jobs=1, resume=True)
    assert numbers_in(done["trials"]) == list(range(6)) and done["aside"] == []
    assert json.loads(path.read_text()) == done and not journal.exists()
