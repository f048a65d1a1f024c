"""Searches of one problem side by side, a thread each, that tell each other what they found.

Every search is a run of its own with a seed and a space of its own. Where it has done a share of work, counted in configurations
checked and not in time, it posts its best path and its ways out of the leaves, and takes up what the others posted at their last such
place but one: a search waits for another only where it is more than a whole share ahead. So what each of them knows, and when, depends
on nothing but seeds and budgets: the same iterations, seed and number of threads give the same result whatever the timing.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.types import Array
from lime_planner.planning.lime_star.run import Run

CHECKS = 3000  #: configurations checked between two exchanges: a fiftieth of a second or so
_BEHIND = 1  # shares that what is taken up is older than what is posted
_WAIT_S = 0.002  # between two looks at whether the search is to end
_BETTER = 1e-6  # share by which another's path must be cheaper to be taken up


class Findings(NamedTuple):
    """What a search posts.

    Attributes:
        cost: of its best path, the goal's terminal cost included; inf without one. path: (M, n), empty without one.
        segments: (M - 1,) costs of its edges.
        ends, costs: (G + 1, n) and (G + 1,) its ways out of the leaves, the start's in the last place.
    """

    cost: float
    path: Array
    segments: Array
    ends: Array
    costs: Array


def findings_of(run: Run) -> Findings:
    """Return a copy of what a search knows."""
    path = np.zeros((0, len(run.start))) if run.best_path is None else run.best_path
    return Findings(run.best_cost, path, run.best_segments, run.exits.ends.copy(), run.exits.cost.copy())


def take_up(run: Run, found: Findings) -> None:
    """Let a search know what another one found, where it is better than its own."""
    better = found.costs < run.exits.cost
    run.exits.ends[better], run.exits.cost[better] = found.ends[better], found.costs[better]
    if not len(found.path) or run.over():
        return
    path, cost = found.path, found.cost
    if run.best_path is not None:
        own = Findings(run.best_cost, run.best_path, run.best_segments, found.ends, found.costs)
        path, cost = spliced(own, found)
    if cost < run.best_cost * (1.0 - _BETTER) and len(path) <= len(run.path):
        run.path[: len(path)] = path
        run.adopt(len(path))


def spliced(own: Findings, found: Findings) -> tuple[Array, float]:
    """Return the cheaper of two paths' pieces between the waypoints that both have, joined, (M, n), and its cost.

    Two searches that polish the same path soon have others of the same: what each gained where the other gained less is kept.
    """
    place = {q.tobytes(): j for j, q in enumerate(found.path)}
    if found.path[-1].tobytes() != own.path[-1].tobytes():  # another goal: its terminal cost is another too
        return (found.path, found.cost) if found.cost < own.cost else (own.path, own.cost)
    pieces, saved = [own.path[:1]], 0.0
    i = j = 0
    for k in range(1, len(own.path)):
        at = place.get(own.path[k].tobytes(), -1)
        if at <= j:
            continue
        gain = float(own.segments[i:k].sum() - found.segments[j:at].sum())
        pieces.append(found.path[j + 1 : at + 1] if gain > 0.0 else own.path[i + 1 : k + 1])
        saved += max(gain, 0.0)
        i, j = k, at
    return np.concatenate(pieces), own.cost - saved


class Exchange:
    """Where the searches of one problem meet.

    Attributes:
        searches: how many there are; stopped: set where all of them are to end.
    """

    def __init__(self, searches: int) -> None:
        """Prepare for a number of searches."""
        self.searches, self.stopped = searches, threading.Event()
        self._news = threading.Condition()
        self._posted: list[dict[int, Findings]] = [{} for _ in range(searches)]
        self._count, self._done = [0] * searches, [False] * searches

    def meet(self, own: int, run: Run) -> None:
        """Post what search `own` knows, and take up what the others knew when they posted the last time but one."""
        with self._news:
            self._posted[own][self._count[own]] = findings_of(run)
            self._count[own] += 1
            self._forget(own)
            self._news.notify_all()
        wanted = self._count[own] - 1 - _BEHIND
        for other in range(len(self._posted)):
            if other != own and wanted >= 0:
                found = self._wait(other, wanted, run)
                if found is not None:
                    take_up(run, found)

    def leave(self, own: int) -> None:
        """Search `own` has ended: nobody waits for it any more."""
        with self._news:
            self._done[own] = True
            self._news.notify_all()

    def wait_for_all(self, look: Callable[[], None]) -> None:
        """Wait until all searches have ended; `look` is called in between."""
        while not all(self._done):
            look()
            with self._news:
                if not all(self._done):
                    self._news.wait(_WAIT_S)

    def _forget(self, own: int) -> None:
        """Drop what no search will ask for any more."""
        others = [self._count[i] for i in range(len(self._count)) if i != own and not self._done[i]]
        for number in [n for n in self._posted[own] if others and n < min(others) - 1 - _BEHIND]:
            del self._posted[own][number]

    def _wait(self, other: int, wanted: int, run: Run) -> Findings | None:
        """Wait until a search has posted so often; None where it ends before, or this one does."""
        while True:
            with self._news:
                if self._count[other] > wanted:
                    return self._posted[other][wanted]
                if self._done[other]:
                    return None
                self._news.wait(_WAIT_S)
            if run.over():
                return None


class Meeting:
    """One search's part in an exchange: called between its rounds, it meets the others after each share of work."""

    def __init__(self, exchange: Exchange, own: int, run: Run) -> None:
        """Begin to count the work of a search, which has the place `own`."""
        self._exchange, self._own = exchange, own
        self._counters = run.space.counters
        self._next = self._checks() + CHECKS if exchange.searches > 1 else math.inf

    def __call__(self, run: Run) -> None:
        """Meet the others if it is time."""
        if self._checks() < self._next or run.over():
            return
        self._next = self._checks() + CHECKS
        self._exchange.meet(self._own, run)

    def _checks(self) -> int:
        return int(self._counters[0] + self._counters[2])


