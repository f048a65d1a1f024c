"""The limes of a generated plant, hanging on short pedicels where there is room for them."""

from __future__ import annotations

import numpy as np

from lime_planner.core.geometry import unit
from lime_planner.core.types import Array
from lime_planner.scene.plants.skeleton import Canopy, Skeleton, nodes_along
from lime_planner.scene.plants.surface import distance_to_segments

PEDICEL_RADII_M = (0.0012, 0.0016)
FRONT_SHARE = 0.75  #: of the limes hang on the robot's side of the trunk: the side that is presented to it
_GAP_M = 0.004  # between a lime and anything it hangs beside
_CANDIDATES = 400


def hang_limes(
    rng: np.random.Generator,
    skeleton: Skeleton,
    canopy: Canopy,
    n: int,
    diameter_m: tuple[float, float],
    front: Array,
) -> tuple[Array, Array, Array]:
    """Hang up to n limes on shoots and twigs, clear of the wood and of each other.

    Args:
        rng: the only source of chance.
        skeleton: the wood.
        canopy: the limes' centres lie inside it.
        n: how many; fewer are hung when the plant has no room for more.
        diameter_m: smallest and largest lime.
        front: (3,), unit vector from the plant to the robot.

    Returns:
        Centres (F, 3) [m], radii (F,) [m], and where the pedicels start (F, 3) [m]; they end at the limes' tops.
    """
    nodes, _ = nodes_along(rng, skeleton, _CANDIDATES, 2)
    order = rng.permutation(len(nodes))
    in_front = (nodes[order] - canopy.centre) @ front > 0.0
    wanted_front = round(FRONT_SHARE * n)
    # Enough candidates of the robot's side come first; a stable sort keeps chance's order within both groups.
    order = order[np.argsort(~in_front, kind="stable")]
    front_first, others = order[: int(in_front.sum())], order[int(in_front.sum()) :]
    centres: list[Array] = []
    radii: list[float] = []
    stalks: list[Array] = []
    for group, limit in ((front_first, wanted_front), (others, n), (front_first, n)):
        for index in group:
            if len(centres) >= limit:
                break
            radius = 0.5 * rng.uniform(*diameter_m)
            hang = unit(np.array([rng.normal(0.0, 0.25), rng.normal(0.0, 0.25), -1.0]))
            centre = nodes[index] + (rng.uniform(0.006, 0.015) + radius) * hang
            if _has_room(centre, radius, skeleton, canopy, centres, radii):
                centres.append(centre)
                radii.append(radius)
                stalks.append(nodes[index])
    return np.array(centres).reshape(-1, 3), np.array(radii), np.array(stalks).reshape(-1, 3)


def _has_room(centre: Array, radius: float, skeleton: Skeleton, canopy: Canopy, centres: list[Array], radii: list[float]) -> bool:
    if ((((centre - canopy.centre) / canopy.half_axes) ** 2).sum()) > 1.0:
        return False
    if any(np.linalg.norm(centre - c) < radius + r + _GAP_M for c, r in zip(centres, radii, strict=True)):
        return False
    wood = distance_to_segments(centre, skeleton.starts, skeleton.ends) - skeleton.radii.max(axis=1)
    return bool(wood.min() > radius + _GAP_M)
