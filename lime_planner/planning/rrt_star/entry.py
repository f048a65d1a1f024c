"""RRT*, APF-RRT* and P-RRT* in the table of planners: as planners to use, or with the parameter `paper` exactly as published."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from lime_planner.core.parameters import Settings
from lime_planner.planning.planner import Metric, Outcome, Planner, Query
from lime_planner.planning.rrt_star.anytime import plan_anytime
from lime_planner.planning.rrt_star.options import PaperOptions
from lime_planner.planning.rrt_star.planner import plan_paper
from lime_planner.planning.rrt_star.tree import search_tree


@dataclass(frozen=True)
class TreeOptions:
    """What one of the three is run with.

    Attributes:
        gains: step, gains and readings as the paper has them.
        weight: leaf weight of J [1/rad]; None: as published, by the paper's own cost.
    """

    gains: PaperOptions
    weight: float | None


class TreePlanner(Planner[TreeOptions]):
    """One of the three algorithms: `rrt_star.anytime`, or `rrt_star.planner` as the paper has it."""

    anytime = True
    warm_iterations = 600

    def __init__(self, name: Literal["rrt_star", "apf_rrt_star", "p_rrt_star"], summary: str) -> None:
        """Keep name and words."""
        self.name, self.summary = name, summary

    def options(self, settings: Settings) -> TreeOptions:
        """The gains of the settings, and J's leaf weight where these do not ask for the paper."""
        gains = PaperOptions.arm(
            self.name,
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
        if settings.paper:
            return TreeOptions(gains, None)
        return TreeOptions(gains, 0.0 if settings.leaf_policy == "ignored" else settings.weight)

    def metric(self, settings: Settings) -> Metric:
        """The paper's counts nodes in leaves."""
        return "node" if settings.paper else "integral"

    def run(self, query: Query, options: TreeOptions) -> Outcome:
        """Search, with `plan_anytime` or with `plan_paper`."""
        if options.weight is not None:
            return plan_anytime(query, options.gains, options.weight)
        outcome = plan_paper(
            query.space,
            query.start,
            query.goals,
            options.gains,
            query.seed,
            terminal_costs=query.terminal_costs,
            iterations=query.iterations,
            should_stop=query.should_stop,
            deadline_s=query.deadline_s,
        )
        checks = int(outcome.counters[0] + outcome.counters[2])
        return Outcome(outcome.path, outcome.status, outcome.final.iterations, checks, tree=lambda: search_tree(outcome.tree))

    def warm_up(self, space: Any) -> None:
        """Compile what only the paper's own reading passes by."""
        plan_paper(space, space.lower, space.upper, PaperOptions.arm(self.name), 0, iterations=0)


APF_RRT_STAR = TreePlanner("apf_rrt_star", "The paper's: RRT* whose steps an adaptive potential field bends towards the goal.")
RRT_STAR = TreePlanner("rrt_star", "RRT*, which the paper compares with.")
P_RRT_STAR = TreePlanner("p_rrt_star", "P-RRT*, which the paper compares with: samples are moved down the potential field.")
