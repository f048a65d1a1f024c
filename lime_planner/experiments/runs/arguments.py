"""Arguments that experiments share, and the folder that their results go to."""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path

from lime_planner.core import atomic_files
from lime_planner.core.errors import ParameterError


def finite_number(text: str) -> float:
    """Read a number for argparse, which would take nan and inf too."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def _at_least_one(text: str) -> int:
    """Parse a number of processes."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of processes, 1 or more")
    return value


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare where results go, who runs the trials, and the seed."""
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for results, tables and figures")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--jobs", type=_at_least_one, metavar="N", help="processes (default: one for each processor)")
    place.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers run the trials, for example tcp://host:8786")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the whole experiment (default: %(default)s)")
    parser.add_argument("--resume", action="store_true", help="continue an earlier run in the same folder")
    parser.add_argument("--no-figures", action="store_true", help="tables only")


def make_results_folder(path: Path) -> None:
    """Make the folder for results where there is none, and make sure that files can be written there, before hours of trials.

    Raises:
        ParameterError: it names the folder and the reason.
    """
    try:
        atomic_files.make_folder(path)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        reason = "it is a file" if isinstance(error, FileExistsError) else error.strerror or str(error)
        raise ParameterError(f"{path} cannot be the folder for results: {reason}") from error
