"""Draws the figures of docs/how-it-works.md, and the first plan's picture, from the package's own parts; `python docs/tools/draw_figures.py [name ...]` chooses some.

Colours are Okabe and Ito's, which every kind of colour vision tells apart; every axis has its unit. A minute or two on two cores.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch
from PIL import Image

from lime_planner import Robot, draw, generate_plant, plan
from lime_planner.api import _warm_pipeline
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import settings_from
from lime_planner.output.approach_lines import APPROACH_COLOURS, APPROACH_WORDS
from lime_planner.pipeline.figures import leaf_profile
from lime_planner.pipeline.goals import find_goals, measure, sampling_box
from lime_planner.pipeline.grasps.goals import goals_of
from lime_planner.pipeline.targets import fruit_target
from lime_planner.planning.lime_star.options import LimeOptions
from lime_planner.planning.lime_star.planner import plan_lime

FIGURES = Path(__file__).resolve().parent.parent / "figures"
GREEN, BROWN, BLUE, ORANGE, SKY, GREY = "#009e73", "#7a4a1e", "#0072b2", "#d55e00", "#56b4e9", "#777777"
JOINT_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
PLANT = 15
GRASPED = 5  # of its limes, in the figure of the grasps
LEAFY = 7  # a plant at whose lime leaves cannot but be touched: the one of docs/tutorials/first-plan.md


def save(figure: Any, name: str) -> None:
    """Write a figure as SVG, the same bytes for the same drawing."""
    figure.savefig(FIGURES / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight")
    plt.close(figure)
    print(f"figures/{name}.svg")


def tidy(ax: Axes, x: str, y: str) -> None:
    """Name the axes, take the upper and right frame away."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.spines[["top", "right"]].set_visible(False)


def stages() -> None:
    """The way from clouds to a motion."""
    figure, ax = plt.subplots(figsize=(9.6, 3.4))
    ax.set_xlim(0, 96)
    ax.set_ylim(0, 34)
    ax.axis("off")
    boxes = (
        (0, 18, "clouds, target,\njoint state", GREY),
        (20, 18, "scene\nlabels, fields", GREEN),
        (40, 18, "goals\ninverse\nkinematics", BLUE),
        (60, 18, "search\nlime_star", BLUE),
        (80, 18, "certificate\nexact meshes,\nevery point", ORANGE),
        (80, 3, "timing\nlimits, leaves", BLUE),
        (60, 3, "contract\nevery rule", ORANGE),
        (40, 3, "last look\nnewest inputs", ORANGE),
        (20, 3, "motion", GREY),
    )
    for x, y, words, colour in boxes:
        ax.add_patch(FancyBboxPatch((x + 0.6, y), 14.4, 8, boxstyle="round,pad=0.5", facecolor="white", edgecolor=colour, linewidth=1.6))
        ax.text(x + 7.8, y + 4, words, ha="center", va="center", fontsize=8.5)
    for (x0, y0, *_), (x1, y1, *_) in itertools.pairwise(boxes):
        tail, head = (x0 + 15.6, y0 + 4), (x1, y1 + 4)
        if x0 == x1:
            tail, head = (x0 + 7.8, y0 - 0.6), (x1 + 7.8, y1 + 8.6)
        elif x1 < x0:
            tail, head = (x0, y0 + 4), (x1 + 15.6, y1 + 4)
        ax.add_patch(FancyArrowPatch(tail, head, arrowstyle="-|>", mutation_scale=11, color="#444444", linewidth=1.2))
    ax.add_patch(
        FancyArrowPatch(
            (87, 26.7), (67, 26.7), connectionstyle="arc3,rad=0.25", arrowstyle="-|>", mutation_scale=11, color=ORANGE, linewidth=1.2
        )
    )
    ax.text(77.5, 30.2, "refused: once more, with more margin", ha="center", fontsize=7.5, color=ORANGE)
    save(figure, "how-stages")


