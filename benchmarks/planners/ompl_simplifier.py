"""OMPL's path simplifier under our cost: after a planner that ends with its first path, or beside one that goes on improving."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from ompl import geometric as og

_GAIN = 0.999  # a round that lowers the cost by less brings nothing


def shorten(simplifier: Any, path: Any, step: float) -> None:
    """One round of OMPL's simplifier, in place."""
    while path.getStateCount() < 3:
        path.subdivide()  # OMPL leaves a single edge as it is
    simplifier.partialShortcutPath(path)
    simplifier.perturbPath(path, step)


class Simplification:
    """OMPL's path simplifier under our cost beside an optimising planner, for a share of its time and in its own time.

    Each path that the planner offers is simplified until that brings no more, whether or not it is the best of all: a path that costs more
    as the planner found it often ends lower. What is left of the share goes into the best one.

    Attributes:
        share: of the time, 0 for none.
        cost, path: of the best path so far (OMPL's), None before the first one.
    """

    def __init__(
        self,
        information: Any,
        goal: Any,
        objective: Any,
        settings: Mapping[str, Any],
        spent: Callable[[], float],
        note: Callable[[float], None],
    ) -> None:
        self.share = float(settings.get("simplify_share", 0.0))
        self.cost = math.inf
        self.path: Any = None
        self._rounds = int(settings.get("simplify_rounds", 10))
        self._step = float(settings.get("simplify_step", 0.4))
        self._objective = objective
        self._simplifier = og.PathSimplifier(information, goal, objective)
        self._spent, self._note, self._used_s = spent, note, 0.0
        self._next: Any = None  # the planner's newest path, not begun
        self._own: Any = None  # what is worked on
        self._low, self._idle = math.inf, 0

    def offer(self, path: Any) -> None:
        """Take a path of the planner's; OMPL simplifies in place, so a copy of it."""
        self._next = og.PathGeometric(path)
        self._keep(path, float(path.cost(self._objective).value()))

    def go_on(self) -> float:
        """One round, if it is the simplifier's turn; the wall time of that [s], its callbacks' (which are counted as such) included."""
        began_s, wall_s = self._spent(), time.perf_counter()
        if self.path is None or self._used_s >= self.share * began_s:
            return 0.0
        if self._own is None:
            self._own = self._next if self._next is not None else og.PathGeometric(self.path)
            self._next, self._low, self._idle = None, math.inf, 0
        shorten(self._simplifier, self._own, self._step)
        cost = float(self._own.cost(self._objective).value())
        self._keep(self._own, cost)
        self._idle = 0 if cost < self._low * _GAIN else self._idle + 1
        self._low = min(self._low, cost)
        if self._idle >= self._rounds:
            self._own = None
        self._used_s += self._spent() - began_s
        return time.perf_counter() - wall_s

    def _keep(self, path: Any, cost: float) -> None:
        if cost < self.cost:
            self.cost, self.path = cost, og.PathGeometric(path)
            self._note(cost)
