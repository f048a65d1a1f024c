"""Why none of the approaches of a target is free, in one sentence."""

from __future__ import annotations

import collections

import numpy as np
from scipy.spatial import cKDTree

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import ARM_BLOCKED, HAND_BLOCKED, NO_ROOM, OUT_OF_REACH, TOO_CLOSE, Approaches
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.targets import Target

_LOOKED_AT = 60  # blocked approaches whose obstacle is looked for
_CELL_M = 0.03  # contacts in one such cube are with one thing


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
        parts.append(f"{blocked} {_commonest(obstacles, checker, approaches)}")
    if counts[NO_ROOM]:
        parts.append(f"{counts[NO_ROOM]} without room for the straight stretch")
    certified = len(outcomes) - sum(counts.values())
    if certified:
        parts.append(f"{certified} too close to something hard on the way to be certified")
    noun = "approach" if len(outcomes) == 1 else "approaches"
    sentence = f"no free grasp of {target}: {len(outcomes)} {noun} tried: {', '.join(parts)}"
    return Status.NO_IK_SOLUTION if counts[OUT_OF_REACH] == len(outcomes) else Status.GOAL_IN_STEM, sentence


def _commonest(obstacles: Obstacles, checker: ExactChecker, approaches: Approaches) -> str:
    """Say what most of the blocked approaches meet."""
    names: collections.Counter[str] = collections.Counter()
    places: list[Array] = []
    hands = approaches.poses[approaches.outcomes == HAND_BLOCKED]
    hands = hands[:: max(1, len(hands) // _LOOKED_AT)]
    hard = cKDTree(obstacles.hard)
    for T in hands:
        place = _in_hand(obstacles, hard, T)
        if place is not None:
            places.append(place)
    arms = approaches.blocked
    share = max(1, len(arms) // _LOOKED_AT)
    for q in arms[::share]:
        hit = checker.stem_hit(q)
        if hit is None:
            names[TOO_CLOSE] += 1
        elif hit.place is not None:
            places.append(hit.place)
        else:
            names[{"self": "through the arm itself", "keep_out": f"through {hit.other}"}.get(hit.what, f"through the {hit.what}")] += 1
    if places:
        cells = np.floor(np.array(places) / _CELL_M).astype(np.int64)
        unique, which, sizes = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        largest = int(sizes.argmax())
        middle = np.array(places)[which.reshape(-1) == largest].mean(axis=0)
        names["through the {} at {:.2f} {:.2f} {:.2f}".format(_what_is_at(obstacles, middle), *middle)] += len(places)
    if not names:
        return "blocked"
    name = names.most_common(1)[0][0]
    return name if len(names) == 1 and not (places and len(unique) > 1) else f"blocked, most often {name}"


def _what_is_at(obstacles: Obstacles, place: Array) -> str:
    spot = obstacles.spot
    if spot is not None and spot.fruit_radius_m is not None and np.linalg.norm(place - spot.centre) < spot.fruit_radius_m + 0.005:
        return "fruit itself"
    return "stem or leaf (leaves are solid)" if obstacles.settings.leaf_policy == "solid" else "branch"


def _in_hand(obstacles: Obstacles, hard: cKDTree, T_base_tool: Array) -> Array | None:
    """Return the hard point (3,) that is deepest in the hand, its tool at a pose (4, 4); None where there is none."""
    from scipy.ndimage import map_coordinates

    shapes, b = obstacles.shapes, obstacles.shapes.gripper
    T_base_joint = T_base_tool @ np.linalg.inv(np.vstack([obstacles.robot.chain.tool, [0.0, 0.0, 0.0, 1.0]]))
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
