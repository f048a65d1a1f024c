"""Figures as JSON, the same way in every command."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping
from typing import Any

STDOUT = "-"


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare `--json [FILE]`."""
    help_ = f"{what} as JSON; without FILE to standard output, in place of the text"
    parser.add_argument("--json", nargs="?", const=STDOUT, metavar="FILE", help=help_)


def is_stdout(destination: str | os.PathLike[str] | None) -> bool:
    """Tell whether JSON takes the place of the text on standard output."""
    return destination is not None and str(destination) == STDOUT


def emit_json(destination: str | os.PathLike[str], figures: Mapping[str, Any]) -> None:
    """Write figures as JSON to a file, or to standard output.

    Raises:
        ParameterError: the file cannot be written.
    """
    if is_stdout(destination):
        print(json.dumps(figures, indent=1, allow_nan=False))
        return
    from lime_planner.viewer.tables import write_json

    write_json(destination, figures)
