"""Plots of the damage experiment: success and leaves touched by method and density, and the paired ratios. Colour-blind safe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.experiments.damage.report import figure as figure_of
from lime_planner.experiments.damage.report import graspable, label, succeeded

# Okabe and Ito's palette; bars have hatches of their own too.
_LOOKS = {
    "solid": ("#999999", "//"),
    "ignored": ("#D55E00", ""),
    "apf_rrt_star": ("#CC79A7", ".."),
    "binary": ("#0072B2", ""),
    "graded": ("#56B4E9", "\\\\"),
    "free": ("#009E73", ""),
    "candidates": ("#F0E442", "xx"),
}


def _axes(columns: int, width: float, height: float) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(drawn)  # no window system, no global state
    return drawn, drawn.subplots(1, columns, squeeze=False)[0]


def _look(method: str) -> dict[str, Any]:
    colour, hatch = _LOOKS[method.partition(":")[0]]
    return {"color": colour, "hatch": hatch, "edgecolor": "white", "linewidth": 0.5}


def bars_figure(results: dict[str, Any], folder: Path) -> Path:
    """Draw success, leaves touched and swept area of each method at each density."""
    densities = [d for d in results["options"]["densities"] if graspable(results, d)]
    methods = list(results["options"]["methods"])
    drawn, axes = _axes(3, 13.0, 4.0)
    width = 0.8 / len(methods)
    for k, method in enumerate(methods):
        heights: list[list[float]] = [[], [], []]
        for density in densities:
            trials = graspable(results, density)
            solved = [t for t in trials if succeeded(t, method)]
            heights[0].append(100.0 * len(solved) / len(trials))
            for row, name in ((1, "leaves"), (2, "area_cm2")):
                heights[row].append(float(np.mean([figure_of(t, method, name) for t in solved])) if solved else np.nan)
        places = np.arange(len(densities)) + (k - (len(methods) - 1) / 2.0) * width
        for ax, values in zip(axes, heights, strict=True):
            ax.bar(places, values, width, label=label(method), **_look(method))
    for ax, words in zip(axes, ("success [%]", "leaves touched, mean", "swept leaf area, mean [cm²]"), strict=True):
        ax.set_xticks(np.arange(len(densities)), densities)
        ax.set_title(words, fontsize=11)
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(True, axis="y", color="#E8E8E8", linewidth=0.6)
        ax.set_axisbelow(True)
    handles, labels = axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=len(methods), frameon=False)
    path = folder / "damage.png"
    drawn.savefig(path, dpi=130)
    return path


def paired_figure(results: dict[str, Any], folder: Path) -> Path:
    """Draw each grasp as a point: leaves touched with leaves ignored against leaves touched by another method."""
    trials = graspable(results)
    methods = [m for m in results["options"]["methods"] if m.partition(":")[0] in ("apf_rrt_star", "binary", "graded")]
    drawn, axes = _axes(len(methods), 3.9 * len(methods), 4.0)
    shift = np.random.default_rng(0)
    most = 1.0
    for ax, method in zip(axes, methods, strict=True):
        pairs = [t for t in trials if succeeded(t, method) and succeeded(t, "ignored")]
        points = np.array([[figure_of(t, m, "leaves") for m in ("ignored", method)] for t in pairs]).reshape(-1, 2)
        most = max(most, float(points.max(initial=0.0)))
        jittered = points + shift.uniform(-0.25, 0.25, points.shape)
        ax.scatter(*jittered.T, s=14, alpha=0.6, color=_LOOKS[method.partition(":")[0]][0], linewidths=0)
        ax.set_title(f"{label(method)} ({len(pairs)} grasps)", fontsize=10)
        ax.set_xlabel("leaves touched, leaves ignored")
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes:
        ax.plot([0, most], [0, most], color="#777777", linewidth=0.8)
        ax.plot([0, most], [0, most / 2.0], color="#777777", linewidth=0.8, linestyle=":")
        ax.set(xlim=(-0.7, most + 0.7), ylim=(-0.7, most + 0.7), aspect="equal")
    axes[0].set_ylabel("leaves touched by the method")
    path = folder / "damage_pairs.png"
    drawn.savefig(path, dpi=130, bbox_inches="tight")
    return path


def all_figures(results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw what the results allow and return the files."""
    if not graspable(results):
        return []
    paths = [bars_figure(results, folder)]
    if "ignored" in results["options"]["methods"] and len(results["options"]["methods"]) > 1:
        paths.append(paired_figure(results, folder))
    return paths
