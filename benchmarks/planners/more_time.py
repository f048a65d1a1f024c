"""Whether more time ever makes a plan worse, and how even plans are: true J after each of several budgets, for the same seeds.

Every budget is a run of its own, by processor time, so that a machine that others use may be measured on.

    python -m benchmarks.planners.more_time --scans scans --plants medium:1 dense:2 --targets 30 --seeds 5 --out more_time.jsonl
    python -m benchmarks.planners.more_time --scans scans --methods lime_star apf_rrt_star rrt_star --budgets 0.1 0.5

The exit status is 1 where a longer run of the same seed returned a path of higher J.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planner_runs import search, warm_up
from benchmarks.problem_sets import choose_problems, plant_specs, scan_specs
from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem, build_problem
from lime_planner.pipeline.leaf_spans import leaf_spans

_ROUNDING = 1e-3  # J that is gained or lost by looking at the same contact more finely


def true_cost(problem: Problem, path: Array | None) -> float:
    """J of a path as the figures of a plan have it; infinite without a path."""
    if path is None:
        return math.inf
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return length + problem.settings.weight * leaf_spans(problem.obstacles, path).charged_rad


def run(problem: Problem, seed: int, budgets_s: Sequence[float], method: str = DEFAULT_PLANNER) -> dict[str, Any]:
    """True J of one seed after each budget of processor time."""
    costs = []
    for budget_s in budgets_s:
        end_s = time.thread_time() + budget_s

        def over(end_s: float = end_s) -> bool:
            return time.thread_time() >= end_s

        costs.append(true_cost(problem, search(problem, method, seed, should_stop=over).path))
    kept = [None if math.isinf(cost) else cost for cost in costs]
    return {"problem": problem.spec.key, "method": method, "seed": seed, "budgets_s": list(budgets_s), "costs": kept}


def worse(row: dict[str, Any]) -> bool:
    """Whether a longer budget gave a higher J."""
    costs = [math.inf if cost is None else cost for cost in row["costs"]]
    return any(after > before * (1.0 + _ROUNDING) + _ROUNDING for before, after in itertools.pairwise(costs))


def summary(rows: Iterable[dict[str, Any]]) -> list[str]:
    """One line for each method and budget: success, and J over the best known of its problem, median, 90th percentile and worst.

    The best known is that of all methods; a problem that none solved has no ratio.
    """
    rows = list(rows)
    best: dict[str, float] = defaultdict(lambda: math.inf)
    for row in rows:
        best[row["problem"]] = min(best[row["problem"]], *(math.inf if cost is None else cost for cost in row["costs"]))
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        for k, budget_s in enumerate(own[0]["budgets_s"]):
            found = [(row["costs"][k], best[row["problem"]]) for row in own if row["costs"][k] is not None]
            line = f"{method}, {budget_s:g} s: {len(found)} of {len(own)} runs found a path"
            if found:
                ratios = [cost / least for cost, least in found]
                middle, high = np.percentile(ratios, [50, 90])
                line += f", median J {np.median([cost for cost, _ in found]):.2f}; over the best known: median {middle:.3f}, "
                line += f"90 % below {high:.2f}, worst {max(ratios):.2f}"
            lines.append(line)
    return lines


def against(rows: Iterable[dict[str, Any]], method: str, other: str) -> list[str]:
    """One line for each budget: J of a method over another's, each pair of the same problem and seed, and whose is lower how often."""
    rows = list(rows)
    theirs = {(row["problem"], row["seed"]): row["costs"] for row in rows if row["method"] == other}
    pairs = [(row, theirs[row["problem"], row["seed"]]) for row in rows if row["method"] == method]
    lines = []
    for k, budget_s in enumerate(pairs[0][0]["budgets_s"]):
        both: dict[str, list[float]] = defaultdict(list)
        for row, costs in pairs:
            if row["costs"][k] is not None and costs[k] is not None:
                both[row["problem"]].append(math.log(row["costs"][k] / costs[k]))
        means = np.array([np.mean(values) for values in both.values()])  # the problem is the unit, not the run
        half = 1.96 * float(means.std(ddof=1)) / math.sqrt(len(means)) if len(means) > 1 else math.nan
        low, middle, high = (math.exp(means.mean() + x) for x in (-half, 0.0, half))
        lower = float(np.mean([value < 0.0 for values in both.values() for value in values]))
        line = (
            f"{method} / {other}, {budget_s:g} s: J {middle:.3f} (95 % {low:.3f} to {high:.3f}), lower in {100 * lower:.0f} % of the runs"
        )
        lines.append(line)
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print the runs that got worse and a summary."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planners.more_time", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--scans", type=Path, metavar="DIR", help="folder of labelled scans (.npz)")
    parser.add_argument("--plants", nargs="+", default=[], metavar="DENSITY:SEED", help="generated plants")
    parser.add_argument("--targets", type=int, default=30, metavar="N", help="problems in all (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds on each problem (default: %(default)s)")
    parser.add_argument(
        "--budgets", type=float, nargs="+", default=[0.1, 0.5, 5.0], metavar="S", help="processor time (default: 0.1 0.5 5)"
    )
    parser.add_argument(
        "--methods", nargs="+", default=[DEFAULT_PLANNER], metavar="NAME", help="what to run (default: the default planner)"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the rows as JSON lines")
    args = parser.parse_args(arguments)
    scenes = [*(scan_specs(args.scans) if args.scans is not None else []), *plant_specs(args.plants)]
    problems, _ = choose_problems(scenes, args.targets)
    rows: list[dict[str, Any]] = []
    for spec in problems:
        problem = build_problem(spec)
        for method in () if rows else args.methods:
            warm_up(problem, method)
        for method, seed in itertools.product(args.methods, range(1, args.seeds + 1)):
            rows.append(run(problem, seed, sorted(args.budgets), method))
            if args.out is not None:
                with args.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
            if worse(rows[-1]):
                print(f"{method}, {spec.key} seed {seed}: J {rows[-1]['costs']} after {rows[-1]['budgets_s']} s", flush=True)
    print("\n".join([*summary(rows), *itertools.chain(*(against(rows, method, args.methods[0]) for method in args.methods[1:]))]))
    return 1 if any(worse(row) for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