def fields(robot: Robot) -> None:
    """A slice through the distance fields of a plant."""
    scene = generate_plant(PLANT)
    assert scene.target_pose is not None
    pipeline, _ = _warm_pipeline(robot)
    parts = pipeline.obstacles(scene, scene.target_pose[:3], settings_from()).world.fields
    height = scene.target_pose[2]
    layer = round((height - parts.origin[2]) / parts.spacing_m)
    x, y = (parts.origin[k] + parts.spacing_m * np.arange(parts.values.shape[k]) for k in (0, 1))
    near_x, near_y = (x > 0.25) & (x < 0.98), (y > -0.38) & (y < 0.38)
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.0), sharey=True, layout="constrained")
    for ax, channel, points, colours, title in (
        (axes[0], 1, scene.leaf_points, "BuGn_r", "distance to the nearest leaf point"),
        (axes[1], 0, scene.stem_points, "YlOrBr_r", "distance to the nearest stem point"),
    ):
        values = 100.0 * parts.values[:, :, layer, channel][np.ix_(near_x, near_y)].T
        shown = ax.contourf(x[near_x], y[near_y], values, levels=np.arange(0, 11, 1), cmap=colours, extend="max")
        slab = points[np.abs(points[:, 2] - height) < 0.006]
        ax.plot(slab[:, 0], slab[:, 1], ".", color="black", markersize=1.5, rasterized=True)
        ax.plot(*scene.target_pose[:2], marker="P", color="#cc79a7", markersize=11, markeredgecolor="white", linestyle="none")
        ax.set_aspect("equal")
        ax.set_title(title, fontsize=10)
        tidy(ax, "x [m]", "y [m]" if channel == 1 else "")
        figure.colorbar(shown, ax=ax, shrink=0.85, label="distance [cm]")
    axes[1].text(
        *(scene.target_pose[:2] + [0.02, 0.02]),
        "target",
        fontsize=9,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
    )
    save(figure, "how-fields")


def models(robot: Robot) -> None:
    """The fast model's clearance against the meshes'."""
    scene = generate_plant(PLANT)
    assert scene.target_pose is not None
    pipeline, _ = _warm_pipeline(robot)
    obstacles = pipeline.obstacles(scene, scene.target_pose[:3], settings_from())
    space, checker = obstacles.measuring_space(), obstacles.exact_checker()
    rng = np.random.default_rng(4)
    goals = find_goals(obstacles, checker, pose_to_matrix(scene.target_pose), robot.home, rng).configurations
    rows: list[tuple[float, float]] = []
    while len(rows) < 400:
        q = goals[rng.integers(len(goals))] + rng.normal(0.0, 0.25, robot.n)
        if robot.within_limits(q):
            fast, exact = measure(space, q)[0], checker.stem_distance(q)
            if 0.0 < exact < 0.024:
                rows.append((1e3 * exact, 1e3 * fast))
    exact, fast = np.array(rows).T
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 3.6), layout="constrained")
    axes[0].plot([0, 24], [0, 24], color=GREY, linewidth=1)
    axes[0].plot(exact, fast, "o", color=BLUE, markersize=3.5, alpha=0.6)
    axes[0].axhline(5, color=ORANGE, linewidth=1)
    axes[0].text(24, 3.3, "what the search requires", color=ORANGE, ha="right", fontsize=8.5)
    tidy(axes[0], "clearance by the meshes [mm]", "clearance by the fast model [mm]")
    axes[1].hist(fast - exact, bins=np.arange(-1.5, 1.51, 0.1), color=BLUE)
    axes[1].axvline(1, color=ORANGE, linewidth=1)
    axes[1].text(1.05, axes[1].get_ylim()[1] * 0.8, "allowed\nfor", color=ORANGE, ha="left", fontsize=8.5)
    tidy(axes[1], "fast model − meshes [mm]", "configurations")
    save(figure, "how-models")


def anytime(robot: Robot) -> None:
    """Cost against search time, on ten plants."""
    pipeline, _ = _warm_pipeline(robot)
    marks = np.geomspace(0.01, 2.0, 60)
    curves = []
    for seed in range(40):
        if len(curves) == 10:
            break
        scene = generate_plant(seed)
        if scene.target_pose is None:
            continue
        settings = settings_from()
        T = pose_to_matrix(scene.target_pose)
        obstacles = pipeline.obstacles(scene, T[:3, 3], settings)
        goals = find_goals(obstacles, obstacles.exact_checker(), T, robot.home, np.random.default_rng(1))
        if goals.status is not None:
            continue
        obstacles = obstacles.with_anchors(goals.anchors, goals.needs)
        space = obstacles.space(*sampling_box(obstacles, robot.home, goals.configurations))
        outcome = plan_lime(space, robot.home, goals.configurations, LimeOptions(weight=settings.weight), 1, deadline_s=2.0)
        if outcome.path is None:
            continue
        times, costs = outcome.history[:, 0], outcome.history[:, 2]
        at = np.searchsorted(times, marks, side="right") - 1
        curves.append(np.where(at >= 0, costs[np.maximum(at, 0)], np.nan) / outcome.cost)
    figure, ax = plt.subplots(figsize=(6.6, 3.6), layout="constrained")
    for curve in curves:
        ax.plot(marks, curve, color=SKY, linewidth=1, drawstyle="steps-post")
    everywhere = np.isfinite(curves).all(axis=0)
    ax.plot(marks[everywhere], np.median(curves, axis=0)[everywhere], color=BLUE, linewidth=2.4, label="median of ten plants")
    ax.axvline(0.5, color=ORANGE, linewidth=1, linestyle="--", label="default time_budget_s")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(0.9, None)
    ax.legend(frameon=False, fontsize=8.5)
    tidy(ax, "search time [s]", "cost / cost after 2 s [–]")
    save(figure, "how-anytime")


