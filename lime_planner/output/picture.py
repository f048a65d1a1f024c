"""One picture of a plan: the plant, the arm at start and goal, and the tool's path coloured by leaf contact, in two views to scale."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.atomic_files import replacing
from lime_planner.core.errors import ParameterError
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.types import Array, Float32, Int64
from lime_planner.output.console import headline
from lime_planner.output.refusal_marks import (
    BLOCKED,
    InRed,
    boxes_shown,
    draw_boxes,
    draw_contact,
    draw_reach,
    legend_entries,
    link_colours,
    point_to,
    within_sight,
    wrapped,
)
from lime_planner.output.render import Image, Layer, View, cloud_layer, compose, halved, mesh_layer
from lime_planner.pipeline.in_the_way import InTheWay, in_the_way_of
from lime_planner.pipeline.obstacles import UNSEEN_VOXEL_M
from lime_planner.pipeline.result import PlanResult
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.seen_map import make_seen_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SUFFIXES = (".png", ".svg", ".pdf")

# Okabe and Ito's palette and neighbours of it: told apart with every kind of colour vision, and in grey by their lightness.
LEAF = (0.16, 0.62, 0.44)
STEM = (0.45, 0.27, 0.12)
LIME = (0.76, 0.85, 0.18)
ARM = (0.62, 0.63, 0.66)
FREE_PATH = (0.00, 0.45, 0.70)
LEAFY_PATH = (0.84, 0.37, 0.00)
TARGET = (0.80, 0.10, 0.50)
UNSEEN = (0.35, 0.30, 0.55)

_START_OPACITY = 0.38
_LEAF_OVER_ARM = 0.42  #: leaves in front of the arm let it shine through
_MARGIN_M = 0.06
_UNSEEN_DEPTH_M = 0.1  #: along the view, from which on unseen space is hatched
_PANEL_PIXELS = 800  #: height of the views, before halving
_AROUND_TARGET_M = 0.06  #: that is in sight, for its ring
_WIDEST_INCHES, _NARROWEST_INCHES = 14.0, 8.5  #: of both views; of the picture, for its legend
_LINE_INCHES = 0.185  #: of the sentence


def draw_plan(result: PlanResult, scene: Scene, robot: Robot, path: str | os.PathLike[str]) -> Path:
    """Draw plant, arm and the tool's path, coloured by leaf contact, from the side and from above; of a refused plan what is in the way.

    Args:
        result: a plan, found or refused.
        scene: the scene it was made in.
        robot: the arm.
        path: the picture; its suffix (`SUFFIXES`) chooses the format.

    Returns:
        The picture's path.

    Raises:
        ParameterError: see `draw_picture`.
    """
    found = len(result.waypoints) > 0
    target = None if result.target is None else result.target.centre if result.target.kind == "fruit" else result.target.shown_pose()
    return draw_picture(
        path,
        scene,
        robot,
        q_start=robot.home if result.q_start is None else result.q_start,
        q_goal=result.waypoints[-1] if found else None,
        tool_path=result.tool_path if found else None,
        tool_leaf=result.tool_leaf if found else None,
        target_pose=target if result.T_base_tool is None else matrix_to_pose(result.T_base_tool),
        title=headline(result.figures()) if result.succeeded else result.status.name,
        sentence="" if result.succeeded else result.message.partition(": ")[2],
        blocked=in_the_way_of(robot, scene, result),
        keep_out_boxes=result.parameters.get("keep_out_boxes", ()),
    )


def draw_picture(
    path: str | os.PathLike[str],
    scene: Scene,
    robot: Robot,
    *,
    q_start: npt.ArrayLike,
    q_goal: npt.ArrayLike | None = None,
    tool_path: npt.ArrayLike | None = None,
    tool_leaf: npt.ArrayLike | None = None,
    target_pose: npt.ArrayLike | None = None,
    title: str = "",
    sentence: str = "",
    blocked: InTheWay | None = None,
    keep_out_boxes: npt.ArrayLike = (),
) -> Path:
    """Draw a side view and a top view and write them to a file; a reader never sees half of it.

    Args:
        path: the file; its suffix (`SUFFIXES`) chooses the format.
        scene: the plant.
        robot: the arm.
        q_start: (n,) configuration at the start [rad].
        q_goal: (n,) configuration at the end; None draws the start alone.
        tool_path: (K, 7) tool poses along the plan, or (K, 3) positions [m].
        tool_leaf: (K,) leaf contact at each of them, 0 for none.
        target_pose: (7,) T_base_tool at the grasp, or (3,) a fruit's centre; the view is widened for one that is out of reach.
        title: one line above the picture; red with a sentence beneath it, which says why there is no plan.
        sentence: any number of words.
        blocked: the configuration that was refused, drawn in red with what it meets.
        keep_out_boxes: (6 K,) lowest x y z, highest x y z of each [m].

    Returns:
        The file.

    Raises:
        ParameterError: a suffix that is not supported, or a file that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise ParameterError(f"{path}: a picture ends in one of {', '.join(SUFFIXES)}, not in {path.suffix or 'nothing'!r}")
    here = blocked is not None and np.array_equal(blocked.q, np.asarray(q_start))
    arms = [Solid(*arm_mesh(robot, np.asarray(q, dtype=np.float64)), ARM) for q in (q_start, q_goal) if q is not None]
    if blocked is not None:
        refused = Solid(*arm_mesh(robot, blocked.q), link_colours(robot, blocked.links))
        arms = [refused] if here else [arms[0], refused]
    line = np.zeros((0, 3)) if tool_path is None else np.asarray(tool_path, dtype=np.float64)[:, :3]
    contact = np.zeros(len(line)) if tool_leaf is None else np.asarray(tool_leaf, dtype=np.float64)
    target = None if target_pose is None else np.asarray(target_pose, dtype=np.float64)
    far = target is not None and not within_sight(target[:3], robot.reach_m)
    beyond = target is not None and not far and float(np.linalg.norm(target[:3])) > robot.reach_m
    boxes, touched = boxes_shown(keep_out_boxes, robot.reach_m), None if blocked is None else blocked.box
    met = None if blocked is None else blocked.place(robot)
    shown = in_sight(scene, robot)
    in_red = None if blocked is None else InRed(*link_mesh(robot, blocked.q, blocked.links), blocked.obstacle(scene))
    unseen = make_seen_map(scene, UNSEEN_VOXEL_M, reach_m=robot.reach_m).unseen
    around: list[Array | Float32] = [
        *(arm.vertices for arm in arms),
        *shown.values(),
        line,
        boxes[np.isfinite(boxes).all(axis=(1, 2))].reshape(-1, 3),
    ]
    low, high = _bounds([*around, np.zeros((0, 3)) if target is None or far else target[:3] + _AROUND_TARGET_M * np.array([[-1.0], [1.0]])])

    from matplotlib.figure import Figure

    views = _views(low, high, target)
    widths = [view.extent[1] - view.extent[0] for _, _, view in views]
    heights = [view.extent[3] - view.extent[2] for _, _, view in views]
    # Inches: the higher view is 4.4 high, the other to the same scale, unless both get too wide; around them labels, colour bar and legend.
    scale = min(4.4 / max(heights), _WIDEST_INCHES / sum(widths))
    marks = legend_entries(blocked=blocked is not None, contact=met is not None, boxes=boxes, touched=touched, reach=beyond)
    left, gap, beside, bottom = 0.75, 0.85, 1.35 if len(contact) else 0.3, 1.15 if marks else 0.95
    width = max(sum(widths) * scale + left + gap + beside, _NARROWEST_INCHES)
    lines = wrapped(f"{sentence[:1].upper()}{sentence[1:]}", width - left - 0.3)
    top = (0.75 if title else 0.4) + _LINE_INCHES * len(lines)
    tallest = max(heights) * scale
    height = tallest + bottom + top
    figure = Figure(figsize=(width, height))
    floor, ceiling = bottom / height, 1.0 - top / height
    starts = (left, left + widths[0] * scale + gap)
    for place, (name, labels, view) in enumerate(views):
        high_inches = heights[place] * scale
        frame = (starts[place] / width, ceiling - high_inches / height, widths[place] * scale / width, high_inches / height)
        axes = figure.add_axes(frame)
        axes.imshow(_render(view, shown, scene, arms, in_red), extent=view.extent, interpolation="antialiased", aspect="equal")
        _draw_unseen(axes, view, unseen)
        draw_boxes(axes, view, boxes, touched)
        _draw_path(axes, view, line, contact)
        if beyond:
            draw_reach(axes, view, robot.reach_m)
        if target is not None and far:
            point_to(axes, view, target[:3], TARGET)
        elif target is not None:
            _draw_target(axes, view, target)
        if met is not None:
            draw_contact(axes, view, met)
        axes.set_title(name, fontsize=10, loc="left")
        axes.set_xlabel(f"{labels[0]} [m]")
        axes.set_ylabel(f"{labels[1]} [m]")
        axes.tick_params(labelsize=8)
        axes.set_xlim(view.extent[:2])
        axes.set_ylim(view.extent[2:])
        axes.grid(False)
    _colour_bar(figure, (1.0 - (beside - 0.3) / width, floor, 0.16 / width, ceiling - floor), contact)
    _legend(
        figure,
        scene,
        not here,
        q_goal is not None or blocked is not None,
        q_goal is not None,
        len(line) > 1,
        None if far else target,
        len(unseen) > 0,
        marks,
    )
    if title:
        bad: dict[str, Any] = {"color": BLOCKED, "weight": "bold"} if sentence else {}
        figure.text(left / width, 1.0 - 0.3 / height, title, ha="left", va="center", fontsize=11, **bad)
    figure.text(left / width, 1.0 - 0.44 / height, "\n".join(lines), ha="left", va="top", fontsize=10, linespacing=1.25)
    return _write(figure, path)


