"""`lime-planner experiment hidden`: stems that no camera saw and the arm touches, by what was known of the plant."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.experiments.runs.arguments import add_run_arguments
from lime_planner.experiments.runs.frame import carry_out, run_experiment

if TYPE_CHECKING:
    from lime_planner.experiments.hidden.trials import HiddenOptions
    from lime_planner.experiments.runs.results_file import Plan


def run_hidden(
    options: HiddenOptions, out: Path, *, jobs: int | None = None, scheduler: str | None = None, resume: bool = False, figures: bool = True
) -> bool:
    """Run the experiment and write `results.json`, `table.md` and the plot to a folder.

    Args:
        options: what to run.
        out: the folder; made if it does not exist.
        jobs: number of processes (default: one for each processor).
        scheduler: address of a Dask scheduler, whose workers run the trials instead.
        resume: continue an earlier run in the same folder.
        figures: draw the plot too.

    Returns:
        False if ctrl-C ended it early: what is done is in the folder.

    Raises:
        ParameterError: see `run_experiment`.
    """
    from lime_planner.experiments.hidden.report import table_text
    from lime_planner.experiments.hidden.trials import plan_of

    def draw(plan: Plan[Any], results: dict[str, Any]) -> None:
        from lime_planner.experiments.hidden.figure import draw as draw_shares

        draw_shares(results, out)

    return run_experiment(lambda: plan_of(options), out, table_text, draw, jobs=jobs, scheduler=scheduler, resume=resume, figures=figures)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_run_arguments(parser)
    parser.add_argument("--plants", type=int, default=17, metavar="N", help="plants of each density (default: %(default)s)")
    parser.add_argument("--first-plant", type=int, default=0, metavar="N", help="seed of the first plant (default: %(default)s)")
    parser.add_argument("--limes", type=int, default=3, metavar="N", help="limes of each plant (default: %(default)s)")
    parser.add_argument("--densities", nargs="+", metavar="NAME", help="foliage: sparse, medium, dense, thicket (default: the first three)")
    parser.add_argument("--time", type=float, default=0.5, metavar="S", help="search budget of every plan [s] (default: %(default)s)")
    parser.add_argument(
        "--iterations", type=int, default=0, metavar="N", help="budget of every plan instead, so that a run can be repeated"
    )
    parser.add_argument("--max-looks", type=int, default=3, metavar="N", help="planned looks at most (default: %(default)s)")
    words = "full, one, priced, three or looks, and after a hyphen fixed or free (default: all)"
    parser.add_argument("--methods", nargs="+", metavar="NAME[:PARAMETER=VALUE,...]", help=words)


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0 when every trial is done, 130 when ctrl-C ended it early."""
    from lime_planner.experiments.hidden.trials import HiddenOptions

    lists: dict[str, Any] = {name: tuple(getattr(args, name)) for name in ("densities", "methods") if getattr(args, name)}
    options = HiddenOptions(
        plants=args.plants,
        limes=args.limes,
        first_plant=args.first_plant,
        seed=args.seed,
        time_s=args.time,
        iterations=args.iterations,
        max_looks=args.max_looks,
        **lists,
    )
    return carry_out(args, run_hidden, options, "results.json, table.md", "hidden.png")