def timing(robot: Robot) -> None:
    """Positions and velocities of one motion, slower among leaves."""
    scene = generate_plant(LEAFY)
    result = plan(scene, robot, seed=1, iterations=3000, leaf_speed_scale=0.3, c_perm=0.1)
    assert result.trajectory is not None, result.message
    motion = result.trajectory
    times = motion.times()
    pipeline, _ = _warm_pipeline(robot)
    assert scene.target_pose is not None
    leaf = leaf_profile(pipeline.obstacles(scene, scene.target_pose[:3], settings_from()), np.asarray(motion.positions))[0] > 0
    figure, axes = plt.subplots(2, 1, figsize=(8.0, 4.8), sharex=True, layout="constrained")
    for ax in axes:
        low, high = 0, 1
        ax.fill_between(
            times, low, high, where=leaf, transform=ax.get_xaxis_transform(), color=GREEN, alpha=0.18, linewidth=0, label="touching leaves"
        )
    for k, colour in enumerate(JOINT_COLOURS[: robot.n]):
        axes[0].plot(times, np.degrees(motion.positions[:, k] - motion.positions[0, k]), color=colour, label=f"joint {k + 1}")
        axes[1].plot(times, np.degrees(motion.velocities[:, k]), color=colour)
    for sign in (-1, 1):
        for limit in sorted(set(np.degrees(robot.velocity_limits).round(3))):
            axes[1].axhline(sign * limit, color=GREY, linewidth=1, linestyle=":")
    axes[1].text(times[-1], np.degrees(robot.velocity_limits.max()) + 1.5, "limits of the joints", ha="right", color=GREY, fontsize=8.5)
    axes[0].legend(frameon=False, fontsize=8.5, ncols=7, loc="lower left", bbox_to_anchor=(-0.02, 1.0), columnspacing=1.0, handlelength=1.5)
    tidy(axes[0], "", "way from the start [°]")
    tidy(axes[1], "time [s]", "velocity [°/s]")
    save(figure, "how-timing")


def weights(robot: Robot) -> None:
    """Leaf contact and length against the leaf weight, on ten plants at whose lime leaves cannot but be touched."""
    values = np.array([0.001, 0.01, 0.1, 1.0, 10.0, 100.0, 1000.0])
    length, contact = [], []
    for seed in range(60):
        if len(length) == 10:
            break
        scene = generate_plant(seed)
        if scene.target_pose is None:
            continue
        usual = plan(scene, robot, seed=1, iterations=1000)
        if not usual.succeeded or usual.leaf_contact_rad < 0.01:
            continue
        results = [plan(scene, robot, seed=1, iterations=4000, c_perm=float(c)) for c in values]
        if all(result.succeeded for result in results):
            print(f"  plant {seed}", flush=True)
            length.append([result.path_length_rad for result in results])
            contact.append([result.leaf_contact_rad for result in results])
    figure, ax = plt.subplots(figsize=(6.6, 3.8), layout="constrained")
    twin = ax.twinx()
    for axis, data, colour, marker in ((ax, contact, ORANGE, "o"), (twin, length, BLUE, "s")):
        low, middle, high = np.quantile(np.array(data), (0.25, 0.5, 0.75), axis=0)
        axis.fill_between(values, low, high, color=colour, alpha=0.15, linewidth=0)
        axis.plot(values, middle, color=colour, marker=marker, linewidth=2)
        axis.set_ylim(0, None)
    ax.set_xscale("log")
    tidy(ax, "c_perm [–]; the leaf weight is c_perm / 0.1 rad", "leaf contact [rad]")
    twin.set_ylabel("path length [rad]", color=BLUE)
    ax.yaxis.label.set_color(ORANGE)
    twin.spines["top"].set_visible(False)
    save(figure, "how-weights")


