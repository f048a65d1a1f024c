"""The table of planners: what can be chosen by name, and where each one's entry is found.

The names alone are known here; `lime_planner.planning.planner.load_planner` imports an entry when it is first used.
"""

from __future__ import annotations

#: Each planner's name, and `module:attribute` of its entry (a `lime_planner.planning.planner.Planner`).
PLANNERS: dict[str, str] = {
    "lime_star": "lime_planner.planning.lime_star.entry:LIME_STAR",
    "apf_rrt_star": "lime_planner.planning.rrt_star.entry:APF_RRT_STAR",
    "rrt_star": "lime_planner.planning.rrt_star.entry:RRT_STAR",
    "p_rrt_star": "lime_planner.planning.rrt_star.entry:P_RRT_STAR",
}

DEFAULT_PLANNER = "lime_star"
