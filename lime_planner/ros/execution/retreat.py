"""The way back: which waypoints lead from where the arm rests along the motions that brought it there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lime_planner.core.geometry import whole_turns
from lime_planner.core.types import Array
from lime_planner.motion.way_back import ARRIVED_RAD, OFF_PATH_RAD, nearest_on_path
from lime_planner.pipeline.targets import Target as Aim
from lime_planner.ros.inputs.latest import Target

#: A motion whose joints all stay within this is a correction at the end of the one before [rad].
CORRECTION_RAD = 0.05


@dataclass(frozen=True)
class Path:
    """What was executed last.

    Attributes:
        waypoints: (M, n) [rad], M >= 2.
        aim: the newest target that it led to, in the planning frame, or None.
        straight_from: (n,) where the straight stretch to it began [rad]; None where it has none.
        target: that target as it came in.
    """

    waypoints: Array
    aim: Aim | None = None
    straight_from: Array | None = None
    target: Target | None = None


class WayOut:
    """The path that leads out again: that of the last real motion, with the corrections that came after it.

    A retreat is no part of it; one that was cut short is gone on with along the same path.
    """

    def __init__(self) -> None:
        """Know of no way."""
        self.path: Path | None = None  # replaced whole: other threads look at it

    def clear(self) -> None:
        """Forget the way: another arm."""
        self.path = None

    def went(self, path: Path, continuous: npt.ArrayLike) -> None:
        """Take note of a motion that was sent.

        Args:
            path: its own.
            continuous: which joints turn without end, (n,) bool.
        """
        begun = path.waypoints[0]
        if self.path is not None:
            before = nearest_turns(self.path.waypoints, begun, continuous)
            index, distance = nearest_on_path(before, begun)
            on_path = distance <= OFF_PATH_RAD and np.abs(begun - before[0]).max() > ARRIVED_RAD
            if on_path and np.abs(path.waypoints - begun).max() <= CORRECTION_RAD:
                path = replace(path, waypoints=np.concatenate([before[: index + 1], path.waypoints]))
        self.path = path


def nearest_turns(waypoints: npt.ArrayLike, q: npt.ArrayLike, continuous: npt.ArrayLike) -> Array:
    """Shift a path by whole turns of its continuous joints so that it comes nearest to a configuration.

    Args:
        waypoints: the path, (M, n) [rad].
        q: where the arm rests, (n,) [rad]; its driver may report other turns than when the path was executed.
        continuous: which joints turn without end, (n,) bool.
    """
    path, here = np.asarray(waypoints, dtype=np.float64), np.asarray(q, dtype=np.float64)
    mask = np.asarray(continuous, dtype=bool)
    turns = np.unique([whole_turns(here - waypoint, mask) for waypoint in path], axis=0)
    distances = [nearest_on_path(path + shift, here)[1] for shift in turns]
    return np.asarray(path + turns[int(np.argmin(distances))], dtype=np.float64)
