"""`lime-planner experiment damage`: leaves that the arm really touches, by method, on generated plants and on scans."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.experiments.runs.arguments import add_run_arguments, make_results_folder

if TYPE_CHECKING:
    from lime_planner.experiments.damage.trials import DamageOptions


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
        ParameterError: the folder cannot be made or written to, or holds an earlier run that may not or cannot be continued.
    """
    from lime_planner.core.atomic_files import write_text
    from lime_planner.experiments.damage.report import table_text
    from lime_planner.experiments.damage.trials import plan_of
    from lime_planner.experiments.runs.parallel import default_jobs
    from lime_planner.experiments.runs.results_file import collect

    make_results_folder(out)
    results, complete = collect(plan_of(options), out / "results.json", jobs=jobs or default_jobs(), scheduler=scheduler, resume=resume)
    write_text(out / "table.md", table_text(results))
    if figures and complete:
        from lime_planner.experiments.damage.figures import all_figures

        all_figures(results, out)
    return complete


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_run_arguments(parser)
    parser.add_argument("--plants", type=int, default=17, metavar="N", help="plants of each density (default: %(default)s)")
    parser.add_argument("--limes", type=int, default=4, metavar="N", help="limes of each plant (default: %(default)s)")
    parser.add_argument("--densities", nargs="+", metavar="NAME", help="foliage: sparse, medium, dense (default: all three)")
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
    figures = not args.no_figures
    complete = run_damage(options, args.out, jobs=args.jobs, scheduler=args.scheduler, resume=args.resume, figures=figures)
    print((args.out / "table.md").read_text())
    if not complete:
        print(f"Stopped by ctrl-C. What is done is in {args.out}; --resume continues it.", file=sys.stderr)
        return 130
    print(f"Written to {args.out}: results.json, table.md" + (", plots" if figures else ""))
    return 0
