"""Standard output and error that take any text: on a terminal of few characters, closed, or without a reader."""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys
import unicodedata
from typing import TextIO

#: What stands for characters that Latin-1 and ASCII lack.
_PLAIN = {
    "–": "-", "—": "-", "−": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "…": "...", "→": "->", "←": "<-", "↔": "<->",
    "≥": ">=", "≤": "<=", "≈": "~", "≠": "!=", "×": "x", "·": "*", "•": "*", "√": "sqrt", "∞": "inf", "∫": "integral ", "°": " deg",
    "±": "+/-", "²": "2", "³": "3", "µ": "u", "μ": "u",
    "─": "-", "━": "-", "│": "|", "┃": "|", "✓": "ok", "✗": "x", "\u00a0": " ", "\u202f": " ", "\u2009": " ",
    "ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss",
}  # fmt: skip
_NAME = "lime_planner.plain"


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_stand_in, error.object[error.start : error.end])), error.end


def _stand_in(character: str) -> str:
    if character in _PLAIN:
        return _PLAIN[character]
    name = unicodedata.name(character, "")
    if name.startswith("GREEK") and " LETTER " in name:
        letter = name.rpartition(" LETTER ")[2].split()[0].lower()
        return letter.capitalize() if "CAPITAL" in name else letter
    base = unicodedata.normalize("NFKD", character)[0]  # the letter without its accent, the digit without its height
    return base if base.isascii() else "?"


def prepare_streams() -> None:
    """Have standard output and error replace what they cannot show, and open those that are closed to nothing."""
    codecs.register_error(_NAME, _plain)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - for as long as the process lives
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_NAME)


def silence(stream: TextIO | None) -> None:
    """Let what a stream still holds go nowhere, so that the interpreter does not trip over it at its end."""
    if stream is None:
        return
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
