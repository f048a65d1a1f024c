"""The frame of an experiment's command: trials, table, figures, and what is printed at the end."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.experiments.runs.arguments import make_results_folder

if TYPE_CHECKING:
    from lime_planner.experiments.runs.results_file import Plan


def run_experiment(
    make_plan: Callable[[], Plan[Any]],
    out: Path,
    table_text: Callable[[dict[str, Any]], str],
    draw: Callable[[Plan[Any], dict[str, Any]], object],
    *,
    jobs: int | None,
    scheduler: str | None,
    resume: bool,
    figures: bool,
) -> bool:
    """Run an experiment and write `results.json`, `table.md` and its figures to a folder.

    Args:
        make_plan: chooses its trials, which may take a while; called once the folder is there.
        out: the folder; made if it does not exist.
        table_text: makes the table of the results.
        draw: draws the figures of complete results.
        jobs: number of processes (default: one for each processor).
        scheduler: address of a Dask scheduler, whose workers run the trials instead.
        resume: continue an earlier run in the same folder.
        figures: draw the figures too.

    Returns:
        False if ctrl-C ended it early: what is done is in the folder.

    Raises:
        ParameterError: the folder cannot be made or written to, or holds an earlier run that may not or cannot be continued.
    """
    from lime_planner.core.atomic_files import write_text
    from lime_planner.experiments.runs.parallel import default_jobs
    from lime_planner.experiments.runs.results_file import collect

    make_results_folder(out)
    plan = make_plan()
    results, complete = collect(plan, out / "results.json", jobs=jobs or default_jobs(), scheduler=scheduler, resume=resume)
    write_text(out / "table.md", table_text(results))
    if figures and complete:
        draw(plan, results)
    return complete


def carry_out(args: argparse.Namespace, run: Callable[..., bool], options: object, tables: str, figures_written: str) -> int:
    """Run an experiment as its command line asks, print its table and where everything is.

    Args:
        args: the command line, with what `add_run_arguments` declares.
        run: the experiment; `run_experiment`'s keywords behind options and folder.
        options: what to run.
        tables: files that are always written.
        figures_written: what is written besides with figures.

    Returns:
        0 when every trial is done, 130 when ctrl-C ended it early.
    """
    figures = not args.no_figures
    complete = run(options, args.out, jobs=args.jobs, scheduler=args.scheduler, resume=args.resume, figures=figures)
    print((args.out / "table.md").read_text())
    if not complete:
        print(f"Stopped by ctrl-C. What is done is in {args.out}; --resume continues it.", file=sys.stderr)
        return 130
    print(f"Written to {args.out}: {tables}" + (f", {figures_written}" if figures else ""))
    return 0
