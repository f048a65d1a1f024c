"""The search for each peer's best settings: a small grid on plants of its own, kept with its results in `peer_settings.json`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.planner_runs import cost_at
from benchmarks.planners.comparison import Run, carry_out
from lime_planner.experiments.problems import ProblemSpec

#: Values that are tried for each setting of a peer, every combination. The rows are what wider searches left. With the optimising planners
#: shorter ranges, other goal biases and nearest neighbours by number were worse; with RRT-Connect longer ranges and smaller steps.
GRIDS: dict[str, dict[str, Sequence[Any]]] = {
    "ompl_rrt_star": {"range": (5.0, 10.0), "goal_bias": (0.02, 0.05, 0.2), "k_nearest": (False,), "simplify_share": (0.5,)},
    "ompl_informed_rrt_star": {
        "range": (5.0,),
        "goal_bias": (0.5, 0.8),
        "k_nearest": (False,),
        "rewire_factor": (1.1, 2.0, 3.0),
        "simplify_share": (0.5,),
    },
    "ompl_bit_star": {
        "samples_per_batch": (300, 1000),
        "use_k_nearest": (False,),
        "rewire_factor": (1.1, 1.5, 2.0),
        "simplify_share": (0.5,),
    },
    "ompl_rrt_connect": {
        "range": (0.2, 0.5, 1.0),
        "shorten_rounds": (10, 30, 100),
        "shorten_step": (0.4, 1.0, 2.0),
        "shorten_max": (False,),  # True: OMPL's whole simplification before the rounds
    },
    "pyroboplan": {"max_connection_dist": (1.0, 3.0), "shorten_iterations": (10, 30, 100)},
}
_SIMPLIFY: dict[str, Sequence[Any]] = {"simplify_share": (0.0, 0.25, 0.8), "simplify_rounds": (15,)}
#: Values that are tried after that, one setting at a time, with the others as they were best: most ends of rows go on here.
FINER: dict[str, dict[str, Sequence[Any]]] = {
    "ompl_rrt_star": {**_SIMPLIFY, "goal_bias": (0.005,), "range": (0.3, 1.0)},
    "ompl_informed_rrt_star": {**_SIMPLIFY, "goal_bias": (0.95,), "rewire_factor": (0.8,), "range": (0.3, 1.0)},
    "ompl_bit_star": {**_SIMPLIFY, "rewire_factor": (0.9,), "samples_per_batch": (3000,)},
    "ompl_rrt_connect": {"range": (0.1, 0.3), "shorten_rounds": (60,), "shorten_max": (True,)},
    "pyroboplan": {"max_connection_dist": (0.3, 10.0), "shorten_iterations": (3,)},
}
FAILURE = 100.0  # a run without a path counts as so many times the best cost


def candidates(method: str) -> list[dict[str, Any]]:
    """Every combination of a method's grid."""
    grid = GRIDS[method]
    return [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]


def finer_candidates(method: str, best: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The best of a method's grid with one setting changed at a time."""
    return [{**best, name: value} for name, values in FINER.get(method, {}).items() for value in values]


def search_runs(
    method: str, settings: Sequence[Mapping[str, Any]], problems: Sequence[ProblemSpec], seeds: int, seconds: float, clock: str
) -> list[Run]:
    """The runs of a method with each of some settings."""
    marks = (seconds / 10.0, seconds)
    return [
        Run(spec, method, 1 + k, seconds, marks, clock, tuple(sorted(one.items())))
        for one in settings
        for spec in problems
        for k in range(seeds)
    ]


def carry_out_search(run: Run) -> dict[str, Any]:
    """A run's record with its settings."""
    return carry_out(run) | {"settings": dict(run.settings)}


def _key(settings: Mapping[str, Any]) -> tuple[tuple[str, Any], ...]:
    return tuple(sorted(settings.items()))


def choose(method: str, trials: Sequence[Mapping[str, Any]], seconds: float) -> dict[str, Any]:
    """Pick the settings with the lowest mean of log(J / best J of the problem), at a tenth of the budget and at its end.

    Returns:
        `settings`, and `tried`: every candidate with its score (a factor: 1.0 is the best of all everywhere).
    """
    own = [t for t in trials if t["method"] == method]
    best: dict[str, float] = {}
    for t in own:
        best[t["problem"]] = min(best.get(t["problem"], math.inf), cost_at(t["curve"], math.inf))
    scores: dict[tuple[tuple[str, Any], ...], list[float]] = {}
    for t in own:
        if math.isinf(best[t["problem"]]):
            continue
        for mark in (seconds / 10.0, seconds):
            ratio = min(cost_at(t["curve"], mark) / best[t["problem"]], FAILURE)
            scores.setdefault(_key(t["settings"]), []).append(math.log(ratio))
    tried: list[dict[str, Any]] = [
        {"settings": dict(key), "score": round(math.exp(float(np.mean(values))), 4)} for key, values in scores.items()
    ]
    tried.sort(key=lambda entry: entry["score"])
    return {"settings": tried[0]["settings"] if tried else {}, "tried": tried}
