"""Which stems a motion really touches: the arm's undecimated meshes against every stem point of the plant, seen or not.

Nothing here is shared with a plan: no distance field, no point's radius, only surfaces and the whole plant.
"""

from __future__ import annotations

import numpy as np

from lime_planner.core.parameters import Settings
from lime_planner.core.types import Int64
from lime_planner.experiments.swept_leaves import FINE_RAD, Motion, Sweeper, motion_samples
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.spots import Spot, exclusion, spared
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

#: A stem point is touched when a link's surface comes this close: half the distance between stem points of a generated plant, and less
#: than the radius that a seen one keeps the arm away with.
TOUCH_M = 0.002


class StemTruth:
    """The stems of one whole plant, ready to be asked what motions touch of them."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        """Take the stem points of a whole plant."""
        self._sweeper = Sweeper(robot)
        self._points = scene.stem_points.astype(np.float64)

    def touched(self, motion: Trajectory | Motion, spot: Spot | None, settings: Settings) -> Int64:
        """Return the numbers of the stem points that a motion touches.

        Args:
            motion: as timed, or as samples of that.
            spot: what is let go for the hand there (the stalk, or what is around an exact pose) does not count.
            settings: say how much that is.
        """
        hidden, _ = exclusion(spot, settings)
        counted = np.flatnonzero(~spared(self._points, hidden)) if hidden[3] > 0.0 else np.arange(len(self._points))
        if isinstance(motion, Trajectory):
            motion = motion_samples(self._sweeper.robot, motion.configurations(FINE_RAD))
        return np.asarray(counted[self._sweeper.reached(motion, self._points[counted], TOUCH_M)])
