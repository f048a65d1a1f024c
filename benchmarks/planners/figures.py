"""Plots of a comparison: cost against time and against checks with quantile bands, and the share of runs that have a path."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planner_runs import cost_at
from benchmarks.planners.report import CHECKS, LABELS, TIME, best_known, budget_of, compared, methods_of, reached
from lime_planner.core.types import Array

_COLOURS = ("#1b7837", "#762a83", "#c2a5cf", "#e08214", "#2166ac", "#b2182b", "#878787", "#01665e", "#8c510a", "#000000")
_POINTS = 80


def _curves(results: Mapping[str, Any], method: str, grid: Array, column: int) -> Array:
    """Ratios to the best known cost (runs, marks), inf before the first path, NaN beyond what the run reached."""
    best = best_known(results)
    rows = []
    for t in compared(results, method):
        if np.isfinite(scale := best[t["problem"]]):
            rows.append([cost_at(t["curve"], float(g), column) / scale if reached(t, float(g), column) else np.nan for g in grid])
    return np.array(rows).reshape(-1, len(grid))


def bands(curves: Array) -> tuple[Array, Array]:
    """Quartiles (3, marks) and share with a path (marks,) of the runs that reached each mark; NaN where fewer than half of them did."""
    quartiles, solved = np.full((3, curves.shape[1]), np.nan), np.full(curves.shape[1], np.nan)
    for k, column in enumerate(curves.T):
        values = np.sort(column[~np.isnan(column)])
        if len(values) and 2 * len(values) >= len(column):
            quartiles[:, k] = np.quantile(values, (0.25, 0.5, 0.75), method="nearest")
            solved[k] = np.isfinite(values).mean()
    return quartiles, solved


def _grid(results: Mapping[str, Any], column: int) -> Array:
    if column == TIME:
        return np.geomspace(1e-3, budget_of(results), _POINTS)
    most = max((t["checks"] for m in methods_of(results) for t in compared(results, m)), default=1000)
    return np.geomspace(100, max(most, 1000), _POINTS)


def plot(results: Mapping[str, Any], stem: Path, column: int) -> list[Path]:
    """Draw ratio and success against time or checks, as PNG and SVG; the files written."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    grid = _grid(results, column)
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(7.5, 7.0), sharex=True, height_ratios=(2, 1), layout="constrained")
    for method, colour in zip(methods_of(results), _COLOURS, strict=False):
        curves = _curves(results, method, grid, column)
        if not len(curves):
            continue
        (low, middle, high), solved = bands(curves)
        shown = np.isfinite(middle)
        label = LABELS.get(method, method)
        top.plot(grid[shown], middle[shown], color=colour, label=label, linewidth=1.8, drawstyle="steps-post")
        band = np.where(np.isfinite(high), high, 1e6)
        top.fill_between(grid[shown], low[shown], band[shown], color=colour, alpha=0.12, step="post", linewidth=0)
        bottom.plot(grid, 100.0 * solved, color=colour, linewidth=1.8, drawstyle="steps-post")
    top.set(xscale="log", yscale="log", ylabel="J / best known J, median and quartiles")
    top.set_ylim(0.97, 40.0)
    top.set_yticks([1, 1.1, 1.25, 1.5, 2, 3, 5, 10, 20, 40], ["1", "1.1", "1.25", "1.5", "2", "3", "5", "10", "20", "40"])
    top.minorticks_off()
    top.grid(alpha=0.3)
    top.legend(fontsize=8)
    words = "time [s]" if column == TIME else "configurations checked"
    bottom.set(xscale="log", xlabel=words, ylabel="runs with a path [%]", ylim=(-3, 103))
    bottom.grid(alpha=0.3)
    written = []
    for suffix in (".png", ".svg"):
        path = stem.with_suffix(suffix)
        figure.savefig(path, dpi=150, metadata={"Date": None} if suffix == ".svg" else None)
        written.append(path)
    plt.close(figure)
    return written


def all_figures(results: Mapping[str, Any], out: Path, *, checks: bool) -> list[Path]:
    """Draw everything into a folder."""
    written = plot(results, out / "cost_against_time", TIME)
    if checks:
        written += plot(results, out / "cost_against_checks", CHECKS)
    return written
