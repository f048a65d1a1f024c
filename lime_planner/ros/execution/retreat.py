"""The way back: which waypoints lead from where the arm rests along the motions that brought it there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import Refusal
from lime_planner.core.geometry import whole_turns
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.targets import Target as Aim
from lime_planner.ros.inputs.latest import Target

#: Farther from the path than this the way back is unknown [rad, over all joints].
OFF_PATH_RAD = 0.1
#: Closer to the path's beginning than this nothing is left to go back [rad].
ARRIVED_RAD = 0.01
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


def nearest_on_path(waypoints: Array, q: Array) -> tuple[int, float]:
    """Return the segment (its first waypoint's index) of a polyline (M, n) that is nearest to q (n,), and its distance [rad]."""
    begins, steps = waypoints[:-1], np.diff(waypoints, axis=0)
    lengths2 = np.maximum((steps**2).sum(axis=1), 1e-18)
    shares = np.clip(((q - begins) * steps).sum(axis=1) / lengths2, 0.0, 1.0)
    distances = np.linalg.norm(q - begins - shares[:, None] * steps, axis=1)
    # Of equally near ones the last: a path that passes a place twice was left at its later pass.
    index = int(len(distances) - 1 - np.argmin(distances[::-1]))
    return index, float(distances[index])


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


def straight_back(path: Path, waypoints: Array) -> slice | None:
    """Return which waypoints (K, n) of a way back lead along the path's straight stretch, None where it has none.

    The first waypoint is where the arm rests; those of the stretch follow, and the last of them is where the stretch began.
    """
    if path.straight_from is None:
        return None
    turns = (waypoints - path.straight_from) / (2.0 * np.pi)
    apart = np.abs(turns - np.rint(turns)).max(axis=1)
    end = int(apart.argmin())
    return slice(0, end + 1) if apart[end] < 1e-6 and end > 0 else None


def way_back(waypoints: npt.ArrayLike, q: npt.ArrayLike) -> Array:
    """Return waypoints (K, n) from q back to the path's beginning.

    Args:
        waypoints: the path that was executed, as far as it went or beyond, (M, n) [rad].
        q: where the arm rests, (n,).

    Raises:
        Refusal: START_INVALID when the arm is not on the path, NOTHING_TO_EXECUTE when it is back already.
    """
    path, here = np.asarray(waypoints, dtype=np.float64), np.asarray(q, dtype=np.float64)
    if np.abs(here - path[0]).max() <= ARRIVED_RAD:
        raise Refusal(Status.NOTHING_TO_EXECUTE, "the arm is back where the last motion began")
    index, distance = nearest_on_path(path, here)
    if distance > OFF_PATH_RAD:
        raise Refusal(Status.START_INVALID, f"the arm is {distance:.3f} rad from the path executed last, the limit is {OFF_PATH_RAD:g} rad")
    back = [here]
    for waypoint in path[index::-1]:
        if np.abs(waypoint - back[-1]).max() > 1e-6:
            back.append(waypoint)
    return np.array(back)
