"""`lime-planner bench planners`: the package's own planners on the same problems, at equal times."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.experiments.runs.arguments import add_run_arguments, finite_number, make_results_folder

if TYPE_CHECKING:
    from benchmarks.planners.comparison import Comparison
    from benchmarks.problem_sets import Refused
    from lime_planner.experiments.problems import ProblemSpec

_EPILOG = """\
Problems are targets inside the foliage; one that no goal configuration reaches
without touching a stem is passed over. Results come as results.json, table.md
and plots. On a machine that others use, --clock cpu counts processor time.

examples:
  lime-planner bench planners --scans scans --out planners
  lime-planner bench planners --plants dense:1 dense:2 --targets 6 --out dense
  lime-planner bench planners --scans scans --cases narrow far --out hard
"""


def add_problem_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare which problems, seeds and times; shared with `bench peers`."""
    parser.add_argument("--scans", type=Path, metavar="DIR", help="folder of labelled scans (.npz)")
    parser.add_argument("--plants", nargs="+", default=[], metavar="DENSITY:SEED", help="generated plants, for example dense:3")
    parser.add_argument("--targets", type=int, default=20, metavar="N", help="problems in all (default: %(default)s)")
    parser.add_argument("--cases", nargs="+", default=["plain"], metavar="CASE", help="plain, narrow, leaf_start, far (default: plain)")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds on each problem (default: %(default)s)")
    parser.add_argument(
        "--marks", nargs="+", type=finite_number, default=[0.1, 0.5, 1.0, 5.0], metavar="S", help="times [s] (default: 0.1 0.5 1 5)"
    )
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall", help="what counts as time (default: %(default)s)")
    parser.add_argument("--keep-paths", action="store_true", help="keep every final path in results.json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    add_run_arguments(parser)
    add_problem_arguments(parser)
    parser.add_argument(
        "--methods", nargs="+", metavar="NAME", help="what to compare (default: the default planner, APF-RRT*, RRT*, APF-RRT* as published)"
    )
    parser.add_argument(
        "--reference", type=finite_number, default=30.0, metavar="S", help="budget of runs for the best known cost; 0: none"
    )
    parser.add_argument("--reference-seeds", type=int, default=2, metavar="N", help="such runs on each problem (default: %(default)s)")


def problems_of(args: argparse.Namespace) -> tuple[list[ProblemSpec], list[Refused]]:
    """Choose the problems that the arguments ask for.

    Raises:
        ParameterError: no scenes, unknown cases, numbers below 1.
    """
    from benchmarks.problem_sets import choose_problems, plant_specs, scan_specs
    from lime_planner.core.errors import ParameterError

    for name in ("targets", "seeds"):
        if getattr(args, name) < 1:
            raise ParameterError(f"--{name} must be at least 1, got {getattr(args, name)}")
    scenes = [*(scan_specs(args.scans) if args.scans is not None else []), *plant_specs(args.plants)]
    if not scenes:
        raise ParameterError("give --scans DIR, --plants DENSITY:SEED, or both")
    return choose_problems(scenes, args.targets, args.cases)


def run_comparison(comparison: Comparison, args: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """State the cost, run what is missing, and keep it in the folder's `results.json`."""
    from benchmarks.planners.comparison import missing_library
    from lime_planner.experiments.runs.parallel import default_jobs
    from lime_planner.experiments.runs.results_file import collect

    jobs = args.jobs or default_jobs()
    for method in dict.fromkeys((*comparison.methods, *comparison.reference_methods)):
        missing = missing_library(method)
        if missing is not None:
            raise ModuleNotFoundError(f"{method} needs {missing}", name=missing.split(":")[0])
    print(comparison.statement(jobs), file=sys.stderr)
    make_results_folder(args.out)
    return collect(comparison.plan(), args.out / "results.json", jobs=jobs, resume=args.resume, scheduler=args.scheduler)


def table_text(results: dict[str, Any]) -> str:
    """The page of tables."""
    from benchmarks.planners import report

    marks = results["options"]["marks_s"]
    parts = [
        "# The package's own planners",
        report.heading(results),
        report.cost_table(results, marks, report.TIME, "s"),
        report.ratio_table(results, marks),
        report.paired_table(results, marks),
        report.effort_table(results),
    ]
    return "\n\n".join(parts) + "\n"


def finish(results: dict[str, Any], text: str, complete: bool, args: argparse.Namespace, *, checks: bool) -> int:
    """Write and print the tables, draw the plots; the exit status."""
    from benchmarks.planners.figures import all_figures
    from lime_planner.core.atomic_files import write_text

    write_text(args.out / "table.md", text)
    if not args.no_figures and results["trials"]:
        all_figures(results, args.out, checks=checks)
    print(text)
    if not complete:
        print(f"Stopped by ctrl-C. What is done is in {args.out}; --resume continues it.", file=sys.stderr)
        return 130
    print(f"Written to {args.out}: results.json, table.md" + ("" if args.no_figures else ", plots"))
    return 0


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0 when every run is done, 130 when ctrl-C ended it early."""
    from benchmarks.planners.comparison import Comparison, load_settings, missing_library

    problems, refused = problems_of(args)
    # Whatever finds the best path may set the mark: a peer, too, where it is installed.
    peers = [] if missing_library("ompl_bit_star") else ["ompl_bit_star"]
    comparison = Comparison(
        "bench planners",
        problems,
        refused,
        methods=args.methods or [DEFAULT_PLANNER, "apf_rrt_star", "rrt_star", "apf_rrt_star_paper"],
        seeds=[args.seed + 1 + k for k in range(args.seeds)],
        marks_s=tuple(args.marks),
        reference_s=args.reference,
        reference_seeds=args.reference_seeds,
        reference_methods=[DEFAULT_PLANNER, *peers],
        settings={peer: load_settings()[peer] for peer in peers},
        clock=args.clock,
        keep_paths=args.keep_paths,
    )
    results, complete = run_comparison(comparison, args)
    return finish(results, table_text(results), complete, args, checks=False)
