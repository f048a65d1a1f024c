"""A plan's figures as a short table, on at most 80 columns."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.atomic import replacing
from lime_planner.errors import ParameterError

if TYPE_CHECKING:
    from rich.console import Console

#: What is shown of a plan: key of its figures, words, unit, factor from the figure's unit, decimals.
ROWS: tuple[tuple[str, str, str, float, int], ...] = (
    ("planning_time_s", "planning time", "s", 1.0, 2),
    ("path_length_rad", "path length, joints", "rad", 1.0, 2),
    ("tool_path_length_m", "path length, tool", "m", 1.0, 3),
    ("leaf_contact_rad", "leaf contact, joints", "rad", 1.0, 2),
    ("tool_leaf_contact_m", "leaf contact, tool", "m", 1.0, 3),
    ("min_stem_clearance_m", "smallest clearance to stems", "mm", 1000.0, 1),
)


def console(*, error: bool = False) -> Console:
    """Return a console of at most 80 columns."""
    from rich.console import Console

    plain = Console(stderr=error, highlight=False)
    return Console(stderr=error, highlight=False, width=min(80, plain.width))


def cell(figures: Mapping[str, Any], key: str, factor: float = 1.0, decimals: int = 2) -> str:
    """Return one figure as text; a dash where there is none."""
    value = figures.get(key)
    if value is None or (isinstance(value, float) and value != value):
        return "–"
    return f"{float(value) * factor:.{decimals}f}"


def headline(figures: Mapping[str, Any]) -> str:
    """Return planner, leaf contact, length and clearance in one line, as the table shows them."""
    texts = {key: cell(figures, key, factor, decimals) for key, _, _, factor, decimals in ROWS}
    contact, length, clearance = (texts[key] for key in ("leaf_contact_rad", "path_length_rad", "min_stem_clearance_m"))
    return f"{figures.get('planner', '')}: leaf contact {contact} rad of {length} rad, stem clearance {clearance} mm"


def print_plans(title: str, columns: Sequence[tuple[str, Mapping[str, Any]]], extra: Sequence[tuple[str, Sequence[str]]] = ()) -> None:
    """Print plans side by side.

    Args:
        title: above the table.
        columns: heading and figures of each plan; figures without a path show dashes.
        extra: further rows: words, and one text for each column.
    """
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", show_edge=False, pad_edge=False)
    table.add_column("")
    for heading, _ in columns:
        table.add_column(heading, justify="right", overflow="fold")
    table.add_row("status", *(str(figures.get("status", "–")) for _, figures in columns))
    for key, words, unit, factor, decimals in ROWS:
        table.add_row(f"{words} [{unit}]".replace("[", r"\["), *(cell(figures, key, factor, decimals) for _, figures in columns))
    for words, texts in extra:
        table.add_row(words.replace("[", r"\["), *texts)
    console().print(table)


def write_json(path: str | os.PathLike[str], figures: Mapping[str, Any]) -> Path:
    """Write figures as JSON; a reader never sees half a file.

    Raises:
        ParameterError: the file cannot be written.
    """
    path = Path(path)
    try:
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise ParameterError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path
