"""Paths unlike the best one: around the place where it pays most for its leaves, and from new trees.

Polishing ends in the nearest valley of the cost. `Detours` searches the roadmap for paths that keep away from where the best path pays
most for its leaves: a path through another gap may cost more as the roadmap has it and less once it is polished, and the ordinary
search, which asks for paths cheaper than the best, never shows it to the polisher. `Restarts` connects the ways out of start and goal
with two new trees, drawn where paths cheaper than the best may pass: trees that know nothing of the best path end in whatever valley
they meet, to the goal that promises most.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lime_planner.core.types import Array

if TYPE_CHECKING:
    from lime_planner.planning.lime_star.run import Run

_RADIUS = 12.0  # of the closed balls, in least steps
_MOST_EXPENSIVE = 2.5  # cost, over the best, above which a detour is not worth polishing
_EDGES = 200  # evaluated for one detour at most
_CLOSED = 6  # balls at once, before it begins with the best path's again
_SHARE = 0.01  # of the best cost; less leaf than this is not worth a detour

_WORTH = 0.01  # share of the best cost that must be left to be gained
_TIRED = 0.01  # what each try adds to what a goal seems to cost
_TRIALS = 80  # of polishing, before such a path is compared with the others


class Detours:
    """What one run has closed so far.

    Attributes:
        closed: (B, n + 1) centre and radius of the balls, the best path's crossing in the first place.
    """

    def __init__(self, n: int) -> None:
        self.closed: Array = np.zeros((0, n + 1))

    def look(self, run: Run, trials: int) -> None:
        """Search for a path around the closed balls and polish it by `trials`; its own crossing is closed the next time."""
        if run.best_path is None:
            return
        best = crossing(run, run.best_path, run.best_segments)
        if best is None:
            return
        if not len(self.closed) or float(np.linalg.norm(self.closed[0, :-1] - best[:-1])) > 0.5 * best[-1]:
            self.closed = best[None]
        count = run.search(_MOST_EXPENSIVE * run.best_cost, self.closed, _EDGES)
        t = run.adopt(count, instead=True) if count and not run.over() else -1
        if t < 0:
            self.closed = best[None]
            return
        if run.over():
            return
        run.polish(t, trials)
        size = int(run.tracks.size[t])
        other = crossing(run, run.tracks.points[t, :size], run.tracks.segment[t, : size - 1])
        self.closed = best[None] if other is None or len(self.closed) >= _CLOSED else np.vstack([self.closed, other])


def crossing(run: Run, points: Array, segments: Array) -> Array | None:
    """Return a ball around the edge of a path that costs most for leaves, (n + 1,): centre and radius.

    None where leaves hardly cost anything, or where the edge is at the start or a goal, which every path has in common.
    """
    leaf = segments - np.linalg.norm(np.diff(points, axis=0), axis=1)
    i = int(np.argmax(leaf))
    if not leaf[i] > _SHARE * run.best_cost:
        return None
    middle, radius = 0.5 * (points[i] + points[i + 1]), _RADIUS * run.least
    ends = np.vstack([run.start, run.goals])
    if np.linalg.norm(ends - middle, axis=1).min() < 1.5 * radius:
        return None
    return np.concatenate([middle, [radius]])


class Restarts:
    """How often one run planned new paths to which goal.

    Attributes:
        tried: (G,) numbers of tries.
    """

    def __init__(self, goals: int) -> None:
        self.tried = np.zeros(goals)

    def look(self, run: Run) -> bool:
        """Try once; False, and nothing was done, where no goal can be reached for much less than the best path costs."""
        costs = run.least_costs()
        promising = costs < (1.0 - _WORTH) * run.best_cost
        if not promising.any():
            return False
        g = int(np.argmin(np.where(promising, costs * (1.0 + _TIRED * self.tried), math.inf)))
        self.tried[g] += 1
        (root, first), (end, last) = run.out(len(run.goals)), run.out(g)
        samples = run.left(run.options.connect_samples)
        space = run.space if run.options.weight > 0.0 else run.leafless  # at no weight leaves are air
        count = run.connect(space, root, end, samples, solid=True, bound=run.best_cost - first - last - run.terminal[g])
        if count and not run.over():
            run.adopt(run.append_goal(run.prepend_start(count), g), trials=_TRIALS)
        return True
