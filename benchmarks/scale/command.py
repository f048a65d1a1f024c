"""`lime-planner bench scale`: how cost grows with points, leaves, joints and budget: tables, one plot, the figures as JSON."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lime_planner.experiments.runs.arguments import add_run_arguments, finite_number, make_results_folder

if TYPE_CHECKING:
    from benchmarks.scale.cases import ScaleTask

POINTS = (1_000, 10_000, 100_000, 300_000, 1_000_000, 5_000_000)
LEAVES = (30, 60, 120, 250, 450, 900)
JOINTS = (3, 4, 5, 6, 7, 8, 10)

_EPILOG = """\
Times are processor time on one core. The budget's problems are targets in the
scans, or in generated plants without --scans.

examples:
  lime-planner bench scale --scans scans --out scale
  lime-planner bench scale --points 1000 100000 --leaves --joints --budget 0 \\
      --out points
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    add_run_arguments(parser)
    parser.add_argument("--scans", type=Path, metavar="DIR", help="folder of labelled scans (.npz)")
    parser.add_argument("--points", type=int, nargs="*", default=POINTS, metavar="N", help="points of a cloud (default: 1k to 5M)")
    parser.add_argument("--leaves", type=int, nargs="*", default=LEAVES, metavar="N", help="leaves of a plant (default: 30 to 900)")
    parser.add_argument("--joints", type=int, nargs="*", default=JOINTS, metavar="N", help="joints of an arm (default: 3 to 10)")
    parser.add_argument(
        "--budget", type=finite_number, default=10.0, metavar="S", help="longest budget [s]; 0: none (default: %(default)s)"
    )
    parser.add_argument("--repeats", type=int, default=2, metavar="N", help="plants, places or seeds for each value (default: %(default)s)")
    parser.add_argument("--targets", type=int, default=8, metavar="N", help="problems for the budget (default: %(default)s)")


def tasks_of(args: argparse.Namespace) -> list[ScaleTask]:
    """All measurements.

    Raises:
        ParameterError: a number below its least.
    """
    from benchmarks.problem_sets import choose_problems
    from benchmarks.scale.cases import ScaleTask, scan_files
    from lime_planner.core.errors import ParameterError

    for name, values, least in (("points", args.points, 1000), ("leaves", args.leaves, 1), ("joints", args.joints, 3)):
        if low := [v for v in values if v < least]:
            raise ParameterError(f"--{name} must be at least {least}, got {low[0]}")
    for name in ("repeats", "targets"):
        if getattr(args, name) < 1:
            raise ParameterError(f"--{name} must be at least 1, got {getattr(args, name)}")
    tasks = [ScaleTask("points", float(n), 0) for n in args.points]
    tasks += [ScaleTask("leaves", float(n), args.seed + k) for n in args.leaves for k in range(args.repeats)]
    tasks += [ScaleTask("joints", float(n), args.seed + k) for n in args.joints for k in range(3 * args.repeats)]
    if args.budget > 0.0:
        problems = choose_problems(scan_files(args.scans), args.targets)[0]
        tasks += [ScaleTask("budget", args.budget, args.seed + k, spec) for spec in problems for k in range(args.repeats)]
    return tasks


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0 when every measurement is done, 130 when ctrl-C ended it early."""
    from benchmarks.scale.cases import run_task
    from benchmarks.scale.report import scale_figure, table_text
    from benchmarks.timing import machine
    from lime_planner.core.atomic_files import write_text
    from lime_planner.experiments.runs.parallel import default_jobs
    from lime_planner.experiments.runs.results_file import Plan, collect

    tasks = tasks_of(args)
    seconds = sum(5.0 + (task.value if task.axis == "budget" else 0.0) for task in tasks)
    print(f"{len(tasks)} measurements: about {seconds / 60.0:.0f} min on one core.", file=sys.stderr)
    plan = Plan(
        name="bench scale",
        description={"seed": args.seed},
        tasks=tasks,
        run=run_task,
        key_of_task=lambda task: task.key,
        key_of_record=lambda r: (r["axis"], r["value"], r["number"], r["problem"]),
        extra={"machine": machine()},
    )
    make_results_folder(args.out)
    results, complete = collect(
        plan, args.out / "results.json", jobs=args.jobs or default_jobs(), resume=args.resume, scheduler=args.scheduler
    )
    text = table_text(results)
    write_text(args.out / "table.md", text)
    if not args.no_figures and results["trials"]:
        scale_figure(results, args.out / "scale")
    print(text)
    if not complete:
        print(f"Stopped by ctrl-C. What is done is in {args.out}; --resume continues it.", file=sys.stderr)
        return 130
    print(f"Written to {args.out}: results.json, table.md" + ("" if args.no_figures else ", plot"))
    return 0