def search_all(
    exchange: Exchange,
    prepare: Callable[[int], Run],
    search: Callable[[Run, Callable[[Run], None]], None],
    look: Callable[[], None],
) -> list[Run]:
    """Carry out searches side by side, the first in the calling thread; return their runs when all have ended.

    Args:
        exchange: of these searches.
        prepare: makes the run with a number, in its own thread.
        search: carries a run out and calls its second argument between rounds.
        look: called while the first search is over and others are not; may set `exchange.stopped`.

    Raises:
        Exception: what one of them raised; the others are stopped.
    """
    searches = exchange.searches
    runs: list[Run | None] = [None] * searches
    errors: list[BaseException] = []

    def carry_out(number: int) -> None:
        try:
            run = runs[number] = prepare(number)
            search(run, Meeting(exchange, number, run))
        except BaseException as error:
            errors.append(error)
            exchange.stopped.set()
        finally:
            exchange.leave(number)

    threads = [threading.Thread(target=carry_out, args=(i,), name=f"search {i}", daemon=True) for i in range(1, searches)]
    try:
        for thread in threads:
            thread.start()
        carry_out(0)
        if not errors:
            exchange.wait_for_all(look)
    finally:  # whatever happens here, the threads end before this returns
        exchange.stopped.set()
        for thread in threads:
            if thread.ident is not None:
                thread.join()
    if errors:
        raise errors[0]
    return [run for run in runs if run is not None]


def merged_history(runs: list[Run]) -> Any:
    """Return the improvements of all runs together, (K, 3): time [s], iterations of the run that found it, cost."""
    falling: list[tuple[float, int, float]] = []
    for event in sorted((event for run in runs for event in run.history), key=lambda event: event[0]):
        if not falling or event[2] < falling[-1][2]:
            falling.append(event)
    return np.array(falling).reshape(-1, 3)
