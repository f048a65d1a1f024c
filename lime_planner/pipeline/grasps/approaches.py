"""Tool poses to try at a target: approaches spread evenly over a cone of directions and all turns about them."""

from __future__ import annotations

import numpy as np

from lime_planner.core.types import Array

# The first numbers of the sequence of Roberts (2018) in three dimensions: powers of the root of x^4 = x + 1.
_ROOT = 1.2207440846057596
_STEPS = np.array([1.0 / _ROOT, 1.0 / _ROOT**2, 1.0 / _ROOT**3])
_MIDDLE_FIRST = 1e-9


def spread(n: int, rng: np.random.Generator) -> Array:
    """Return n points (n, 3) of the unit cube, spread evenly in every prefix (a low-discrepancy sequence, shifted at random)."""
    return np.asarray((rng.uniform(size=3) + np.arange(1, n + 1)[:, None] * _STEPS) % 1.0)


def frames_along(directions: Array, rolls: Array) -> Array:
    """Return rotations (P, 3, 3) whose third column is a direction (P, 3) of length 1, turned about it by rolls (P,) [rad]."""
    z = directions
    helper = np.where(np.abs(z[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    one = np.cross(helper, z)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(z, one)
    x = np.cos(rolls)[:, None] * one + np.sin(rolls)[:, None] * two
    return np.stack([x, np.cross(z, x), z], axis=2)


def in_cone(axis: Array, cone_rad: float, points: Array) -> Array:
    """Turn points (P, 3) of the unit cube into rotations (P, 3, 3): even over the cap of directions, and over the turns about them.

    Args:
        axis: (3,) middle of the cone, of length 1.
        cone_rad: largest angle between a direction and the axis.
        points: height over the cap, azimuth and roll as shares.
    """
    cosine = 1.0 - points[:, :1] * (1.0 - np.cos(cone_rad))
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    turn = 2.0 * np.pi * points[:, 1:2]
    frame = frames_along(axis[None], np.zeros(1))[0]
    directions = cosine * frame[:, 2] + sine * (np.cos(turn) * frame[:, 0] + np.sin(turn) * frame[:, 1])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return frames_along(directions, 2.0 * np.pi * points[:, 2])


def around(rotations: Array, axis: Array, cone_rad: float, turn_rad: float, rng: np.random.Generator) -> Array:
    """Turn rotations (P, 3, 3) a little: normally distributed turns about all axes, the directions kept inside the cone.

    Args:
        rotations: where to begin.
        axis, cone_rad: of the cone that the third columns stay in.
        turn_rad: standard deviation of the turn about each axis of the tool; twice that about the approach.
        rng: source of chance.
    """
    from scipy.spatial.transform import Rotation

    vectors = rng.normal(size=(len(rotations), 3)) * (turn_rad * np.array([1.0, 1.0, 2.0]))
    turned = np.asarray(rotations @ Rotation.from_rotvec(vectors).as_matrix())
    outside = turned[:, :, 2] @ axis < np.cos(cone_rad) - _MIDDLE_FIRST
    # The direction was inside before: where the turn leads out, only the turn about it is made.
    rolls = np.zeros_like(vectors)
    rolls[:, 2] = vectors[:, 2]
    turned[outside] = (rotations @ Rotation.from_rotvec(rolls).as_matrix())[outside]
    return turned


def nearest_earlier(rotations: Array, count: int) -> Array:
    """Return, for each rotation (P, 3, 3), the `count` nearest ones before it, nearest first, (P, count) int64; -1 where there are fewer.

    Orientations that are near each other have configurations near each other: inverse kinematics goes on from there.
    """
    flat = rotations.reshape(len(rotations), 9)
    alike = flat @ flat.T  # the trace of the rotation between two: 1 + 2 cos(angle)
    alike[np.triu_indices(len(flat))] = -np.inf
    order = np.argsort(-alike, axis=1, kind="stable")[:, :count]
    found = np.take_along_axis(alike, order, axis=1) > -np.inf
    result = np.where(found, order, -1)
    return np.pad(result, ((0, 0), (0, count - result.shape[1])), constant_values=-1)
