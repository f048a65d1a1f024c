"""OMPL's path simplifier under our cost: after a planner that ends with its first path, or beside one that goes on improving."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from ompl import geometric as og

from lime_planner.experiments.peers_callbacks import Callbacks


def shorten(simplifier: Any, path: Any, step: float) -> None:
    """One round of OMPL's simplifier, in place."""
    while path.getStateCount() < 3:
        path.subdivide()  # OMPL leaves a single edge as it is
    simplifier.partialShortcutPath(path)
    simplifier.perturbPath(path, step)


class Simplification:
    """OMPL's path simplifier under our cost beside an optimising planner, for a share of its time and in its own time.

    Each path that the planner offers gets some rounds, whether or not it is the best of all. What is left of the share goes into that one.

    Attributes:
        share: of the time, 0 for none.
        cost, path: of the best path so far (OMPL's), None before the first one.
    """

    def __init__(
        self,
        information: Any,
        goal: Any,
        objective: Any,
        callbacks: Callbacks,
        settings: Mapping[str, Any],
        spent: Callable[[], float],
        note: Callable[[float], None],
    ) -> None:
        self.share = float(settings.get("simplify_share", 0.0))
        self.cost = math.inf
        self.path: Any = None
        self._rounds = int(settings.get("simplify_rounds", 5))
        self._step = float(settings.get("simplify_step", 0.4))
        self._callbacks, self._objective = callbacks, objective
        self._simplifier = og.PathSimplifier(information, goal, objective)
        self._spent, self._note, self._used_s = spent, note, 0.0
        self._left = 0
        self._own: Any = None

    def offer(self, path: Any) -> None:
        """Take a path of the planner's; OMPL simplifies in place, so a copy of it."""
        self._left, self._own = self._rounds, og.PathGeometric(path)
        self._keep(float(path.cost(self._objective).value()))

    def go_on(self) -> None:
        """One round, if it is the simplifier's turn; called where OMPL asks whether to stop, whose time is counted as a callback's."""
        began_s, wall_s = self._spent(), time.perf_counter()
        if self.path is None or self._used_s >= self.share * began_s:
            return
        if self._own is None:
            self._own = og.PathGeometric(self.path)
        shorten(self._simplifier, self._own, self._step)
        cost = float(self._own.cost(self._objective).value())
        self._keep(cost)
        self._left -= 1
        if self._left <= 0 and cost > self.cost:
            self._own = None  # on with the best one
        self._used_s += self._spent() - began_s
        self._callbacks.callback_s -= time.perf_counter() - wall_s  # the rounds are OMPL's, their callbacks have been counted

    def _keep(self, cost: float) -> None:
        if cost < self.cost:
            self.cost, self.path = cost, og.PathGeometric(self._own)
            self._note(cost)
