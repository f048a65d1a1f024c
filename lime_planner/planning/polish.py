"""Local improvement of paths: shortcuts, moved and inserted waypoints, each kept only if the path's cost falls.

Several paths (tracks) are improved side by side, because which goal and which way round a stem is best shows only after polishing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lime_planner.jit import kernel
from lime_planner.planning.random import below, normal, uniform
from lime_planner.space import distance, edge, evaluate

Array = npt.NDArray[np.float64]

MAX_WAYPOINTS = 96
_GAIN = 1e-9  # a change must be better by this share of the cost
_TRIALS_UP, _TRIALS_DOWN = 1.6, 0.87  # step control of moved waypoints: the one-fifth success rule


class Tracks(NamedTuple):
    """Paths being improved; T tracks.

    Attributes:
        points: (T, W, n) waypoints; size: (T,) how many, 0 for an empty track.
        segment: (T, W) exact cost of the edge to the next waypoint.
        step: (T, W) standard deviation of the next move of a waypoint.
        cost: (T,) sums of the segments, inf for an empty track.
        trial: (n,) scratch.
    """

    points: Array
    size: npt.NDArray[np.int64]
    segment: Array
    step: Array
    cost: Array
    trial: Array


def new_tracks(tracks: int, n: int) -> Tracks:
    """Make room for `tracks` paths in n dimensions."""
    return Tracks(
        np.zeros((tracks, MAX_WAYPOINTS, n)),
        np.zeros(tracks, np.int64),
        np.zeros((tracks, MAX_WAYPOINTS)),
        np.zeros((tracks, MAX_WAYPOINTS)),
        np.full(tracks, np.inf),
        np.zeros(n),
    )


@kernel
def sum_cost(tracks: Any, t: int) -> None:
    """Add a track's segments up."""
    total = 0.0
    for i in range(tracks.size[t] - 1):
        total += tracks.segment[t, i]
    tracks.cost[t] = total


@kernel
def load_track(space: Any, tracks: Any, t: int, path: Any, count: int, weight: float, step: float, bound: float) -> bool:
    """Put a path (M, n) of valid edges into track t; its cost is evaluated. False, and the track is empty, above `bound`."""
    total = 0.0
    tracks.size[t] = 0
    tracks.cost[t] = np.inf
    for i in range(count - 1):
        c = edge(space, path[i], path[i + 1], weight, bound - total)
        total += c
        if not total <= bound or total == np.inf:
            return False
        tracks.segment[t, i] = c
    for i in range(count):
        tracks.points[t, i] = path[i]
        tracks.step[t, i] = step
    tracks.size[t] = count
    tracks.cost[t] = total
    return True


@kernel
def _remove_between(tracks: Any, t: int, i: int, j: int, cost: float) -> None:
    """Join waypoints i and j of a track by an edge of the given cost."""
    gone = j - i - 1
    for k in range(i + 1, tracks.size[t] - gone):
        tracks.points[t, k] = tracks.points[t, k + gone]
        tracks.step[t, k] = tracks.step[t, k + gone]
        tracks.segment[t, k] = tracks.segment[t, k + gone]
    tracks.segment[t, i] = cost
    tracks.size[t] -= gone
    sum_cost(tracks, t)


@kernel
def _shortcut(space: Any, tracks: Any, t: int, weight: float, random: Any) -> bool:
    """Try to join two waypoints directly."""
    m = tracks.size[t]
    if m < 3:
        return False
    i = below(random, m - 2)
    j = i + 2 + below(random, m - i - 2)
    old = 0.0
    for k in range(i, j):
        old += tracks.segment[t, k]
    limit = old * (1.0 - _GAIN)
    if distance(space, tracks.points[t, i], tracks.points[t, j]) >= limit:
        return False
    c = edge(space, tracks.points[t, i], tracks.points[t, j], weight, limit)
    if c >= limit:
        return False
    _remove_between(tracks, t, i, j, c)
    return True


