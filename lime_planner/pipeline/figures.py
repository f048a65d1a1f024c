"""The figures of a path: length, leaf contact, clearance, cost, and the tool's way."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from lime_planner.collision.exact import ExactChecker
from lime_planner.collision.fast import LEAF
from lime_planner.collision.joint_space import measure
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.types import Array
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.planner import load_planner

MEASURED_STEP_RAD = 0.02  # spacing of the figures
_MAX_TOOL_POSES = 500


def sample_path(waypoints: Array, step_rad: float) -> tuple[Array, Array]:
    """Sample a polyline at most `step_rad` apart, waypoints included.

    Returns:
        (K, n) configurations and (K,) lengths along the path [rad].
    """
    rows, lengths = [waypoints[:1]], [np.zeros(1)]
    along = 0.0
    for a, b in itertools.pairwise(waypoints):
        length = float(np.linalg.norm(b - a))
        steps = max(1, int(np.ceil(length / step_rad)))
        t = np.arange(1, steps + 1)[:, None] / steps
        rows.append(a + t * (b - a))
        lengths.append(along + length * t[:, 0])
        along += length
    return np.vstack(rows), np.concatenate(lengths)


def leaf_profile(obstacles: Obstacles, configurations: Array) -> tuple[Array, Array]:
    """Leaf intensity and clearance to stems [m] at configurations (K, n)."""
    space = obstacles.measuring_space()
    leaf, clear = np.zeros(len(configurations)), np.zeros(len(configurations))
    for i, q in enumerate(np.ascontiguousarray(configurations)):
        measure(space, q)
        leaf[i] = space.state.misc[LEAF]
        clear[i] = space.state.clear.min()
    return leaf, clear


def path_figures(
    obstacles: Obstacles, checker: ExactChecker, waypoints: Array, T_base_tool: Array | None, straight_from: int | None = None
) -> dict[str, Any]:
    """The figures of `PlanResult` that describe a path (M, n), straight from waypoint `straight_from` on."""
    robot, settings = obstacles.robot, obstacles.settings
    rows, lengths = sample_path(waypoints, MEASURED_STEP_RAD)
    leaf, clear = leaf_profile(obstacles, rows)
    ds = np.diff(lengths)
    touching = (leaf > 0.0).astype(np.float64)
    contact = float((0.5 * (touching[1:] + touching[:-1]) * ds).sum())
    intensity = float((0.5 * (leaf[1:] + leaf[:-1]) * ds).sum())
    length = float(lengths[-1])
    poses = np.array([robot.forward(q) for q in rows])
    hops = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    lowest = int(np.argmin(clear))
    clearance = float(clear[lowest])
    if clearance < 0.05 and len(obstacles.hard):
        clearance = min(clearance, checker.stem_distance(rows[lowest]))
    at_nodes = leaf_profile(obstacles, waypoints)[0]
    metric = load_planner(settings.planner).metric(settings)
    collision = settings.c_perm * float(at_nodes.sum()) if metric == "node" else settings.weight * intensity
    keep = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MAX_TOOL_POSES)).round().astype(int))
    figures: dict[str, Any] = {
        "cost": length + collision,
        "cost_metric": metric,
        "path_length_rad": length,
        "collision_cost": collision,
        "n_collision_nodes": int((at_nodes > 0.0).sum()),
        "leaf_contact_rad": contact,
        "tool_path_length_m": float(hops.sum()),
        "tool_leaf_contact_m": float((0.5 * (touching[1:] + touching[:-1]) * hops).sum()),
        "min_stem_clearance_m": clearance,
        "waypoints": waypoints,
        "tool_path": matrix_to_pose(poses[keep]),
        "tool_leaf": leaf[keep],
    }
    if straight_from is not None:
        begin, end = (robot.forward(waypoints[i])[:3, 3] for i in (straight_from, -1))
        figures["straight_approach_m"] = float(np.linalg.norm(end - begin))
    if T_base_tool is not None:
        T_tool_target = np.linalg.inv(poses[-1]) @ T_base_tool
        figures["goal_error_m"] = float(np.linalg.norm(T_tool_target[:3, 3]))
        cosine = np.clip((np.trace(T_tool_target[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)
        figures["goal_error_rad"] = float(np.arccos(cosine))
    return figures
