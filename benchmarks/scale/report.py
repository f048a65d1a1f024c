"""Tables and plot of `lime-planner bench scale`, from its results file alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planner_runs import cost_at
from benchmarks.scale.cases import MEMORY_TARGET_BYTES, POINTS_TARGETS_S
from lime_planner.experiments.analysis.bootstrap import median
from lime_planner.experiments.analysis.tables import markdown_table
from lime_planner.experiments.runs.results_file import machine_text

Records = list[dict[str, Any]]

MARKS_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


def records(results: Mapping[str, Any], axis: str) -> dict[float, Records]:
    """The records of one axis by value, rising."""
    found: dict[float, Records] = {}
    for trial in results["trials"]:
        if trial["axis"] == axis:
            found.setdefault(trial["value"], []).append(trial)
    return dict(sorted(found.items()))


def searches(rows: Records) -> Records:
    """All searches behind some records, whether a record is one or holds several."""
    return [run for row in rows for run in row.get("searches", [row])]


def middle(values: Sequence[float | None]) -> float:
    """Median with what is missing as infinite; NaN of nothing."""
    return median(np.array([math.inf if v is None else v for v in values])) if len(values) else math.nan


def _text(value: float, digits: int = 1, scale: float = 1.0) -> str:
    return "–" if math.isnan(value) else "∞" if math.isinf(value) else f"{scale * value:,.{digits}f}"


def points_table(results: Mapping[str, Any]) -> str:
    """Clouds: time to a clean scene and to obstacles, peak memory."""
    rows = []
    for value, found in records(results, "points").items():
        scene_s = middle([r["scene_s"] for r in found])
        target_s = POINTS_TARGETS_S.get(int(value))
        asked = "" if target_s is None else f"{1e3 * target_s:,.0f}"
        peak = max(r["peak_bytes"] for r in found)
        kept = f"{found[0]['kept']:,}"
        obstacles = _text(middle([r["obstacles_s"] for r in found]), 0, 1e3)
        rows.append([f"{value:,.0f}", _text(scene_s, 1, 1e3), asked, kept, obstacles, f"{peak / 1e9:.2f}"])
    head = ["points", "to a clean scene [ms]", "at most", "points kept", "to obstacles [ms]", "peak memory [GB]"]
    return markdown_table(head, rows)


def targets_missed(results: Mapping[str, Any]) -> list[str]:
    """What of the points' targets is not kept, in words."""
    missed = []
    for value, found in records(results, "points").items():
        target_s = POINTS_TARGETS_S.get(int(value))
        if target_s is None:
            continue
        if middle([r["scene_s"] for r in found]) > target_s:
            missed.append(f"{value:,.0f} points take longer than {target_s:g} s")
        if max(r["peak_bytes"] for r in found) > MEMORY_TARGET_BYTES:
            missed.append(f"{value:,.0f} points take more than {MEMORY_TARGET_BYTES / 1e9:g} GB")
    return missed


def search_table(results: Mapping[str, Any], axis: str, heading: str) -> str:
    """Leaves or joints: check, first path, configurations checked in a search, J."""
    rows = []
    for value, found in records(results, axis).items():
        runs = searches(found)
        solved = sum(r["cost"] is not None for r in runs)
        obstacles = [_text(middle([r["obstacles_s"] for r in found]), 0, 1e3)] if axis == "leaves" else []
        rows.append(
            [
                f"{value:,.0f}",
                *obstacles,
                _text(middle([r["check_s"] for r in found if r["check_s"] is not None]), 2, 1e6),
                _text(middle([r["first_s"] for r in runs]), 1, 1e3),
                _text(middle([r["checks"] for r in runs]), 0),
                _text(middle([r["cost"] for r in runs])),
                f"{solved} of {len(runs)}",
            ]
        )
    extra = ["to obstacles [ms]"] if axis == "leaves" else []
    head = [heading, *extra, "check [µs]", "first path [ms]", "configurations checked in 0.5 s", "median J at 0.5 s", "solved"]
    return markdown_table(head, rows)


def budget_ratios(results: Mapping[str, Any], mark_s: float) -> list[float]:
    """J at a time over the best J that any run of the same problem reached; inf before the first path."""
    runs = [r for found in records(results, "budget").values() for r in found]
    best: dict[str, float] = {}
    for r in runs:
        best[r["problem"]] = min(best.get(r["problem"], math.inf), cost_at(r["curve"], math.inf))
    return [cost_at(r["curve"], mark_s) / best[r["problem"]] for r in runs if math.isfinite(best[r["problem"]])]


def budget_marks(results: Mapping[str, Any]) -> list[float]:
    """The marks up to the longest budget."""
    longest = max(records(results, "budget"), default=0.0)
    return [m for m in MARKS_S if m <= longest]


