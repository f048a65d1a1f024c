"""The paper's planners' entries in the table of planners."""

from __future__ import annotations

from typing import Literal

import numpy as np

from lime_planner.core.parameters import Settings
from lime_planner.planning.planner import Metric, Outcome, Planner, Query, SearchTree
from lime_planner.planning.rrt_star.options import PaperOptions
from lime_planner.planning.rrt_star.planner import plan_paper
from lime_planner.planning.rrt_star.tree import Tree


def search_tree(tree: Tree) -> SearchTree:
    """The edges from each node's parent to it; they cost more than their length where the node touches leaves."""
    size = int(tree.size[0])
    children = np.flatnonzero(tree.parent[:size] >= 0)
    ends = np.stack([tree.parent[children].astype(np.int64), children], axis=1)
    return SearchTree(tree.rows[:size], ends, np.asarray(tree.intensity[children] > 0.0))


class PaperPlanner(Planner[PaperOptions]):
    """One of the three algorithms of `lime_planner.planning.rrt_star.planner`, as the paper has it."""

    def __init__(self, name: Literal["rrt_star", "apf_rrt_star", "p_rrt_star"], summary: str) -> None:
        """Keep name and words."""
        self.name, self.summary = name, summary

    def options(self, settings: Settings) -> PaperOptions:
        """The gains of the settings."""
        return PaperOptions.arm(
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

    def metric(self, settings: Settings) -> Metric:
        """The paper's: nodes in leaves."""
        return "node"

    def run(self, query: Query, options: PaperOptions) -> Outcome:
        """Search with `plan_paper`."""
        outcome = plan_paper(
            query.space,
            query.start,
            query.goals,
            options,
            query.seed,
            terminal_costs=query.terminal_costs,
            iterations=query.iterations,
            should_stop=query.should_stop,
            deadline_s=query.deadline_s,
        )
        checks = int(outcome.counters[0] + outcome.counters[2])
        return Outcome(outcome.path, outcome.status, outcome.final.iterations, checks, tree=lambda: search_tree(outcome.tree))


APF_RRT_STAR = PaperPlanner("apf_rrt_star", "The paper's: RRT* whose steps an adaptive potential field bends towards the goal.")
RRT_STAR = PaperPlanner("rrt_star", "RRT* as the paper compares with it.")
P_RRT_STAR = PaperPlanner("p_rrt_star", "P-RRT* as the paper compares with it: samples are moved down the potential field.")
