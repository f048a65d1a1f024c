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
from lime_planner.space import clamp, distance, edge, evaluate

Array = npt.NDArray[np.float64]

MAX_WAYPOINTS = 96
_GAIN = 1e-9  # a change must be better by this share of the cost
_TRIALS_UP, _TRIALS_DOWN = 1.6, 0.87  # step control of moved waypoints: the one-fifth success rule
_FINEST = 0.03  # how far below the least step that control may go
# Shares of the trials: new waypoints (of these two at once), shortcuts, two waypoints moved alike; the others move one.
_NEW, _NEW_PAIRS, _SHORTCUTS, _PAIRS = 0.35, 0.3, 0.15, 0.15
_AT_BORDERS = 0.5  # share of the new waypoints that are put where leaves begin or end: there the best paths have their bends
_FINER = 0.3  # their step, over that of the others
_HALVINGS = 7  # for finding such a place


class Tracks(NamedTuple):
    """Paths being improved; T tracks.

    Attributes:
        points: (T, W, n) waypoints; size: (T,) how many, 0 for an empty track.
        segment: (T, W) exact cost of the edge to the next waypoint.
        step: (T, W) standard deviation of the next move of a waypoint.
        cost: (T,) sums of the segments, inf for an empty track.
        trial, second: (n,) scratch.
    """

    points: Array
    size: npt.NDArray[np.int64]
    segment: Array
    step: Array
    cost: Array
    trial: Array
    second: Array


