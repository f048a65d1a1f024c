"""The default planner: anytime and asymptotically optimal on J = ∫ (1 + w · leaf) ds, with stems certified along every edge.

Five parts work in turn, each in compiled slices of a few milliseconds:

1. a straight line and two trees (`connect`) give a first path quickly;
2. ways out of the leaves (`leaf_exits`) show which goals are cheap and from where; paths over them come next;
3. local improvement (`polish`) drives a few paths down side by side (`tracks`), the cheapest most, because only polishing shows which
   goal and which side of a branch is cheap; few of them may be nearly the same;
4. a roadmap that grows by batches (`roadmap`), sampled in the whole box, around the goals and around the best paths, is searched
   lazily; what it finds becomes a new path to polish. Uniform samples and k ~ log N neighbours make the whole asymptotically
   optimal (as PRM*, Karaman and Frazzoli 2011). Now and then it is searched for a path through another gap (`alternatives`);
5. new trees to the goals that promise most (`alternatives`), in the time that polishing can do without.

A short best path leaves only an ellipsoid of the box where better ones may pass; it is sampled instead (`sampling`).
A sample or a path that cannot lead below the best cost is pruned: the straight distance bounds every cost from below.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.jit import kernel
from lime_planner.core.status import Status
from lime_planner.planning.lime_star import roadmap as graph
from lime_planner.planning.lime_star.alternatives import Detours, Restarts
from lime_planner.planning.lime_star.options import LimeOptions, LimeOutcome
from lime_planner.planning.lime_star.run import Run
from lime_planner.planning.lime_star.side_by_side import Exchange, merged_history, search_all
from lime_planner.planning.lime_star.tracks import MAX_WAYPOINTS
from lime_planner.planning.planner import budget_spent, checked_ends, checked_limits
from lime_planner.planning.sampling import below, draw_between, draw_in_box, normal, uniform
from lime_planner.planning.space import clamp, distance, evaluate, inside, one, raise_pending

__all__ = ["LimeOptions", "LimeOutcome", "plan_lime", "warm_up"]


# Shares of the roadmap's samples; the others fall around the paths. Where the best path is short, a part of the box is left to be
# sampled, and takes fewer samples.
_UNIFORM, _INFORMED, _AT_GOALS = 0.6, 0.3, 0.08
_DETOURS = 3  # rounds between two of them
_LEAST_TRIALS = 5  # of polishing, for each track in each round
_REACHED_FIRST = 6  # goals that are reached for before the roadmap begins; restarts come to the others
_POLISHED_FIRST = 40  # trials of the best path before the first round
_REDRAWN = 30  # times a sample that cannot be part of a better path is drawn again


@kernel
def _draw(space: Any, road: Any, tracks: Any, best: float, least: float, most: float, random: Any, q: Any) -> None:
    """Draw a sample: uniformly where paths cheaper than `best` may pass, around a goal, or around one of the paths, chosen by cost."""
    n = q.shape[0]
    kind = uniform(random)
    informed = False
    if kind < _UNIFORM:
        start = road.rows[graph.START]
        near, goal = 0, graph.START
        for g in range(1, 1 + road.size[2]):
            if distance(space, start, road.rows[g]) + road.terminal[g] < best:
                near += 1
                if below(random, near) == 0:
                    goal = g
        volume = draw_between(space, start, road.rows[goal], best - road.terminal[goal], random, q)
        informed = volume > 0.0
        if informed:
            if kind < _INFORMED + (_UNIFORM - _INFORMED) * volume:
                return
            kind = _UNIFORM + uniform(random) * (1.0 - _UNIFORM)
    if not informed:
        draw_in_box(space, random, q)
        if kind < _UNIFORM:
            return
    step = least * math.exp(uniform(random) * math.log(most / least))
    if kind < _UNIFORM + _AT_GOALS:
        goal = 1 + below(random, road.size[2])
        for k in range(n):
            q[k] = road.rows[goal, k]
    else:
        t = below(random, tracks.size.shape[0])
        if tracks.size[t] < 2:
            return
        pick = uniform(random) * (tracks.cost[t] - tracks.terminal[t])
        i = 0
        while i < tracks.size[t] - 2 and pick >= tracks.segment[t, i]:
            pick -= tracks.segment[t, i]
            i += 1
        share = uniform(random)
        for k in range(n):
            q[k] = tracks.points[t, i, k] + share * (tracks.points[t, i + 1, k] - tracks.points[t, i, k])
    for k in range(n):
        q[k] += step * normal(random)
    clamp(space, q)


@kernel
def _grow(space: Any, road: Any, tracks: Any, samples: int, best: float, least: float, most: float, random: Any, q: Any) -> None:
    """Evaluate a number of samples that may lie on a path cheaper than `best`, and add the valid ones."""
    for _ in range(samples):
        for _ in range(_REDRAWN):
            _draw(space, road, tracks, best, least, most, random, q)
            ahead = np.inf
            for g in range(1, 1 + road.size[2]):
                ahead = min(ahead, distance(space, q, road.rows[g]) + road.terminal[g])
            if inside(space, q) and distance(space, q, road.rows[graph.START]) + ahead < best:
                leaf = evaluate(space, q)
                if leaf >= 0.0:
                    graph.add_vertex(space, road, q, leaf)
                break


def plan_lime(
    space: Any,
    start: npt.ArrayLike,
    goals: npt.ArrayLike,
    options: LimeOptions,
    seed: int,
    *,
    terminal_costs: npt.ArrayLike | None = None,
    iterations: int | None = None,
    should_stop: Callable[[], bool] | None = None,
    deadline_s: float | None = None,
    patience: float = 1.0,
    threads: int = 1,
    another_space: Callable[[], Any] | None = None,
) -> LimeOutcome:
    """Plan from a start to the cheapest of several goals, each with a terminal cost of its own: what comes behind it costs something.

    Equal arguments, seed and iteration budget give equal results. The best path found is returned at the end, also after a stop.
    Several threads search side by side and share what they find (`side_by_side`); the first is the search that one alone would be.

    Args:
        space: a space of `lime_planner.planning.space`; its counters are written.
        start: (n,); goals: (n,) or (G, n), invalid ones are left out.
        options: see `LimeOptions`.
        seed: of the generator.
        terminal_costs: (G,) finite and not negative, what ending at each goal adds to J [rad]; zeros by default.
        iterations: budget of sampled configurations of each thread, None for none.
        should_stop: True ends the search; asked every few milliseconds, by the calling thread.
        deadline_s: search time from the call on [s], None for none.
        patience: share of these budgets after which a search without a path ends.
        threads: searches side by side.
        another_space: makes another space like `space` with memory of its own, for the further threads; without it there is one.

    Raises:
        ProblemError: malformed start, goals or terminal costs, or no end of the search given.
    """
    began = time.monotonic()  # checks of start and goals and the run's memory are part of what a user waits for
    ends = checked_ends(space, start, goals, terminal_costs)
    q_start, q_goals, terminal = ends.start, ends.goals, ends.terminal
    checked_limits(iterations, deadline_s, should_stop)
    before = np.array(space.counters)
    handle = space.handle()
    start_leaf, leaf = one(handle, q_start), np.array([one(handle, g) for g in q_goals])
    raise_pending(space)
    if start_leaf < 0.0:
        return LimeOutcome(None, math.inf, Status.START_INVALID, 0, 0, 0, math.nan, np.zeros((0, 3)))
    if not (leaf >= 0.0).any():
        return LimeOutcome(None, math.inf, Status.GOAL_IN_STEM, 0, 0, 0, math.nan, np.zeros((0, 3)))
    exchange = Exchange(threads if another_space is not None else 1)
    ended: list[Status] = []

    def cancelled() -> bool:
        if should_stop is not None and should_stop():
            exchange.stopped.set()
        return exchange.stopped.is_set()

    def look() -> None:
        if cancelled():
            ended[:] = [Status.CANCELLED]

    def limit(run: Run) -> Status | None:
        share = patience if run.best_path is None else 1.0
        return budget_spent(iterations, deadline_s, share, run.iterations, run.elapsed())

    def first_over(run: Run) -> bool:
        raise_pending(space)
        status = Status.CANCELLED if cancelled() else limit(run)
        if status is not None:
            ended.append(status)
        return bool(ended)

    def other_over(run: Run) -> bool:
        return exchange.stopped.is_set() or limit(run) is not None

    def prepare(number: int) -> Run:
        own_seed = seed if number == 0 else int(np.random.SeedSequence([seed, number]).generate_state(1, np.uint64)[0])
        own_space = space if number == 0 or another_space is None else another_space()
        over = other_over if number else first_over
        run = Run(own_space, q_start, q_goals[leaf >= 0.0], terminal[leaf >= 0.0], options, own_seed, iterations, over, began)
        if options.weight > 0.0:  # otherwise leaves are air
            run.start_leaf, run.goal_leaf = start_leaf, leaf[leaf >= 0.0]
        return run

    runs = search_all(exchange, prepare, _search, look)
    best = min(runs, key=lambda run: run.best_cost)  # the first of equals
    status = ended[0]
    if best.best_path is not None and status in (Status.NO_PATH, Status.TIMED_OUT):
        status = Status.SUCCEEDED
    counted = np.sum([run.space.counters for run in runs], axis=0) - before
    history = merged_history(runs)
    return LimeOutcome(
        best.best_path,
        best.best_cost,
        status,
        max(run.iterations for run in runs),
        int(counted[0] + counted[2]),
        int(counted[1]),
        float(history[0, 0]) if len(history) else math.nan,
        history,
        best.road,
    )


def warm_up(space: Any) -> None:
    """Compile what an easy problem passes by: where a straight line reaches the goal no tree grows."""
    middle = 0.5 * (np.asarray(space.lower) + np.asarray(space.upper))
    run = Run(space, middle, middle[None], np.zeros(1), LimeOptions(), 1)
    run.reach(middle, 1)
    run.start_leaf = 1.0
    run.goal_leaf[0] = 1.0
    run.look_for_ways_out()
    run.use_ways_out()
    graph.add_known(run.space, run.road, middle, 0, 1.0)  # without leaves no way out costs anything, and none is kept


def _search(run: Run, meet: Callable[[Run], None]) -> None:
    """Run the parts in turn until a limit is reached; `meet` is called between them."""
    graph.add_vertex(run.space, run.road, run.start, run.start_leaf)
    for g, intensity in zip(run.goals, run.goal_leaf, strict=True):
        graph.add_vertex(run.space, run.road, g, float(intensity))
    run.road.size[2] = len(run.goals)
    run.road.terminal[1 : 1 + len(run.goals)] = run.terminal
    run.straight_lines()
    if run.over():
        return
    _first_paths(run)
    detours, restarts = Detours(len(run.start)), Restarts(len(run.goals))
    while not run.over():
        meet(run)
        _round(run, detours, restarts)


def _first_paths(run: Run) -> None:
    """Find any path, then the ways out of the leaves and paths over them, then paths to the goals that are still worth it."""
    waiting = list(range(len(run.goals)))
    while waiting and not math.isfinite(run.best_cost) and not run.over():
        run.reach(run.goals[waiting.pop(0)], run.left(run.options.connect_samples), _LEAST_TRIALS)
    run.look_for_ways_out()
    run.use_ways_out()
    for g in sorted(waiting, key=run.least_cost)[:_REACHED_FIRST]:
        if run.over() or not run.least_cost(g) < run.best_cost:
            break
        if run.goal_leaf[g] > 0.0:
            run.reach(run.goals[g], run.left(run.options.connect_samples))
        else:
            run.join(g)
    # Before the roadmap is searched: a search takes the longer the more the best path costs.
    best = int(np.argmin(run.tracks.cost))
    if math.isfinite(run.tracks.cost[best]) and not run.over():
        run.polish(best, _POLISHED_FIRST)


def _round(run: Run, detours: Detours, restarts: Restarts) -> None:
    """One batch of roadmap samples with its search, at times one for a detour, then more ways out, then polishing of the tracks."""
    o = run.options
    if run.road.size[0] + o.batch + MAX_WAYPOINTS > len(run.road.rows) or 2 * run.road.size[1] > len(run.road.length):
        run.road = graph.enlarged(run.road)
    best_track = int(np.argmin(run.tracks.cost))
    if not math.isfinite(run.best_cost):
        # Still no path at all: harder tries, goal after goal, before the roadmap has its turn again.
        run.tries += 1
        samples = o.connect_samples * min(2 ** (run.tries // len(run.goals) + 1), 64)
        run.reach(run.goals[run.tries % len(run.goals)], run.left(samples))
        if run.over():
            return
    samples = run.left(o.batch)
    _grow(run.space, run.road, run.tracks, samples, run.best_cost, run.least, run.most, run.random, run.q)
    run.iterations += samples
    if math.isfinite(run.tracks.cost[best_track]):
        goal = run.goal_vertex(best_track)
        count = int(run.tracks.size[best_track])
        graph.add_path(run.space, run.road, run.tracks.points[best_track], run.tracks.segment[best_track], count, goal)
    count = run.search(run.best_cost, run.everywhere)
    if count:
        run.adopt(count)
    run.rounds += 1
    if run.rounds % _DETOURS == 0 and not run.over():
        detours.look(run, 2 * o.batch)
    if run.over():
        return
    run.improve_ways_out(4, o.batch // 2)
    trials = int(o.polish * len(run.start) * o.batch)
    alive = np.argsort(run.tracks.cost)[: o.tracks]
    alive = alive[np.isfinite(run.tracks.cost[alive])]
    for place, t in enumerate(alive):
        if run.over():
            return
        wanted = max(_LEAST_TRIALS, trials / 2 ** (place + 1))
        given = max(_LEAST_TRIALS, int(wanted / 2 if run.idle[t] else wanted))
        run.spare += wanted - given
        run.polish(int(t), given)
    before = run.iterations
    while len(alive) and run.spare > run.iterations - before and not run.over():
        if not restarts.look(run):
            run.polish(int(alive[0]), int(run.spare) + 1)
    run.spare -= run.iterations - before  # below zero after a long try: the next rounds make up for it
