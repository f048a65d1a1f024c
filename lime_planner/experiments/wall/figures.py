"""Figures of the wall experiment: trees, example paths, and cost against iterations and time. PNG and SVG, colour-blind safe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.types import Array
from lime_planner.experiments.wall.optimum import plane_optimum
from lime_planner.experiments.wall.reference import ROWS, Row
from lime_planner.experiments.wall.trials import WallOptions
from lime_planner.planning.rrt_star.planner import PaperOptions, PaperOutcome, plan_paper
from lime_planner.planning.spaces.plane import PlaneWorld

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Okabe and Ito's palette; every line also has a style of its own.
_BLUE, _GREEN, _SKY, _BLACK, _RED = "#0072B2", "#009E73", "#56B4E9", "#000000", "#D55E00"
_STYLES = {
    "rrt_star": (_BLACK, "-", "o"),
    "apf_rrt_star_1": (_BLUE, "--", "s"),
    "apf_rrt_star_1.5": (_SKY, "-.", "^"),
    "apf_rrt_star_2": (_GREEN, ":", "D"),
    "p_rrt_star": (_RED, (0, (5, 1, 1, 1, 1, 1)), "v"),
}
_LEAF, _STEM, _TREE = "#CFE8C9", "#6B4F3A", "#9A9A9A"


def _figure(rows: int, columns: int, width: float, height: float) -> tuple[Figure, npt.NDArray[Any]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)  # no window system, no global state
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.08)  # type: ignore[union-attr, call-arg]
    return figure, figure.subplots(rows, columns, squeeze=False)


def _save(figure: Figure, folder: Path, name: str) -> list[Path]:
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    for path in paths:
        figure.savefig(path, dpi=160, bbox_inches="tight", pad_inches=0.08)
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


def draw_path(axes: Axes, path: Array | None, colour: str = _RED) -> None:
    """Draw a path with its nodes."""
    if path is not None:
        axes.plot(path[:, 0], path[:, 1], "-o", color=colour, linewidth=2.0, markersize=3.0, zorder=5)


def _typical_seed(options: WallOptions, results: dict[str, Any], row: Row) -> int:
    """Return the seed of the trial whose cost after the last mark is the median of its row."""
    last = str(options.marks[-1])
    solved = [t for t in results["trials"] if t["algorithm"] == row.key and t["marks"][last]["cost"] is not None]
    if not solved:
        return options.seed
    return int(sorted(solved, key=lambda t: (t["marks"][last]["cost"], t["trial"]))[len(solved) // 2]["seed"])


def _run(options: WallOptions, planner: PaperOptions, seed: int, iterations: int) -> PaperOutcome:
    world = options.world
    return plan_paper(world.space(), world.start, world.goal, planner, seed, iterations=iterations)


def trees_figure(options: WallOptions, results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the trees of APF-RRT* for β 1, 1.5 and 2 (the paper's figure on β), of each row's median trial."""
    rows = [row for row in options.rows if row.algorithm == "apf_rrt_star"]
    figure, axes = _figure(1, max(len(rows), 1), 11.0, 4.0)
    for ax, row in zip(axes[0], rows, strict=False):
        outcome = _run(options, options.planner_options(row), _typical_seed(options, results, row), options.iterations)
        draw_world(ax, options.world)
        draw_tree(ax, outcome)
        draw_path(ax, outcome.path)
        ax.set_title(f"β = {row.beta:g}: cost {outcome.final.node_cost:.0f} after {options.iterations}", fontsize=11)
    return _save(figure, folder, "trees")


