"""The search of one plan: the planner that the settings name, in the sampling box around start and goals."""

from __future__ import annotations

from collections.abc import Callable

from lime_planner.collision.joint_space import ArmSpace
from lime_planner.core.cores import usable_cores
from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import Goals, sampling_box
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.planner import Outcome, Query, load_planner

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
) -> Outcome:
    """Run the search that the settings name.

    Args:
        obstacles: with the anchors of start and goals.
        q_start: (n,) [rad].
        goals: at least one.
        settings: planner, iterations, gains.
        seed: of this plan.
        budget_s: search time [s]; None where the iterations limit it.
        should_stop: cancels.
    """
    lower, upper = sampling_box(obstacles, q_start, goals.configurations)
    planner = load_planner(settings.planner)

    def space() -> ArmSpace:
        return obstacles.space(lower, upper)

    query = Query(
        space(),
        q_start,
        goals.configurations,
        seed,
        terminal_costs=goals.costs,
        iterations=settings.iterations or None,
        deadline_s=budget_s,
        should_stop=should_stop,
        threads=threads_of(settings),
        another_space=space,
    )
    return planner.run(query, planner.options(settings))
