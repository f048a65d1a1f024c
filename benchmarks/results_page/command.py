"""`lime-planner experiment report`: keep what finished runs found, and write the results page from what is kept."""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

_EPILOG = """\
Each folder is the --out of an experiment or a benchmark. Its results go to
DOCS/results in a compact form, its plots to DOCS/figures, and the tables of
DOCS/results.md are made again. Without folders only the tables are.

examples:
  lime-planner experiment report lime damage planners peers scale
  lime-planner experiment report --check
"""

#: Plots of the page: experiment, file of its run, name in the documentation.
FIGURES = (
    ("lime", "simulation.png", "results-lime.png"),
    ("damage", "damage.png", "results-damage.png"),
    ("damage", "damage_pairs.png", "results-damage-pairs.png"),
    ("hidden", "hidden.png", "results-hidden.png"),
    ("planners", "cost_against_time.png", "results-planners.png"),
    ("peers", "cost_against_time.png", "results-peers-time.png"),
    ("peers", "cost_against_checks.png", "results-peers-checks.png"),
    ("scale", "scale.png", "results-scale.png"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    parser.add_argument("runs", type=Path, nargs="*", metavar="DIR", help="folders of finished runs")
    parser.add_argument("--docs", type=Path, default=Path("docs"), metavar="DOCS", help="the documentation's folder (default: %(default)s)")
    parser.add_argument("--check", action="store_true", help="change nothing; exit status 1 where the page differs from the kept results")


def keep_run(run: Path, docs: Path) -> list[Path]:
    """Keep one run's results and plots; the files written.

    Raises:
        SceneError: the folder holds no results that are kept, or not all of them.
    """
    from benchmarks.results_page.kept_results import keep, name_of
    from lime_planner.core.atomic_files import write_json
    from lime_planner.core.errors import SceneError

    try:
        results = json.loads((run / "results.json").read_text())
    except (OSError, ValueError) as error:
        raise SceneError(f"{run} holds no results.json that can be read ({error})") from error
    if not results.get("complete"):
        raise SceneError(f"{run}: the run was stopped; finish it with --resume")
    kept, name = keep(results), name_of(results)
    (docs / "results").mkdir(parents=True, exist_ok=True)
    (docs / "figures").mkdir(exist_ok=True)
    written = [docs / "results" / f"{name}.json"]
    write_json(written[0], kept, compact=True)
    for experiment, source, target in FIGURES:
        if experiment == name and (run / source).is_file():
            written.append(docs / "figures" / target)
            shutil.copyfile(run / source, written[-1])
    return written


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0, or with --check 1 where the page is not what the kept results give."""
    from benchmarks.results_page.page import filled, missing
    from lime_planner.core.atomic_files import write_text
    from lime_planner.core.errors import SceneError

    page = args.docs / "results.md"
    if not page.is_file():
        raise SceneError(f"{page} is not there: --docs names the folder of the documentation")
    if args.check:
        wrong = missing(page.read_text(), args.docs / "results")
        for name in wrong:
            print(f"{page}: block {name} differs from the kept results")
        return 1 if wrong else 0
    for folder in args.runs:
        print("\n".join(str(path) for path in keep_run(folder, args.docs)))
    write_text(page, filled(page.read_text(), args.docs / "results"))
    print(page)
    return 0
