"""Figures of the wall experiment: trees, example paths, and cost against iterations and time. PNG and SVG, colour-blind safe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lime_planner.experiments.plane_optimum import plane_optimum
from lime_planner.experiments.wall_reference import ROWS, Row
from lime_planner.experiments.wall_trials import WallOptions
from lime_planner.planning.paper import PaperOptions, PaperOutcome, plan_paper
from lime_planner.planning.plane import PlaneWorld

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette; every line also has a style of its own.
_BLUE, _ORANGE, _GREEN, _PURPLE, _SKY, _BLACK = "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000"
_RED = "#D55E00"
_STYLES = {
    "rrt_star": (_BLACK, "-", "o"),
    "apf_rrt_star_1": (_BLUE, "--", "s"),
    "apf_rrt_star_1.5": (_SKY, "-.", "^"),
    "apf_rrt_star_2": (_GREEN, ":", "D"),
    "p_rrt_star": (_RED, (0, (5, 1, 1, 1, 1, 1)), "v"),
}
_LEAF, _STEM, _TREE = "#CFE8C9", "#6B4F3A", "#9A9A9A"


def _figure(columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)  # no window system, no global state
    axes = figure.subplots(1, columns, squeeze=False)
    return figure, list(axes[0])


def _save(figure: Figure, folder: Path, name: str) -> list[Path]:
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    for path in paths:
        figure.savefig(path, dpi=160)
    return paths


def draw_world(axes: Axes, world: PlaneWorld) -> None:
    """Draw the map, the leaves, the stems, start and goal."""
    from matplotlib.patches import Polygon

    for polygons, colour, hatch in ((world.permeable, _LEAF, ""), (world.impermeable, _STEM, "////")):
        for corners in polygons:
            look = {"facecolor": colour, "edgecolor": "#5E8C57", "linewidth": 0.8, "hatch": hatch, "zorder": 1}
            axes.add_patch(Polygon(np.array(corners), closed=True, **look))
    axes.plot(*world.start, marker="o", color=_BLACK, markersize=7, zorder=6)
    axes.plot(*world.goal, marker="*", color=_BLACK, markersize=12, zorder=6)
    axes.set(xlim=(world.lower[0], world.upper[0]), ylim=(world.lower[1], world.upper[1]), aspect="equal", xticks=[], yticks=[])


def draw_tree(axes: Axes, outcome: PaperOutcome, colour: str = _TREE, width: float = 0.5) -> None:
    """Draw every edge of the search tree."""
    from matplotlib.collections import LineCollection

    tree = outcome.tree
    children = np.nonzero(tree.parent >= 0)[0]
    lines = np.stack([tree.rows[children], tree.rows[tree.parent[children]]], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=width, zorder=2, rasterized=True))


def draw_path(axes: Axes, path: npt.NDArray[np.float64] | None, colour: str = _RED) -> None:
    """Draw a path with its nodes."""
    if path is not None:
        axes.plot(path[:, 0], path[:, 1], "-o", color=colour, linewidth=2.0, markersize=3.0, zorder=5)


def _run(options: WallOptions, planner: PaperOptions, iterations: int) -> PaperOutcome:
    world = options.world
    return plan_paper(world.space(), world.start, world.goal, planner, options.seed, iterations=iterations)


def trees_figure(options: WallOptions, folder: Path) -> list[Path]:
    """Draw the trees of APF-RRT* for β 1, 1.5 and 2 (the paper's figure on β)."""
    rows = [row for row in ROWS if row.algorithm == "apf_rrt_star"]
    figure, axes = _figure(len(rows), 11.0, 3.9)
    for ax, row in zip(axes, rows, strict=True):
        outcome = _run(options, options.planner_options(row), options.iterations)
        draw_world(ax, options.world)
        draw_tree(ax, outcome)
        draw_path(ax, outcome.path)
        ax.set_title(f"β = {row.beta:g}: cost {outcome.final.node_cost:.0f} after {options.iterations}")
    return _save(figure, folder, "trees")


def paths_figure(options: WallOptions, folder: Path) -> list[Path]:
    """Draw the best path of one run of APF-RRT*, β = 1.5, at the marks."""
    row = Row("", "", "apf_rrt_star", 1.5)
    figure, axes = _figure(len(options.marks), 11.0 / 3.0 * len(options.marks), 3.9)
    for ax, mark in zip(axes, options.marks, strict=True):
        at_mark = _run(options, options.planner_options(row), mark)  # the same run, shorter: the tree as it was
        draw_world(ax, options.world)
        draw_tree(ax, at_mark)
        draw_path(ax, at_mark.path)
        ax.set_title(f"{mark} iterations: cost {at_mark.final.node_cost:.0f}, {at_mark.final.nodes_inside} nodes inside")
    return _save(figure, folder, "paths")


def cheap_figure(options: WallOptions, folder: Path) -> list[Path]:
    """Draw a path for C_perm = 1 beside one for C_perm = 100, with the exact optima of J."""
    row = Row("", "", "apf_rrt_star", 1.5)
    figure, axes = _figure(2, 7.6, 4.2)
    for ax, c_perm in zip(axes, (1.0, 100.0), strict=True):
        planner = PaperOptions(**{**vars(options.planner_options(row)), "c_perm": c_perm})
        outcome = _run(options, planner, options.iterations)
        optimum = plane_optimum(options.world, planner.leaf_weight)
        draw_world(ax, options.world)
        draw_path(ax, outcome.path)
        ax.plot(optimum.path[:, 0], optimum.path[:, 1], "--", color=_BLUE, linewidth=1.6, zorder=4)
        ax.set_title(f"C_perm = {c_perm:g}")
        ax.plot([], [], "-o", color=_RED, markersize=3.0, label=f"found, J {outcome.final.integral_cost:.1f}")
        ax.plot([], [], "--", color=_BLUE, label=f"optimum, J {optimum.cost:.1f}")
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=2, frameon=False, fontsize=9)
    return _save(figure, folder, "c_perm_1")


