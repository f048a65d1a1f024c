"""The paper's simulation figure: start configuration, the baseline's path, APF-RRT*'s path; plant green, lime yellow, arm dark grey."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.atomic_files import replacing
from lime_planner.core.types import Array, Int64
from lime_planner.experiments.lime.trials import ALGORITHMS, FIXED, LABELS, Task, plan_trial, space_of
from lime_planner.experiments.problems import pipeline_of, scene_of
from lime_planner.experiments.runs.results_file import Plan
from lime_planner.output.render import Image, View, cloud_layer, compose, halved, mesh_layer
from lime_planner.robot.model import Robot, home
from lime_planner.scene.scene import Scene

_LEAF, _STEM, _LIME, _ARM, _PATH = (0.16, 0.62, 0.44), (0.45, 0.27, 0.12), (0.95, 0.88, 0.25), (0.27, 0.28, 0.30), (0.84, 0.37, 0.0)
_PIXEL_M = 0.0016
_GHOSTS = 3  # configurations drawn between start and goal
_VEIL = 0.5  # opacity of the plant in front of the arm


def _arm(robot: Robot, q: Array) -> tuple[Array, Int64]:
    poses = robot.link_poses(q)
    counts = np.cumsum([0] + [len(link.vertices) for link in robot.links])
    vertices = [link.vertices @ poses[link.joint, :3, :3].T + poses[link.joint, :3, 3] for link in robot.links]
    triangles = [link.triangles.astype(np.int64) + count for link, count in zip(robot.links, counts[:-1], strict=True)]
    return np.concatenate(vertices), np.concatenate(triangles)


def _panel(view: View, scene: Scene, robot: Robot, configurations: list[tuple[Array, float]]) -> Image:
    """Draw the plant, and the arm at configurations with their opacities."""
    assert scene.leaf_triangles is not None
    tone = 0.8 + 0.35 * ((np.asarray(scene.leaf_triangle_ids) * 0.6180339887) % 1.0)
    corners = scene.leaf_triangles.reshape(-1, 3)
    plant = [
        mesh_layer(view, corners, np.arange(len(corners)).reshape(-1, 3), np.clip(np.outer(tone, _LEAF), 0.0, 1.0)),
        cloud_layer(view, scene.stem_points, _STEM, (0.0018, 0.0045)),
        cloud_layer(view, scene.fruit_points, _LIME, (0.0012, 0.0045)),
    ]
    solid = [(mesh_layer(view, *_arm(robot, q), _ARM), opacity) for q, opacity in configurations]
    return halved(compose(plant, solid, _VEIL))


def _along(path: Array, count: int) -> Array:
    """Configurations at equal lengths along a polyline (M, n), ends included."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    wanted = np.linspace(0.0, lengths[-1], count)
    return np.stack([np.interp(wanted, lengths, column) for column in path.T], axis=1)


def _plant_to_show(results: dict[str, Any]) -> int:
    """The default plant, or the first one on which every planner found a path if they did not all find one there."""
    found = {(t["plant"], t["algorithm"]) for t in results["trials"] if t["variant"] == FIXED and t["cost"] is not None}
    plants = [int(scene["seed"]) for scene in results["scenes"]]
    return next((plant for plant in plants if all((plant, key) in found for key in ALGORITHMS)), plants[0])


def typical(plan: Plan[Task], results: dict[str, Any], plant: int, algorithm: str) -> Task | None:
    """Return the trial on a plant whose node cost is its planner's median; None if it never found a path."""
    place = (plant, FIXED, algorithm)
    found = [t for t in results["trials"] if (t["plant"], t["variant"], t["algorithm"]) == place and t["cost"] is not None]
    if not found:
        return None
    middle = sorted(found, key=lambda t: (t["cost"], t["trial"]))[len(found) // 2]
    return next(task for task in plan.tasks if task.key == (*place, middle["trial"]))


def simulation_figure(plan: Plan[Task], results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the figure; of each planner the trial with its median cost."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    plant = _plant_to_show(results)
    task = next(task for task in plan.tasks if task.scene.seed == plant)
    robot, scene = pipeline_of(task.options.robot).robot, scene_of(task.scene.spec)
    start = home(robot)
    panels: list[tuple[str, list[tuple[Array, float]], Array | None]] = [(f"(a) start configuration, plant {plant}", [(start, 1.0)], None)]
    for letter, algorithm in zip("bcd", ("p_rrt_star", "rrt_star", "apf_rrt_star"), strict=True):
        chosen = typical(plan, results, plant, algorithm)
        if chosen is None:
            panels.append((f"({letter}) {LABELS[algorithm]}: no path found", [(start, 1.0)], None))
            continue
        space, goals = space_of(chosen)
        final = plan_trial(chosen, space, goals)
        assert final.path is not None
        states = _along(final.path, _GHOSTS + 2)
        ghosts = [(q, 0.35) for q in states[1:-1]] + [(states[-1], 1.0)]
        words = f"({letter}) {LABELS[algorithm]}: cost {final.node_cost:.0f}, {final.nodes_inside} nodes in leaves"
        panels.append((words, ghosts, np.stack([robot.forward(q)[:3, 3] for q in _along(final.path, 200)])))
    right, up = np.array([0.86, -0.51, 0.0]), np.array([0.13, 0.22, 0.967])
    right /= np.linalg.norm(right)
    up = up - (up @ right) * right
    up /= np.linalg.norm(up)
    figure = Figure(figsize=(15.2, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(panels))
    arms = np.concatenate([_arm(robot, q)[0] for _, states, _ in panels for q, _ in states])
    everything = np.concatenate([arms, scene.leaf_points, scene.stem_points, scene.fruit_points])
    flat = everything @ np.stack([right, up], axis=1)
    low, high = flat.min(axis=0) - 0.02, flat.max(axis=0) + 0.02
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    view = View(right, up, extent, 0.5 * _PIXEL_M)
    for axis, (words, shown, line) in zip(axes, panels, strict=True):
        axis.imshow(_panel(view, scene, robot, shown), extent=extent, interpolation="antialiased", aspect="equal")
        if line is not None:
            drawn = view.project(line)
            axis.plot(drawn[:, 0], drawn[:, 1], color="white", linewidth=4.0)
            axis.plot(drawn[:, 0], drawn[:, 1], color=_PATH, linewidth=2.2)
        axis.set_title(words, fontsize=10)
        axis.set_axis_off()
    path = folder / "simulation.png"
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110, facecolor="white", format="png")
    return [path]