@dataclass(frozen=True, eq=False)
class Solid:
    """An arm to be drawn.

    Attributes:
        vertices: (V, 3) [m].
        triangles: (T, 3).
        colours: (T, 3) or (3,), 0 to 1.
    """

    vertices: Array
    triangles: Int64
    colours: npt.ArrayLike


def _write(figure: Any, path: Path) -> Path:
    try:
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=200, facecolor="white")
    except OSError as error:
        raise ParameterError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


def arm_mesh(robot: Robot, q: Array) -> tuple[Array, Int64]:
    """Return the whole arm at q as one mesh in the planning frame: vertices (V, 3), triangles (T, 3)."""
    return link_mesh(robot, q, [link.name for link in robot.links])


def link_mesh(robot: Robot, q: Array, names: Sequence[str]) -> tuple[Array, Int64]:
    """Return some links of the arm at q as one mesh in the planning frame: vertices (V, 3), triangles (T, 3)."""
    poses = robot.link_poses(q)
    vertices, triangles, count = [], [], 0
    for link in robot.links:
        if link.name in names:
            pose = poses[link.joint]
            vertices.append(link.vertices @ pose[:3, :3].T + pose[:3, 3])
            triangles.append(link.triangles.astype(np.int64) + count)
            count += len(link.vertices)
    return np.concatenate(vertices), np.concatenate(triangles)


