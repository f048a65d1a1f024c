"""The search tree of a plan, for display: the search is run once more with the plan's own seed, and its tree is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.core.types import Bool, Float32
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline.context import never
from lime_planner.pipeline.grasps.goals import goals_of
from lime_planner.pipeline.result import PlanRecord
from lime_planner.pipeline.search import search
from lime_planner.pipeline.targets import pose_target
from lime_planner.planning.planner import no_tree

EDGES_SHOWN = 400  # more hide the plant
_PIECES = 8  # straight in joint space, an edge is a curve for the tool


@dataclass(frozen=True, eq=False)
class SearchTree:
    """A search tree as the tool's positions see it.

    Attributes:
        segments: (E, P, 2, 3) tool positions at both ends of the pieces of each edge [m].
        leafy: (E,) whether the edge's cost holds leaves.
        total: edges that there were; more than E where they were thinned.
    """

    segments: Float32
    leafy: Bool
    total: int


def search_tree_of(pipeline: Pipeline, shown: PlanRecord, *, should_stop: Callable[[], bool] = never) -> SearchTree:
    """Search again as the plan did, and return the tree.

    Args:
        pipeline: of the same arm.
        shown: a plan with a target.
        should_stop: ends the search early; the tree as it is then is returned.
    """
    result, settings = shown.result, shown.settings
    aim = result.target if result.target is not None or shown.target is None else pose_target(shown.target)
    if aim is None or not len(result.waypoints):
        return SearchTree(np.zeros((0, _PIECES, 2, 3), np.float32), np.zeros(0, bool), 0)
    q = result.waypoints[0]
    obstacles = pipeline.obstacles(shown.scene, aim.spot(shown.scene, settings), settings)
    goals = goals_of(obstacles, obstacles.exact_checker(), aim, q, np.random.default_rng(result.seed), should_stop)
    tree = no_tree()
    if len(goals.configurations):
        outcome, _, _ = search(
            obstacles.with_anchors(goals.anchors, goals.needs),
            q,
            goals,
            settings,
            seed=result.seed,
            budget_s=None if settings.iterations else settings.time_budget_s,
            should_stop=should_stop,
        )
        tree = outcome.tree()
    rows, ends, leafy = tree.configurations, tree.edges, tree.leafy
    keep = np.unique(np.linspace(0, max(len(ends) - 1, 0), min(len(ends), EDGES_SHOWN)).round().astype(int))
    share = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    tool = np.zeros((len(keep), _PIECES + 1, 3), np.float32)
    for curve, (a, b) in zip(tool, ends[keep], strict=True):
        curve[:] = [pipeline.robot.forward(q)[:3, 3] for q in rows[a] + share * (rows[b] - rows[a])]
    return SearchTree(np.stack([tool[:, :-1], tool[:, 1:]], axis=2), leafy[keep], len(ends))
