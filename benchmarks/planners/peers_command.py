"""`lime-planner bench peers`: the default planner against OMPL and pyroboplan, with our cost and our compiled checks in all of them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.planners.command import add_problem_arguments, finish, problems_of, run_comparison
from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.experiments.runs.arguments import add_run_arguments, make_results_folder

PEERS = ("ompl_rrt_star", "ompl_informed_rrt_star", "ompl_bit_star", "ompl_rrt_connect")
SEARCH_PLANTS = ("sparse:901", "medium:901", "dense:902", "dense:903")  # never among those that are compared

_EPILOG = """\
Every peer gets the same space, start, goals and cost, and our compiled checks.
OMPL comes with pip install 'lime_planner[bench]'. Peers call back into Python,
so they are compared at equal numbers of checked configurations as well, as far
as at least half of the runs got, and the share of their time that goes into
callbacks and the way there is in the table.

examples:
  lime-planner bench peers --scans scans --out peers
  lime-planner bench peers --plants dense:1 --targets 4 --seeds 2 --out peers
  lime-planner bench peers --search --out search
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    add_run_arguments(parser)
    add_problem_arguments(parser)
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="peers (default: all that are installed)")
    parser.add_argument("--settings", type=Path, metavar="FILE", help="settings of the peers (default: the package's, found by --search)")
    parser.add_argument(
        "--min-checks", type=int, default=300_000, metavar="N", help="peers go on until so many checks, 4 × their time at most"
    )
    parser.add_argument("--search", action="store_true", help="search for the peers' best settings instead")


def table_text(results: dict[str, Any]) -> str:
    """The page of tables."""
    from benchmarks.planners import report

    marks = results["options"]["marks_s"]
    parts = [
        "# The default planner against other libraries'",
        report.heading(results),
        report.lead_text(results, 0.5 if 0.5 in marks else marks[0]),
        "## Equal time",
        report.cost_table(results, marks, report.TIME, "s"),
        report.ratio_table(results, marks),
        report.paired_table(results, marks),
        "## Equal numbers of checked configurations",
        report.cost_table(results, report.CHECK_MARKS, report.CHECKS, "checks"),
        "## Where the time goes",
        report.effort_table(results),
    ]
    return "\n\n".join(parts) + "\n"


def _available(wanted: list[str] | None) -> list[str]:
    """The methods to compare: those wanted, else every peer that is installed; what is not is said."""
    from benchmarks.planners.comparison import PYROBOPLAN, missing_library

    if wanted:
        return list(dict.fromkeys([DEFAULT_PLANNER, *wanted]))
    methods = [DEFAULT_PLANNER]
    for method in (*PEERS, PYROBOPLAN):
        missing = missing_library(method)
        if missing is None:
            methods.append(method)
        else:
            print(f"{method} is left out; it needs {missing}", file=sys.stderr)
    return methods


def run_search(args: argparse.Namespace) -> int:
    """Search for the peers' settings and write `peer_settings.json`."""
    from benchmarks.planners.comparison import Run
    from benchmarks.planners.peer_settings_search import GRIDS, candidates, carry_out_search, choose, finer_candidates, search_runs
    from benchmarks.problem_sets import choose_problems, plant_specs
    from benchmarks.timing import machine
    from lime_planner.experiments.runs.parallel import default_jobs
    from lime_planner.experiments.runs.results_file import Plan, collect
    from lime_planner.output.console import write_json

    seconds = max(args.marks)
    plants = args.plants or list(SEARCH_PLANTS)
    problems = choose_problems(plant_specs(plants), min(args.targets, 6))[0]
    methods = [m for m in _available(args.methods) if m in GRIDS]
    seeds, jobs = min(args.seeds, 3), args.jobs or default_jobs()
    path = args.out / "results.json"
    make_results_folder(args.out)

    def search(settings: Mapping[str, Sequence[Mapping[str, Any]]], resume: bool) -> tuple[dict[str, Any], bool]:
        runs = [run for m in methods for run in search_runs(m, settings[m], problems, seeds, seconds, args.clock)]
        minutes = len(runs) * (seconds + 1.5) / 60 / jobs
        print(f"{len(runs)} runs of {seconds:g} s: about {minutes:.0f} min with {jobs} at a time.", file=sys.stderr)
        plan: Plan[Run] = Plan(
            name="peer settings",
            description={"seconds": seconds, "clock": args.clock, "plants": plants},
            tasks=runs,
            run=carry_out_search,
            key_of_task=lambda r: (r.spec.key, r.method, r.seed, str(sorted(r.settings))),
            key_of_record=lambda r: (r["problem"], r["method"], r["seed"], str(sorted(r["settings"].items()))),
            extra={"machine": machine(), "problems": [spec.to_dict() for spec in problems]},
        )
        results, complete = collect(plan, path, jobs=jobs, resume=resume, scheduler=args.scheduler)
        said = {"seeds": seeds, "problems": [s.key for s in problems]}
        return {method: choose(method, results["trials"], seconds) | said for method in methods}, complete

    grids = {method: candidates(method) for method in methods}
    found, complete = search(grids, args.resume)
    if complete:  # what the grid left is kept, so that only the rest is run
        found, complete = search({m: [*grids[m], *finer_candidates(m, found[m]["settings"])] for m in methods}, True)
    path = write_json(
        args.out / "peer_settings.json",
        {"seconds": seconds, "clock": args.clock, "methods": found},
    )
    for method, entry in found.items():
        print(f"{method}: {entry['settings']}")
    print(f"Written to {path}" if complete else f"Stopped by ctrl-C; --resume continues. So far: {path}")
    return 0 if complete else 130


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0 when every run is done, 130 when ctrl-C ended it early."""
    from benchmarks.planners.comparison import SETTINGS_FILE, Comparison, load_settings

    if args.search:
        return run_search(args)
    problems, refused = problems_of(args)
    comparison = Comparison(
        "bench peers",
        problems,
        refused,
        methods=_available(args.methods),
        seeds=[args.seed + 1 + k for k in range(args.seeds)],
        marks_s=tuple(args.marks),
        clock=args.clock,
        settings=load_settings(args.settings or SETTINGS_FILE),
        min_checks=args.min_checks,
        keep_paths=args.keep_paths,
    )
    results, complete = run_comparison(comparison, args)
    return finish(results, table_text(results), complete, args, checks=True)
