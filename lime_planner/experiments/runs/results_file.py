"""An experiment's trials in one JSON file: what is missing is run, what is done is kept, whatever interrupts it."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from lime_planner import __version__
from lime_planner.core.atomic_files import write_json
from lime_planner.core.errors import ParameterError, SceneError
from lime_planner.core.validation import TextFileError, read_json
from lime_planner.experiments.runs.parallel import run_trials

Task = TypeVar("Task")

_SAVE_EVERY_S = 2.0  # the whole file
_SAVE_SHARE = 0.02  # of the time may go into saving it


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


def _journal(path: Path) -> Path:
    """Where finished trials stand, one in a line, until the results file is written with them."""
    return path.with_name(f"{path.name}.journal")


def _journalled(path: Path) -> list[dict[str, Any]]:
    try:
        lines = _journal(path).read_text().splitlines()
    except OSError:
        return []
    records = []
    for line in lines:
        try:
            records.append(json.loads(line))
        except ValueError:
            break  # the run was killed while it wrote this one
    return records


def load_results(path: Path, name: str) -> dict[str, Any]:
    """Read the results file of an experiment, with the trials that a killed run had no time to put there.

    Raises:
        SceneError: it cannot be read, or is not one.
    """
    try:
        data = read_json(path)
    except TextFileError as error:
        raise SceneError(f"cannot read {path}: {error}") from None
    if not isinstance(data, dict) or data.get("experiment") != name:
        raise SceneError(f"{path} does not hold the experiment {name!r}")
    if records := _journalled(path):
        data["trials"] = [*data["trials"], *records]
    return data


class _Book(Generic[Task]):
    """The results of a plan, in memory and in its file."""

    def __init__(self, plan: Plan[Task], path: Path, resume: bool) -> None:
        self.plan, self.path = plan, path
        self.order = {plan.key_of_task(task): i for i, task in enumerate(plan.tasks)}
        self.trials: list[dict[str, Any]] = []
        self.aside: list[dict[str, Any]] = []
        machines: list[Any] = []
        if path.exists():
            if not resume:
                raise ParameterError(f"{path} exists: continue it with --resume, or use another folder")
            machines = self._take_over()
        else:
            _journal(path).unlink(missing_ok=True)  # of a results file that was removed
        done = {plan.key_of_record(t) for t in self.trials}
        self.tasks = [task for task in plan.tasks if plan.key_of_task(task) not in done]
        if "machine" in plan.extra and (self.tasks or not machines):
            machines = [*machines, plan.extra["machine"]]
        self.results = {
            "experiment": plan.name,
            "version": __version__,
            "options": plan.description,
            **plan.extra,
            **({"machine": machines[0], "machines": machines} if machines else {}),
            "complete": False,
            "trials": self.trials,
            "aside": self.aside,
        }
        self.next_save_s = -math.inf  # the first record is saved at once, and with it on which machine it was made

    def _take_over(self) -> list[Any]:
        """Take over the finished trials of an earlier run; the machines on which they were made."""
        plan, path = self.plan, self.path
        data = load_results(path, plan.name)
        if data.get("version") != __version__:
            raise ParameterError(
                f"{path} was made by lime_planner {data.get('version')}, this is {__version__}: "
                "resume with that version, or use another folder"
            )
        for option, value in json.loads(json.dumps(plan.description)).items():
            if data["options"].get(option) != value:
                raise ParameterError(f"{path} was made with another {option}; resume with the same options, or use another folder")
        seen = set()
        for record in (*data["trials"], *data.get("aside", [])):
            key = plan.key_of_record(record)
            if key not in seen:
                (self.trials if key in self.order else self.aside).append(record)
            seen.add(key)
        return list(data.get("machines") or ([data["machine"]] if "machine" in data else []))

    def keep(self, record: dict[str, Any]) -> None:
        """Keep a finished trial, safe from whatever kills this process."""
        self.trials.append(record)
        now_s = time.monotonic()
        if now_s < self.next_save_s:  # the whole file takes long when there are many; a line does not
            with _journal(self.path).open("a") as journal:
                journal.write(json.dumps(record, allow_nan=False, separators=(",", ":")) + "\n")
            return
        self.save()
        self.next_save_s = time.monotonic() + max(_SAVE_EVERY_S, (time.monotonic() - now_s) / _SAVE_SHARE)

    def save(self) -> None:
        """Write the whole file."""
        write_json(self.path, self.results, compact=True)
        _journal(self.path).unlink(missing_ok=True)  # should the process die in between, trials are there twice, and count once

    def close(self, complete: bool) -> None:
        """Write the whole file for the last time, in the plan's order."""
        self.trials.sort(key=lambda t: self.order[self.plan.key_of_record(t)])
        self.results["complete"] = complete
        self.save()


def collect(plan: Plan[Task], path: Path, *, jobs: int, resume: bool, scheduler: str | None = None) -> tuple[dict[str, Any], bool]:
    """Run all trials that `path` does not hold yet and keep them there.

    Args:
        plan: what to run.
        path: the results file; written every few seconds, at the end, and on ctrl-C. What finishes in between stands in a second file
            beside it, so that nothing is lost when the process is killed.
        jobs: number of processes on this machine.
        resume: keep the finished trials of an earlier run with the same options. Those that the plan does not ask for are put aside in
            the file, where no report reads them; a plan that asks for them takes them back.
        scheduler: address of a Dask scheduler, whose workers run the trials instead.

    Returns:
        The contents of the file, and False if ctrl-C ended the run early.

    Raises:
        ParameterError: an earlier run is there and `resume` is not set, or its options or its version of this package differ.
    """
    book = _Book(plan, path, resume)
    try:
        if scheduler is not None:
            from lime_planner.experiments.runs.cluster import run_on_cluster

            complete = run_on_cluster(plan.run, book.tasks, book.keep, scheduler=scheduler, description=plan.name)
        else:
            complete = run_trials(plan.run, book.tasks, book.keep, jobs=max(1, min(jobs, len(book.tasks))), description=plan.name)
    except BaseException:  # whatever went wrong, what is done is not lost; a file without any of it would only be in the way
        if book.trials or book.aside:
            book.close(False)
        raise
    book.close(complete)
    return book.results, complete


def machine_text(results: Mapping[str, Any]) -> str:
    """In words, on what results were measured: `machine`, and `machines` where a run was continued."""
    first, *later = results.get("machines") or [results["machine"]]
    text = f"{first['processor']}, {first['cores']} cores, load {first['load'][0]:g} at the start"
    others = dict.fromkeys(f"{m['processor']}, {m['cores']} cores, load {m['load'][0]:g}" for m in later)
    return f"{text} (continued on {'; '.join(others)})" if others else text
