"""The search of one plan: the planner that the settings name, in the sampling box around start and goals."""

from __future__ import annotations

from collections.abc import Callable

from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import Goals, sampling_box
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.planner import Outcome, Query, load_planner


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
    query = Query(
        obstacles.space(lower, upper),
        q_start,
        goals.configurations,
        seed,
        terminal_costs=goals.costs,
        iterations=settings.iterations or None,
        deadline_s=budget_s,
        should_stop=should_stop,
    )
    return planner.run(query, planner.options(settings))
