"""What the arm must not or should not touch, as compiled code sees it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from lime_planner.collision.distance_fields import Fields, box_distance, lattice_fields
from lime_planner.core.jit import inline_kernel
from lime_planner.core.types import Array, Float32
from lime_planner.planning.prices import BINARY, Prices

CAP_M = 0.5  # larger clearances are reported as this


class World(NamedTuple):
    """What the arm must not or should not touch, in the planning frame [m].

    Attributes:
        fields: distance fields and points of stems and leaves.
        stem_radius, leaf_radius: radii of the points.
        margin: clearance kept to stems, beyond their radius.
        boxes: (K, 2, 3) keep-out boxes.
        floor_z: height of the floor, -1e10 for none.
        workspace: (2, 3) box that the arm stays in, infinite for none.
        exclusion: (6,) where stem points do not block the gripper: x y z of the target, radius, and the lowest and the highest height
            over the target of an upright segment; points within the radius of the segment are left out. Both heights 0 make a sphere,
            radius 0 none.
        zone: distance of the tool from the target within which that holds.
        anchors: (A, n) configurations (start, goals) that have less clearance than the margin, anchor_need: (A,) what is required at
            them; the requirement grows by `slope` [m/rad] with the distance from them until it is the margin again.
        prices: how what is touched becomes a configuration's price.
    """

    fields: Fields
    stem_radius: float
    leaf_radius: float
    margin: float
    boxes: Array
    floor_z: float
    workspace: Array
    exclusion: Array
    zone: float
    anchors: Array
    anchor_need: Array
    slope: float
    prices: Prices


def empty_world(fields: Fields, n: int, **values: Any) -> World:
    """A world with the given parts and nothing else."""
    infinite = np.array([[-np.inf] * 3, [np.inf] * 3])
    parts: dict[str, Any] = {
        "fields": fields,
        "stem_radius": 0.004,
        "leaf_radius": 0.004,
        "margin": 0.005,
        "boxes": np.zeros((0, 2, 3)),
        "floor_z": -np.inf,
        "workspace": infinite,
        "exclusion": np.zeros(6),
        "zone": 0.0,
        "anchors": np.zeros((0, n)),
        "anchor_need": np.zeros(0),
        "slope": 0.02,
        "prices": Prices(BINARY, 1.0),
    }
    return World(**(parts | values))


def unseen_world(places: Float32, voxel_m: float, n: int, pause: Callable[[], None] = lambda: None) -> World:
    """Make a world of space that no camera has seen: permeable points of price 1, one for each voxel, and nothing else.

    Args:
        places: (K, 3) middles of the voxels [m].
        voxel_m: edge of a voxel [m]; an arm that comes closer to the middle of one than half of that is in it.
        n: number of joints.
        pause: see `build_fields`.
    """
    return empty_world(lattice_fields(places, voxel_m, pause=pause), n, leaf_radius=0.5 * voxel_m, margin=0.0, stem_radius=0.0)


@inline_kernel
def required_clearance(world: World, q: Array) -> float:
    """Clearance to stems required at q: the margin, less near a start or goal that has less itself [m]."""
    need = world.margin
    for a in range(world.anchors.shape[0]):
        total = 0.0
        for i in range(q.shape[0]):
            total += (q[i] - world.anchors[a, i]) ** 2
        need = min(need, world.anchor_need[a] + world.slope * math.sqrt(total))
    return need


@inline_kernel
def hard_distance(world: Any, x: Any, y: Any, z: Any) -> Any:
    """Distance from a place to the keep-out boxes, the floor and out of the workspace box [m]."""
    best = CAP_M
    for k in range(world.boxes.shape[0]):
        best = min(best, box_distance(world.boxes[k], x, y, z))
    best = min(best, z - world.floor_z)
    best = min(best, x - world.workspace[0, 0], world.workspace[1, 0] - x)
    best = min(best, y - world.workspace[0, 1], world.workspace[1, 1] - y)
    best = min(best, z - world.workspace[0, 2], world.workspace[1, 2] - z)
    return best