def budget_table(results: Mapping[str, Any]) -> str:
    """Quartiles of J over the best J, by budget."""
    rows = []
    for mark_s in budget_marks(results):
        ratios = np.sort(budget_ratios(results, mark_s))
        cells = [_text(float(np.quantile(ratios, share, method="nearest")), 3) for share in (0.25, 0.5, 0.75, 0.9)]
        rows.append([f"{mark_s:g}", *cells, f"{int(np.isfinite(ratios).sum())} of {len(ratios)}"])
    return markdown_table(["budget [s]", "lower quartile", "median J / best", "upper quartile", "90 %", "with a path"], rows)


def table_text(results: Mapping[str, Any]) -> str:
    """The page of tables."""
    lines = ["# How cost grows", "", f"Processor time on one core of: {machine_text(results)}.", ""]
    if not results["complete"]:
        lines += ["**Incomplete**: the run was stopped.", ""]
    if records(results, "points"):
        lines += ["## Points of a cloud", "", points_table(results), ""]
    if records(results, "leaves"):
        lines += ["## Leaves of a plant", "", search_table(results, "leaves", "leaves"), ""]
    if records(results, "joints"):
        lines += ["## Joints of an arm", "", search_table(results, "joints", "joints"), ""]
    if records(results, "budget"):
        lines += ["## Budget of a search", "", budget_table(results), ""]
    return "\n".join(lines)


def scale_figure(results: Mapping[str, Any], stem: Path) -> list[Path]:
    """Draw the four dependences as PNG and SVG; the files written."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    blue, orange, green = "#0072B2", "#D55E00", "#009E73"
    figure = Figure(figsize=(12.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)  # no window system, no global state
    (points, leaves), (joints, budget) = figure.subplots(2, 2)

    found = records(results, "points")
    values = list(found)
    points.plot(values, [middle([r["scene_s"] for r in found[v]]) for v in values], "o-", color=blue, label="to a clean scene")
    points.plot(
        values, [middle([r["obstacles_s"] for r in found[v]]) for v in values], "s--", color=orange, label="from there to obstacles"
    )
    for n, limit_s in POINTS_TARGETS_S.items():
        if values:
            points.plot([n], [limit_s], "v", color="black", markersize=7, label="at most" if n == min(POINTS_TARGETS_S) else None)
    points.set(xscale="log", yscale="log", xlabel="points of a cloud", ylabel="time [s]", title="Points")

    for axes, axis, name in ((leaves, "leaves", "leaves of a plant"), (joints, "joints", "joints of an arm")):
        found = records(results, axis)
        values = list(found)
        check = [1e6 * middle([r["check_s"] for r in found[v] if r["check_s"] is not None]) for v in values]
        first = [1e3 * middle([r["first_s"] for r in searches(found[v])]) for v in values]
        axes.plot(values, check, "o-", color=blue, label="full check [µs]")
        axes.plot(values, first, "s--", color=orange, label="first path [ms]")
        if axis == "leaves":
            axes.plot(
                values, [1e3 * middle([r["obstacles_s"] for r in found[v]]) for v in values], "^:", color=green, label="obstacles [ms]"
            )
            axes.set_xscale("log")
        axes.set(yscale="log", xlabel=name, ylabel="time, units in the legend", title=axis.capitalize())

    marks = budget_marks(results)
    if marks:
        ratios = np.sort(np.array([budget_ratios(results, m) for m in marks]), axis=1)
        low, mid, high = (np.quantile(ratios, share, axis=1, method="nearest") for share in (0.25, 0.5, 0.75))
        shown = np.isfinite(mid)
        band = np.where(np.isfinite(high), high, 1e3)
        budget.plot(np.array(marks)[shown], mid[shown], "o-", color=blue, label="median")
        budget.fill_between(np.array(marks)[shown], low[shown], band[shown], color=blue, alpha=0.2, linewidth=0, label="quartiles")
        budget.set_ylim(0.98, min(3.0, 1.3 * float(np.max(mid[shown], initial=1.1))))
    budget.set(xscale="log", xlabel="budget [s]", ylabel="J / best J of any run", title="Budget")
    plain = FuncFormatter(lambda value, _: f"{value:,.7g}")
    for axes in (points, leaves, joints, budget):
        if not any(len(line.get_xdata()) for line in axes.get_lines()):
            axes.set_visible(False)  # not measured
            continue
        for side in (axes.xaxis, axes.yaxis):
            if side.get_scale() == "log":
                side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if axes is not points else (1.0,)))
                side.set_major_formatter(plain)
                side.set_minor_formatter(NullFormatter())
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    written = []
    for suffix in (".png", ".svg"):
        path = stem.with_suffix(suffix)
        figure.savefig(path, dpi=130, metadata={"Date": None} if suffix == ".svg" else None)
        written.append(path)
    return written
