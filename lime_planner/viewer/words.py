"""What the page says: the moment in a sentence, a plan's figures, two plans side by side, and the legend, as HTML."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence

import numpy as np

from lime_planner.core.status import Status
from lime_planner.output.approach_lines import APPROACH_COLOURS, APPROACH_WORDS
from lime_planner.output.picture import ARM, FREE_PATH, LEAFY_PATH, LIME, STEM, TARGET
from lime_planner.output.refusal_marks import BLOCKED
from lime_planner.output.timeline import CLEARANCE_SHOWN_M, Timeline
from lime_planner.pipeline.result import PlanRecord
from lime_planner.viewer.backend import Activity, Moment
from lime_planner.viewer.layers import LEAF, Colour, rgb

#: Signs of the status line; refusals and finds have their own, so that no colour is needed to tell them apart.
_SIGNS = {Activity.LOADING: "…", Activity.IDLE: "●", Activity.PLANNING: "◔", Activity.MOVING: "▶", Activity.STOPPING: "■"}
#: Outcomes that ask for nothing to be mended.
_NO_REFUSAL = ("SUCCEEDED", "CANCELLED", "PREEMPTED", "NOT_READY")
_CODES = tuple(Status.__members__)


def refused(moment: Moment) -> bool:
    """Tell whether the newest outcome is a refusal."""
    code = moment.message.partition(": ")[0]
    return moment.activity is Activity.IDLE and code in _CODES and code not in _NO_REFUSAL


def in_words(moment: Moment) -> str:
    """Return what to tell about a moment, in a sentence or two."""
    shown, message = moment.shown, re.sub(r" \[plan_id [^]]*\]$", "", moment.message)
    if shown is not None and shown.result.status is Status.SUCCEEDED and message == shown.result.message:
        then = f"Execute is not possible: {moment.blocked_motion}." if moment.blocked_motion else "Play shows it, Execute moves the arm."
        return f"A path is found; nothing has moved. {then}"
    return message


def status(moment: Moment, advice: str, warnings: Sequence[str], notes: Sequence[str]) -> str:
    """Return the headline.

    Args:
        moment: what there is to see.
        advice: what to do next, empty where the sentence says it.
        warnings: what is hardly meant about scene, target and start; they stand out.
        notes: what is drawn otherwise than one would think.
    """
    head, sign, kind, sentence = moment.activity.value, _SIGNS[moment.activity], "", in_words(moment)
    if refused(moment):
        code, _, sentence = sentence.partition(": ")
        head, sign, kind = f"Refused: {code}", "✕", "refused"
        sentence = f"{sentence[:1].upper()}{sentence[1:]}"
    elif moment.activity is Activity.IDLE and not moment.blocked_motion:
        kind = "found"
    lines = [
        f'<div class="lp-status {kind}" role="status" aria-live="polite" data-state="{html.escape(head)}">',
        f'<b><span aria-hidden="true">{sign}</span> {html.escape(head)}</b>',
        f'<div class="what">{html.escape(sentence)}</div>',
        *(f'<div class="warning"><b><span aria-hidden="true">⚠</span> Warning:</b> {html.escape(warning)}</div>' for warning in warnings),
        *(f'<div class="note">{html.escape(note)}</div>' for note in ([advice] if advice else []) + list(notes)),
        "</div>",
    ]
    return "".join(lines)


def _rows(shown: PlanRecord, timeline: Timeline | None) -> list[tuple[str, float, str, int, int]]:
    """Return a plan's rows: name, value, unit, decimals, and whether less (-1) or more (1) is better (0: neither).

    What is drawn along the path is measured on what is drawn: the motion.
    """
    result = shown.result
    rows: list[tuple[str, float, str, int, int]] = [("planned in", result.planning_time_s, "s", 2, -1)]
    if timeline is not None:
        rows += [
            ("among leaves", timeline.leaf_contact_rad, "rad", 3, -1),
            ("whole way", timeline.length_rad, "rad", 2, -1),
            ("cost", float(timeline.cost[-1]), "rad", 2, -1),
            ("nearest stem", 1000.0 * float(timeline.clearance_m.min()), "mm", 1, 1),
            ("tool's way", result.tool_path_length_m, "m", 2, -1),
        ]
    if result.trajectory is not None:
        rows.append(("motion", result.trajectory.duration_s, "s", 1, -1))
    if result.views:
        rows.append(("in unseen space", result.unseen_contact_rad, "rad", 2, -1))
    return rows


def _number(name: str, value: float, unit: str, decimals: int) -> str:
    if not np.isfinite(value):
        return "–"
    if name == "nearest stem" and value >= 1000.0 * CLEARANCE_SHOWN_M - 1e-6:
        return f"{1000.0 * CLEARANCE_SHOWN_M:.0f} {unit} or more"
    return f"{value:.{decimals}f} {unit}"


def figures(shown: PlanRecord | None, timeline: Timeline | None, touched: str) -> str:
    """Return a plan's figures as a small table; empty without a path."""
    if shown is None or not shown.found:
        return ""
    rows = [(name, _number(name, value, unit, decimals)) for name, value, unit, decimals, _ in _rows(shown, timeline)]
    rows.insert(0, ("plan", f"<b>{shown.number}</b>, by {html.escape(shown.result.planner)}"))
    rows.append(("touched", touched))
    cells = "".join(f"<tr><td>{name}</td><td>{text}</td></tr>" for name, text in rows if text)
    return f'<table class="lp-table">{cells}</table>'


