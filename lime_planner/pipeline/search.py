"""Which search runs: the default planner, or one of the paper's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lime_planner.core.parameters import Settings
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import Goals, sampling_box
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.lime_star.options import LimeOptions
from lime_planner.planning.lime_star.planner import plan_lime
from lime_planner.planning.rrt_star.planner import PaperOptions, plan_paper


@dataclass(frozen=True, eq=False)
class Found:
    """A path from a search, or why there is none.

    Attributes:
        path: (M, n) start to goal, or None.
        status: SUCCEEDED, or NO_PATH, TIMED_OUT, CANCELLED.
        iterations: configurations sampled; checks: configurations checked, inside edges included.
        first_path_s: search time until the first path, NaN if unknown.
    """

    path: Array | None
    status: Status
    iterations: int
    checks: int
    first_path_s: float = float("nan")


def paper_options(settings: Settings) -> PaperOptions:
    """The paper's planner with the settings' gains."""
    return PaperOptions.arm(
        settings.planner,
        delta=settings.step_rad,
        c_perm=settings.c_perm,
        beta=settings.beta,
        k_att=settings.k_att,
        k_rep_permeable=settings.k_rep_leaf,
        k_rep_impermeable=settings.k_rep_stem,
        d_star=settings.d_star_m,
        goal_radius=settings.goal_radius_rad,
        goal_bias=settings.goal_bias,
    )


def search(
    obstacles: Obstacles,
    q_start: Array,
    goals: Goals,
    settings: Settings,
    *,
    seed: int,
    budget_s: float | None,
    should_stop: Callable[[], bool],
    watch: Callable[[Any], None] | None = None,
) -> Found:
    """Run the search that the settings name.

    Args:
        obstacles: with the anchors of start and goals.
        q_start: (n,).
        goals: at least one.
        settings: planner, iterations, gains.
        seed: of this plan.
        budget_s: search time [s]; None where the iterations limit it.
        should_stop: cancels.
        watch: is shown what the search grew: `planning.roadmap.Roadmap`, or the paper's `planning.tree.Tree`.
    """
    lower, upper = sampling_box(obstacles, q_start, goals.configurations)
    space = obstacles.space(lower, upper)
    iterations = settings.iterations or None
    if settings.planner == "lime_star":
        weight = 0.0 if settings.leaf_policy == "ignored" else settings.weight
        outcome = plan_lime(
            space,
            q_start,
            goals.configurations,
            LimeOptions(weight=weight),
            seed,
            iterations=iterations,
            should_stop=should_stop,
            deadline_s=budget_s,
            watch=watch,
        )
        return Found(outcome.path, outcome.status, outcome.iterations, outcome.states_checked, outcome.first_path_s)
    paper = plan_paper(
        space,
        q_start,
        goals.configurations,
        paper_options(settings),
        seed,
        iterations=iterations,
        should_stop=should_stop,
        deadline_s=budget_s,
    )
    if watch is not None:
        watch(paper.tree)
    checks = int(paper.counters[0] + paper.counters[2])
    return Found(paper.path, paper.status, paper.final.iterations, checks)