def in_sight(scene: Scene, robot: Robot) -> dict[str, Float32]:
    """Return the points of each class that lie near the arm's reach; a wall of the greenhouse would make the plant a dot."""
    limit = robot.reach_m + 0.3
    clouds = {"leaf": scene.leaf_points, "stem": scene.stem_points, "fruit": scene.fruit_points}
    return {name: points[np.linalg.norm(points, axis=1) < limit] for name, points in clouds.items()}


def _bounds(clouds: Sequence[npt.NDArray[Any]]) -> tuple[Array, Array]:
    held = [np.asarray(points, dtype=np.float64) for points in clouds if len(points)]
    low = np.min([points.min(axis=0) for points in held], axis=0) - _MARGIN_M
    high = np.max([points.max(axis=0) for points in held], axis=0) + _MARGIN_M
    return low, high


def _views(low: Array, high: Array, target: Array | None) -> list[tuple[str, tuple[str, str], View]]:
    """Return the side view, across the direction from the base to the target, and the top view, both to one scale."""
    x, y, z = np.eye(3)
    pixel = float(max(high[2] - low[2], high[1] - low[1])) / _PANEL_PIXELS
    middle = target[:3] if target is not None else 0.5 * (low + high)
    if abs(middle[0]) >= abs(middle[1]):
        side = ("from the side", ("x", "z"), View(x, z, (low[0], high[0], low[2], high[2]), pixel))
    else:
        side = ("from the side", ("y", "z"), View(y, z, (low[1], high[1], low[2], high[2]), pixel))
    return [side, ("from above", ("x", "y"), View(x, y, (low[0], high[0], low[1], high[1]), pixel))]