@kernel
def _two_edges(space: Any, a: Any, b: Any, c: Any, weight: float, limit: float) -> tuple[float, float]:
    """Costs of a → b and b → c if their sum stays below the limit, else inf for the first."""
    rest = distance(space, b, c)
    if distance(space, a, b) + rest >= limit:
        return np.inf, np.inf
    first = edge(space, a, b, weight, limit - rest)
    if first + rest >= limit:
        return np.inf, np.inf
    second = edge(space, b, c, weight, limit - first)
    if first + second >= limit:
        return np.inf, np.inf
    return first, second


@kernel
def _perturb(space: Any, centre: Any, step: float, random: Any, out: Any) -> bool:
    """Draw a valid configuration around a centre, all coordinates or only one of them moved."""
    n = centre.shape[0]
    only = below(random, 3 * n) if n > 2 else n  # one time in three a single coordinate
    for k in range(n):
        out[k] = centre[k]
        if only >= n or only == k:
            out[k] += step * normal(random)
        out[k] = min(max(out[k], space.lower[k]), space.upper[k])
    return evaluate(space, out) >= 0.0


@kernel
def _move(space: Any, tracks: Any, t: int, weight: float, least: float, random: Any) -> bool:
    """Try to move one waypoint."""
    m = tracks.size[t]
    if m < 3:
        return False
    i = 1 + below(random, m - 2)
    step = tracks.step[t, i]
    limit = (tracks.segment[t, i - 1] + tracks.segment[t, i]) * (1.0 - _GAIN)
    good = _perturb(space, tracks.points[t, i], step, random, tracks.trial)
    if good:
        first, second = _two_edges(space, tracks.points[t, i - 1], tracks.trial, tracks.points[t, i + 1], weight, limit)
        good = first < np.inf
        if good:
            tracks.points[t, i] = tracks.trial
            tracks.segment[t, i - 1] = first
            tracks.segment[t, i] = second
            sum_cost(tracks, t)
    tracks.step[t, i] = max(least, step * (_TRIALS_UP if good else _TRIALS_DOWN))
    return good


@kernel
def _insert(space: Any, tracks: Any, t: int, weight: float, least: float, most: float, random: Any) -> bool:
    """Try a new waypoint beside an edge chosen by its cost."""
    m = tracks.size[t]
    if m >= MAX_WAYPOINTS or m < 2:
        return False
    pick = uniform(random) * tracks.cost[t]
    i = 0
    while i < m - 2 and pick >= tracks.segment[t, i]:
        pick -= tracks.segment[t, i]
        i += 1
    share = uniform(random)
    step = least * math.exp(uniform(random) * math.log(most / least))
    a = tracks.points[t, i]
    b = tracks.points[t, i + 1]
    for k in range(a.shape[0]):
        tracks.trial[k] = a[k] + share * (b[k] - a[k]) + step * normal(random)
        tracks.trial[k] = min(max(tracks.trial[k], space.lower[k]), space.upper[k])
    if evaluate(space, tracks.trial) < 0.0:
        return False
    first, second = _two_edges(space, a, tracks.trial, b, weight, tracks.segment[t, i] * (1.0 - _GAIN))
    if first == np.inf:
        return False
    for k in range(m, i + 1, -1):
        tracks.points[t, k] = tracks.points[t, k - 1]
        tracks.step[t, k] = tracks.step[t, k - 1]
        tracks.segment[t, k] = tracks.segment[t, k - 1]
    tracks.points[t, i + 1] = tracks.trial
    tracks.step[t, i + 1] = step
    tracks.segment[t, i] = first
    tracks.segment[t, i + 1] = second
    tracks.size[t] = m + 1
    sum_cost(tracks, t)
    return True


@kernel
def polish(space: Any, tracks: Any, t: int, trials: int, weight: float, least: float, most: float, random: Any) -> None:
    """Make a number of trials on track t.

    Args:
        space: the space.
        tracks, t: the track, not empty.
        trials: configurations or shortcuts to try.
        weight: leaf weight of J.
        least, most: smallest and largest standard deviation of a new waypoint [unit of the space].
        random: generator state.
    """
    for _ in range(trials):
        kind = uniform(random)
        if tracks.size[t] < 3 or kind < 0.35:
            _insert(space, tracks, t, weight, least, most, random)
        elif kind < 0.5:
            _shortcut(space, tracks, t, weight, random)
        else:
            _move(space, tracks, t, weight, least, random)
