"""How approaches that were tried are drawn: lines that end before the fruit, coloured by what became of them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from lime_planner.core.types import Array
from lime_planner.pipeline.goals import ARM_BLOCKED, DEARER, FREE, HAND_BLOCKED, NO_ROOM, OUT_OF_REACH

GAP_M, LENGTH_M = 0.05, 0.05  #: how far from the fruit the lines end, and how long they are

#: What became of an approach: green free, pale green dearer than enough of those, red the hand is blocked, orange the arm is, violet no
#: room to come straight, grey out of reach.
APPROACH_COLOURS = {
    FREE: (0.15, 0.65, 0.30),
    DEARER: (0.62, 0.80, 0.55),
    HAND_BLOCKED: (0.85, 0.20, 0.10),
    ARM_BLOCKED: (0.95, 0.55, 0.10),
    NO_ROOM: (0.55, 0.35, 0.75),
    OUT_OF_REACH: (0.6, 0.6, 0.6),
}
APPROACH_WORDS = {
    FREE: "free",
    DEARER: "dearer, not looked at",
    HAND_BLOCKED: "hand blocked",
    ARM_BLOCKED: "arm blocked",
    NO_ROOM: "no room to come straight",
    OUT_OF_REACH: "out of reach",
}


def approach_lines(poses: Array, gap_m: float = GAP_M, length_m: float = LENGTH_M) -> Array:
    """Return the ends of the lines of approaches (A, 7) x y z qx qy qz qw, (A, 2, 3), the one nearer to the fruit last."""
    ways = Rotation.from_quat(poses[:, 3:]).as_matrix()[:, :, 2]
    tips = poses[:, :3] - gap_m * ways
    return np.stack([tips - length_m * ways, tips], axis=1)
