"""State of one run of the default planner, and the parts that bring paths into it: trees, ways out of the leaves, polishing."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lime_planner.core.types import Array, Int64
from lime_planner.planning.lime_star import connect as trees
from lime_planner.planning.lime_star import leaf_exits
from lime_planner.planning.lime_star import polish as local
from lime_planner.planning.lime_star import roadmap as graph
from lime_planner.planning.lime_star.options import LimeOptions
from lime_planner.planning.lime_star.tracks import MAX_WAYPOINTS, copy_track, empty_track, load_track, near_tracks, new_tracks
from lime_planner.planning.sampling import random_state
from lime_planner.planning.space import line, one

_SLICE_S = 0.004
_PROMISING = 0.95  # share of the best cost below which a way out that was not reached is tried again
_EDGES_IN_ONE_GO = 10  # an edge among leaves takes a millisecond or two at worst, and a stop is heard in between
_CHEAP = 4.0  # times its length that a straight line may cost before others are tried
_POOR = 3.0  # times the cheapest way out's cost that those of other goals may cost; ends that cost more are not looked at further
_JOINED_FIRST = 6
_LONGEST = 16  # such tries take at most so many times the first one's samples
_FIRST_TRIALS = 20  # ways out tried for each goal before the worse half is left aside; then twice as many for the others
_STAGES = 5
_TRIALS_IN_ONE_GO = 20
_SAMPLES_IN_ONE_GO = 25
# Less gain than this in one round is none: a share of the track's cost, and a share of what it is behind the best.
_STALE, _SLOW = 5e-5, 0.02
_HOPELESS = 2.0  # times the cost of the worst track, above which a new path is not polished at all
_FAIR = 40  # polishing trials of a new path before it is compared with the others
_TOLERANCE, _FINER = 3e-4, 8  # of the polishing (`polish`), and how often it is halved for a path that does not get better any more
_SAME, _COPIES = 10.0, 3  # least steps between two paths that are nearly the same, and how many of these may be tracks
_TRIED = 6  # waypoints of the best path from which the end of a way out is tried to be reached

_TURN_RAD, _SAME_TURN_RAD = 2.0 * np.pi, 1e-6


def twins(goals: Array) -> Int64:
    """Return, for each of the goals (G, n), the first one that differs from it by whole turns of its joints only, (G,)."""
    turns = (goals[:, None, :] - goals[None, :, :]) / _TURN_RAD
    alike = (np.abs(turns - np.rint(turns)) < _SAME_TURN_RAD).all(axis=2)
    return np.asarray(alike.argmax(axis=1), dtype=np.int64)


class Run:
    """One search: roadmap, tracks, ways out, generator, clock, limits and best path.

    Attributes:
        goals: (G, n) valid goals; terminal: (G,) what ending there adds to J; goal_leaf: (G,) leaf intensity there.
        exits: way out of each goal, the start's in the last place.
        twin: (G,) the first goal that differs by whole turns only: leaves and stems are the same there, and ways out are shared.
        tracks: paths being polished; the last place is for loading.
        idle: (T,) whether a track's last polishing brought next to nothing; halved: (T,) times that its tolerance was halved.
        joins: (G,) times that a goal's way out was tried to be reached.
        best_path, best_cost, best_segments: so far; (M - 1,) costs of the edges.
        rounds: how many there were; spare: trials that polishing left for restarts.
        ended: what ended the run, None while it goes on.
    """

    def __init__(
        self,
        space: Any,
        start: Array,
        goals: Array,
        terminal: Array,
        options: LimeOptions,
        seed: int,
        iterations: int | None = None,
        over: Callable[[Run], bool] = lambda _: False,
        began: float | None = None,
    ) -> None:
        """Prepare a run.

        Args:
            space, start, goals, terminal, options, seed: as for `plan_lime`, everything valid.
            iterations: budget, None for none.
            over: tells whether the run has ended.
            began: reading of `time.monotonic` from which times are counted [s], None for now.
        """
        self.began = time.monotonic() if began is None else began
        n = len(start)
        self.space, self.start, self.options = space.handle(), start, options
        self.goals, self.terminal = goals, terminal
        self.goal_leaf = np.zeros(len(goals))
        self.start_leaf = 0.0
        self.leafless = space._replace(own_leaves=False).handle() if hasattr(space, "own_leaves") else self.space
        self.random = random_state(seed)
        diagonal = float(np.linalg.norm(np.asarray(space.upper) - np.asarray(space.lower)))
        self.least, self.most = options.least_step * diagonal, options.most_step * diagonal
        self.stride = 0.15 * diagonal
        self.same = _SAME * self.least
        self.road = graph.new_roadmap(2000, n)
        self.tracks = new_tracks(options.tracks + 1, n)
        self.joins = np.zeros(len(goals))
        self.idle, self.halved = np.zeros(options.tracks + 1, dtype=bool), np.zeros(options.tracks + 1)
        self.exits = leaf_exits.new_exits(len(goals) + 1, n, self.least)
        self.twin = twins(goals)
        self.from_start, self.from_goal = trees.new_tree(n), trees.new_tree(n)
        self.path, self.trial, self.q = np.zeros((MAX_WAYPOINTS, n)), np.zeros((2, n)), np.zeros(n)
        self.iterations = self.tries = 0
        self._budget, self._over = iterations, over
        self.best_cost = math.inf
        self.best_path: Array | None = None
        self.best_segments: Array = np.zeros(0)
        self.everywhere: Array = np.zeros((0, n + 1))  # no ball is closed
        self.rounds, self.spare = 0, 0.0
        self._rooted: tuple[bytes, bool] | None = None
        self.history: list[tuple[float, int, float]] = []

    def elapsed(self) -> float:
        """Time since the run began [s]."""
        return time.monotonic() - self.began

    def over(self) -> bool:
        """Tell whether the run has ended."""
        return self._over(self)

    def left(self, wanted: int) -> int:
        """As many of the wanted iterations as the budget has left, at least one."""
        return wanted if self._budget is None else max(1, min(wanted, self._budget - self.iterations))

    # --- paths that come in ---------------------------------------------------------------------------------------------------

    def keep(self, t: int) -> None:
        """Remember track t if it is the best so far."""
        if self.tracks.cost[t] < self.best_cost:
            self.best_cost = float(self.tracks.cost[t])
            self.best_path = self.tracks.points[t, : self.tracks.size[t]].copy()
            self.best_segments = self.tracks.segment[t, : self.tracks.size[t] - 1].copy()
            self.history.append((self.elapsed(), self.iterations, self.best_cost))

    def straight_lines(self) -> None:
        """Try the straight line to each goal, the nearest first: those that hardly touch leaves, or else the first that touches no stem.

        To measure how much a line touches takes milliseconds where it is much, and polishing comes to the same from any of them.
        """
        lengths = np.linalg.norm(self.goals - self.start, axis=1)
        order = np.argsort(lengths + self.terminal, kind="stable")
        for g in order:
            bound = min(_CHEAP * float(lengths[g]), self.best_cost - float(self.terminal[g]))
            self.path[0], self.path[1] = self.start, self.goals[g]
            if line(self.space, self.start, self.goals[g], self.options.weight, bound) < bound:
                self.adopt(2)
            if self.over():
                return
        for g in order:
            if math.isfinite(self.best_cost) or self.over():
                return
            self.path[0], self.path[1] = self.start, self.goals[g]
            if np.isfinite(line(self.leafless, self.start, self.goals[g], 0.0, math.inf)):
                self.adopt(2)

    def adopt(self, count: int, *, trials: int = 0, instead: bool = False) -> int:
        """Make the path in `self.path` a track, after some polishing trials; the track, or -1 where it is not worth it.

        It replaces the worst if that costs more, or anyway (`instead`); but where some tracks are nearly the same as it already, the most
        expensive of these: tracks that all are one path would be of no more use than one.
        """
        tracks, spare = self.tracks, self.options.tracks
        worst = int(np.argmax(tracks.cost[:-1]))
        limit = math.inf if instead else float(tracks.cost[worst]) * (_HOPELESS if trials else 1.0)
        terminal = float(self.terminal[self.goal_at(self.path[count - 1])])
        if not load_track(self.space, tracks, spare, self.path, count, terminal, self.options.weight, self.most / 4, limit):
            return -1
        self.halved[spare] = 0.0
        self.keep(spare)
        if trials and not self.over():
            self.polish(spare, trials)
        copies, most_expensive = near_tracks(self.space, tracks, spare, self.same)
        place = worst if copies < _COPIES else most_expensive
        if tracks.cost[spare] < tracks.cost[place] or (instead and not copies):
            copy_track(tracks, spare, place)
            self.idle[place], self.halved[place] = False, 0.0
        else:
            place = -1
        empty_track(tracks, spare)
        return place

    def polish(self, t: int, trials: int) -> None:
        """Polish a track in slices short enough to be stopped between them: one trial may take 10 ms among leaves, or 10 µs."""
        trials = self.left(trials)
        o, before, done, slice_ = self.options, float(self.tracks.cost[t]), 0, 4
        tolerance = _TOLERANCE / 2.0 ** self.halved[t]
        while done < trials:
            size = min(slice_, trials - done)
            began = time.monotonic()
            local.polish(self.space, self.tracks, t, size, o.weight, self.least, self.most, tolerance, self.random)
            self.iterations += size
            done += size
            share = _SLICE_S / max(time.monotonic() - began, 1e-6)
            slice_ = int(min(max(size * share, 1.0), 4.0 * size))
            if done < trials and self.over():
                break
        cost = float(self.tracks.cost[t])
        stale = before - cost < max(_STALE * cost, _SLOW * (cost - self.best_cost))
        self.idle[t] = stale
        self.halved[t] = min(self.halved[t] + stale, _FINER)
        self.keep(t)

    def goal_vertex(self, t: int) -> int:
        """The roadmap's vertex of the goal that track t ends at."""
        return 1 + self.goal_at(self.tracks.points[t, self.tracks.size[t] - 1])

    def goal_at(self, q: Array) -> int:
        """Which goal is at q."""
        return int(np.argmin(((self.goals - q) ** 2).sum(axis=1)))

    def search(self, bound: float, closed: Array, edges: int | None = None) -> int:
        """Search the roadmap for a path cheaper than `bound`, around closed balls; the number of waypoints in `self.path`, or 0.

        At most `edges` edges are evaluated; a search that would take more finds nothing.
        """
        graph.begin_search(self.space, self.road, self.options.weight, bound, closed)
        while not graph.continue_search(self.space, self.road, self.options.weight, bound, closed, _EDGES_IN_ONE_GO):
            edges = None if edges is None else edges - _EDGES_IN_ONE_GO
            if self.over() or (edges is not None and edges <= 0):
                return 0
        return int(graph.read_path(self.road, self.path))

    # --- trees ----------------------------------------------------------------------------------------------------------------

    def reach(self, goal: Array, samples: int, trials: int = _FAIR) -> bool:
        """Try to reach a goal from the start by two trees that leave leaves out of account; polish what comes out a little."""
        count = self.connect(self.leafless, self.start, goal, samples, solid=False)
        if not count:
            return False
        self.adopt(count, trials=trials)
        return True

    def connect(self, space: Any, root: Array, goal: Array, samples: int, *, solid: bool, bound: float = math.inf) -> int:
        """Write a path between two configurations into `self.path`; the number of waypoints, 0 without one.

        The start's tree is kept for the next goal, but where a path below a bound is asked for: it would give the same path again.
        """
        rooted = (root.tobytes(), solid)
        if math.isfinite(bound) or rooted != self._rooted or self.from_start.size[0] > trees.CAPACITY // 2:
            trees.reset(self.from_start, root)
            self._rooted = rooted
        trees.reset(self.from_goal, goal)
        while samples > 0 and not self.over():
            share = self.left(min(samples, _SAMPLES_IN_ONE_GO))  # short slices: a stop is heard in between
            stride = self.stride / 3.0 if solid else self.stride
            count, drawn = trees.connect(
                space, self.from_start, self.from_goal, share, stride, bound, solid, self.random, self.trial, self.path
            )
            self.iterations += drawn
            samples -= share
            if count:
                return int(count)
        return 0

    # --- ways out of the leaves -----------------------------------------------------------------------------------------------

    def origin(self, g: int) -> Array:
        """The configuration whose way out is in place g of the exits."""
        return self.start if g == len(self.goals) else np.asarray(self.goals[g])

    def out(self, g: int) -> tuple[Array, float]:
        """The end of a way out, and its cost; the configuration itself where it touches no leaf."""
        leaf = self.start_leaf if g == len(self.goals) else self.goal_leaf[g]
        return (self.exits.ends[g], float(self.exits.cost[g])) if leaf > 0.0 else (self.origin(g), 0.0)

    def look_for_ways_out(self) -> None:
        """Find ways out of start and goals, with most trials for the goals that turn out cheap (successive halving)."""
        if self.start_leaf > 0.0:
            self._improve(len(self.goals), _FIRST_TRIALS * _STAGES)
        alive = np.unique(self.twin[self.goal_leaf > 0.0])
        trials = _FIRST_TRIALS
        for _ in range(_STAGES):
            for g in alive:
                if self.over():
                    return
                bound = _POOR * float((self.exits.cost[:-1] + self.terminal).min()) - float(self.terminal[g])
                self._improve(int(g), trials, bound)
            costs = self.exits.cost[alive] + self.terminal[alive]
            alive = alive[np.argsort(costs, kind="stable")][: max(1, len(alive) // 2)]
            trials *= 2
            # The best so far at once: a search that ends now should have something of it.
            if len(alive):
                alike = np.flatnonzero(self.twin == alive[0])
                best = int(alike[np.argmin([self.least_cost(int(g)) for g in alike])])
                if self.least_cost(best) < self.best_cost and not self.over():
                    self.join(best)

    def _improve(self, g: int, trials: int, bound: float = math.inf) -> bool:
        """Try more ways out of one configuration, cheaper than a bound, in slices: a stop is heard in between."""
        o, better = self.options, False
        while trials > 0 and not self.over():
            share = self.left(min(trials, _TRIALS_IN_ONE_GO))
            better |= leaf_exits.improve(
                self.space, self.exits, g, self.origin(g), share, o.weight, bound, 2.0 * self.least, self.most / 2.0, self.random
            )
            self.iterations += share
            trials -= share
        if better and g < len(self.goals):
            self._share(g)
        return better

    def _share(self, g: int) -> None:
        """Take the way out of goal g for the goals that differ from it by whole turns, where it is one there too."""
        for other in np.flatnonzero(self.twin == self.twin[g]):
            if other == g:
                continue
            end = self.exits.ends[g] + (self.goals[other] - self.goals[g])
            if (end < self.space.lower).any() or (end > self.space.upper).any() or one(self.space, end) != 0.0:
                continue
            cost = line(self.space, self.goals[other], end, self.options.weight, float(self.exits.cost[other]))
            if cost < self.exits.cost[other]:
                self.exits.ends[other], self.exits.cost[other] = end, cost

    def least_cost(self, g: int) -> float:
        """What a path over the known ways out of start and goal g costs at least."""
        (a, first), (b, last) = self.out(len(self.goals)), self.out(g)
        return first + last + float(np.linalg.norm(a - b)) + float(self.terminal[g])

    def least_costs(self) -> Array:
        """The same for every goal, (G,)."""
        return np.array([self.least_cost(g) for g in range(len(self.goals))])

    def use_ways_out(self) -> None:
        """Join the ways out of the goals to the start's, cheapest first, as long as the outcome may be the best."""
        costs = self.least_costs()
        for g in np.argsort(costs, kind="stable")[:_JOINED_FIRST]:
            if not costs[g] < self.best_cost or self.over():
                return
            if self.start_leaf > 0.0 or self.goal_leaf[g] > 0.0:
                self.join(int(g))

    def improve_ways_out(self, goals: int, trials: int) -> None:
        """Go on with the ways out of the cheapest goals, and use what was found."""
        costs = self.least_costs()
        joined = False
        looked: set[int] = set()
        for g in np.argsort(costs, kind="stable"):
            if len(looked) == goals or self.over():
                break
            if self.twin[g] in looked:
                continue
            looked.add(int(self.twin[g]))
            if self.goal_leaf[g] > 0.0 and self._improve(int(g), trials) and self.least_cost(int(g)) < self.best_cost:
                self.join(int(g))
                joined = True
        # A way out that promises much and was not reached yet is tried again, a little longer each time.
        promise = np.where(self.goal_leaf > 0.0, costs * (1.0 + 0.1 * self.joins), math.inf)
        g = int(np.argmin(promise))
        if not joined and promise[g] < _PROMISING * self.best_cost and not self.over():
            self.join(g)

    def join(self, g: int) -> None:
        """Make a path over the ways out of the start and of goal g: straight, from the best path, or by two trees."""
        (root, _), (end, cost) = self.out(len(self.goals)), self.out(g)
        if not (math.isfinite(cost) and np.isfinite(self.out(len(self.goals))[1])):
            return
        if cost > 0.0:
            graph.add_known(self.space, self.road, end, 1 + g, cost)
        again = int(self.joins[g])
        self.joins[g] += 1
        samples = self.options.connect_samples * min(again + 1, _LONGEST) // 2
        count = self._from_best_path(end, cost + float(self.terminal[g]))
        for solid in (True, False)[: 2 - min(again, 1)] if not count else ():
            space = self.space if solid and self.options.weight > 0.0 else self.leafless  # at no weight leaves are air
            count = self.connect(space, root, end, samples, solid=solid)
            if count:
                count = self.prepend_start(count)
            if count or self.over():
                break
        if count and not self.over():
            self.adopt(self.append_goal(count, g), trials=_FAIR)

    def prepend_start(self, count: int) -> int:
        """Let the path in `self.path`, of `count` waypoints, begin with the start if it begins at its way out; the new number."""
        if self.start_leaf > 0.0 and count < MAX_WAYPOINTS:
            self.path[1 : count + 1] = self.path[:count].copy()
            self.path[0] = self.start
            count += 1
        return count

    def append_goal(self, count: int, g: int) -> int:
        """Let the path in `self.path`, of `count` waypoints, end with goal g if it ends at its way out; the new number."""
        if self.goal_leaf[g] > 0.0 and count < MAX_WAYPOINTS:
            self.path[count] = self.goals[g]
            count += 1
        return count

    def _from_best_path(self, end: Array, cost: float) -> int:
        """Reach the end of a way out straight from a waypoint of the best path; the number of waypoints in `self.path`, or 0.

        `cost` is what comes behind that end: the way out and the goal's terminal cost.
        """
        path = self.start[None] if self.best_path is None else self.best_path
        to_come = np.concatenate([[0.0], np.cumsum(self.best_segments)])
        best, count = self.best_cost - cost, 0
        for i in range(min(len(path) - 1, _TRIED) or 1):
            come = float(to_come[i])
            if come + float(np.linalg.norm(end - path[i])) >= best:
                continue
            on = come + line(self.space, path[i], end, self.options.weight, best - come)
            if on < best:
                best, count = on, i + 2
        if count:
            self.path[: count - 1] = path[: count - 1]
            self.path[count - 1] = end
        return count
