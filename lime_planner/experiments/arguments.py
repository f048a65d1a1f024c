"""Arguments that experiments share."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare where results go, who runs the trials, and the seed."""
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for results, tables and figures")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--jobs", type=int, metavar="N", help="processes (default: one for each processor)")
    place.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers run the trials, for example tcp://host:8786")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the whole experiment (default: %(default)s)")
    parser.add_argument("--resume", action="store_true", help="continue an earlier run in the same folder")
    parser.add_argument("--no-figures", action="store_true", help="tables only")
