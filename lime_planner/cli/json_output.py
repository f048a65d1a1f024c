"""Figures as JSON, the same way in every command."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError

if TYPE_CHECKING:
    import numpy.typing as npt

STDOUT = "-"


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare `--json [FILE]`."""
    help_ = f"{what} as JSON; without FILE to standard output, in place of the text"
    parser.add_argument("--json", nargs="?", const=STDOUT, metavar="FILE", help=help_)


def is_stdout(destination: str | os.PathLike[str] | None) -> bool:
    """Tell whether JSON takes the place of the text on standard output."""
    return destination is not None and str(destination) == STDOUT


def as_lists(array: npt.NDArray[Any] | None) -> Any:
    """Return an array as JSON takes it, None for none."""
    return None if array is None else array.tolist()


def emit_json(destination: str | os.PathLike[str], figures: Mapping[str, Any]) -> None:
    """Write figures as JSON to a file, or to standard output.

    Raises:
        ParameterError: the file cannot be written.
    """
    if is_stdout(destination):
        print(json.dumps(figures, indent=1, allow_nan=False))
        return
    from lime_planner.output.console import write_json

    write_json(destination, figures)


def emit_outcome(args: argparse.Namespace, code: str, message: str) -> None:
    """Write an outcome without figures, as `status` and `message`, to where the arguments want JSON, if they do.

    So no reader takes an earlier run's file for this one's. A file that is something else than figures stays as it is: in
    `plan --json plant.npz` it is the scene.

    Args:
        args: of the command, whether it has `--json` or not.
        code: the status.
        message: `CODE: sentence`.
    """
    destination = getattr(args, "json", None)
    if destination is None or (not is_stdout(destination) and not _may_be_replaced(Path(destination))):
        return
    # Why the file cannot be written may be what the message says already; standard error has it in any case.
    with contextlib.suppress(ParameterError, BrokenPipeError):
        emit_json(destination, {"status": code, "message": message})


def _may_be_replaced(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(64).lstrip()[:1] in (b"", b"{")
    except FileNotFoundError:
        return True
    except OSError:
        return False
