"""RRT*, APF-RRT* and P-RRT* as planners to use: one tree that grows as they say, on J, with what a search needs in practice.

The tree grows by the rules of the three (`kernels`): the paper's contribution, a field that bends its steps, is as in the paper. Around
that, the same for all three and shared with the default planner:

- edges are certified and cost their integral, costs are handed on to descendants, and neighbours lie in the radius of RRG;
- a straight line and two trees (`lime_star.connect`) bring a first path;
- samples fall where a cheaper path may pass (`sampling`), and every goal, with its terminal cost, is a node once it is reached;
- paths that the tree finds are shortcut and polished as the default's (`lime_star.polish`), and join the tree as they are then.
"""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

import numpy as np

from lime_planner.core.status import Status
from lime_planner.planning.lime_star.options import LimeOptions
from lime_planner.planning.lime_star.run import Run
from lime_planner.planning.planner import Outcome, Query, checked_ends, checked_limits
from lime_planner.planning.rrt_star import goal_nodes
from lime_planner.planning.rrt_star.growth import Growth
from lime_planner.planning.rrt_star.options import PaperOptions
from lime_planner.planning.rrt_star.tree import search_tree, trace
from lime_planner.planning.space import one, raise_pending

_STEP = 3.0  # in steps of the paper's: certified edges are as safe when they are long, and get further
_REACH = 3.0  # in steps of ours: largest radius of neighbours, and from how far goals are joined
_BATCH = 50  # samples between two turns of the polisher
_SLICE = 10  # of them between two looks at the clock: among leaves, a sample and its neighbours' edges may take a millisecond
_POLISH = 0.5  # polishing trials of the cheapest path for each sample and dimension; half as many of the next, and so on
_TRACKS = 2
_FAIR = 2  # polishing trials of a new path for each of its waypoints, before it is compared with the others
_GAIN = 1e-3  # share by which a path must be cheaper than the last one before it joins the tree


def usable(options: PaperOptions, space: Any, weight: float) -> PaperOptions:
    """Return a planner's gains with the readings that are wanted of a planner to use (see above).

    The radius of RRG holds e (1 + 1/n) ln N of N nodes that fill the sampling box evenly; three steps at most.

    Args:
        options: gains, and the paper's step.
        space: for its sampling box.
        weight: leaf weight of J [1/rad].
    """
    n = len(space.lower)
    log_ball = 0.5 * n * math.log(math.pi) - math.lgamma(0.5 * n + 1.0)  # of the unit ball's volume
    log_box = float(np.log(np.asarray(space.upper) - np.asarray(space.lower)).sum())
    delta = _STEP * options.delta
    return dataclasses.replace(
        options,
        delta=delta,
        cost="integral",
        weight=weight,
        propagate=True,
        radius="rrg",
        rrg_gamma=math.exp((log_box - log_ball + math.log(math.e * (1.0 + 1.0 / n))) / n),
        radius_limit=_REACH * delta,
        goal_radius=_REACH * delta,
    )


def plan_anytime(query: Query, options: PaperOptions, weight: float) -> Outcome:
    """Plan to the cheapest of several goals; the best path's J never rises.

    Equal queries with an iteration budget give equal results. Iterations are samples of the tree, of the first paths' trees, and
    polishing trials.

    Args:
        query: the problem and its limits.
        options: gains; see `usable` for what is made of them.
        weight: leaf weight of J [1/rad].

    Raises:
        ProblemError: malformed start, goals or terminal costs, or no end of the search given.
    """
    began_s = time.monotonic()
    ends = checked_ends(query.space, query.start, query.goals, query.terminal_costs)
    checked_limits(query.iterations, query.deadline_s, query.should_stop)
    limit = query.limit()
    handle, before = query.space.handle(), np.array(query.space.counters)
    start_leaf, valid = one(handle, ends.start), np.array([one(handle, goal) >= 0.0 for goal in ends.goals])
    raise_pending(query.space)
    if start_leaf < 0.0:
        return Outcome(None, Status.START_INVALID, 0, 0)
    if not valid.any():
        return Outcome(None, Status.GOAL_IN_STEM, 0, 0)
    ended: list[Status] = []

    def over(run: Run) -> bool:
        raise_pending(query.space)
        status = limit(run.iterations, run.best_path is not None)
        if status is not None:
            ended.append(status)
        return bool(ended)

    own = LimeOptions(weight=weight, tracks=_TRACKS)
    run = Run(query.space, ends.start, ends.goals[valid], ends.terminal[valid], own, query.seed, query.iterations, over, began_s)
    search = _Search(run, query.space, usable(options, query.space, weight))
    search.first_path()
    while not run.over():
        search.turn()
    status = ended[0]
    if run.best_path is not None and status in (Status.NO_PATH, Status.TIMED_OUT):
        status = Status.SUCCEEDED
    counted = np.asarray(query.space.counters) - before
    return Outcome(
        run.best_path,
        status,
        run.iterations,
        int(counted[0] + counted[2]),
        run.history[0][0] if run.history else math.nan,
        np.array(run.history).reshape(-1, 3),
        lambda: search_tree(search.growth.tree),
    )


