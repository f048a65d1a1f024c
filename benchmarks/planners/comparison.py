"""Runs of planners side by side: the same problems, seeds and budgets, in parts and parallel, kept in one results file."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.isolated import IsolatedError, run_isolated
from benchmarks.planner_runs import CLOCKS, OWN_METHODS, is_anytime, run_own, warm_up
from benchmarks.problem_sets import Refused
from benchmarks.timing import machine
from lime_planner.core.errors import ParameterError
from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.experiments.problems import Problem, ProblemSpec, build_problem
from lime_planner.experiments.runs.results_file import Plan

OMPL_PREFIX = "ompl_"
PYROBOPLAN = "pyroboplan"
SETTINGS_FILE = Path(__file__).with_name("peer_settings.json")
_PREPARE_S = 1.5  # for each run, besides its budget: problem, process, measuring the path
_PATIENCE = 60.0  # a peer that takes this many times its budget hangs


@dataclass(frozen=True)
class Run:
    """One run of one method.

    Attributes:
        spec: the problem; method: its name; seed: of the method.
        seconds: budget; marks_s: times at which costs are wanted, for methods that are run again for each.
        clock: `wall` or `cpu`.
        settings: of a peer, by name.
        min_checks: a peer goes on until so many configurations are checked.
        keep_path: keep the path in the record.
    """

    spec: ProblemSpec
    method: str
    seed: int
    seconds: float
    marks_s: tuple[float, ...]
    clock: str = "wall"
    settings: tuple[tuple[str, Any], ...] = ()
    min_checks: int = 0
    keep_path: bool = False


def methods_known() -> tuple[str, ...]:
    """Names of all methods, whether installed or not."""
    return (*OWN_METHODS, "ompl_rrt_star", "ompl_informed_rrt_star", "ompl_bit_star", "ompl_rrt_connect", PYROBOPLAN)


def missing_library(method: str) -> str | None:
    """What to install for a method, None if it can run."""
    if method.startswith(OMPL_PREFIX):
        try:
            import ompl.geometric  # noqa: F401
        except ImportError:
            return "ompl: pip install 'lime_planner[bench]'"
    if method == PYROBOPLAN:
        from benchmarks.planners.pyroboplan import installed

        if not installed():
            return "pyroboplan: pip install meshcat && pip install --no-deps pyroboplan"
    return None


def load_settings(path: Path = SETTINGS_FILE) -> dict[str, dict[str, Any]]:
    """Settings of the peers by method, as the settings search wrote them.

    Raises:
        ParameterError: the file is missing or something else.
    """
    try:
        data = json.loads(path.read_text())
        return {method: dict(entry["settings"]) for method, entry in data["methods"].items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ParameterError(f"{path} holds no settings of peers ({error})") from error


def _warm_up(problem: Problem, method: str) -> None:
    # Compiled here, not inside the measured time, and before a peer's process is forked off.
    from benchmarks.planners.compiled_checks import CompiledChecks

    checks = CompiledChecks(problem.space(), problem.settings.weight)
    checks.cost(problem.start.tolist(), problem.start.tolist())
    problem.cost(np.array([problem.start, problem.goals.configurations[0]]))
    if method in OWN_METHODS:
        warm_up(problem, method)


_WARMED: set[str] = set()


def carry_out(run: Run) -> dict[str, Any]:
    """Carry a run out and return its record; a peer that crashes or hangs gives a record without a path that says so."""
    problem = build_problem(run.spec)
    if run.method not in _WARMED:
        _warm_up(problem, run.method)
        _WARMED.add(run.method)
    settings = dict(run.settings)
    if run.method in OWN_METHODS:
        result = run_own(problem, run.method, run.seed, tuple(m for m in run.marks_s if m <= run.seconds) or (run.seconds,), run.clock)
    else:
        function = functools.partial(_peer, problem, run, settings)
        try:
            result = run_isolated(function, timeout_s=60.0 + _PATIENCE * run.seconds)
        except IsolatedError as error:
            reason = str(error).strip().splitlines()[-1]
            result = {"curve": [], "checks": 0, "cost": None, "path": None, "failure": reason}
    result |= {"problem": run.spec.key, "method": run.method, "seed": run.seed, "seconds": run.seconds}
    if not run.keep_path:
        result.pop("path", None)
    return result


def _peer(problem: Problem, run: Run, settings: Mapping[str, Any]) -> dict[str, Any]:
    if run.method == PYROBOPLAN:
        from benchmarks.planners.pyroboplan import run_pyroboplan

        return run_pyroboplan(problem, run.seed, run.seconds, settings, clock=run.clock, min_checks=run.min_checks)
    from benchmarks.planners.ompl import run_ompl

    name = run.method.removeprefix(OMPL_PREFIX)
    return run_ompl(problem, name, run.seed, run.seconds, settings, clock=run.clock, min_checks=run.min_checks)


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    Attributes:
        name: of the results file.
        problems, refused: as chosen.
        methods: in the order of the tables.
        seeds: of every method on every problem.
        marks_s: times at which costs are compared; the last one is the budget.
        reference_s: budget of the runs that look for the best known cost, 0 for none; reference_seeds: how many of each of
            `reference_methods`.
        clock: `wall` or `cpu`.
        settings: of the peers.
        min_checks, keep_paths: see `Run`.
    """

    name: str
    problems: Sequence[ProblemSpec]
    refused: Sequence[Refused]
    methods: Sequence[str]
    seeds: Sequence[int]
    marks_s: tuple[float, ...]
    reference_s: float = 0.0
    reference_seeds: int = 2
    reference_methods: Sequence[str] = (DEFAULT_PLANNER,)
    clock: str = "wall"
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    min_checks: int = 0
    keep_paths: bool = False

    def __post_init__(self) -> None:
        """Check what can be wrong.

        Raises:
            ParameterError: names the field, its value and what is allowed.
        """
        for method in (*self.methods, *self.reference_methods):
            if method not in methods_known():
                raise ParameterError(f"method {method!r} is none of {', '.join(methods_known())}")
        finite = all(math.isfinite(mark) for mark in self.marks_s)
        if not self.marks_s or not finite or list(self.marks_s) != sorted(set(self.marks_s)) or self.marks_s[0] <= 0.0:
            raise ParameterError(f"marks must be rising times above 0 s, got {list(self.marks_s)}")
        if not (math.isfinite(self.reference_s) and self.reference_s >= 0.0):
            raise ParameterError(f"reference must be a time of at least 0 s, got {self.reference_s}")
        if self.clock not in CLOCKS:
            raise ParameterError(f"clock {self.clock!r} is none of {', '.join(CLOCKS)}")
        if not self.problems:
            raise ParameterError("no target of the scenes has a goal that touches no stem")

    def runs(self) -> list[Run]:
        """All runs, problem by problem, so that an interrupted comparison has whole problems."""
        runs: list[Run] = []
        for spec in self.problems:
            for seed in self.seeds:
                runs += [self._run(spec, method, seed, self.marks_s[-1]) for method in self.methods]
            if self.reference_s > self.marks_s[-1]:
                for method in self.reference_methods:
                    runs += [self._run(spec, method, 1000 + k, self.reference_s) for k in range(self.reference_seeds)]
        return runs

    def _run(self, spec: ProblemSpec, method: str, seed: int, seconds: float) -> Run:
        settings = tuple(sorted(self.settings.get(method, {}).items()))
        checks = self.min_checks if seconds == self.marks_s[-1] else 0
        return Run(spec, method, seed, seconds, self.marks_s, self.clock, settings, checks, self.keep_paths)

    def seconds(self) -> float:
        """Time that all runs take together, one after the other [s]."""
        total = 0.0
        for run in self.runs():
            once = run.method not in OWN_METHODS or is_anytime(run.method)
            again = 0.0 if once else sum(m for m in self.marks_s if m < run.seconds)
            total += run.seconds + again + _PREPARE_S
        return total

    def statement(self, jobs: int) -> str:
        """What the comparison will cost, in one sentence."""
        minutes = self.seconds() / 60.0 / max(jobs, 1)
        return f"{len(self.runs())} runs on {len(self.problems)} problems: about {minutes:.0f} min with {jobs} at a time."

    def plan(self) -> Plan[Run]:
        """The comparison as a list of independent trials."""
        own = {method: dict(values) for method, values in self.settings.items()}
        return Plan(
            name=self.name,
            description={"marks_s": list(self.marks_s), "clock": self.clock, "settings": own, "min_checks": self.min_checks},
            tasks=self.runs(),
            run=carry_out,
            key_of_task=lambda r: (r.spec.key, r.method, r.seed, r.seconds),
            key_of_record=lambda r: (r["problem"], r["method"], r["seed"], r["seconds"]),
            extra={
                "machine": machine(),
                "methods": list(self.methods),
                "problems": [spec.to_dict() for spec in self.problems],
                "refused": [{"key": r.key, "reason": r.reason} for r in self.refused],
                "seconds_stated": round(self.seconds()),
            },
        )