def paths_figure(options: WallOptions, results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the best path of one run of APF-RRT*, β = 1.5, at the marks (the median trial of its row)."""
    row = next((row for row in options.rows if row.key == "apf_rrt_star_1.5"), options.rows[0])
    seed = _typical_seed(options, results, row)
    figure, axes = _figure(1, len(options.marks), 11.0 / 3.0 * len(options.marks), 4.0)
    for ax, mark in zip(axes[0], options.marks, strict=True):
        at_mark = _run(options, options.planner_options(row), seed, mark)  # the same run, cut short
        draw_world(ax, options.world)
        draw_tree(ax, at_mark)
        draw_path(ax, at_mark.path)
        ax.set_title(f"{mark} iterations: cost {at_mark.final.node_cost:.0f}, {at_mark.final.nodes_inside} nodes inside", fontsize=11)
    return _save(figure, folder, "paths")


def cheap_figure(options: WallOptions, results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw a path for C_perm = 1 beside one for the experiment's own C_perm, with the exact optima of J."""
    row = next((row for row in options.rows if row.key == "apf_rrt_star_1.5"), options.rows[0])
    seed = _typical_seed(options, results, row)
    figure, axes = _figure(1, 2, 7.6, 4.6)
    plain = options.planner_options(row)
    for ax, c_perm in zip(axes[0], (1.0, plain.c_perm), strict=True):
        planner = PaperOptions(**{**vars(plain), "c_perm": c_perm})
        outcome = _run(options, planner, seed, options.iterations)
        optimum = plane_optimum(options.world, planner.leaf_weight)
        draw_world(ax, options.world)
        draw_path(ax, outcome.path)
        ax.plot(optimum.path[:, 0], optimum.path[:, 1], "--", color=_BLUE, linewidth=1.6, zorder=4)
        ax.set_title(f"C_perm = {c_perm:g}\nJ found {outcome.final.integral_cost:.1f}, optimum {optimum.cost:.1f}", fontsize=11)
    axes[0][0].plot([], [], "-o", color=_RED, markersize=3.0, label=f"{row.label} after {options.iterations} iterations")
    axes[0][0].plot([], [], "--", color=_BLUE, label="cheapest path")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return _save(figure, folder, "c_perm_1")


def _curves(results: dict[str, Any], key: str, name: str) -> Array:
    rows = [t["curve"][name] for t in results["trials"] if t["algorithm"] == key]
    return np.array([[np.nan if v is None else v for v in row] for row in rows], dtype=np.float64)


def curves_figure(results: dict[str, Any], folder: Path, x_name: str, y_name: str, name: str) -> list[Path]:
    """Draw one quantity over another, a panel for each algorithm: median and quantile bands, the other medians in grey."""
    rows = [row for row in ROWS if len(_curves(results, row.key, y_name))]
    figure, axes = _figure(1, len(rows), 2.9 * len(rows), 3.7)
    medians: dict[str, tuple[Array, Array]] = {}
    for row in rows:
        y = _curves(results, row.key, y_name)
        solved = np.isfinite(y).mean(axis=0) >= 0.9  # quantiles of the few quick ones would flatter
        x = np.median(_curves(results, row.key, x_name), axis=0) * (1e3 if x_name == "time_s" else 1.0)
        medians[row.key] = (x[solved], np.nanpercentile(y[:, solved], [10, 25, 50, 75, 90], axis=0) if solved.any() else np.empty((5, 0)))
    for ax, row in zip(axes[0], rows, strict=True):
        colour, style, marker = _STYLES[row.key]
        for other, (x, bands) in medians.items():
            if other != row.key:
                ax.plot(x, bands[2], color="#BDBDBD", linewidth=1.0, zorder=1)
        x, bands = medians[row.key]
        ax.fill_between(x, bands[0], bands[4], color=colour, alpha=0.15, linewidth=0, label="10th to 90th percentile")
        ax.fill_between(x, bands[1], bands[3], color=colour, alpha=0.25, linewidth=0, label="25th to 75th percentile")
        ax.plot(x, bands[2], linestyle=style, color=colour, marker=marker, markevery=3, markersize=4.5, linewidth=1.8, label="median")
        ax.set_title(row.label, fontsize=11)
        ax.set_xlabel("planning time [ms]" if x_name == "time_s" else "iterations")
        ax.grid(True, color="#E8E8E8", linewidth=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.sharex(axes[0][0])
        ax.sharey(axes[0][0])
    axes[0][0].set_ylabel("length + C_perm × nodes inside" if y_name == "cost" else "J = length + C_perm / δ × length inside")
    figure.text(0.01, 0.02, "grey: the other medians", fontsize=9, color="#777777")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=3, frameon=False)
    return _save(figure, folder, name)


def all_figures(options: WallOptions, results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw everything into a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [*trees_figure(options, results, folder), *paths_figure(options, results, folder), *cheap_figure(options, results, folder)]
    for x, y, name in (("iterations", "cost", "cost_iterations"), ("time_s", "cost", "cost_time"), ("iterations", "J", "j_iterations")):
        paths += curves_figure(results, folder, x, y, name)
    return paths