class _Search:
    """The tree, beside the run that keeps and polishes paths.

    Attributes:
        run: best path, tracks, generator and limits; growth: the tree.
        nodes: (G,) each goal's node in the tree, -1 while it has none.
        joined: cost of the cheapest path that is both in the tree and among the run's.
    """

    def __init__(self, run: Run, space: Any, options: PaperOptions) -> None:
        self.run, self.growth = run, Growth(space, run.start, run.goals, options, 2000)
        self.nodes = np.full(len(run.goals), -1, np.int64)
        self.samples = np.zeros((_BATCH, len(run.start)))
        self.joined = math.inf

    def first_path(self) -> None:
        """Straight lines to the goals, then two trees, goal by goal."""
        run = self.run
        run.straight_lines()
        for goal in run.goals:
            if math.isfinite(run.best_cost) or run.over():
                return
            run.reach(goal, run.left(run.options.connect_samples))

    def turn(self) -> None:
        """A batch of samples for the tree, the paths that come of it, and polishing."""
        run, growth = self.run, self.growth
        if not math.isfinite(run.best_cost):
            # Still none: harder tries, goal after goal, beside the tree.
            run.tries += 1
            samples = run.options.connect_samples * min(2 ** (run.tries // len(run.goals) + 1), 64)
            run.reach(run.goals[run.tries % len(run.goals)], run.left(samples))
            if run.over():
                return
        first = int(growth.tree.size[0])
        if run.best_path is not None and run.best_cost < self.joined * (1.0 - _GAIN):
            self.joined = run.best_cost
            growth.make_room(len(run.best_path) + len(run.goals))
            goal = run.goal_at(run.best_path[-1])
            goal_nodes.add_path(run.space, run.goals, growth.tree, self.nodes, run.best_path, run.best_segments, goal)
        self._grow()
        if run.over():
            return
        growth.make_room(len(run.goals))
        goal = int(goal_nodes.reach_goals(run.space, growth.rules, run.goals, run.terminal, growth.tree, first, self.nodes))
        if goal >= 0:
            self._adopt(goal)
        trials = max(1, int(_POLISH * len(run.start) * _BATCH))
        for t in np.argsort(run.tracks.cost[:-1], kind="stable"):
            if run.over():
                return
            if math.isfinite(run.tracks.cost[t]):
                run.polish(int(t), trials)
            trials = max(1, trials // 2)

    def _grow(self) -> None:
        """Draw a batch of samples and let the tree grow to them, in slices: a stop is heard in between."""
        run, bias = self.run, self.growth.options.goal_bias
        wanted = run.left(_BATCH)
        goal_nodes.draw(run.space, run.start, run.goals, run.terminal, run.best_cost, bias, run.random, self.samples, wanted, run.q)
        for done in range(0, wanted, _SLICE):
            if done and run.over():
                return
            share = self.samples[done : min(done + _SLICE, wanted)]
            self.growth.extend(share)
            run.iterations += len(share)

    def _adopt(self, goal: int) -> None:
        """Make the tree's best path a track, if it is another than the best of all, whose waypoints are in the tree too."""
        run, tree = self.run, self.growth.tree
        node = int(self.nodes[goal])
        cost = float(tree.cost[node] + run.terminal[goal])
        if not cost < self.joined * (1.0 - 1e-9):
            return
        self.joined = cost
        path = trace(tree, node)
        if len(path) <= len(run.path):
            run.path[: len(path)] = path
            run.adopt(len(path), trials=_FAIR * len(path))
