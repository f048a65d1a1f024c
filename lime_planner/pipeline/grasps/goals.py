"""Goals for the search from any kind of target: where the straight stretches begin, and what comes behind them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.types import Array
from lime_planner.pipeline.context import never
from lime_planner.pipeline.goals import FREE, Goals, find_goals, tight_anchors
from lime_planner.pipeline.grasps.refusal import explain
from lime_planner.pipeline.grasps.search import Grasps, find_grasps, follow_back, joint_window
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.targets import Target
from lime_planner.robot.model import Robot

_MORE_TURNS = 2  # times as many goals as grasps at most: the same grasps with whole turns of joints
_TURN = 2.0 * np.pi
_ASK_FOR_FRUIT = "; only this pose was tried: grasp_freedom cone, or the fruit itself as the target, leaves the approach open"


def goals_of(
    obstacles: Obstacles,
    checker: ExactChecker,
    target: Target,
    q_start: Array,
    rng: np.random.Generator,
    should_stop: Callable[[], bool] = never,
) -> Goals:
    """Find the goals of a target, or why there are none.

    Args:
        obstacles: of the target's spot, without anchors.
        checker: of the same obstacles.
        target: what to reach.
        q_start: (n,) where the arm is [rad].
        rng: source of chance.
        should_stop: cancels.

    Raises:
        Refusal: CANCELLED.
    """
    if target.exact:
        goals = find_goals(obstacles, checker, target.poses[0], q_start, rng)
        if goals.status is not None:
            return dataclasses.replace(goals, sentence=goals.sentence + _ASK_FOR_FRUIT, tried=1)
        return _straightened(obstacles, target.poses[0], q_start, goals)
    wanted = obstacles.settings.max_goals
    grasps = find_grasps(obstacles, target, q_start, rng, wanted, should_stop)
    return _with_turns(obstacles, grasps, target, q_start, checker)


def _straightened(obstacles: Obstacles, T_base_tool: Array, q_start: Array, goals: Goals) -> Goals:
    """Let goals begin as far back on the straight way to an exact pose as is free: down to nothing, at a price for what is missing."""
    settings = obstacles.settings
    already_m = float(np.linalg.norm(obstacles.robot.forward(q_start)[:3, 3] - T_base_tool[:3, 3]))
    if already_m <= settings.approach_distance_m:
        return dataclasses.replace(goals, tried=1, free=1)  # from so near the arm need not back out first
    stretches, costs = follow_back(obstacles, T_base_tool, q_start, goals.configurations)
    begins = np.array([stretch[0] for stretch in stretches])
    order = np.argsort(costs + np.linalg.norm(begins - q_start, axis=1), kind="stable")
    anchors, needs = tight_anchors(obstacles, begins[order], q_start)
    return dataclasses.replace(
        goals,
        configurations=begins[order],
        costs=costs[order],
        stretches=tuple(stretches[i] for i in order),
        poses=np.tile(T_base_tool, (len(order), 1, 1)),
        anchors=anchors,
        needs=needs,
        tried=1,
        free=1,
    )


def _with_turns(obstacles: Obstacles, grasps: Grasps, target: Target, q_start: Array, checker: ExactChecker) -> Goals:
    """Make goals of free grasps: each as near to the start as it can be, and some with further turns of the joints."""
    approaches, more = grasps.approaches, grasps.more
    n, tried = obstacles.robot.n, len(approaches.poses)
    free = int((approaches.outcomes == FREE).sum())
    if not len(grasps.costs):
        status, sentence = explain(obstacles, checker, approaches, target)
        none = np.zeros((0, n))
        return Goals(none, none, np.zeros(0), status, sentence, 0, tried=tried, free=0, approaches=approaches)
    rows: list[tuple[float, int, Array]] = []
    for g, cost in enumerate(grasps.costs):
        stretch = grasps.stretches[g, : grasps.counts[g]][::-1]
        rows += [(float(cost + np.linalg.norm(q[0] - q_start)), g, q) for q in _turned(obstacles.robot, stretch, q_start)]
    rows.sort(key=lambda row: row[0])
    firsts: dict[int, int] = {}
    for place, (_, g, _) in enumerate(rows):
        firsts.setdefault(g, place)
    others = [place for place in range(len(rows)) if place not in firsts.values()]
    chosen = sorted([*firsts.values(), *others[: (_MORE_TURNS - 1) * len(firsts)]])
    stretches = tuple(np.ascontiguousarray(rows[place][2]) for place in chosen)
    which = np.array([rows[place][1] for place in chosen])
    begins = np.array([stretch[0] for stretch in stretches])
    anchors, needs = tight_anchors(obstacles, begins, q_start)
    return Goals(
        begins,
        anchors,
        needs,
        None,
        "",
        len(grasps.costs),
        costs=grasps.costs[which],
        stretches=stretches,
        poses=approaches.poses[grasps.approach[which]],
        tried=tried,
        free=free,
        approaches=approaches,
        more=None if more is None else lambda: _with_turns(obstacles, more(), target, q_start, checker),
    )


def _turned(robot: Robot, stretch: Array, q_start: Array) -> list[Array]:
    """Return a stretch (K, n) with all whole turns of its joints that keep it within limits and a turn of the start."""
    lower, upper = joint_window(robot, q_start)
    lowest, highest = stretch.min(axis=0), stretch.max(axis=0)
    choices = []
    for i in range(robot.n):
        turns = np.arange(np.ceil((lower[i] - lowest[i]) / _TURN - 1e-9), np.floor((upper[i] - highest[i]) / _TURN + 1e-9) + 1.0)
        choices.append(_TURN * turns)
    return [stretch + np.array(shift) for shift in itertools.product(*choices)]
