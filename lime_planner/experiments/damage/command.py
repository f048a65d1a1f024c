"""`lime-planner experiment damage`: leaves that the arm really touches, by method, on generated plants and on scans."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.experiments.runs.arguments import add_run_arguments
from lime_planner.experiments.runs.frame import carry_out, run_experiment

if TYPE_CHECKING:
    from lime_planner.experiments.damage.trials import DamageOptions
    from lime_planner.experiments.runs.results_file import Plan


def run_damage(
    options: DamageOptions, out: Path, *, jobs: int | None = None, scheduler: str | None = None, resume: bool = False, figures: bool = True
) -> bool:
    """Run the experiment and write `results.json`, `table.md` and the plots to a folder.

    Args:
        options: what to run.
        out: the folder; made if it does not exist.
        jobs: number of processes (default: one for each processor).
        scheduler: address of a Dask scheduler, whose workers run the trials instead.
        resume: continue an earlier run in the same folder.
        figures: draw the plots too.

    Returns:
        False if ctrl-C ended it early: what is done is in the folder.

    Raises:
        ParameterError: see `run_experiment`.
    """
    from lime_planner.experiments.damage.report import table_text
    from lime_planner.experiments.damage.trials import plan_of

    def draw(plan: Plan[Any], results: dict[str, Any]) -> None:
        from lime_planner.experiments.damage.figures import all_figures

        all_figures(results, out)

    return run_experiment(lambda: plan_of(options), out, table_text, draw, jobs=jobs, scheduler=scheduler, resume=resume, figures=figures)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_run_arguments(parser)
    parser.add_argument("--plants", type=int, default=17, metavar="N", help="plants of each density (default: %(default)s)")
    parser.add_argument("--limes", type=int, default=4, metavar="N", help="limes of each plant (default: %(default)s)")
    parser.add_argument("--densities", nargs="+", metavar="NAME", help="foliage: sparse, medium, dense, thicket (default: the first three)")
    parser.add_argument("--scans", type=Path, metavar="DIR", help="folder of labelled scans (.npz) to run on as well")
    parser.add_argument("--scan-targets", type=int, default=8, metavar="N", help="places in each scan (default: %(default)s)")
    budget = parser.add_mutually_exclusive_group()
    budget.add_argument("--time", type=float, default=0.5, metavar="S", help="search budget of every method [s] (default: %(default)s)")
    words = "a fixed number of iterations for each method instead, as many as 0.5 s allow: the same results every time"
    budget.add_argument("--repeatable", action="store_true", help=words)
    budget.add_argument("--iterations", type=int, default=0, metavar="N", help="one budget in iterations for every method instead")
    parser.add_argument(
        "--methods",
        nargs="+",
        metavar="NAME[:PARAMETER=VALUE,...]",
        help="solid, ignored, apf_rrt_star, binary, graded, free, candidates (default: all)",
    )


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0 when every trial is done, 130 when ctrl-C ended it early."""
    from lime_planner.core.errors import ParameterError
    from lime_planner.experiments.damage.trials import DamageOptions

    scans: tuple[str, ...] = ()
    if args.scans is not None:
        scans = tuple(str(path) for path in sorted(args.scans.glob("*.npz")))
        if not scans:
            raise ParameterError(f"--scans {args.scans}: there is no .npz file")
    lists: dict[str, Any] = {name: tuple(getattr(args, name)) for name in ("densities", "methods") if getattr(args, name)}
    options = DamageOptions(
        plants=args.plants,
        limes=args.limes,
        scans=scans,
        scan_targets=args.scan_targets,
        seed=args.seed,
        time_s=args.time,
        iterations=args.iterations,
        repeatable=args.repeatable,
        **lists,
    )
    return carry_out(args, run_damage, options, "results.json, table.md", "plots")
