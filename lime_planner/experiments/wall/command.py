"""`lime-planner experiment wall`: the paper's experiment on the plane (section IV), from trials to tables and figures."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError
from lime_planner.experiments.runs.arguments import add_run_arguments, make_results_folder
from lime_planner.experiments.runs.frame import carry_out

if TYPE_CHECKING:
    from lime_planner.experiments.wall.trials import WallOptions


_EPILOG = """\
A wall of your own is a JSON file; permeable polygons cost, impermeable ones
block. Corners may lie beyond the map, start and goal may not. Nothing of it
has a unit, but steps (--option delta) and field are made for maps of 100:

  {"map": {"lower": [0, 0], "upper": [100, 100]},
   "start": [10, 50], "goal": [90, 50],
   "permeable": [[[42, -10], [58, -10], [58, 110], [42, 110]]],
   "impermeable": [[[46, 30], [54, 30], [54, 60], [46, 60]]]}

Both lists of polygons may be left out; "name" is for titles.

examples:
  lime-planner experiment wall --trials 20 --out wall
  lime-planner experiment wall --wall mine.json --trials 20 --out mine
  lime-planner experiment wall --random-wall 7 --trials 20 --out seven
"""


def run_wall(
    options: WallOptions, out: Path, *, jobs: int | None = None, scheduler: str | None = None, resume: bool = False, figures: bool = True
) -> bool:
    """Run the experiment and write `results.json`, `table.md`, `statistics.md` and the figures to a folder.

    Args:
        options: what to run.
        out: the folder; made if it does not exist.
        jobs: number of processes (default: one for each processor).
        scheduler: address of a Dask scheduler, whose workers run the trials instead.
        resume: continue an earlier run in the same folder.
        figures: draw the figures too.

    Returns:
        False if ctrl-C ended it early: what is done is in the folder, and table and statistics speak of that.

    Raises:
        ParameterError: the folder cannot be made or written to, or holds an earlier run that may not or cannot be continued.
        ModuleNotFoundError: pingouin is not installed (extra `experiments`).
    """
    from lime_planner.core.atomic_files import write_text
    from lime_planner.experiments.runs.parallel import default_jobs
    from lime_planner.experiments.wall.report import statistics_text, table_text
    from lime_planner.experiments.wall.trials import collect

    if importlib.util.find_spec("pingouin") is None:  # before the trials, not after them
        raise ModuleNotFoundError("the experiment's statistics need pingouin", name="pingouin")
    make_results_folder(out)
    results, complete = collect(options, out / "results.json", jobs=jobs or default_jobs(), resume=resume, scheduler=scheduler)
    write_text(out / "table.md", table_text(results))
    write_text(out / "statistics.md", statistics_text(results))
    if figures and complete:
        from lime_planner.experiments.wall.figures import all_figures

        all_figures(options, results, out)
    return complete


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    add_run_arguments(parser)
    parser.add_argument("--wall", type=Path, metavar="FILE.json", help="another wall, see below (default: geometry G, fitted to the paper)")
    parser.add_argument("--random-wall", type=int, metavar="SEED", help="a wall of another shape, made from a seed")
    parser.add_argument("--trials", type=int, default=100, metavar="N", help="trials for each row (default: %(default)s)")
    parser.add_argument("--iterations", type=int, default=5000, metavar="N", help="iterations of a run (default: %(default)s)")
    parser.add_argument("--marks", type=int, nargs="+", metavar="N", help="iterations to report at (default: 1000 2500 5000)")
    parser.add_argument("--propagate", action="store_true", help="hand rewired costs on to descendants")
    parser.add_argument(
        "--option", action="append", default=[], metavar="NAME=VALUE", help="another option of the planners, e.g. cost=integral"
    )


def _changes(assignments: list[str]) -> dict[str, Any]:
    """Turn NAME=VALUE texts into options of the planners."""
    from dataclasses import fields

    from lime_planner.planning.rrt_star.planner import PaperOptions

    known = {f.name: f for f in fields(PaperOptions)}
    changes: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals or name not in known:
            raise ParameterError(f"--option takes NAME=VALUE with a name of {', '.join(sorted(known))}; got {text!r}")
        kind = str(known[name].type)
        try:
            if kind == "bool":
                changes[name] = {"true": True, "false": False}[value.lower()]
            elif kind == "int":
                changes[name] = int(value)
            else:
                changes[name] = value if kind.startswith("Literal") else float(value)
        except (KeyError, ValueError):
            raise ParameterError(f"--option {name} takes a {kind}, got {value!r}") from None
    return changes


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0 when every trial is done, 130 when ctrl-C ended it early."""
    from lime_planner.experiments.wall.trials import WallOptions
    from lime_planner.planning.spaces.plane import load_world, random_wall, wall_g

    if args.wall is not None and args.random_wall is not None:
        raise ParameterError("give --wall or --random-wall, not both")
    world = load_world(args.wall) if args.wall is not None else wall_g()
    if args.random_wall is not None:
        world = random_wall(args.random_wall)
    changes = _changes(args.option)
    if args.propagate:
        changes["propagate"] = True
    marks = tuple(args.marks) if args.marks else tuple(m for m in (1000, 2500, 5000) if m <= args.iterations) or (args.iterations,)
    options = WallOptions(world=world, trials=args.trials, seed=args.seed, iterations=args.iterations, marks=marks, changes=changes)
    return carry_out(args, run_wall, options, "results.json, table.md, statistics.md", "figures")
