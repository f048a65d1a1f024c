"""What a check found: one line, and where something is wrong what to do about it."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any


class Level(enum.Enum):
    """How bad it is."""

    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True)
class Finding:
    """The outcome of one check.

    Attributes:
        check: what was looked at, in one or two words.
        level: how bad it is.
        sentence: what was found, with its numbers.
        cure: what to do; empty where nothing is to be done.
    """

    check: str
    level: Level
    sentence: str
    cure: str = ""

    def figures(self) -> dict[str, Any]:
        """Return the finding for JSON."""
        return {"check": self.check, "level": self.level.value, "sentence": self.sentence, "cure": self.cure}


def ok(check: str, sentence: str) -> Finding:
    """Report that all is well."""
    return Finding(check, Level.OK, sentence)


def warning(check: str, sentence: str, cure: str) -> Finding:
    """Report what works, but worse than it could."""
    return Finding(check, Level.WARNING, sentence, cure)


def fault(check: str, sentence: str, cure: str) -> Finding:
    """Report what keeps the planner from working."""
    return Finding(check, Level.FAULT, sentence, cure)


def healthy(findings: Iterable[Finding]) -> bool:
    """Tell whether there is no fault among the findings."""
    return all(finding.level is not Level.FAULT for finding in findings)