def _curves(results: dict[str, Any], key: str, name: str) -> npt.NDArray[np.float64]:
    rows = [t["curve"][name] for t in results["trials"] if t["algorithm"] == key]
    return np.array([[np.nan if v is None else v for v in row] for row in rows], dtype=np.float64)


def _band(ax: Axes, x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], key: str, label: str) -> None:
    """Draw the median of the columns of y over x, with the band from the 10th to the 90th percentile."""
    solved = np.isfinite(y).mean(axis=0) >= 0.9
    if not solved.any():
        return
    colour, style, marker = _STYLES[key]
    low, middle, high = np.nanpercentile(y[:, solved], [10, 50, 90], axis=0)
    every = max(1, int(solved.sum()) // 7)
    ax.plot(x[solved], middle, linestyle=style, color=colour, marker=marker, markevery=every, markersize=4.5, linewidth=1.6, label=label)
    ax.fill_between(x[solved], low, high, color=colour, alpha=0.12, linewidth=0)


def curves_figure(results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the paper's cost against iterations and against time, and J against iterations."""
    figure, axes = _figure(3, 13.0, 4.4)
    for row in ROWS:
        cost = _curves(results, row.key, "cost")
        if not len(cost):
            continue
        iterations = _curves(results, row.key, "iterations")[0]
        time_ms = 1e3 * np.nanmedian(_curves(results, row.key, "time_s"), axis=0)
        _band(axes[0], iterations, cost, row.key, row.label)
        _band(axes[1], time_ms, cost, row.key, row.label)
        _band(axes[2], iterations, _curves(results, row.key, "J"), row.key, row.label)
    axes[0].set(xlabel="iterations", ylabel="length + C_perm × nodes inside", title="the paper's cost")
    axes[1].set(xlabel="planning time [ms]", title="the paper's cost over time")
    axes[2].set(xlabel="iterations", ylabel="J = length + (C_perm / δ) × length inside", title="what the path really crosses")
    for ax in axes:
        ax.grid(True, color="#E5E5E5", linewidth=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylim(axes[1].get_ylim())
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.suptitle("Median, and the band from the 10th to the 90th percentile of the trials", fontsize=11)
    return _save(figure, folder, "cost")


def all_figures(options: WallOptions, results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw everything into a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = trees_figure(options, folder) + paths_figure(options, folder) + cheap_figure(options, folder)
    return paths + curves_figure(results, folder)
