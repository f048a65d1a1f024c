"""The default planner's entry in the table of planners."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.parameters import Settings
from lime_planner.planning.lime_star import planner as search
from lime_planner.planning.lime_star.options import LimeOptions
from lime_planner.planning.lime_star.roadmap import BLOCKED, UNKNOWN, Roadmap
from lime_planner.planning.planner import Outcome, Planner, Query, SearchTree


def search_tree(road: Roadmap) -> SearchTree:
    """The edges of a roadmap that were evaluated and are free of stems."""
    vertices, count = int(road.size[0]), int(road.size[1])
    checked = np.flatnonzero((road.known[:count] != UNKNOWN) & (road.known[:count] != BLOCKED))
    leafy = np.asarray(road.cost[checked] > road.length[checked] * (1.0 + 1e-6))
    return SearchTree(road.rows[:vertices], road.ends[checked].astype(np.int64), leafy)


class LimeStar(Planner[LimeOptions]):
    """See `lime_planner.planning.lime_star.planner`."""

    name = "lime_star"
    summary = "This package's own: anytime, on length and leaf contact along the path."
    anytime = True
    warm_iterations = 600

    def options(self, settings: Settings) -> LimeOptions:
        """The leaf weight, zero where leaves are ignored."""
        return LimeOptions(weight=0.0 if settings.leaf_policy == "ignored" else settings.weight)

    def run(self, query: Query, options: LimeOptions) -> Outcome:
        """Search with `plan_lime`."""
        outcome = search.plan_lime(
            query.space,
            query.start,
            query.goals,
            options,
            query.seed,
            terminal_costs=query.terminal_costs,
            iterations=query.iterations,
            should_stop=query.should_stop,
            deadline_s=query.deadline_s,
            patience=query.patience,
            threads=query.threads,
            another_space=query.another_space,
        )
        road = outcome.road
        return Outcome(
            outcome.path,
            outcome.status,
            outcome.iterations,
            outcome.states_checked,
            outcome.first_path_s,
            outcome.history,
            *(() if road is None else (lambda: search_tree(road),)),
        )

    def warm_up(self, space: Any) -> None:
        """Compile trees and ways out of the leaves, which a straight line to the goal makes superfluous."""
        search.warm_up(space)


LIME_STAR = LimeStar()
