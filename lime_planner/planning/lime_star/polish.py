"""Local improvement of a path: waypoints and stretches moved, corners cut, waypoints put in, each kept if the path's cost falls.

A path of many waypoints is improved slowly, one waypoint at a time. So a waypoint that gains next to nothing is not put in, and one
whose absence costs next to nothing is left out: how much that is, is the tolerance, a share of the path's cost.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lime_planner.core.jit import copy_row, kernel
from lime_planner.planning.lime_star.tracks import MAX_WAYPOINTS, cost_between, make_room, sum_cost, take_out
from lime_planner.planning.sampling import below, normal, uniform
from lime_planner.planning.space import clamp, distance, edge, evaluate

_GAIN = 1e-9  # a moved waypoint must be better by this share of the cost
_TRIALS_UP, _TRIALS_DOWN = 1.6, 0.87  # step control of moved waypoints: the one-fifth success rule
_FINEST = 0.03  # how far below the least step that control may go
# Shares of the trials: new waypoints (of these two at once), shortcuts, corners cut, stretches moved; the others move one waypoint.
_NEW, _NEW_PAIRS, _SHORTCUTS, _CUTS, _BENDS = 0.3, 0.3, 0.1, 0.15, 0.12
_FURTHER = 0.5  # chance that a corner that is cut has one waypoint more
_SMALLEST_CUT = 4.0  # the least share of an edge that is cut away is exp of minus this
_AT_BORDERS = 0.5  # share of the new waypoints that are put where leaves begin or end: there the best paths have their bends
_FINER = 0.3  # their step, over that of the others
_HALVINGS = 7  # for finding such a place


@kernel
def _shortcut(space: Any, tracks: Any, t: int, weight: float, tolerance: float, random: Any) -> bool:
    """Try to join two waypoints directly."""
    m = tracks.size[t]
    if m < 3:
        return False
    i = below(random, m - 2)
    j = i + 2 + below(random, m - i - 2)
    limit = cost_between(tracks, t, i, j) + tolerance * tracks.cost[t]
    if distance(space, tracks.points[t, i], tracks.points[t, j]) >= limit:
        return False
    c = edge(space, tracks.points[t, i], tracks.points[t, j], weight, limit)
    if c >= limit:
        return False
    take_out(tracks, t, i, j - i - 1)
    tracks.segment[t, i] = c
    sum_cost(tracks, t)
    return True


@kernel
def _cut(space: Any, tracks: Any, t: int, weight: float, tolerance: float, random: Any) -> bool:
    """Try to cut a corner: join two points inside two edges. In free space what is valid is shorter."""
    m = tracks.size[t]
    if m < 3 or m + 2 > MAX_WAYPOINTS:
        return False
    i = below(random, m - 2)
    j = i + 1
    while j < m - 2 and uniform(random) < _FURTHER:
        j += 1
    n = tracks.trial.shape[0]
    # Shares of the two edges that are cut away, small ones as likely as large ones.
    first, last = math.exp(-_SMALLEST_CUT * uniform(random)), math.exp(-_SMALLEST_CUT * uniform(random))
    a, b = tracks.points[t, i], tracks.points[t, i + 1]
    c, d = tracks.points[t, j], tracks.points[t, j + 1]
    for k in range(n):
        tracks.trial[k] = b[k] + first * (a[k] - b[k])
        tracks.second[k] = c[k] + last * (d[k] - c[k])
    limit = cost_between(tracks, t, i, j + 1) - 2.0 * tolerance * tracks.cost[t]
    length_a, length_d = distance(space, a, b), distance(space, c, d)
    rest = length_a * (1.0 - first) + length_d * (1.0 - last)
    if distance(space, tracks.trial, tracks.second) + rest >= limit:
        return False
    if evaluate(space, tracks.trial) < 0.0 or evaluate(space, tracks.second) < 0.0:
        return False
    middle = edge(space, tracks.trial, tracks.second, weight, limit - rest)
    if middle + rest >= limit:
        return False
    before = edge(space, a, tracks.trial, weight, limit - middle)
    if middle + before >= limit:
        return False
    after = edge(space, tracks.second, d, weight, limit - middle - before)
    if middle + before + after >= limit:
        return False
    step = tracks.step[t, i + 1]
    other = tracks.step[t, j]
    if j == i + 1:
        make_room(tracks, t, i + 1, 1)
    else:  # of the waypoints between the two edges two stay
        take_out(tracks, t, i + 2, j - i - 2)
    copy_row(tracks.trial, tracks.points[t, i + 1])
    copy_row(tracks.second, tracks.points[t, i + 2])
    tracks.step[t, i + 1] = step
    tracks.step[t, i + 2] = other
    tracks.segment[t, i] = before
    tracks.segment[t, i + 1] = middle
    tracks.segment[t, i + 2] = after
    sum_cost(tracks, t)
    return True


@kernel
def _two_edges(space: Any, a: Any, b: Any, c: Any, weight: float, limit: float) -> tuple[float, float]:
    """Costs of a → b and b → c if b is valid and their sum stays below the limit, else inf for the first."""
    rest = distance(space, b, c)
    if distance(space, a, b) + rest >= limit or evaluate(space, b) < 0.0:
        return np.inf, np.inf
    first = edge(space, a, b, weight, limit - rest)
    if first + rest >= limit:
        return np.inf, np.inf
    second = edge(space, b, c, weight, limit - first)
    if first + second >= limit:
        return np.inf, np.inf
    return first, second


@kernel
def _perturb(space: Any, centre: Any, step: float, random: Any, out: Any) -> None:
    """Draw a configuration around a centre, all coordinates or only one of them moved."""
    n = centre.shape[0]
    only = below(random, 3 * n) if n > 2 else n  # one time in three a single coordinate
    for k in range(n):
        out[k] = centre[k]
        if only >= n or only == k:
            out[k] += step * normal(random)
    clamp(space, out)


@kernel
def _move(space: Any, tracks: Any, t: int, weight: float, least: float, random: Any) -> bool:
    """Try to move one waypoint."""
    m = tracks.size[t]
    if m < 3:
        return False
    i = 1 + below(random, m - 2)
    step = tracks.step[t, i]
    limit = (tracks.segment[t, i - 1] + tracks.segment[t, i]) * (1.0 - _GAIN)
    _perturb(space, tracks.points[t, i], step, random, tracks.trial)
    first, second = _two_edges(space, tracks.points[t, i - 1], tracks.trial, tracks.points[t, i + 1], weight, limit)
    good = first < np.inf
    if good:
        copy_row(tracks.trial, tracks.points[t, i])
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
    """Costs of a → b, b → c and c → d if b and c are valid and their sum stays below the limit, else inf for the first."""
    rest = distance(space, c, d)
    if distance(space, a, b) + distance(space, b, c) + rest >= limit or evaluate(space, c) < 0.0:
        return np.inf, np.inf, np.inf
    first, second = _two_edges(space, a, b, c, weight, limit - rest)
    if first == np.inf:
        return np.inf, np.inf, np.inf
    third = edge(space, c, d, weight, limit - first - second)
    if first + second + third >= limit:
        return np.inf, np.inf, np.inf
    return first, second, third


@kernel
def _bend(space: Any, tracks: Any, t: int, weight: float, least: float, random: Any) -> bool:
    """Try to shift a stretch of the path as one: a waypoint most, those on either side of it less and less."""
    m = tracks.size[t]
    if m < 4:
        return _move(space, tracks, t, weight, least, random)
    n = tracks.trial.shape[0]
    i = 1 + below(random, m - 2)
    first = 1 + below(random, i)
    last = i + below(random, m - 1 - i)
    for k in range(n):
        tracks.trial[k] = tracks.step[t, i] * normal(random)
    limit = cost_between(tracks, t, first - 1, last + 1) * (1.0 - _GAIN)
    for j in range(first - 1, last + 2):
        share = (j - first + 1.0) / (i - first + 1.0) if j <= i else (last - j + 1.0) / (last - i + 1.0)
        for k in range(n):
            tracks.moved[j, k] = tracks.points[t, j, k] + share * tracks.trial[k]
        if first <= j <= last:  # the two beside the stretch stay where they are
            clamp(space, tracks.moved[j])
    good = _price(space, tracks, first - 1, last + 1, weight, limit)
    if good:
        for j in range(first - 1, last + 1):
            tracks.segment[t, j] = tracks.price[j]
            if j >= first:
                copy_row(tracks.moved[j], tracks.points[t, j])
        sum_cost(tracks, t)
    for j in range(first, last + 1):
        tracks.step[t, j] = max(_FINEST * least, tracks.step[t, j] * (_TRIALS_UP if good else _TRIALS_DOWN))
    return good


@kernel
def _price(space: Any, tracks: Any, first: int, last: int, weight: float, limit: float) -> bool:
    """Evaluate the edges from waypoint `first` to `last` of the path in `moved`; False where their sum is not below the limit."""
    rest = 0.0
    for j in range(first, last):
        rest += distance(space, tracks.moved[j], tracks.moved[j + 1])
    if not rest < limit:
        return False
    for j in range(first + 1, last):
        if evaluate(space, tracks.moved[j]) < 0.0:
            return False
    for j in range(first, last):
        rest -= distance(space, tracks.moved[j], tracks.moved[j + 1])
        tracks.price[j] = edge(space, tracks.moved[j], tracks.moved[j + 1], weight, limit - rest)
        rest += tracks.price[j]
        if not rest < limit:
            return False
    return True


@kernel
def _insert(space: Any, tracks: Any, t: int, weight: float, least: float, most: float, two: bool, tolerance: float, random: Any) -> bool:
    """Try one new waypoint, or two, beside an edge chosen by its cost.

    Around a corner among leaves one alone may cost more wherever it is put, and two cost less.
    """
    m = tracks.size[t]
    if m + 2 > MAX_WAYPOINTS or m < 2:
        return False
    pick = uniform(random) * (tracks.cost[t] - tracks.terminal[t])
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
    limit = tracks.segment[t, i] - 2.0 * tolerance * tracks.cost[t]
    n = a.shape[0]
    for k in range(n):
        tracks.trial[k] = a[k] + share * (b[k] - a[k]) + step * normal(random)
    clamp(space, tracks.trial)
    if not two:
        first, second = _two_edges(space, a, tracks.trial, b, weight, limit)
        if first == np.inf:
            return False
        make_room(tracks, t, i, 1)
    else:
        length = distance(space, a, b)
        further = min(1.0, share + 3.0 * step * uniform(random) / max(length, 1e-9))
        for k in range(n):
            tracks.second[k] = a[k] + further * (b[k] - a[k]) + step * normal(random)
        clamp(space, tracks.second)
        first, second, third = _three_edges(space, a, tracks.trial, tracks.second, b, weight, limit)
        if first == np.inf:
            return False
        make_room(tracks, t, i, 2)
        copy_row(tracks.second, tracks.points[t, i + 2])
        tracks.step[t, i + 2] = step
        tracks.segment[t, i + 2] = third
    copy_row(tracks.trial, tracks.points[t, i + 1])
    tracks.step[t, i + 1] = step
    tracks.segment[t, i] = first
    tracks.segment[t, i + 1] = second
    sum_cost(tracks, t)
    return True


@kernel
def polish(space: Any, tracks: Any, t: int, trials: int, weight: float, least: float, most: float, tolerance: float, random: Any) -> None:
    """Make a number of trials on track t.

    Args:
        space: the space.
        tracks, t: the track, not empty.
        trials: configurations or shortcuts to try.
        weight: leaf weight of J.
        least, most: smallest and largest standard deviation of a new waypoint [unit of the space].
        tolerance: share of the cost that leaving waypoints out may add; a further waypoint must gain twice as much.
        random: generator state.
    """
    for _ in range(trials):
        kind = uniform(random)
        if tracks.size[t] < 3 or kind < _NEW:
            _insert(space, tracks, t, weight, least, most, uniform(random) < _NEW_PAIRS, tolerance, random)
        elif kind < _NEW + _SHORTCUTS:
            _shortcut(space, tracks, t, weight, tolerance, random)
        elif kind < _NEW + _SHORTCUTS + _CUTS:
            _cut(space, tracks, t, weight, tolerance, random)
        elif kind < _NEW + _SHORTCUTS + _CUTS + _BENDS:
            _bend(space, tracks, t, weight, least, random)
        else:
            _move(space, tracks, t, weight, least, random)
