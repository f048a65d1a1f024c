"""Paths anew: two trees between the ways out of start and goal, drawn where paths cheaper than the best may pass.

Polishing ends in the nearest valley, and the roadmap shows others only where they cost less before they are polished. Trees that
know nothing of the best path end in whatever valley they meet, to the goal that promises most.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lime_planner.planning.lime_star.run import Run

_WORTH = 0.01  # share of the best cost that must be left to be gained
_TIRED = 0.01  # what each try adds to what a goal seems to cost
_TRIALS = 80  # of polishing, before such a path is compared with the others


class Restarts:
    """How often one run tried which goal anew.

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
        count = run.connect(run.space, root, end, samples, solid=True, bound=run.best_cost - first - last)
        if count and not run.over():
            run.adopt(run.append_goal(run.prepend_start(count), g), trials=_TRIALS)
        return True
