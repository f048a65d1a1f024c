"""The figures of a path: length, leaf contact, clearance, cost, and the tool's way."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from lime_planner.collision.fast import LEAF
from lime_planner.collision.joint_space import ArmSpace, measure
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.types import Array
from lime_planner.pipeline.clearance import StemClearance
from lime_planner.pipeline.leaf_spans import LeafSpans, leaf_spans, unseen_spans
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.planner import load_planner
from lime_planner.robot.model import Robot

MEASURED_STEP_RAD = 0.02  # spacing of the tool's path and of clearances
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
    return _profile(obstacles.measuring_space(), configurations)


def _profile(space: ArmSpace, configurations: Array) -> tuple[Array, Array]:
    leaf, clear = np.zeros(len(configurations)), np.zeros(len(configurations))
    for i, q in enumerate(np.ascontiguousarray(configurations)):
        measure(space, q)
        leaf[i] = space.state.misc[LEAF]
        clear[i] = space.state.clear.min()
    return leaf, clear


def _in_unseen(obstacles: Obstacles, configurations: Array) -> Array:
    """Tell of configurations (K, n) whether they are in unseen space, 1 or 0."""
    space = obstacles.unseen_space()
    return np.zeros(len(configurations)) if space is None else _profile(space, configurations)[0]


def _tool_contact_m(robot: Robot, contact: LeafSpans, rows: Array, lengths: Array) -> float:
    """Length of the tool's way on which any part of the arm touches what `contact` is about [m].

    Args:
        robot, contact: the arm, and where it touches leaves.
        rows: (K, n) the path, sampled; lengths: (K,) along it [rad].
    """
    if not len(contact.spans):
        return 0.0
    borders = contact.spans[:, :2].ravel()
    at = np.unique(np.concatenate([lengths, np.clip(borders, 0.0, lengths[-1])]))
    columns = [np.interp(at, lengths, column) for column in rows.T]
    tool = np.array([robot.forward(np.array(q))[:3, 3] for q in zip(*columns, strict=True)])
    inside = contact.price_at(0.5 * (at[1:] + at[:-1])) > 0.0
    return float(np.linalg.norm(np.diff(tool, axis=0), axis=1)[inside].sum())


def path_figures(obstacles: Obstacles, waypoints: Array, T_base_tool: Array | None, straight_from: int | None = None) -> dict[str, Any]:
    """The figures of `PlanResult` that describe a path (M, n), straight from waypoint `straight_from` on."""
    robot, settings = obstacles.robot, obstacles.settings
    rows, lengths = sample_path(waypoints, MEASURED_STEP_RAD)
    contact, unseen = leaf_spans(obstacles, waypoints), unseen_spans(obstacles, waypoints)
    length = float(lengths[-1])
    poses = np.array([robot.forward(q) for q in rows])
    hops = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    at_nodes, _ = leaf_profile(obstacles, waypoints)
    metric = load_planner(settings.planner).metric(settings)
    collision = settings.c_perm * float(at_nodes.sum()) if metric == "node" else settings.weight * contact.charged_rad
    if metric == "node":
        hidden = settings.c_perm * settings.unseen_price * float(_in_unseen(obstacles, waypoints).sum())
    else:
        hidden = settings.weight * settings.unseen_price * unseen.charged_rad
    keep = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MAX_TOOL_POSES)).round().astype(int))
    figures: dict[str, Any] = {
        "cost": length + collision + hidden,
        "cost_metric": metric,
        "path_length_rad": length,
        "cost_error": 0.0 if metric == "node" else settings.weight * (contact.doubt_rad + settings.unseen_price * unseen.doubt_rad),
        "collision_cost": collision,
        "n_collision_nodes": int((at_nodes > 0.0).sum()),
        "leaf_contact_rad": contact.contact_rad,
        "tool_path_length_m": float(hops.sum()),
        "tool_leaf_contact_m": _tool_contact_m(robot, contact, rows, lengths),
        "views": obstacles.views,
        "unseen_contact_rad": unseen.contact_rad,
        "tool_unseen_m": _tool_contact_m(robot, unseen, rows, lengths),
        "min_stem_clearance_m": StemClearance(obstacles).smallest(rows),
        "waypoints": waypoints,
        "tool_path": matrix_to_pose(poses[keep]),
        "tool_leaf": contact.price_at(lengths[keep]),
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
