"""Which pairs of links can collide with each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lime_planner.core.types import Array
from lime_planner.robot.kinematics import Chain, forward_kinematics
from lime_planner.robot.meshes import LinkMesh, bvh_of

_SAMPLES = 200
_ALWAYS = 0.95  # as in MoveIt's setup assistant: more often in contact than this is contact by design


def find_collision_pairs(
    chain: Chain, links: Sequence[LinkMesh], adjacent: frozenset[tuple[int, int]], lower: Array, upper: Array
) -> tuple[tuple[int, int], ...]:
    """Return the pairs of links to check for self-collision, as indices (i < j) of `links`.

    Left out are links on the same joint, links that meet in a joint (`adjacent`), and pairs in contact in more than 95 % of
    configurations drawn from a fixed seed within the limits, which are in contact by design. Pairs that never met in the sample
    are kept: a sample proves nothing, and a far pair costs next to nothing.

    Args:
        chain: the kinematic chain of n joints.
        links: the links' meshes.
        adjacent: pairs of indices of links that meet in a joint.
        lower: (n,) lower limits [rad], -inf for continuous joints.
        upper: (n,) upper limits [rad].
    """
    import fcl

    pairs = [
        (i, j) for i in range(len(links)) for j in range(i + 1, len(links)) if links[i].joint != links[j].joint and (i, j) not in adjacent
    ]
    objects = [fcl.CollisionObject(bvh_of(link)) for link in links]
    rng = np.random.default_rng(0)
    low, high = np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)
    poses = np.empty((len(lower) + 1, 3, 4))
    request, touching = fcl.CollisionRequest(), np.zeros(len(pairs), dtype=int)
    free = 0.0
    undecided = list(range(len(pairs)))
    for _ in range(_SAMPLES):
        forward_kinematics(chain, rng.uniform(low, high), poses)
        for link, thing in zip(links, objects, strict=True):
            thing.setTransform(fcl.Transform(poses[link.joint, :, :3], poses[link.joint, :, 3]))
        for k in undecided:
            i, j = pairs[k]
            touching[k] += fcl.collide(objects[i], objects[j], request, fcl.CollisionResult()) > 0
        free += 1
        # A pair seen apart more often than 5 % of all samples allow is decided.
        undecided = [k for k in undecided if free - touching[k] <= (1.0 - _ALWAYS) * _SAMPLES]
        if not undecided:
            break
    return tuple(pair for k, pair in enumerate(pairs) if k not in set(undecided))


def touches_itself(chain: Chain, links: Sequence[LinkMesh], pairs: Sequence[tuple[int, int]], q: Array) -> bool:
    """Tell whether any of `pairs` is in contact at configuration q (n,) [rad], by the exact meshes."""
    import fcl

    poses = np.empty((len(q) + 1, 3, 4))
    forward_kinematics(chain, q, poses)
    objects = [fcl.CollisionObject(bvh_of(k), fcl.Transform(poses[k.joint, :, :3], poses[k.joint, :, 3])) for k in links]
    return any(fcl.collide(objects[i], objects[j], fcl.CollisionRequest(), fcl.CollisionResult()) > 0 for i, j in pairs)
