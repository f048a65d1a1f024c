"""What the tables of all experiments are written with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from lime_planner.core.types import Array


def values(results: dict[str, Any], quantity: str = "cost") -> dict[str, Array]:
    """Return one quantity of every trial at every mark: for each algorithm (trials, marks), NaN for failures."""
    marks = [str(m) for m in results["options"]["marks"]]
    found: dict[str, list[list[float]]] = {key: [] for key in results["options"]["planners"]}
    for trial in results["trials"]:
        row = [trial["marks"][m][quantity] for m in marks]
        failed = [trial["marks"][m]["cost"] is None for m in marks]
        found[trial["algorithm"]].append([math.nan if v is None or f else float(v) for v, f in zip(row, failed, strict=True)])
    return {key: np.array(rows).reshape(-1, len(marks)) for key, rows in found.items() if rows}


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, first column left-aligned, the others right-aligned."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" + "---:|" * (len(head) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def p_text(p: float) -> str:
    """Return a p-value as it is printed in papers."""
    if math.isnan(p):
        return "–"
    return "< .001" if p < 0.001 else f"{p:.3f}".replace("0.", ".", 1)
