"""What the picture of a refused plan shows besides plant and arm: the contact, keep-out boxes, the arm's reach, and a target far away."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.types import Array, Float32, Int64
from lime_planner.output.render import Layer, View, cloud_layer, mesh_layer
from lime_planner.robot.model import Robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLOCKED = (0.86, 0.10, 0.12)
BOX = (0.45, 0.45, 0.50)
_PALE = (0.97, 0.73, 0.70)  # links of the blocked arm that are not in the way themselves
_FARTHEST = 4.0  #: times the arm's reach: a target beyond that is pointed to, not shown
_BEFORE_M = 100.0
_LETTER_INCHES = 0.077  #: of the sentence's font, on average


@dataclass(frozen=True, eq=False)
class InRed:
    """What is in the way: links of the arm, and what they meet.

    Attributes:
        vertices: (V, 3) of the links [m].
        triangles: (T, 3).
        obstacle: (P, 3) points [m].
    """

    vertices: Array
    triangles: Int64
    obstacle: Float32

    def layers(self, view: View) -> list[tuple[Layer, float]]:
        """Return layers with their opacity, before everything else: leaves and stems would hide what is the matter."""
        links = mesh_layer(view, self.vertices, self.triangles, BLOCKED)
        points = cloud_layer(view, self.obstacle, BLOCKED, (0.003, 0.006))
        return [(Layer(layer.colour, layer.height_m + _BEFORE_M), opacity) for layer, opacity in ((links, 0.8), (points, 1.0))]


def link_colours(robot: Robot, links: Sequence[str]) -> Array:
    """Return a colour for each triangle (T, 3) of the whole arm's mesh: red for blocked links, pale for the others."""
    return np.concatenate([np.tile(BLOCKED if link.name in links else _PALE, (len(link.triangles), 1)) for link in robot.links])


def boxes_shown(boxes: npt.ArrayLike, reach_m: float) -> Array:
    """Return lowest and highest corners (K, 2, 3) [m] of keep-out boxes, which may be huge, as far as the arm can get."""
    corners = np.asarray(boxes, dtype=np.float64).reshape(-1, 2, 3)
    shown = np.clip(corners, -reach_m, reach_m)
    shown[(shown[:, 1] <= shown[:, 0]).any(axis=1)] = np.nan  # beside all that the arm can reach
    return shown


def within_sight(place: Array, reach_m: float) -> bool:
    """Tell whether the picture is widened for a place (3,) [m]."""
    return float(np.linalg.norm(place)) <= _FARTHEST * reach_m


def draw_boxes(axes: Axes, view: View, boxes: Array, touched: int | None) -> None:
    """Hatch keep-out boxes (K, 2, 3); the one that is touched is red."""
    from matplotlib.patches import Rectangle

    for number, corners in enumerate(boxes):
        if np.isnan(corners).any():
            continue
        (x0, y0, _), (x1, y1, _) = view.project(corners)
        colour, face = (BLOCKED, 0.12) if number == touched else (BOX, 0.08)
        low, size = (min(x0, x1), min(y0, y1)), (abs(x1 - x0), abs(y1 - y0))
        axes.add_patch(Rectangle(low, *size, facecolor=(*colour, face), edgecolor="none", zorder=2.0))
        axes.add_patch(
            Rectangle(
                low, *size, facecolor="none", edgecolor=(*colour, 0.75), hatch="\\\\\\", hatch_linewidth=0.5, linewidth=1.4, zorder=2.1
            )
        )


def draw_contact(axes: Axes, view: View, place: Array) -> None:
    """Frame where the blocked arm meets something (3,) [m], on top of everything; unlike the target's ring, a diamond."""
    x, y, _ = view.project(place[None])[0]
    for colour, width in (("white", 4.2), (BLOCKED, 2.0)):
        axes.plot(x, y, marker="D", markersize=17, markerfacecolor="none", markeredgecolor=colour, markeredgewidth=width, zorder=6)


def draw_reach(axes: Axes, view: View, reach_m: float) -> None:
    """Draw the border of what the arm can reach."""
    from matplotlib.patches import Circle

    axes.add_patch(Circle((0.0, 0.0), reach_m, facecolor="none", edgecolor="0.45", linewidth=1.1, linestyle=(0, (5, 4)), zorder=1.5))


def point_to(axes: Axes, view: View, place: Array, colour: tuple[float, float, float]) -> None:
    """Point from the view's border to a target that is too far away to be drawn, and say how far."""
    left, right, low, high = view.extent
    middle = np.array([0.5 * (left + right), 0.5 * (low + high)])
    way = view.project(place[None])[0, :2] - middle
    if np.linalg.norm(way) < 1e-6:
        return
    room = 0.5 * np.array([right - left, high - low])
    tip = middle + 0.97 * way * float(np.min(room / np.maximum(np.abs(way), 1e-9)))
    tail = middle + 0.86 * (tip - middle)
    axes.annotate("", tip, tail, arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2.2, "mutation_scale": 16}, zorder=6)
    sideways = "right" if way[0] > 0 else "left"
    words = f"target {np.linalg.norm(place):.3g} m away"
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    axes.annotate(words, tail, ha=sideways, va="center", fontsize=9, color=colour, bbox=box, zorder=5.9)


def wrapped(sentence: str, width_inches: float) -> list[str]:
    """Return a sentence in lines that are no wider than the picture."""
    return textwrap.wrap(sentence, max(30, int(width_inches / _LETTER_INCHES)), break_on_hyphens=False) if sentence else []


def legend_entries(*, blocked: bool, contact: bool, boxes: Array, touched: int | None, reach: bool) -> list[Any]:
    """Return the legend's entries for what is drawn here."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[Any] = []
    if blocked:
        entries.append(Patch(facecolor=BLOCKED, edgecolor="0.3", linewidth=0.5, label="blocked, and by what"))
        entries.append(Patch(facecolor=_PALE, edgecolor="0.3", linewidth=0.5, label="the rest of the arm there"))
    if contact:
        entries.append(
            Line2D(
                [],
                [],
                color=BLOCKED,
                linestyle="",
                marker="D",
                markersize=8,
                markerfacecolor="none",
                markeredgewidth=1.6,
                label="where they meet",
            )
        )
    drawn = [number for number in range(len(boxes)) if not np.isnan(boxes[number]).any()]
    for words, colour, there in (
        ("keep-out box that is met", BLOCKED, touched in drawn),
        ("keep-out box", BOX, any(number != touched for number in drawn)),
    ):
        if there:
            entries.append(Patch(facecolor=(*colour, 0.1), edgecolor=(*colour, 0.75), hatch="\\\\\\", label=words))
    if reach:
        entries.append(Line2D([], [], color="0.45", linewidth=1.1, linestyle=(0, (4, 2)), label="end of the arm's reach"))
    return entries
