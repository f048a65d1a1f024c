"""Clearance and cost along the path, beside the scene, with the slider's moment marked."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.output.picture import FREE_PATH, LEAFY_PATH, STEM
from lime_planner.output.timeline import CLEARANCE_SHOWN_M, Timeline

_HEIGHT = 190
_CEILING_MM = 1080.0 * CLEARANCE_SHOWN_M


def _css(colour: tuple[float, float, float], alpha: float = 1.0) -> str:
    red, green, blue = (round(255 * c) for c in colour)
    return f"rgba({red},{green},{blue},{alpha:g})"


class Plots:
    """Two charts over the same axis as the slider."""

    def __init__(self, gui: Any) -> None:
        """Add the charts, empty.

        Args:
            gui: viser's, in the container that they belong to.
        """
        nothing = (np.array([0.0, 1.0]), np.zeros(2), np.zeros(2))
        self._clearance = gui.add_uplot(
            nothing,
            ({"label": "time"}, _line("to the nearest stem", STEM), _marker()),
            title="Clearance to stems [mm]",
            scales={"x": {"time": False}, "y": {"auto": False, "range": (0.0, _CEILING_MM)}},
            axes=_axes("time [s]"),
            legend={"show": False},
            height=_HEIGHT,
            visible=False,
        )
        self._cost = gui.add_uplot(
            (*nothing, np.zeros(2)),
            ({"label": "time"}, _line("cost so far", FREE_PATH), _line("among leaves", LEAFY_PATH, fill=0.25), _marker()),
            title="Cost so far [rad]; orange: among leaves",
            scales={"x": {"time": False}, "y": {"auto": False, "range": (0.0, 1.0)}},
            axes=_axes("time [s]"),
            legend={"show": False},
            height=_HEIGHT,
            visible=False,
        )
        self._timeline: Timeline | None = None
        self._top = 1.0

    def load(self, timeline: Timeline | None) -> None:
        """Show a plan, or hide the charts."""
        self._timeline = timeline
        self._clearance.visible = self._cost.visible = timeline is not None
        if timeline is None:
            return
        self._top = max(1e-3, 1.08 * float(timeline.cost[-1]))
        self._cost.scales = {"x": {"time": False}, "y": {"auto": False, "range": (0.0, self._top)}}
        self._clearance.axes = self._cost.axes = _axes("time [s]" if timeline.timed else "along the path [rad]")
        self.mark(0.0)

    def mark(self, t_s: float) -> None:
        """Mark a moment."""
        timeline = self._timeline
        if timeline is None:
            return
        # A spike, three points wide, is an upright line in a chart whose series share their abscissae.
        hair = 1e-4 * max(timeline.duration_s, 1e-3)
        moment = np.clip(t_s, 2.0 * hair, max(timeline.duration_s - 2.0 * hair, 3.0 * hair))
        times = np.sort(np.concatenate([timeline.times_s, moment + hair * np.array([-1.0, 0.0, 1.0])]))
        spike = (times == moment).astype(np.float64)

        def along(values: Array) -> Array:
            return np.asarray(np.interp(times, timeline.times_s, values))

        touching = np.interp(times, timeline.times_s, (timeline.leaf > 0.0).astype(np.float64)) > 0.5
        cost = along(timeline.cost)
        self._clearance.data = (times, 1000.0 * along(timeline.clearance_m), _CEILING_MM * spike)
        self._cost.data = (times, cost, np.where(touching, cost, 0.0), self._top * spike)


def _line(label: str, colour: tuple[float, float, float], fill: float = 0.0) -> Any:
    series: dict[str, Any] = {"label": label, "stroke": _css(colour), "width": 2, "points": {"show": False}}
    if fill:
        series |= {"fill": _css(colour, fill), "stroke": _css(colour, 0.0)}
    return series


def _marker() -> Any:
    return {"label": "now", "stroke": "rgba(40,40,40,0.9)", "width": 1, "points": {"show": False}}


def _axes(abscissa: str) -> Any:
    plain = {"stroke": "#444", "grid": {"stroke": "#e6e6e6", "width": 1}, "font": "11px sans-serif", "labelFont": "11px sans-serif"}
    return ({**plain, "label": abscissa, "size": 34, "labelSize": 16}, {**plain, "size": 46})
