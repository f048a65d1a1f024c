"""The default planner: anytime and asymptotically optimal on J = ∫ (1 + w · leaf) ds, with stems certified along every edge.

Three parts work in turn, each in compiled slices of a few milliseconds:

1. a straight line and two trees (`connect`) to each goal give first paths quickly;
2. local improvement (`polish`) drives each of them down; the worst are given up (successive halving), because only polishing
   shows which goal and which side of a branch is cheap;
3. a roadmap that grows by batches (`roadmap`), sampled in the whole box, around the goals and around the best paths, is searched
   lazily; what it finds becomes a new path to polish. Uniform samples and k ~ log N neighbours make the whole asymptotically
   optimal (as PRM*, Karaman and Frazzoli 2011).

A sample or a path that cannot lead below the best cost is pruned: the straight distance bounds every cost from below.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.errors import ProblemError
from lime_planner.jit import kernel
from lime_planner.planning import connect as trees
from lime_planner.planning import polish as local
from lime_planner.planning import roadmap as graph
from lime_planner.planning.lime_options import LimeOptions, LimeOutcome
from lime_planner.planning.random import below, normal, random_state, uniform
from lime_planner.space import distance, edge, evaluate
from lime_planner.status import Status

__all__ = ["LimeOptions", "LimeOutcome", "plan_lime", "warm_up"]

Array = npt.NDArray[np.float64]

_SLICE_S = 0.004


@kernel
def _one(space: Any, q: Any) -> Any:
    return evaluate(space, q)


@kernel
def _line(space: Any, a: Any, b: Any, weight: float, bound: float) -> Any:
    return edge(space, a, b, weight, bound)


@kernel
def _draw(space: Any, road: Any, tracks: Any, least: float, most: float, random: Any, q: Any) -> None:
    """Draw a sample: in the whole box, around a goal, or around a point of one of the paths, chosen by cost."""
    n = q.shape[0]
    kind = uniform(random)
    for k in range(n):
        q[k] = space.lower[k] + uniform(random) * (space.upper[k] - space.lower[k])
    if kind < 0.3:
        return
    step = least * math.exp(uniform(random) * math.log(most / least))
    if kind < 0.45:
        goal = 1 + below(random, road.size[2])
        for k in range(n):
            q[k] = road.rows[goal, k]
    else:
        t = below(random, tracks.size.shape[0])
        if tracks.size[t] < 2:
            return
        pick = uniform(random) * tracks.cost[t]
        i = 0
        while i < tracks.size[t] - 2 and pick >= tracks.segment[t, i]:
            pick -= tracks.segment[t, i]
            i += 1
        share = uniform(random)
        for k in range(n):
            q[k] = tracks.points[t, i, k] + share * (tracks.points[t, i + 1, k] - tracks.points[t, i, k])
    for k in range(n):
        q[k] = min(max(q[k] + step * normal(random), space.lower[k]), space.upper[k])


@kernel
def _grow(space: Any, road: Any, tracks: Any, samples: int, best: float, least: float, most: float, random: Any, q: Any) -> None:
    """Draw a number of samples and add the valid ones that may lie on a path cheaper than `best`."""
    for _ in range(samples):
        _draw(space, road, tracks, least, most, random, q)
        ahead = np.inf
        for g in range(1, 1 + road.size[2]):
            ahead = min(ahead, distance(space, q, road.rows[g]))
        if distance(space, q, road.rows[graph.START]) + ahead >= best:
            continue
        leaf = evaluate(space, q)
        if leaf >= 0.0:
            graph.add_vertex(space, road, q, leaf)


class _Run:
    """One search: roadmap, tracks, generator, clock and best path."""

    def __init__(self, space: Any, start: Array, goals: Array, options: LimeOptions, seed: int) -> None:
        n = len(start)
        self.space, self.start, self.goals, self.options = space, start, goals, options
        self.leafless = space._replace(own_leaves=False) if hasattr(space, "own_leaves") else space
        self.random = random_state(seed)
        diagonal = float(np.linalg.norm(np.asarray(space.upper) - np.asarray(space.lower)))
        self.least, self.most = options.least_step * diagonal, options.most_step * diagonal
        self.stride = 0.15 * diagonal
        self.road = graph.new_roadmap(2000, n)
        self.tracks = local.new_tracks(options.tracks + 1, n)
        self.goal_of = [-1] * (options.tracks + 1)
        self.from_start, self.from_goal = trees.new_bush(n), trees.new_bush(n)
        self.path, self.trial, self.q = np.zeros((local.MAX_WAYPOINTS, n)), np.zeros((2, n)), np.zeros(n)
        self.iterations = self.tries = 0
        self.best_cost = math.inf
        self.best_path: Array | None = None
        self.history: list[tuple[float, int, float]] = []
        self.began = time.monotonic()

    def elapsed(self) -> float:
        return time.monotonic() - self.began

    def keep(self, t: int) -> None:
        """Remember track t if it is the best so far."""
        if self.tracks.cost[t] < self.best_cost:
            self.best_cost = float(self.tracks.cost[t])
            self.best_path = self.tracks.points[t, : self.tracks.size[t]].copy()
            self.history.append((self.elapsed(), self.iterations, self.best_cost))

    def adopt(self, count: int, bound: float) -> int:
        """Load the path in `self.path` into the worst track, if it is cheaper than that one and than `bound`; the track or -1."""
        worst = int(np.argmax(self.tracks.cost[:-1]))
        limit = min(bound, float(self.tracks.cost[worst]))
        spare = self.options.tracks
        if not local.load_track(self.space, self.tracks, spare, self.path, count, self.options.weight, self.most / 4, limit):
            return -1
        for name in ("points", "size", "segment", "step", "cost"):
            array = getattr(self.tracks, name)
            array[worst] = array[spare]
        self.tracks.size[spare], self.tracks.cost[spare] = 0, np.inf
        self.keep(worst)
        return worst


def _goal_vertex(run: _Run, t: int) -> int:
    end = run.tracks.points[t, run.tracks.size[t] - 1]
    return 1 + int(np.argmin(((run.goals - end) ** 2).sum(axis=1)))


def plan_lime(
    space: Any,
    start: npt.ArrayLike,
    goals: npt.ArrayLike,
    options: LimeOptions,
    seed: int,
    *,
    iterations: int | None = None,
    should_stop: Callable[[], bool] | None = None,
    deadline_s: float | None = None,
    watch: Callable[[Any], None] | None = None,
) -> LimeOutcome:
    """Plan from a start to the cheapest of several goals.

    Equal arguments, seed and iteration budget give equal results. The best path found is returned at the end, also after a stop.

    Args:
        space: a space of `lime_planner.space`; its counters are written.
        start: (n,); goals: (n,) or (G, n), invalid ones are left out.
        options: see `LimeOptions`.
        seed: of the generator.
        iterations: budget of sampled configurations, None for none.
        should_stop: True ends the search; asked every few milliseconds.
        deadline_s: search time [s], None for none.
        watch: is shown the roadmap (`roadmap.Roadmap`) when the search has ended.

    Raises:
        ProblemError: malformed start or goals, or no end of the search given.
    """
    n = len(space.lower)
    q_start = np.ascontiguousarray(start, dtype=np.float64)
    q_goals = np.ascontiguousarray(np.atleast_2d(np.asarray(goals, dtype=np.float64)))
    if q_start.shape != (n,) or q_goals.ndim != 2 or q_goals.shape[1] != n or len(q_goals) == 0:
        raise ProblemError(f"start needs {n} numbers and goals {n} each, got shapes {q_start.shape} and {q_goals.shape}")
    if not (np.isfinite(q_start).all() and np.isfinite(q_goals).all()):
        raise ProblemError("start or goals have numbers that are not finite")
    if iterations is None and deadline_s is None and should_stop is None:
        raise ProblemError("give iterations, deadline_s or should_stop: the search has no end of its own")
    before = np.array(space.counters)
    run = _Run(space, q_start, q_goals, options, seed)
    if _one(space, q_start) < 0.0:
        return _outcome(run, Status.START_INVALID, before)
    leaf = np.array([_one(space, g) for g in q_goals])
    if not (leaf >= 0.0).any():
        return _outcome(run, Status.GOAL_IN_STEM, before)
    run.goals = q_goals[leaf >= 0.0]
    status = _search(run, leaf[leaf >= 0.0], iterations, should_stop, deadline_s)
    if watch is not None:
        watch(run.road)
    return _outcome(run, status, before)


def warm_up(space: Any) -> None:
    """Compile what an easy problem passes by: where a straight line reaches the goal no tree grows."""
    middle = 0.5 * (np.asarray(space.lower) + np.asarray(space.upper))
    run = _Run(space, middle, middle[None], LimeOptions(), 1)
    trees.plant(run.from_start, middle)
    trees.plant(run.from_goal, middle)
    trees.connect(run.leafless, run.from_start, run.from_goal, 0, run.stride, run.random, run.trial, run.path)


def _search(
    run: _Run, goal_leaf: Array, iterations: int | None, should_stop: Callable[[], bool] | None, deadline_s: float | None
) -> Status:
    """Run the parts in turn until a limit is reached; what the end would mean without a path."""
    ended: list[Status] = []

    def over() -> bool:
        if should_stop is not None and should_stop():
            ended.append(Status.CANCELLED)
        elif iterations is not None and run.iterations >= iterations:
            ended.append(Status.NO_PATH)
        elif deadline_s is not None and run.elapsed() >= deadline_s:
            ended.append(Status.TIMED_OUT)
        return bool(ended)

    left = (lambda wanted: wanted) if iterations is None else (lambda wanted: max(1, min(wanted, iterations - run.iterations)))
    o, space = run.options, run.space
    graph.add_vertex(space, run.road, run.start, max(0.0, _one(space, run.start)))
    for g, intensity in zip(run.goals, goal_leaf, strict=True):
        graph.add_vertex(space, run.road, g, float(intensity))
    run.road.size[2] = len(run.goals)
    for g in run.goals:
        run.path[0], run.path[1] = run.start, g
        if np.isfinite(_line(space, run.start, g, o.weight, run.best_cost)):
            run.adopt(2, math.inf)
        if over():
            return ended[0]
    _first_paths(run, over, left)
    while not over():
        _round(run, over, left)
    return ended[0]


def _first_paths(run: _Run, over: Callable[[], bool], left: Callable[[int], int]) -> None:
    """Reach each goal by two trees, nearest first, and polish what comes out a little."""
    trees.plant(run.from_start, run.start)
    for g in run.goals:
        if over():
            return
        if float(np.linalg.norm(g - run.start)) < run.best_cost:
            _reach(run, g, left(run.options.connect_samples), over, left)


def _reach(run: _Run, goal: Array, samples: int, over: Callable[[], bool], left: Callable[[int], int]) -> None:
    """Try to reach one goal by two trees; the start's tree is kept from goal to goal."""
    if run.from_start.size[0] > trees.CAPACITY // 2:
        trees.plant(run.from_start, run.start)
    trees.plant(run.from_goal, goal)
    while samples > 0 and not over():
        share = left(min(samples, 100))  # short slices: a stop is heard in between
        count, drawn = trees.connect(run.leafless, run.from_start, run.from_goal, share, run.stride, run.random, run.trial, run.path)
        run.iterations += drawn
        samples -= share
        if count:
            t = run.adopt(count, math.inf)
            if t >= 0 and not over():
                _polish(run, t, left(40), over)
            return


