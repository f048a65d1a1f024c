"""A caller's numbers, taken as arrays or refused in a sentence; the same for text and JSON in files that users name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array

_LONGEST = 120  # of a value in a sentence


def shown(value: Any) -> str:
    """Return a value in the form for a sentence: on one line, and not for ever."""
    text = " ".join(repr(value.tolist() if isinstance(value, np.ndarray) else value).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def floats(name: str, value: npt.ArrayLike) -> Array:
    """Return what was given as an array of its own, whatever its shape.

    Args:
        name: of the argument, for the sentence.
        value: numbers.

    Raises:
        ProblemError: it is something else.
    """
    try:
        return np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError):
        raise ProblemError(f"{name} must be numbers, got {shown(value)}") from None


def finite_vector(name: str, value: npt.ArrayLike, n: int) -> Array:
    """Return what was given as n finite numbers, (n,).

    Args:
        name: of the argument, for the sentence.
        value: numbers.
        n: how many there must be.

    Raises:
        ProblemError: it is something else.
    """
    array = floats(name, value)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise ProblemError(f"{name} must be {n} finite numbers, got {shown(value)}")
    return array


class TextFileError(ValueError):
    """A file that cannot be read; the text says why, without the file's name."""


def read_text(path: Path) -> str:
    """Return a file's text.

    Raises:
        TextFileError: it cannot be opened, or is no UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise TextFileError("it is no text in UTF-8") from None
    except OSError as error:
        raise TextFileError(error.strerror or "it cannot be opened") from None


def read_json(path: Path) -> Any:
    """Return what a JSON file holds.

    Raises:
        TextFileError: as `read_text`; or it is not JSON; line and column are named.
    """
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise TextFileError(f"it is not JSON from line {error.lineno}, column {error.colno} on") from None
    except RecursionError:
        raise TextFileError("it is JSON that is nested too deeply") from None
