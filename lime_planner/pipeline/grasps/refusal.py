"""Why none of the approaches of a target is free, in one sentence."""

from __future__ import annotations

import collections

import numpy as np
from scipy.spatial import cKDTree

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import ARM_BLOCKED, HAND_BLOCKED, NO_ROOM, OUT_OF_REACH, TOO_CLOSE, Approaches
from lime_planner.pipeline.grasps.search import least_stretch_m, stations
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.targets import Target

_LOOKED_AT = 60  # blocked approaches whose obstacle is looked for
_CELL_M = 0.03  # contacts in one such cube are with one thing
_OVERSHOOT_M = 0.004  # what stands around the hand in the model that refused it reaches this far beyond its surface
_HARD_IN_WORDS = {"self": "through the arm itself", "floor": "through the floor", "workspace": "out of the workspace box"}


def explain(obstacles: Obstacles, checker: ExactChecker, approaches: Approaches, target: Target) -> tuple[Status, str]:
    """Count what became of the approaches and name the commonest obstacle.

    Returns:
        NO_IK_SOLUTION where the arm reaches none of them, else GOAL_IN_STEM; the sentence.
    """
    outcomes = approaches.outcomes
    counts = {outcome: int((outcomes == outcome).sum()) for outcome in (OUT_OF_REACH, HAND_BLOCKED, ARM_BLOCKED, NO_ROOM)}
    blocked = counts[HAND_BLOCKED] + counts[ARM_BLOCKED]
    parts = []
    if counts[OUT_OF_REACH]:
        parts.append(f"{counts[OUT_OF_REACH]} out of reach")
    if blocked:
        parts.append(f"{blocked} {_commonest(obstacles, checker, approaches, least_stretch_m(target, obstacles.settings))}")
    if counts[NO_ROOM]:
        parts.append(f"{counts[NO_ROOM]} without room for the straight stretch")
    certified = len(outcomes) - sum(counts.values())
    if certified:
        parts.append(f"{certified} too close to something hard on the way to be certified")
    noun = "approach" if len(outcomes) == 1 else "approaches"
    sentence = f"no free grasp of {target}: {len(outcomes)} {noun} tried: {', '.join(parts)}"
    return Status.NO_IK_SOLUTION if counts[OUT_OF_REACH] == len(outcomes) else Status.GOAL_IN_STEM, sentence


def _commonest(obstacles: Obstacles, checker: ExactChecker, approaches: Approaches, least_m: float) -> str:
    """Say what most of the blocked approaches meet.

    Args:
        obstacles, checker: see `explain`.
        approaches: with at least one that is blocked.
        least_m: how far back along the approach the hand must be free, too [m].
    """
    names: collections.Counter[str] = collections.Counter()
    places: list[Array] = []
    hands = approaches.poses[approaches.outcomes == HAND_BLOCKED]
    hands = hands[:: max(1, len(hands) // _LOOKED_AT)]
    hard = cKDTree(obstacles.hard)
    for T in hands:
        met, at = _met_by_hand(obstacles, hard, T, least_m)
        places += at
        names.update(met)
    arms = approaches.blocked
    share = max(1, len(arms) // _LOOKED_AT)
    for q in arms[::share]:
        hit = checker.stem_hit(q)
        if hit is None:
            names[TOO_CLOSE] += 1
        elif hit.place is not None:
            places.append(hit.place)
        else:
            names[_HARD_IN_WORDS.get(hit.what, f"through {hit.other}")] += 1
    kinds: dict[str, list[Array]] = {}
    for place in places:
        kinds.setdefault(_what_is_at(obstacles, place), []).append(place)
    one_place = True
    for kind, at in kinds.items():
        middle, alone = _thickest(np.array(at))
        one_place = one_place and alone
        names["through the {} at {:.2f} {:.2f} {:.2f}".format(kind, *middle)] += len(at)
    if not names:
        return "blocked"
    name = names.most_common(1)[0][0]
    return name if len(names) == 1 and one_place else f"blocked, most often {name}"


def _thickest(places: Array) -> tuple[Array, bool]:
    """Return the middle (3,) of where most of the places (P, 3) are, and whether that is all of them."""
    cells = np.floor(places / _CELL_M).astype(np.int64)
    unique, which, sizes = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return places[which.reshape(-1) == int(sizes.argmax())].mean(axis=0), len(unique) == 1


def _what_is_at(obstacles: Obstacles, place: Array) -> str:
    spot = obstacles.spot
    if spot is not None and spot.is_fruit(place):
        return "fruit itself"
    return "stem or leaf (leaves are solid)" if obstacles.settings.leaf_policy == "solid" else "branch"


def _met_by_hand(obstacles: Obstacles, hard: cKDTree, T_base_tool: Array, least_m: float) -> tuple[list[str], list[Array]]:
    """Return what blocks the hand on an approach: boxes, floor and workspace in words, and the deepest hard point (3,), if there is one."""
    T_base_joint = T_base_tool @ np.linalg.inv(np.vstack([obstacles.robot.chain.tool, [0.0, 0.0, 0.0, 1.0]]))
    for back_m in stations(least_m):
        T = T_base_joint.copy()
        T[:3, 3] -= back_m * T_base_tool[:3, 2]
        names, place = _borders_met(obstacles, T), _point_met(obstacles, hard, T)
        if names or place is not None:
            return names, [] if place is None else [place]
    return [], []


def _borders_met(obstacles: Obstacles, T_base_joint: Array) -> list[str]:
    """Name the keep-out boxes that the hand is in, the floor that it is below, and the workspace that it leaves."""
    shapes, world, b = obstacles.shapes, obstacles.world, obstacles.shapes.gripper
    first, last = (int(shapes.surface_start[shapes.fine_start[shapes.coarse_start[k]]]) for k in (b, b + 1))
    points = shapes.surface[first:last] @ T_base_joint[:3, :3].T + T_base_joint[:3, 3]
    if not len(points):
        return []
    near_m = world.margin + _OVERSHOOT_M
    found = []
    for number, (low, high) in enumerate(world.boxes):
        outside = np.maximum(np.maximum(low - points, points - high), 0.0)
        if np.linalg.norm(outside, axis=1).min() < near_m:
            found.append(f"through keep-out box {number}")
    if points[:, 2].min() - world.floor_z < near_m:
        found.append(_HARD_IN_WORDS["floor"])
    if min(float((points - world.workspace[0]).min()), float((world.workspace[1] - points).min())) < near_m:
        found.append(_HARD_IN_WORDS["workspace"])
    return found


def _point_met(obstacles: Obstacles, hard: cKDTree, T_base_joint: Array) -> Array | None:
    """Return the hard point (3,) that is deepest in the hand, the frame of its joint at a pose (4, 4); None where there is none."""
    from scipy.ndimage import map_coordinates

    shapes, b = obstacles.shapes, obstacles.shapes.gripper
    too_close_m = obstacles.world.stem_radius + obstacles.world.margin
    middle = T_base_joint[:3, :3] @ shapes.bound[b, :3] + T_base_joint[:3, 3]
    points = hard.data[hard.query_ball_point(middle, shapes.bound[b, 3] + too_close_m)]
    if not len(points):
        return None
    local = (points - T_base_joint[:3, 3]) @ T_base_joint[:3, :3]
    size = shapes.size[b]
    grid = shapes.grid[shapes.offset[b] : shapes.offset[b] + int(size.prod())].reshape(size)
    depth = map_coordinates(grid, ((local - shapes.origin[b]) / shapes.spacing[b]).T, order=1, mode="constant", cval=1.0)
    deepest = int(depth.argmin())
    return points[deepest] if depth[deepest] < too_close_m else None