def _render(view: View, shown: dict[str, Float32], scene: Scene, arms: list[Solid], in_red: InRed | None) -> Image:
    """Draw plant and arms, and over them what is in the way, at twice the picture's resolution and halve it."""
    fine = View(view.right, view.up, view.extent, 0.5 * view.pixel_m)
    plant = [
        leaf_layer(fine, shown["leaf"], scene),
        cloud_layer(fine, shown["stem"], STEM, (0.0018, 0.0045)),
        fruit_layer(fine, shown["fruit"], scene),
    ]
    opacities = [_START_OPACITY, 1.0] if len(arms) > 1 else [1.0]
    solid = [(mesh_layer(fine, arm.vertices, arm.triangles, arm.colours), opacity) for arm, opacity in zip(arms, opacities, strict=True)]
    if in_red is not None:
        solid += in_red.layers(fine)
    return halved(compose(plant, solid, _LEAF_OVER_ARM))


def leaf_layer(view: View, points: Float32, scene: Scene) -> Layer:
    """Draw the leaves' own triangles where they are known (each leaf a little lighter or darker), else their points."""
    if scene.leaf_triangles is None or not len(scene.leaf_triangles):
        return cloud_layer(view, points, LEAF, (0.0012, 0.0045))
    ids = np.arange(len(scene.leaf_triangles)) if scene.leaf_triangle_ids is None else scene.leaf_triangle_ids
    tone = 0.85 + 0.3 * ((ids * 0.6180339887) % 1.0)
    colours = np.clip(np.asarray(LEAF) * tone[:, None], 0.0, 1.0)
    corners = scene.leaf_triangles.reshape(-1, 3)
    return mesh_layer(view, corners, np.arange(len(corners)).reshape(-1, 3), colours)


def fruit_layer(view: View, points: Float32, scene: Scene) -> Layer:
    """Draw limes as the balls that they are, with the dimple of their far end, where the scene knows them; else their points."""
    if scene.fruit_centres is None or scene.fruit_radii is None or not len(scene.fruit_centres):
        return cloud_layer(view, points, LIME, (0.0012, 0.0045))
    ball, faces = _lime()
    vertices = scene.fruit_centres[:, None] + scene.fruit_radii[:, None, None] * ball
    triangles = faces + len(ball) * np.arange(len(vertices))[:, None, None]
    return mesh_layer(view, vertices.reshape(-1, 3).astype(np.float64), triangles.reshape(-1, 3), LIME)


def _lime(rings: int = 12, segments: int = 20) -> tuple[Array, Int64]:
    """Return a lime of radius 1: vertices (V, 3), triangles (T, 3); a ball that is drawn out a little at its lower end."""
    polar = np.linspace(0.0, np.pi, rings + 1)
    around = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    height = np.cos(polar) - 0.14 * np.exp(-(((polar - np.pi) / 0.28) ** 2))
    x, y = np.sin(polar)[:, None] * np.cos(around), np.sin(polar)[:, None] * np.sin(around)
    vertices = np.stack([x, y, np.broadcast_to(height[:, None], x.shape)], axis=-1).reshape(-1, 3)
    ring, segment = np.meshgrid(np.arange(rings), np.arange(segments), indexing="ij")
    here, beside = ring * segments + segment, ring * segments + (segment + 1) % segments
    below, across = here + segments, beside + segments
    return vertices, np.concatenate([np.stack([here, below, beside], -1), np.stack([beside, below, across], -1)]).reshape(-1, 3)


def _path_colours(contact: Array) -> tuple[Any, Any]:
    """Return colour map and norm for leaf contact."""
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    shades = LinearSegmentedColormap.from_list("leaf contact", [FREE_PATH, (0.93, 0.84, 0.76), LEAFY_PATH])
    return shades, Normalize(0.0, max(1.0, float(contact.max()) if len(contact) else 1.0))


def _draw_path(axes: Axes, view: View, line: Array, contact: Array) -> None:
    if len(line) < 2:
        return
    from matplotlib.collections import LineCollection

    flat = view.project(line)[:, :2]
    pieces = np.stack([flat[:-1], flat[1:]], axis=1)
    shades, norm = _path_colours(contact)
    axes.plot(flat[:, 0], flat[:, 1], color="white", linewidth=5.2, solid_capstyle="round", zorder=3)
    axes.plot(flat[:, 0], flat[:, 1], color="black", linewidth=3.8, solid_capstyle="round", zorder=4)
    coloured = LineCollection(list(pieces), cmap=shades, norm=norm, linewidth=2.6, capstyle="round", zorder=5)
    coloured.set_array(np.maximum(contact[:-1], contact[1:]))
    axes.add_collection(coloured)
    axes.plot(*flat[0], marker="o", markersize=6, markerfacecolor="white", markeredgecolor="black", markeredgewidth=1.3, zorder=3.5)