def new_tracks(tracks: int, n: int) -> Tracks:
    """Make room for `tracks` paths in n dimensions."""
    return Tracks(
        np.zeros((tracks, MAX_WAYPOINTS, n)),
        np.zeros(tracks, np.int64),
        np.zeros((tracks, MAX_WAYPOINTS)),
        np.zeros((tracks, MAX_WAYPOINTS)),
        np.full(tracks, np.inf),
        np.zeros(n),
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
    clamp(space, out)
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
    tracks.step[t, i] = max(_FINEST * least, step * (_TRIALS_UP if good else _TRIALS_DOWN))
    return good


@kernel
def _border(space: Any, a: Any, b: Any, share: float, other: float, scratch: Any) -> float:
    """Share of an edge at which leaves begin or end between two shares of it, by bisection; the first share where none does."""
    n = a.shape[0]
    for k in range(n):
        scratch[k] = a[k] + share * (b[k] - a[k])
    inside = evaluate(space, scratch) > 0.0
    for k in range(n):
        scratch[k] = a[k] + other * (b[k] - a[k])
    if (evaluate(space, scratch) > 0.0) == inside:
        return share
    for _ in range(_HALVINGS):
        middle = 0.5 * (share + other)
        for k in range(n):
            scratch[k] = a[k] + middle * (b[k] - a[k])
        if (evaluate(space, scratch) > 0.0) == inside:
            share = middle
        else:
            other = middle
    return 0.5 * (share + other)


@kernel
def _three_edges(space: Any, a: Any, b: Any, c: Any, d: Any, weight: float, limit: float) -> tuple[float, float, float]:
    """Costs of a → b, b → c and c → d if their sum stays below the limit, else inf for the first."""
    rest = distance(space, c, d)
    first, second = _two_edges(space, a, b, c, weight, limit - rest)
    if first == np.inf:
        return np.inf, np.inf, np.inf
    third = edge(space, c, d, weight, limit - first - second)
    if first + second + third >= limit:
        return np.inf, np.inf, np.inf
    return first, second, third


@kernel
def _move_two(space: Any, tracks: Any, t: int, weight: float, least: float, random: Any) -> bool:
    """Try to move two neighbouring waypoints alike."""
    m = tracks.size[t]
    if m < 4:
        return _move(space, tracks, t, weight, least, random)
    i = 1 + below(random, m - 3)
    step = math.sqrt(tracks.step[t, i] * tracks.step[t, i + 1])
    limit = (tracks.segment[t, i - 1] + tracks.segment[t, i] + tracks.segment[t, i + 1]) * (1.0 - _GAIN)
    n = tracks.trial.shape[0]
    for k in range(n):
        d = step * normal(random)
        tracks.trial[k] = tracks.points[t, i, k] + d
        tracks.second[k] = tracks.points[t, i + 1, k] + d
    clamp(space, tracks.trial)
    clamp(space, tracks.second)
    good = evaluate(space, tracks.trial) >= 0.0 and evaluate(space, tracks.second) >= 0.0
    if good:
        first, second, third = _three_edges(
            space, tracks.points[t, i - 1], tracks.trial, tracks.second, tracks.points[t, i + 2], weight, limit
        )
        good = first < np.inf
        if good:
            tracks.points[t, i] = tracks.trial
            tracks.points[t, i + 1] = tracks.second
            tracks.segment[t, i - 1] = first
            tracks.segment[t, i] = second
            tracks.segment[t, i + 1] = third
            sum_cost(tracks, t)
    for j in range(i, i + 2):
        tracks.step[t, j] = max(_FINEST * least, tracks.step[t, j] * (_TRIALS_UP if good else _TRIALS_DOWN))
    return good


@kernel
def _make_room(tracks: Any, t: int, i: int, count: int) -> None:
    """Shift the waypoints behind waypoint i of a track by `count` places."""
    for k in range(tracks.size[t] - 1 + count, i + count, -1):
        tracks.points[t, k] = tracks.points[t, k - count]
        tracks.step[t, k] = tracks.step[t, k - count]
        tracks.segment[t, k] = tracks.segment[t, k - count]
    tracks.size[t] += count


@kernel
def _insert(space: Any, tracks: Any, t: int, weight: float, least: float, most: float, two: bool, random: Any) -> bool:
    """Try one new waypoint, or two, beside an edge chosen by its cost.

    Around a corner among leaves one alone may cost more wherever it is put, and two cost less.
    """
    m = tracks.size[t]
    if m + 2 > MAX_WAYPOINTS or m < 2:
        return False
    pick = uniform(random) * tracks.cost[t]
    i = 0
    while i < m - 2 and pick >= tracks.segment[t, i]:
        pick -= tracks.segment[t, i]
        i += 1
    a = tracks.points[t, i]
    b = tracks.points[t, i + 1]
    share = uniform(random)
    step = least * math.exp(uniform(random) * math.log(most / least))
    if two or uniform(random) < _AT_BORDERS:
        other = uniform(random)
        if weight > 0.0:  # otherwise leaves are air
            share = _border(space, a, b, share, other, tracks.trial)
        step *= _FINER
    limit = tracks.segment[t, i] * (1.0 - _GAIN)
    n = a.shape[0]
    for k in range(n):
        tracks.trial[k] = a[k] + share * (b[k] - a[k]) + step * normal(random)
    clamp(space, tracks.trial)
    if evaluate(space, tracks.trial) < 0.0:
        return False
    if not two:
        first, second = _two_edges(space, a, tracks.trial, b, weight, limit)
        if first == np.inf:
            return False
        _make_room(tracks, t, i, 1)
    else:
        length = distance(space, a, b)
        further = min(1.0, share + 3.0 * step * uniform(random) / max(length, 1e-9))
        for k in range(n):
            tracks.second[k] = a[k] + further * (b[k] - a[k]) + step * normal(random)
        clamp(space, tracks.second)
        if evaluate(space, tracks.second) < 0.0:
            return False
        first, second, third = _three_edges(space, a, tracks.trial, tracks.second, b, weight, limit)
        if first == np.inf:
            return False
        _make_room(tracks, t, i, 2)
        tracks.points[t, i + 2] = tracks.second
        tracks.step[t, i + 2] = step
        tracks.segment[t, i + 2] = third
    tracks.points[t, i + 1] = tracks.trial
    tracks.step[t, i + 1] = step
    tracks.segment[t, i] = first
    tracks.segment[t, i + 1] = second
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
        if tracks.size[t] < 3 or kind < _NEW:
            _insert(space, tracks, t, weight, least, most, uniform(random) < _NEW_PAIRS, random)
        elif kind < _NEW + _SHORTCUTS:
            _shortcut(space, tracks, t, weight, random)
        elif kind < _NEW + _SHORTCUTS + _PAIRS:
            _move_two(space, tracks, t, weight, least, random)
        else:
            _move(space, tracks, t, weight, least, random)