def grasps(robot: Robot) -> None:
    """What became of the approaches to one lime, over direction and roll, and what the free ones cost."""
    scene = generate_plant(PLANT)
    assert scene.fruit_centres is not None and scene.fruit_radii is not None
    pipeline, _ = _warm_pipeline(robot)
    settings = settings_from()
    target = fruit_target(scene.fruit_centres[GRASPED].astype(np.float64), float(scene.fruit_radii[GRASPED]))
    obstacles = pipeline.obstacles(scene, target.spot(scene, settings), settings)
    found = goals_of(obstacles, obstacles.exact_checker(), target, robot.home, np.random.default_rng(1))
    assert found.approaches is not None and len(found.costs), found.sentence
    ahead = target.centre / np.linalg.norm(target.centre)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)

    def flat(poses: Any) -> tuple[Any, Any]:
        """Directions (P, 3) in the plane in which equal areas of the sphere stay equal (Lambert's), in degrees from the ray."""
        ways = poses[:, :3, 2]
        off = np.degrees(2.0 * np.sin(0.5 * np.arccos(np.clip(ways @ ahead, -1.0, 1.0))))
        turn = np.arctan2(ways @ above, ways @ right)
        return off * np.cos(turn), off * np.sin(turn)

    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.4), layout="constrained")
    poses, outcomes = found.approaches.poses, found.approaches.outcomes
    for outcome, colour in APPROACH_COLOURS.items():
        which = outcomes == outcome
        if which.any():
            axes[0].plot(*flat(poses[which]), "o", color=colour, markersize=3.6, label=f"{APPROACH_WORDS[outcome]} ({int(which.sum())})")
    axes[0].set_title(f"{len(poses)} approaches tried", fontsize=10)
    order = np.argsort(-found.costs)
    shown = axes[1].scatter(
        *flat(found.poses[order]), c=found.costs[order], s=34, cmap="viridis_r", norm="log", edgecolor="black", linewidth=0.4
    )
    figure.colorbar(shown, ax=axes[1], shrink=0.85, label="price of the grasp [rad]")
    chosen = int(np.argmin(found.costs))
    axes[1].plot(
        *flat(found.poses[chosen : chosen + 1]), "o", markersize=13, markerfacecolor="none", markeredgecolor=ORANGE, markeredgewidth=1.6
    )
    axes[1].set_title(f"{len(np.unique(found.costs))} goals of the search; ringed: the cheapest", fontsize=10)
    rim = np.degrees(2.0 * np.sin(0.5 * settings.approach_cone_rad))
    marks = np.array([30.0, 60.0, 90.0])
    for ax in axes:
        for degrees in marks:
            radius = np.degrees(2.0 * np.sin(0.5 * np.radians(degrees)))
            ax.add_patch(Circle((0.0, 0.0), radius, fill=False, color=GREY, linewidth=0.6, linestyle=":"))
            ax.text(0.0, radius + 1.0, f"{degrees:.0f}°", ha="center", fontsize=7.5, color=GREY)
        ax.set_xlim(-rim - 6, rim + 6)
        ax.set_ylim(-rim - 6, rim + 10)
        ax.set_aspect("equal")
        ax.axis("off")
    axes[0].legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(-0.12, 0.02), ncols=2)
    save(figure, "how-grasps")


def first_plan(robot: Robot) -> None:
    """The picture of docs/tutorials/first-plan.md, as its commands draw it, with fewer pixels and colours."""
    scene = generate_plant(LEAFY)
    result = plan(scene, robot, seed=1, iterations=2000)
    target = FIGURES.parent / "demo.png"
    draw(result, scene, robot, target)
    with Image.open(target) as picture:
        plain = picture.convert("RGB")
    small = plain.resize((1600, round(plain.height * 1600 / plain.width)), Image.Resampling.LANCZOS)
    small.quantize(256, kmeans=3, dither=Image.Dither.NONE).save(target, optimize=True)
    print(target.name)


FIGURES_BY_NAME = {
    "first_plan": first_plan,
    "stages": stages,
    "fields": fields,
    "models": models,
    "grasps": grasps,
    "anytime": anytime,
    "timing": timing,
    "weights": weights,
}


def main() -> None:
    """Draw all figures, or those named."""
    plt.rcParams.update({"font.size": 9.5, "svg.hashsalt": "lime_planner", "savefig.dpi": 200, "axes.grid": False})
    robot = Robot.load("kinova_j2s6s200")
    for name in sys.argv[1:] or FIGURES_BY_NAME:
        drawn = FIGURES_BY_NAME[name]
        if drawn is stages:
            drawn()
        else:
            drawn(robot)


if __name__ == "__main__":
    main()
