"""The search of one plan: the planner that the settings name, in the sampling box around start and goals."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

from lime_planner.collision.joint_space import ArmSpace
from lime_planner.core.elsewhere import usable_cores
from lime_planner.core.parameters import Settings
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import Goals, sampling_box, tight_anchors
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.planner import Outcome, Query, load_planner

# Of the budget, while there is no path and there are more goals: most first paths are found within some thousandths of a second.
_PATIENCE = 0.25
_MOST_THREADS = 8  # by default: more find little more, and what of a search is Python they do one after another


def threads_of(settings: Settings) -> int:
    """Return how many searches go side by side.

    By default cores less one, for whatever else there is to be done. A search that is limited by iterations is to be repeated on other
    machines: there it is one.
    """
    if settings.threads:
        return settings.threads
    return 1 if settings.iterations else max(1, min(usable_cores() - 1, _MOST_THREADS))


def search(
    obstacles: Obstacles,
    q_start: Array,
    goals: Goals,
    settings: Settings,
    *,
    seed: int,
    budget_s: float | None,
    should_stop: Callable[[], bool],
) -> tuple[Outcome, Goals, Obstacles]:
    """Run the search that the settings name; where no way leads to the goals and there are more, once more with those.

    Args:
        obstacles: with the anchors of start and goals.
        q_start: (n,) [rad].
        goals: at least one.
        settings: planner, iterations, gains.
        seed: of this plan.
        budget_s: search time of all [s]; None where the iterations limit it.
        should_stop: cancels.

    Returns:
        What was found, the goals it was found among, and the obstacles with their anchors.
    """
    began_s = time.monotonic()
    planner = load_planner(settings.planner)

    def once(among: Goals, obstacles: Obstacles, iterations: int, deadline_s: float | None, patience: float) -> Outcome:
        lower, upper = sampling_box(obstacles, q_start, among.configurations)

        def space() -> ArmSpace:
            return obstacles.space(lower, upper)

        query = Query(
            space(),
            q_start,
            among.configurations,
            seed,
            terminal_costs=among.costs,
            iterations=iterations or None,
            deadline_s=deadline_s,
            patience=patience,
            should_stop=should_stop,
            threads=threads_of(settings),
            another_space=space,
        )
        return planner.run(query, planner.options(settings))

    first = once(goals, obstacles, settings.iterations, budget_s, 1.0 if goals.more is None else _PATIENCE)
    if first.path is not None or goals.more is None or first.status not in (Status.NO_PATH, Status.TIMED_OUT):
        return first, goals, obstacles
    more = goals.more()
    obstacles = obstacles.with_anchors(*tight_anchors(obstacles, more.configurations, q_start))
    left_s = None if budget_s is None else max(budget_s - (time.monotonic() - began_s), 0.0)
    then = once(more, obstacles, max(settings.iterations - first.iterations, 1) if settings.iterations else 0, left_s, 1.0)
    both = dataclasses.replace(then, iterations=first.iterations + then.iterations, checks=first.checks + then.checks)
    return both, more, obstacles
