"""`lime-planner experiment lime`: the paper's experiment with the arm (section V), from trials to table and figure."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lime_planner.experiments.runs.arguments import add_run_arguments, make_results_folder

if TYPE_CHECKING:
    from lime_planner.experiments.lime.trials import LimeOptions


def run_lime(
    options: LimeOptions, out: Path, *, jobs: int | None = None, scheduler: str | None = None, resume: bool = False, figures: bool = True
) -> bool:
    """Run the experiment and write `results.json`, `table.md` and the figure to a folder.

    Args:
        options: what to run.
        out: the folder; made if it does not exist.
        jobs: number of processes (default: one for each processor).
        scheduler: address of a Dask scheduler, whose workers run the trials instead.
        resume: continue an earlier run in the same folder.
        figures: draw the figure too.

    Returns:
        False if ctrl-C ended it early: what is done is in the folder.

    Raises:
        ParameterError: the folder cannot be made or written to, or holds an earlier run that may not or cannot be continued.
    """
    from lime_planner.core.atomic_files import write_text
    from lime_planner.experiments.lime.report import table_text
    from lime_planner.experiments.lime.trials import plan_of
    from lime_planner.experiments.runs.parallel import default_jobs
    from lime_planner.experiments.runs.results_file import collect

    make_results_folder(out)
    plan = plan_of(options)
    results, complete = collect(plan, out / "results.json", jobs=jobs or default_jobs(), scheduler=scheduler, resume=resume)
    write_text(out / "table.md", table_text(results))
    if figures and complete:
        from lime_planner.experiments.lime.figure import simulation_figure

        simulation_figure(plan, results, out)
    return complete


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_run_arguments(parser)
    parser.add_argument("--trials", type=int, default=100, metavar="N", help="trials of each planner on each plant (default: %(default)s)")
    parser.add_argument("--plants", type=int, default=10, metavar="N", help="plants beside the default one (default: %(default)s)")
    words = "trials of each planner for each changed choice (default: %(default)s)"
    parser.add_argument("--sensitivity-trials", type=int, default=30, metavar="N", help=words)
    parser.add_argument("--iterations", type=int, default=1500, metavar="N", help="iterations of a run (default: %(default)s)")
    parser.add_argument("--checker", choices=("fast", "fcl"), default="fast", help="collision check (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0 when every trial is done, 130 when ctrl-C ended it early."""
    from lime_planner.experiments.lime.trials import LimeOptions

    options = LimeOptions(
        trials=args.trials,
        plants=args.plants,
        sensitivity_trials=args.sensitivity_trials,
        seed=args.seed,
        iterations=args.iterations,
        checker=args.checker,
    )
    figures = not args.no_figures
    complete = run_lime(options, args.out, jobs=args.jobs, scheduler=args.scheduler, resume=args.resume, figures=figures)
    print((args.out / "table.md").read_text())
    if not complete:
        print(f"Stopped by ctrl-C. What is done is in {args.out}; --resume continues it.", file=sys.stderr)
        return 130
    print(f"Written to {args.out}: results.json, table.md" + (", simulation.png" if figures else ""))
    return 0
