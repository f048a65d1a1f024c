"""`lime-planner experiment lime`: the paper's experiment with the arm (section V), from trials to table and figure."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.experiments.runs.arguments import add_run_arguments
from lime_planner.experiments.runs.frame import carry_out, run_experiment

if TYPE_CHECKING:
    from lime_planner.experiments.lime.trials import LimeOptions
    from lime_planner.experiments.runs.results_file import Plan


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
        ParameterError: see `run_experiment`.
    """
    from lime_planner.experiments.lime.report import table_text
    from lime_planner.experiments.lime.trials import plan_of

    def draw(plan: Plan[Any], results: dict[str, Any]) -> None:
        from lime_planner.experiments.lime.figure import simulation_figure

        simulation_figure(plan, results, out)

    return run_experiment(lambda: plan_of(options), out, table_text, draw, jobs=jobs, scheduler=scheduler, resume=resume, figures=figures)


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
    return carry_out(args, run_lime, options, "results.json, table.md", "simulation.png")
