"""`lime-planner bench kernels`: how long the compiled parts take on one core, warm, beside what was aimed at."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmarks.timing import Timing

_EPILOG = """\
Times are processor time of one thread, so that other programs disturb little;
the ratio to the reference loop compares machines. Without --scans the first
paths are timed on generated plants.

example:
  lime-planner bench kernels --scans scans --json kernels.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    parser.add_argument("--scans", type=Path, metavar="DIR", help="folder of labelled scans (.npz)")
    parser.add_argument("--targets", type=int, default=20, metavar="N", help="problems for the planners (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="seeds on each of them (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=50, metavar="N", help="samples of each kernel (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--strict", action="store_true", help="exit status 1 where a target is missed")


def measure_all(scans: Path | None, *, targets: int, seeds: int, repeats: int) -> dict[str, Any]:
    """Time everything; JSON-ready, kernels under `kernels` in the order of the table."""
    from benchmarks.kernels import cases, view_cases
    from benchmarks.problem_sets import choose_problems, plant_specs, scan_specs
    from benchmarks.timing import machine, reference_loop
    from lime_planner import __version__

    before = reference_loop()
    bench = cases.Bench(repeats)
    timings: list[Timing] = [*bench.checks(), bench.edges(), *bench.fields(), *view_cases.maps(repeats), view_cases.look(repeats)]
    scenes = scan_specs(scans) if scans is not None else plant_specs(["medium:1", "dense:2"])
    problems = choose_problems(scenes, targets)[0]
    timings += [cases.paper_mode(problems, seeds), cases.first_path(problems, seeds, "cpu")]
    after = reference_loop()
    reference = min(before, after, key=lambda t: t.quantile(0.5))
    reference_s = reference.quantile(0.5)
    return {
        "benchmark": "kernels",
        "version": __version__,
        "machine": machine(),
        "scenes": [s.name for s in scenes],
        "clock": "processor time of one thread",
        "reference_s": reference_s,
        "reference_drift": after.quantile(0.5) / before.quantile(0.5),
        "kernels": [t.to_dict(reference_s) for t in (reference, *timings)],
    }


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def print_table(results: dict[str, Any]) -> None:
    """Print the figures on at most 80 columns."""
    from rich.table import Table

    from lime_planner.output.console import console

    table = Table(title="Time on one core, warm", title_justify="left", title_style="bold", show_edge=False, pad_edge=False)
    table.add_column("")
    for heading in ("median", "5 %", "95 %", "ratio", "target"):
        table.add_column(heading, justify="right")
    for row in results["kernels"]:
        verdict = {None: "", True: "", False: " missed"}[row["met"]]
        target = "" if row["target_s"] is None else _duration(row["target_s"]) + verdict
        ratio = "–" if row["ratio"] is None else f"{row['ratio']:,.0f}" if row["ratio"] >= 10 else f"{row['ratio']:.1f}"
        table.add_row(row["words"], *(_duration(row[k]) for k in ("median_s", "q05_s", "q95_s")), ratio, target)
    screen = console()
    screen.print(table)
    for row in results["kernels"]:
        if row["note"] or row["failures"]:
            failed = f" ({row['failures']} of {row['samples']} without a result)" if row["failures"] else ""
            screen.print(f"{row['words']}: {row['note']}{failed}", style="dim")
    screen.print(f"{results['machine']['processor']}, load {results['machine']['load'][0]}; ratio: to a step of the reference loop.")


def run(args: argparse.Namespace) -> int:
    """Carry out the command: 0, or with --strict 1 where a target is missed."""
    from lime_planner.core.errors import ParameterError
    from lime_planner.output.console import write_json

    for name in ("targets", "seeds", "repeats"):
        if getattr(args, name) < 1:
            raise ParameterError(f"--{name} must be at least 1, got {getattr(args, name)}")
    results = measure_all(args.scans, targets=args.targets, seeds=args.seeds, repeats=args.repeats)
    print_table(results)
    if args.json is not None:
        write_json(args.json, results)
    missed = [row["words"] for row in results["kernels"] if row["met"] is False]
    return 1 if args.strict and missed else 0