def _polish(run: _Run, t: int, trials: int, over: Callable[[], bool]) -> None:
    """Polish a track in slices short enough to be stopped between them: one trial may take 10 ms among leaves, or 10 µs."""
    done, slice_ = 0, 4
    while done < trials:
        size = min(slice_, trials - done)
        began = time.monotonic()
        local.polish(run.space, run.tracks, t, size, run.options.weight, run.least, run.most, run.random)
        run.iterations += size
        done += size
        share = _SLICE_S / max(time.monotonic() - began, 1e-6)
        slice_ = int(min(max(size * share, 1.0), 4.0 * size))
        if done < trials and over():
            break
    run.keep(t)


def _round(run: _Run, over: Callable[[], bool], left: Callable[[int], int]) -> None:
    """One batch of roadmap samples with its search, then polishing of the tracks."""
    o = run.options
    if run.road.size[0] + o.batch + local.MAX_WAYPOINTS > len(run.road.rows) or 2 * run.road.size[1] > len(run.road.length):
        run.road = graph.enlarged(run.road)
    best_track = int(np.argmin(run.tracks.cost))
    if not math.isfinite(run.best_cost):
        # Still no path at all: harder tries, goal after goal, before the roadmap has its turn again.
        run.tries += 1
        samples = o.connect_samples * min(2 ** (run.tries // len(run.goals) + 1), 64)
        _reach(run, run.goals[run.tries % len(run.goals)], left(samples), over, left)
        if over():
            return
    samples = left(o.batch)
    _grow(run.space, run.road, run.tracks, samples, run.best_cost, run.least, run.most, run.random, run.q)
    run.iterations += samples
    if math.isfinite(run.tracks.cost[best_track]):
        goal = _goal_vertex(run, best_track)
        count = int(run.tracks.size[best_track])
        graph.add_path(run.space, run.road, run.tracks.points[best_track], run.tracks.segment[best_track], count, goal)
    graph.begin_search(run.space, run.road, o.weight, run.best_cost)
    while not graph.continue_search(run.space, run.road, o.weight, run.best_cost, 100):
        if over():
            return
    count = graph.read_path(run.road, run.path)
    if count:
        run.adopt(count, math.inf)
    trials = int(o.polish_per_batch * o.batch)
    alive = np.argsort(run.tracks.cost)[: o.tracks]
    alive = alive[np.isfinite(run.tracks.cost[alive])]
    for place, t in enumerate(alive):
        if over():
            return
        _polish(run, int(t), left(max(5, int(trials / 2 ** (place + 1)))), over)


def _outcome(run: _Run, status: Status, before: npt.NDArray[np.int64]) -> LimeOutcome:
    if run.best_path is not None and status in (Status.NO_PATH, Status.TIMED_OUT):
        status = Status.SUCCEEDED
    counted = np.asarray(run.space.counters) - before
    return LimeOutcome(
        run.best_path,
        run.best_cost,
        status,
        run.iterations,
        int(counted[0] + counted[2]),
        int(counted[1]),
        run.history[0][0] if run.history else float("nan"),
        np.array(run.history).reshape(-1, 3),
    )
