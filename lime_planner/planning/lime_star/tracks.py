"""Tracks: paths that are improved side by side, because which goal and which way round a stem is best shows only after polishing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import copy_row, kernel
from lime_planner.core.types import Array, Int64
from lime_planner.planning.space import distance, edge

MAX_WAYPOINTS = 96
_COMPARED = 8  # places along two paths at which their distance is taken


class Tracks(NamedTuple):
    """Paths being improved; T tracks.

    Attributes:
        points: (T, W, n) waypoints; size: (T,) how many, 0 for an empty track.
        segment: (T, W) exact cost of the edge to the next waypoint.
        step: (T, W) standard deviation of the next move of a waypoint.
        terminal: (T,) what the goal at its end adds; cost: (T,) sums of that and the segments, inf for an empty track.
        trial, second: (n,) scratch; moved: (W, n) and price: (W,) scratch, a path as it would be and its segments.
    """

    points: Array
    size: Int64
    segment: Array
    step: Array
    terminal: Array
    cost: Array
    trial: Array
    second: Array
    moved: Array
    price: Array


def new_tracks(tracks: int, n: int) -> Tracks:
    """Make room for `tracks` paths in n dimensions."""
    return Tracks(
        np.zeros((tracks, MAX_WAYPOINTS, n)),
        np.zeros(tracks, np.int64),
        np.zeros((tracks, MAX_WAYPOINTS)),
        np.zeros((tracks, MAX_WAYPOINTS)),
        np.zeros(tracks),
        np.full(tracks, np.inf),
        np.zeros(n),
        np.zeros(n),
        np.zeros((MAX_WAYPOINTS, n)),
        np.zeros(MAX_WAYPOINTS),
    )


@kernel
def cost_between(tracks: Any, t: int, first: int, last: int) -> float:
    """Cost of a track from waypoint `first` to waypoint `last`."""
    total = 0.0
    for i in range(first, last):
        total += tracks.segment[t, i]
    return total


@kernel
def sum_cost(tracks: Any, t: int) -> None:
    """Add a track's segments and its goal's terminal cost up."""
    tracks.cost[t] = cost_between(tracks, t, 0, tracks.size[t] - 1) + tracks.terminal[t]


@kernel
def empty_track(tracks: Any, t: int) -> None:
    """Leave a track without a path."""
    tracks.size[t] = 0
    tracks.cost[t] = np.inf


@kernel
def load_track(space: Any, tracks: Any, t: int, path: Any, count: int, terminal: float, weight: float, step: float, bound: float) -> bool:
    """Put a path (M, n) of valid edges into track t; its cost is evaluated and the goal's terminal cost added.

    False, and the track is empty, above `bound`.
    """
    total = terminal
    empty_track(tracks, t)
    for i in range(count - 1):
        c = edge(space, path[i], path[i + 1], weight, bound - total)
        total += c
        if not total <= bound or total == np.inf:
            return False
        tracks.segment[t, i] = c
    for i in range(count):
        copy_row(path[i], tracks.points[t, i])
        tracks.step[t, i] = step
    tracks.size[t] = count
    tracks.terminal[t] = terminal
    tracks.cost[t] = total
    return True


@kernel
def make_room(tracks: Any, t: int, i: int, count: int) -> None:
    """Shift the waypoints behind waypoint i of a track by `count` places."""
    for k in range(tracks.size[t] - 1 + count, i + count, -1):
        copy_row(tracks.points[t, k - count], tracks.points[t, k])
        tracks.step[t, k] = tracks.step[t, k - count]
        tracks.segment[t, k] = tracks.segment[t, k - count]
    tracks.size[t] += count


@kernel
def take_out(tracks: Any, t: int, i: int, count: int) -> None:
    """Take the `count` waypoints behind waypoint i out of a track; the edge from there is to be set."""
    for k in range(i + 1, tracks.size[t] - count):
        copy_row(tracks.points[t, k + count], tracks.points[t, k])
        tracks.step[t, k] = tracks.step[t, k + count]
        tracks.segment[t, k] = tracks.segment[t, k + count]
    tracks.size[t] -= count


@kernel
def copy_track(tracks: Any, t: int, to: int) -> None:
    """Overwrite a track by another one."""
    for i in range(tracks.size[t]):
        copy_row(tracks.points[t, i], tracks.points[to, i])
        tracks.segment[to, i] = tracks.segment[t, i]
        tracks.step[to, i] = tracks.step[t, i]
    tracks.size[to] = tracks.size[t]
    tracks.terminal[to] = tracks.terminal[t]
    tracks.cost[to] = tracks.cost[t]


@kernel
def _place(space: Any, tracks: Any, t: int, share: float, out: Any) -> None:
    """Write the configuration at a share of a track's length."""
    m = tracks.size[t]
    total = 0.0
    for i in range(m - 1):
        total += distance(space, tracks.points[t, i], tracks.points[t, i + 1])
    on = share * total
    for i in range(m - 1):
        length = distance(space, tracks.points[t, i], tracks.points[t, i + 1])
        if on <= length or i == m - 2:
            part = min(1.0, on / length) if length > 0.0 else 1.0
            for k in range(out.shape[0]):
                out[k] = tracks.points[t, i, k] + part * (tracks.points[t, i + 1, k] - tracks.points[t, i, k])
            return
        on -= length


@kernel
def near_tracks(space: Any, tracks: Any, t: int, radius: float) -> tuple[int, int]:
    """Count the tracks whose paths are nowhere farther from track t's than a radius, and name the most expensive of them, -1 for none.

    Distances are taken between places at equal shares of the two lengths.
    """
    count, most_expensive = 0, -1
    for other in range(tracks.size.shape[0]):
        if other == t or tracks.size[other] < 2:
            continue
        widest = 0.0
        for c in range(1, _COMPARED + 1):
            _place(space, tracks, t, c / _COMPARED, tracks.trial)
            _place(space, tracks, other, c / _COMPARED, tracks.second)
            widest = max(widest, distance(space, tracks.trial, tracks.second))
            if widest >= radius:
                break
        if widest < radius:
            count += 1
            if most_expensive < 0 or tracks.cost[other] > tracks.cost[most_expensive]:
                most_expensive = other
    return count, most_expensive