def _draw_unseen(axes: Axes, view: View, places: Float32) -> None:
    """Hatch where much of the space that is looked through was seen by no camera: `places` (K, 3), middles of voxels."""
    if not len(places):
        return
    left, right, low, high = view.extent
    across, up, _ = view.project(places.astype(np.float64)).T
    bins = [np.arange(begin, end + UNSEEN_VOXEL_M, UNSEEN_VOXEL_M) for begin, end in ((left, right), (low, high))]
    counts, columns, rows = np.histogram2d(across, up, bins=bins)
    depth_m = counts.T * UNSEEN_VOXEL_M
    if depth_m.max() < _UNSEEN_DEPTH_M:
        return
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (columns, rows)]
    hatched = axes.contourf(*middles, depth_m, levels=[_UNSEEN_DEPTH_M, np.inf], colors="none", hatches=["///"], zorder=2)
    hatched.set_edgecolor((*UNSEEN, 0.6))
    hatched.set_linewidth(0.0)


def _draw_target(axes: Axes, view: View, target: Array) -> None:
    """Ring the target, beneath the path, whose end it must not hide; a line shows from where the palm comes to a pose."""
    from lime_planner.core.geometry import pose_to_matrix

    approach = pose_to_matrix(target)[:3, 2] if len(target) == 7 else np.zeros(3)
    (x, y, _), (x0, y0, _) = view.project(np.stack([target[:3], target[:3] - 0.09 * approach]))
    for colour, width, order in (("white", 3.4, 2.4), (TARGET, 1.8, 2.5)):
        axes.plot([x0, x], [y0, y], color=colour, linewidth=width, linestyle="-", zorder=order)
        axes.plot(x, y, marker="o", markersize=17, markerfacecolor="none", markeredgecolor=colour, markeredgewidth=width, zorder=order)


def _colour_bar(figure: Any, place: tuple[float, float, float, float], contact: Array) -> None:
    from matplotlib.cm import ScalarMappable

    if not len(contact):
        return
    shades, norm = _path_colours(contact)
    bar = figure.colorbar(ScalarMappable(norm, shades), cax=figure.add_axes(place))
    bar.set_label("price of the leaves touched [leaf weights per rad]; 0: none", fontsize=9)
    bar.ax.tick_params(labelsize=8)


def _legend(
    figure: Any, scene: Scene, start: bool, two: bool, goal: bool, path: bool, target: Array | None, unseen: bool, marks: list[Any]
) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[Any] = [Patch(color=LEAF, label="leaves"), Patch(color=STEM, label="stems (hard)")]
    if len(scene.fruit_points):
        entries.append(Patch(facecolor=LIME, edgecolor="0.4", linewidth=0.5, label="limes"))
    if unseen:
        words = f"unseen, {100.0 * _UNSEEN_DEPTH_M:.0f} cm deep or more"
        entries.append(Patch(facecolor="white", edgecolor=UNSEEN, hatch="///", linewidth=0.0, label=words))
    if start:
        entries.append(Patch(facecolor=ARM, alpha=_START_OPACITY if two else 1.0, edgecolor="0.3", linewidth=0.5, label="arm at the start"))
    if goal:
        entries.append(Patch(facecolor=ARM, edgecolor="0.2", linewidth=0.5, label="arm at the goal"))
    if path:
        line = Line2D([], [], color=FREE_PATH, linewidth=2.6, marker="o", markerfacecolor="white", markeredgecolor="black")
        line.set_label("tool's path from its start")
        entries.append(line)
    if target is not None:
        ring: dict[str, Any] = {"color": TARGET, "marker": "o", "markersize": 8, "markerfacecolor": "none"}
        posed = len(target) == 7
        entries.append(Line2D([], [], linestyle="-" if posed else "", label="target and approach" if posed else "target", **ring))
    entries += marks
    figure.legend(
        handles=entries,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.01),
        ncol=len(entries) if not marks else (len(entries) + 1) // 2,
        frameon=False,
        fontsize=9,
        handlelength=1.6,
        columnspacing=1.4,
    )
