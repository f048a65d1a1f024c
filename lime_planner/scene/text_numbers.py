"""Numbers in the text bodies of PLY and PCD files: one record a line, as nearly all writers do, or in any lines that add up."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Array, Int64

_NEWLINE, _RETURN = 10, 13
_IS_SPACE = np.isin(np.arange(256), list(b" \t\n\v\f\r"))

#: How C libraries write what is no number.
_NOT_NUMBERS = {
    b"nan": np.nan,
    b"-nan": np.nan,
    b"nan(ind)": np.nan,
    b"-nan(ind)": np.nan,
    b"1.#qnan": np.nan,
    b"-1.#ind": np.nan,
    b"1.#ind": np.nan,
    b"1.#inf": np.inf,
    b"-1.#inf": -np.inf,
}


class TextNumbers:
    """The numbers of a text, by their place in it and by the line that they stand on."""

    def __init__(self, text: bytes) -> None:
        """Find where numbers begin; nothing is converted yet.

        Args:
            text: numbers with white space between them.
        """
        self._text = text
        codes = np.frombuffer(text, np.uint8)
        space = _IS_SPACE[codes]
        after_space = np.ones(len(codes), bool)
        after_space[1:] = space[:-1]
        self._starts = np.flatnonzero(~space & after_space)
        end = _NEWLINE if (codes == _NEWLINE).any() else _RETURN
        line_of = np.cumsum(codes == end)[self._starts] if len(self._starts) else np.empty(0, np.int64)
        self._firsts = np.flatnonzero(np.diff(line_of, prepend=-1))

    def __len__(self) -> int:
        """Return how many numbers there are."""
        return len(self._starts)

    @property
    def line_lengths(self) -> Int64:
        """How many numbers each line holds, blank lines left out, (L,)."""
        return np.diff(self._firsts, append=len(self._starts))

    def line(self, k: int) -> int:
        """Return the place of the first number of line k, blank lines left out; of the end, beyond the last line."""
        return int(self._firsts[k]) if k < len(self._firsts) else len(self._starts)

    def values(self, first: int, count: int) -> Array:
        """Convert numbers, in double precision.

        Args:
            first: place of the first one.
            count: how many.

        Raises:
            SceneError: there are fewer, or one is something else.
        """
        if first + count > len(self._starts):
            raise SceneError(f"is truncated: {len(self._starts)} numbers, its header needs {first + count}")
        if not count:
            return np.empty(0)
        begin = int(self._starts[first])
        end = int(self._starts[first + count]) if first + count < len(self._starts) else len(self._text)
        piece = self._text[begin:end]
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", DeprecationWarning)
                numbers = np.fromstring(piece, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            numbers = np.empty(0)
        return numbers if len(numbers) == count else self._one_by_one(piece.split())

    @staticmethod
    def _one_by_one(words: Sequence[bytes]) -> Array:
        """Convert words among which there is one that NumPy does not know."""
        numbers = np.empty(len(words))
        for k, word in enumerate(words):
            try:
                numbers[k] = float(word) if b"_" not in word else float("no number")  # Python would take 1_0 for 10
            except ValueError:
                value = _NOT_NUMBERS.get(word.lower())
                if value is None:
                    raise SceneError(f"{word[:40].decode('ascii', errors='replace')!r} is not a number") from None
                numbers[k] = value
        return numbers
