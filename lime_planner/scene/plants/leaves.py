"""The leaves of a generated plant: elliptic blades, folded along the midrib and curved, each on a petiole.

A petiole belongs to its leaf: it bends with the blade, so its points are permeable and its strip is part of the leaf's triangles.
"""

from __future__ import annotations

import numpy as np

from lime_planner.core.geometry import unit
from lime_planner.core.types import Array
from lime_planner.scene.plants.surface import perpendicular

PETIOLE_WIDTH_M = 0.0016
_SECTIONS = np.array([0.18, 0.45, 0.75])  # where along the midrib the blade has its cross-sections
_HALF_WIDTHS = np.sin(np.pi * _SECTIONS**0.85)  # of an elliptic blade, widest a little below its middle, pointed at the tip

#: Corners of a leaf's triangles. 0: base of the blade; 1 to 9: left, midrib, right at each section; 10: tip; 11 to 14: petiole.
FACES = np.array(
    [
        *([0, 1, 2], [0, 2, 3], [1, 4, 2], [2, 4, 5], [2, 5, 3], [3, 5, 6], [4, 7, 5], [5, 7, 8], [5, 8, 6], [6, 8, 9]),
        *([7, 10, 8], [8, 10, 9], [11, 12, 13], [11, 13, 14]),
    ]
)


def grow_leaves(
    rng: np.random.Generator, nodes: Array, axes: Array, turns_rad: Array, trunk_xy: Array, length_m: tuple[float, float]
) -> Array:
    """Grow one leaf at each node.

    Args:
        rng: the only source of chance.
        nodes: (N, 3) [m], where the petioles leave the twigs.
        axes: (N, 3), unit directions of the twigs there.
        turns_rad: (N,), position of each petiole around its twig.
        trunk_xy: (2,) [m], the leaves' upper faces turn up and away from it.
        length_m: shortest and longest blade.

    Returns:
        Triangles (N, len(FACES), 3, 3) [m].
    """
    n = len(nodes)
    one, two = perpendicular(axes)
    sideways = np.cos(turns_rad)[:, None] * one + np.sin(turns_rad)[:, None] * two
    petiole = unit(sideways + 0.6 * axes + 0.2 * rng.standard_normal((n, 3)) + np.array([0.0, 0.0, 0.25]))
    base = nodes + rng.uniform(0.008, 0.018, (n, 1)) * petiole
    droop = rng.uniform(0.1, 0.7, (n, 1))
    forward = unit(petiole + 0.25 * rng.standard_normal((n, 3)) - droop * np.array([0.0, 0.0, 1.0]))
    outward = unit(np.concatenate([nodes[:, :2] - trunk_xy, np.zeros((n, 1))], axis=1))
    light = np.array([0.0, 0.0, 1.0]) + 0.5 * outward + 0.35 * rng.standard_normal((n, 3))
    normal = unit(light - (light * forward).sum(axis=1, keepdims=True) * forward)
    left = np.cross(normal, forward)

    length = rng.uniform(*length_m, n)[:, None]
    width = length * rng.uniform(0.42, 0.56, (n, 1))
    bend = rng.uniform(0.1, 0.9, (n, 1))  # the whole midrib's curve, downwards [rad]
    fold = rng.uniform(0.1, 0.45, (n, 1))  # of each half over the midrib [rad]

    def midrib(t: Array) -> tuple[Array, Array, Array]:
        # A circular arc of the blade's length; its own normal leans forward as it curves.
        angle = bend * t
        rib = base[:, None] + (length * np.sin(angle) / bend)[..., None] * forward[:, None]
        rib = rib - (length * (1.0 - np.cos(angle)) / bend)[..., None] * normal[:, None]
        up = np.cos(angle)[..., None] * normal[:, None] + np.sin(angle)[..., None] * forward[:, None]
        return rib, up, angle

    rib, up, _ = midrib(_SECTIONS[None, :])
    half = (0.5 * width * _HALF_WIDTHS)[..., None]
    lifted = (half * np.sin(fold)[..., None]) * up
    aside = (half * np.cos(fold)[..., None]) * left[:, None]
    tip, _, _ = midrib(np.ones((1, 1)))
    blade = np.stack([rib + aside + lifted, rib, rib - aside + lifted], axis=2).reshape(n, -1, 3)
    edge = 0.5 * PETIOLE_WIDTH_M * left
    strip = np.stack([nodes - edge, nodes + edge, base + edge, base - edge], axis=1)
    corners = np.concatenate([base[:, None], blade, tip, strip], axis=1)
    return corners[:, FACES]
