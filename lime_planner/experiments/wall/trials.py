"""The trials of the wall experiment (section IV): what is run, by whom, and the file that holds every one of them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.errors import ParameterError
from lime_planner.experiments.runs import results_file as collection
from lime_planner.experiments.runs.results_file import Plan
from lime_planner.experiments.wall.reference import MARKS, ROWS, Row
from lime_planner.planning.rrt_star.planner import PaperOptions, Snapshot, plan_paper
from lime_planner.planning.spaces.plane import PlaneWorld, check_ends, wall_g, world_from_dict

_CURVE_POINTS = 20  # of the cost-over-iterations figure


@dataclass(frozen=True)
class WallOptions:
    """What a wall experiment runs.

    Attributes:
        world: the wall.
        trials: for each row.
        seed: of the experiment; every trial has a seed of its own made from it, the row and its number.
        iterations: of one run, rejected ones included.
        marks: iterations at which costs are reported.
        rows: planners.
        changes: options of the planners that differ from `PaperOptions.wall` (`propagate`, `cost`, ...).
    """

    world: PlaneWorld = field(default_factory=wall_g)
    trials: int = 100
    seed: int = 0
    iterations: int = 5000
    marks: tuple[int, ...] = MARKS
    rows: tuple[Row, ...] = ROWS
    changes: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ParameterError: names the field, its value and what is allowed.
            SceneError: start or goal of the wall is where nothing may be.
        """
        check_ends(self.world)
        if self.trials < 1:
            raise ParameterError(f"trials must be at least 1, got {self.trials}")
        if self.seed < 0:
            raise ParameterError(f"seed must be at least 0, got {self.seed}")
        if not self.marks or list(self.marks) != sorted(set(self.marks)) or self.marks[0] < 1 or self.marks[-1] > self.iterations:
            raise ParameterError(f"marks must rise between 1 and the {self.iterations} iterations, got {list(self.marks)}")
        for row in self.rows:
            self.planner_options(row)

    def planner_options(self, row: Row) -> PaperOptions:
        """Return the options of one row's planner."""
        known = {f.name for f in fields(PaperOptions)} - {"algorithm", "beta"}
        if unknown := sorted(set(self.changes) - known):
            raise ParameterError(f"unknown planner option {unknown[0]!r}; the options are {', '.join(sorted(known))}")
        return PaperOptions.wall(row.algorithm, **{"beta": row.beta, **self.changes})

    def trial_seed(self, row: Row, trial: int) -> int:
        """Return the seed of one trial: different for every row, so that rows are independent samples."""
        key = int.from_bytes(row.key.encode(), "little")
        return int(np.random.SeedSequence([self.seed, key, trial]).generate_state(1)[0])

    def all_marks(self) -> tuple[int, ...]:
        """Return the marks together with those of the curves."""
        curve = np.linspace(0, self.iterations, _CURVE_POINTS + 1)[1:].astype(int)
        return tuple(sorted({*self.marks, *(int(m) for m in curve if m >= 1)}))

    def description(self) -> dict[str, Any]:
        """Return what two runs must have in common for the trials of one to continue the other, JSON-ready."""
        return {
            "world": self.world.to_dict(),
            "seed": self.seed,
            "iterations": self.iterations,
            "marks": list(self.marks),
            "planners": {row.key: asdict(self.planner_options(row)) for row in self.rows},
        }


@dataclass(frozen=True)
class Task:
    """One trial, in a form that can go to another process."""

    options: WallOptions
    row: Row
    trial: int


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None  # JSON has no infinity


def _mark(snapshot: Snapshot) -> dict[str, Any]:
    return {
        "cost": _number(snapshot.node_cost),
        "stored_cost": _number(snapshot.stored_cost),
        "J": _number(snapshot.integral_cost),
        "length": _number(snapshot.length),
        "nodes_inside": snapshot.nodes_inside,
        "tree_nodes": snapshot.nodes,
        "time_s": round(snapshot.elapsed_s, 6),
    }


def run_trial(task: Task) -> dict[str, Any]:
    """Run one trial and return its record for `results.json`."""
    options, seed = task.options, task.options.trial_seed(task.row, task.trial)
    world = options.world
    outcome = plan_paper(
        world.space(),
        world.start,
        world.goal,
        options.planner_options(task.row),
        seed,
        iterations=options.iterations,
        marks=options.all_marks(),
    )
    at = {s.iterations: s for s in outcome.snapshots}
    return {
        "algorithm": task.row.key,
        "trial": task.trial,
        "seed": seed,
        "marks": {str(m): _mark(at[m]) for m in options.marks},
        "failures": [m for m in options.marks if at[m].path is None],
        "time_s": round(outcome.final.elapsed_s, 6),
        "curve": {
            "iterations": [s.iterations for s in outcome.snapshots],
            "cost": [_number(s.node_cost) for s in outcome.snapshots],
            "J": [_number(s.integral_cost) for s in outcome.snapshots],
            "time_s": [round(s.elapsed_s, 6) for s in outcome.snapshots],
        },
    }


def options_from(results: dict[str, Any]) -> WallOptions:
    """Return the options that a `results.json` was made with."""
    described = results["options"]
    rows = tuple(row for row in ROWS if row.key in described["planners"])
    planner = PaperOptions(**next(iter(described["planners"].values())))
    plain = asdict(PaperOptions.wall(planner.algorithm))
    changes = {k: v for k, v in asdict(planner).items() if v != plain[k] and k not in ("algorithm", "beta")}
    return WallOptions(
        world=world_from_dict(described["world"]),
        trials=int(results["trials_wanted"]),
        seed=int(described["seed"]),
        iterations=int(described["iterations"]),
        marks=tuple(described["marks"]),
        rows=rows,
        changes=changes,
    )


def plan_of(options: WallOptions) -> Plan[Task]:
    """The experiment as trials for `lime_planner.experiments.runs.results_file`, a trial of every row in turn."""
    return Plan(
        "wall",
        options.description(),
        [Task(options, row, trial) for trial in range(options.trials) for row in options.rows],
        run_trial,
        lambda task: (task.row.key, task.trial),
        lambda record: (record["algorithm"], record["trial"]),
        {"trials_wanted": options.trials},
    )


def collect(options: WallOptions, path: Path, *, jobs: int, resume: bool, scheduler: str | None = None) -> tuple[dict[str, Any], bool]:
    """Run all trials that `path` does not hold yet and keep them there; see `collection.collect`."""
    if scheduler is None:  # compiled once here; the processes then load it
        world, row = options.world, options.rows[0]
        plan_paper(world.space(), world.start, world.goal, options.planner_options(row), 0, iterations=1)
    return collection.collect(plan_of(options), path, jobs=jobs, resume=resume, scheduler=scheduler)
