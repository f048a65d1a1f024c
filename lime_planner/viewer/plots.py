"""Clearance and cost along the path, drawn as vector graphics, with the slider's moment marked and a second plan beside the first."""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from lime_planner.core.types import Array, Bool
from lime_planner.output.timeline import CLEARANCE_SHOWN_M, Timeline

_WIDTH, _HEIGHT = 300.0, 118.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 34.0, 6.0, 18.0, 26.0


class Plots:
    """Two charts over the same axis as the slider."""

    def __init__(self, gui: Any) -> None:
        """Add the charts, empty.

        Args:
            gui: viser's, in the container that they belong to.
        """
        self._mark = gui.add_html("", visible=False)
        self._charts = gui.add_html("", visible=False)
        self._end = 1.0

    def load(self, timeline: Timeline | None, other: Timeline | None = None) -> None:
        """Show a plan, or hide the charts.

        Args:
            timeline: of the plan that is shown.
            other: of one to compare it with.
        """
        self._charts.visible = self._mark.visible = timeline is not None
        if timeline is None:
            return
        both = [each for each in (timeline, other) if each is not None and each.timed == timeline.timed]
        self._end = max(max(each.duration_s for each in both), 1e-3)
        self._charts.content = charts(both)
        self.mark(0.0)

    def mark(self, t_s: float) -> None:
        """Mark a moment."""
        share = (_LEFT + (_WIDTH - _LEFT - _RIGHT) * min(max(t_s / self._end, 0.0), 1.0)) / _WIDTH
        line = f"position:absolute;left:{100.0 * share:.2f}%;top:0;width:0;border-left:1px solid currentColor;z-index:1"
        # As high as both charts, whatever the panel's width: the charts keep their shape.
        height = f"padding-top:{100.0 * 2.0 * _HEIGHT / _WIDTH:.1f}%"
        self._mark.content = f'<div style="position:relative;height:0" aria-hidden="true"><div style="{line};{height}"></div></div>'


def charts(timelines: list[Timeline]) -> str:
    """Return the charts of a plan, and of one beside it, as HTML."""
    first = timelines[0]
    end = max(max(each.duration_s for each in timelines), 1e-3)
    abscissa = "time [s]" if first.timed else "along the path [rad]"
    ceiling = 1000.0 * CLEARANCE_SHOWN_M
    clearance = _chart(
        "Clearance to stems [mm]",
        abscissa,
        end,
        ceiling,
        [(each.times_s, np.minimum(1000.0 * each.clearance_m, ceiling), None) for each in timelines],
        ("--lp-stem", "--lp-other"),
    )
    top = max(max(float(each.cost[-1]) for each in timelines), 1e-3)
    cost = _chart(
        "Cost so far [rad]; orange: among leaves",
        abscissa,
        end,
        top,
        [(each.times_s, each.cost, each.leaf > 0.0) for each in timelines],
        ("--lp-free", "--lp-other"),
    )
    return clearance + cost


def _chart(
    title: str, abscissa: str, end: float, top: float, curves: list[tuple[Array, Array, Bool | None]], colours: tuple[str, str]
) -> str:
    right, floor = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def x(values: Array) -> Array:
        return _LEFT + (right - _LEFT) * values / end

    def y(values: Array) -> Array:
        return floor - (floor - _TOP) * values / top

    parts = [f'<text class="title" x="{_LEFT}" y="11">{html.escape(title)}</text>']
    for value in ticks(top):
        height = float(y(np.array(value)))
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{right}" y1="{height:.1f}" y2="{height:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 4}" y="{height + 3:.1f}" text-anchor="end">{value:g}</text>')
    for value in ticks(end):
        parts.append(f'<text x="{float(x(np.array(value))):.1f}" y="{floor + 12:.1f}" text-anchor="middle">{value:g}</text>')
    parts.append(f'<text x="{right}" y="{floor + 23:.1f}" text-anchor="end">{abscissa}</text>')
    for number in reversed(range(len(curves))):
        times, values, leafy = curves[number]
        along, up = x(times), y(values)
        style = f"stroke:var({colours[number]})" + (";stroke-dasharray:4 3" if number else "")
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(along, up, strict=True))
        parts.append(f'<polyline class="curve" style="{style}" points="{points}"/>')
        for begin, last in [] if leafy is None else spans(leafy):
            piece = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(along[begin : last + 1], up[begin : last + 1], strict=True))
            parts.append(f'<polyline class="curve" style="stroke:var(--lp-leafy);stroke-width:3" points="{piece}"/>')
    inside = "".join(parts)
    return f'<svg class="lp-plot" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{html.escape(title)}">{inside}</svg>'


def ticks(top: float) -> list[float]:
    """Return three to six round numbers from 0 to at most `top`."""
    raw = top / 4.0
    size = 10.0 ** np.floor(np.log10(raw))
    step = next(factor * size for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * size >= raw * 0.999)
    return [float(f"{k * step:.6g}") for k in range(int(top / step + 1e-9) + 1)]


def spans(marks: Bool) -> list[tuple[int, int]]:
    """Return the stretches of samples (first, last) between which something holds, each led to its neighbours."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marks, [False]]).astype(np.int8)))
    return [(max(int(a) - 1, 0), min(int(b), len(marks) - 1)) for a, b in edges.reshape(-1, 2)]
