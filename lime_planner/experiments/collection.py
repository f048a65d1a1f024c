"""An experiment's trials in one JSON file: what is missing is run, what is done is kept, whatever interrupts it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from lime_planner import __version__
from lime_planner.errors import ParameterError, SceneError
from lime_planner.experiments.runner import run_trials, write_json

Task = TypeVar("Task")

_SAVE_EVERY_S = 2.0
_SAVE_SHARE = 0.02  # of the time may go into saving


@dataclass(frozen=True)
class Plan(Generic[Task]):
    """An experiment as a list of independent trials.

    Attributes:
        name: of the experiment, in the file.
        description: what two runs must have in common for the trials of one to continue the other, JSON-ready.
        tasks: all trials, in the file's order.
        run: carries a task out and returns its record (a JSON-ready dictionary); importable by name.
        key_of_task, key_of_record: identify a trial; a record's key is its task's.
        extra: further entries of the file.
    """

    name: str
    description: dict[str, Any]
    tasks: Sequence[Task]
    run: Callable[[Task], dict[str, Any]]
    key_of_task: Callable[[Task], Any]
    key_of_record: Callable[[dict[str, Any]], Any]
    extra: dict[str, Any] = field(default_factory=dict)


def load_results(path: Path, name: str) -> dict[str, Any]:
    """Read the results file of an experiment.

    Raises:
        SceneError: it cannot be read, or is not one.
    """
    try:
        data = json.loads(path.read_text())
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise SceneError(f"{path} is not JSON: {error}") from error
    if not isinstance(data, dict) or data.get("experiment") != name:
        raise SceneError(f"{path} does not hold the experiment {name!r}")
    return data


def _previous(path: Path, plan: Plan[Task]) -> list[dict[str, Any]]:
    """Return the finished trials of an earlier run with the same options."""
    data = load_results(path, plan.name)
    for option, value in json.loads(json.dumps(plan.description)).items():
        if data["options"].get(option) != value:
            raise ParameterError(f"{path} was made with another {option}; resume with the same options, or use another folder")
    return list(data["trials"])


def collect(plan: Plan[Task], path: Path, *, jobs: int, resume: bool, scheduler: str | None = None) -> tuple[dict[str, Any], bool]:
    """Run all trials that `path` does not hold yet and keep them there.

    Args:
        plan: what to run.
        path: the results file; written every few seconds, at the end, and on ctrl-C.
        jobs: number of processes on this machine.
        resume: keep the finished trials of an earlier run with the same options.
        scheduler: address of a Dask scheduler, whose workers run the trials instead.

    Returns:
        The contents of the file, and False if ctrl-C ended the run early.

    Raises:
        ParameterError: an earlier run is there and `resume` is not set, or its options differ.
    """
    trials: list[dict[str, Any]] = []
    if path.exists():
        if not resume:
            raise ParameterError(f"{path} exists: continue it with --resume, or use another folder")
        trials = _previous(path, plan)
    done = {plan.key_of_record(t) for t in trials}
    order = {plan.key_of_task(task): i for i, task in enumerate(plan.tasks)}
    tasks = [task for task in plan.tasks if plan.key_of_task(task) not in done]
    results = {
        "experiment": plan.name,
        "version": __version__,
        "options": plan.description,
        **plan.extra,
        "complete": False,
        "trials": trials,
    }
    next_save_s = time.monotonic() + _SAVE_EVERY_S

    def keep(record: dict[str, Any]) -> None:
        nonlocal next_save_s
        trials.append(record)
        now_s = time.monotonic()
        if now_s > next_save_s:
            write_json(path, results)
            next_save_s = time.monotonic() + max(_SAVE_EVERY_S, (time.monotonic() - now_s) / _SAVE_SHARE)

    complete = False
    try:
        if scheduler is not None:
            from lime_planner.experiments.cluster import run_on_cluster

            complete = run_on_cluster(plan.run, tasks, keep, scheduler=scheduler, description=plan.name)
        else:
            complete = run_trials(plan.run, tasks, keep, jobs=max(1, min(jobs, len(tasks))), description=plan.name)
    finally:  # whatever went wrong, what is done is not lost
        trials.sort(key=lambda t: order.get(plan.key_of_record(t), len(order)))
        results["complete"] = complete
        write_json(path, results)
    return results, complete