def comparison(first: tuple[PlanRecord, Timeline | None], second: tuple[PlanRecord, Timeline | None]) -> str:
    """Return the figures of two plans side by side; the better one of each pair is marked."""
    values = [{row[0]: row for row in _rows(*each)} for each in (first, second)]
    names = list(dict.fromkeys([*values[0], *values[1]]))
    lines = ["<tr><th></th>" + "".join(f"<td class='n'><b>plan {record.number}</b></td>" for record, _ in (first, second)) + "</tr>"]
    results = [record.result for record, _ in (first, second)]
    heads = (
        ("planner", [result.planner for result in results]),
        ("outcome", [result.status.name for result in results]),
        ("seed", [str(result.seed) for result in results]),
    )
    for name, texts in heads:
        lines.append(f"<tr><td>{name}</td>" + "".join(f"<td class='n'>{html.escape(text)}</td>" for text in texts) + "</tr>")
    for name in names:
        pair = [value.get(name) for value in values]
        texts = ["–" if row is None else _number(*row[:4]) for row in pair]
        marks = ["", ""]
        if pair[0] is not None and pair[1] is not None and pair[0][4] and texts[0] != texts[1]:
            ahead = pair[0][4] * (pair[0][1] - pair[1][1])
            marks[0 if ahead > 0.0 else 1] = " better"
        lines.append(f"<tr><td>{name}</td>" + "".join(f"<td class='n{m}'>{t}</td>" for m, t in zip(marks, texts, strict=True)) + "</tr>")
    return f'<table class="lp-table">{"".join(lines)}</table>'


def legend() -> str:
    """Return what the scene's colours mean."""
    entries: tuple[tuple[Colour, str], ...] = (
        (rgb(LEAF), "leaves: may be touched, cost"),
        (rgb(STEM), "stems: never touched"),
        (rgb(LIME), "limes: click one"),
        (rgb(ARM), "arm, as measured"),
        (rgb(FREE_PATH), "tool's path, ghost arm"),
        (rgb(LEAFY_PATH), "path among leaves, leaves touched"),
        (rgb(TARGET), "target, and from where"),
        (rgb(BLOCKED), "what is in the way"),
        *((rgb(colour), f"approach: {APPROACH_WORDS[outcome]}") for outcome, colour in APPROACH_COLOURS.items()),
    )
    items = "".join(f'<span><i style="background:rgb{colour}"></i>{html.escape(words)}</span>' for colour, words in entries)
    return f'<div class="lp-legend">{items}</div>'
