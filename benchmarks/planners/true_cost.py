"""Whether the searches minimise what they say: J of polished paths against an integral of their leaf contact that shares no code with it.

The other integral looks at the path every half milliradian by the check of single configurations. A contact shorter than that may fall
between its samples or be taken for a whole one, so that it is a yardstick to about half a milliradian for each contact.

    python -m benchmarks.planners.true_cost --scans scans --plants medium:1 dense:2 --paths 300

The exit status is 1 where a path is off by more than 2 % + 0.3.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planner_runs import search
from benchmarks.problem_sets import choose_problems, plant_specs, scan_specs
from lime_planner.collision.fast import LEAF
from lime_planner.collision.joint_space import measure
from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem, build_problem
from lime_planner.pipeline.obstacles import Obstacles

STEP_RAD = 0.0005
SHARE, MOST = 0.02, 0.3  # what J may be off by: a share of it, and so much besides


def sampled_cost(obstacles: Obstacles, path: Array, weight: float, step_rad: float = STEP_RAD) -> tuple[float, int]:
    """J of a path (M, n) by samples in the middle of equal steps, and how many contacts these show; stems are not looked at."""
    space = obstacles.measuring_space()
    cost, contacts, inside = 0.0, 0, False
    for a, b in itertools.pairwise(path):
        length = float(np.linalg.norm(b - a))
        steps = max(1, int(np.ceil(length / step_rad)))
        charged = 0.0
        for k in range(steps):
            measure(space, a + (k + 0.5) / steps * (b - a))
            price = float(space.state.misc[LEAF])
            charged += price / steps
            contacts += int(price > 0.0 and not inside)
            inside = price > 0.0
        cost += length * (1.0 + weight * charged)
    return cost, contacts


def compare(problem: Problem, seed: int, iterations: int, method: str = DEFAULT_PLANNER) -> dict[str, Any]:
    """Plan once; J of the search and J by samples."""
    outcome = search(problem, method, seed, iterations=iterations)
    row = {"problem": problem.spec.key, "seed": seed, "cost": None, "sampled": None}
    if outcome.path is not None:
        sampled, contacts = sampled_cost(problem.obstacles, outcome.path, problem.settings.weight)
        row |= {"cost": float(outcome.history[-1][2]), "sampled": sampled, "contacts": contacts}
    return row


def is_true(row: dict[str, Any]) -> bool:
    """Whether a row's two costs agree."""
    return row["cost"] is None or abs(row["cost"] - row["sampled"]) <= SHARE * row["sampled"] + MOST


def rows(scans: Path | None, plants: Sequence[str], paths: int, seeds: int, iterations: int) -> Iterator[dict[str, Any]]:
    """Plan on problems in turn, `seeds` times on each, until there are so many paths."""
    scenes = [*(scan_specs(scans) if scans is not None else []), *plant_specs(plants)]
    problems, _ = choose_problems(scenes, -(-paths // seeds))
    for spec in problems:
        for seed in range(1, seeds + 1):
            yield compare(build_problem(spec), seed, iterations)


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan, compare, print the paths that are off and a summary."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planners.true_cost", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--scans", type=Path, metavar="DIR", help="folder of labelled scans (.npz)")
    parser.add_argument("--plants", nargs="+", default=[], metavar="DENSITY:SEED", help="generated plants")
    parser.add_argument("--paths", type=int, default=300, metavar="N", help="paths in all (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="paths on each problem (default: %(default)s)")
    parser.add_argument("--iterations", type=int, default=3000, metavar="N", help="of each search (default: %(default)s)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the rows as JSON lines")
    args = parser.parse_args(arguments)
    found = []
    for row in rows(args.scans, args.plants, args.paths, args.seeds, args.iterations):
        found.append(row)
        if args.out is not None:
            with args.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
        if not is_true(row):
            print(
                f"{row['problem']} seed {row['seed']}: J {row['cost']:.2f}, sampled {row['sampled']:.2f}, {row['contacts']} contacts",
                flush=True,
            )
    planned = [row for row in found if row["cost"] is not None]
    off = [row for row in planned if not is_true(row)]
    errors = np.array([row["cost"] - row["sampled"] for row in planned])
    if len(errors):
        low, high = np.percentile(errors, [1, 99])
        print(f"{len(planned)} paths of {len(found)} searches, {len(off)} off; J - sampled: 1 % below {low:.2f}, 1 % above {high:.2f}")
    return 1 if off or not planned else 0


if __name__ == "__main__":
    sys.exit(main())
