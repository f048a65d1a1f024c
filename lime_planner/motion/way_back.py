"""The way back along a path that the arm has gone, as waypoints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.core.types import Array

#: Farther from the path than this the way back is unknown [rad, over all joints].
OFF_PATH_RAD = 0.1
#: Closer to the path's beginning than this nothing is left to go back [rad].
ARRIVED_RAD = 0.01


def nearest_on_path(waypoints: Array, q: Array) -> tuple[int, float]:
    """Return the segment (its first waypoint's index) of a polyline (M, n) that is nearest to q (n,), and its distance [rad]."""
    begins, steps = waypoints[:-1], np.diff(waypoints, axis=0)
    lengths2 = np.maximum((steps**2).sum(axis=1), 1e-18)
    shares = np.clip(((q - begins) * steps).sum(axis=1) / lengths2, 0.0, 1.0)
    distances = np.linalg.norm(q - begins - shares[:, None] * steps, axis=1)
    # Of equally near ones the last: a path that passes a place twice was left at its later pass.
    index = int(len(distances) - 1 - np.argmin(distances[::-1]))
    return index, float(distances[index])


def straight_back(straight_from: Array | None, waypoints: Array) -> slice | None:
    """Return which waypoints (K, n) of a way back lead along the path's straight stretch, None where it has none.

    The first waypoint is where the arm rests; those of the stretch follow, and the last of them is `straight_from` (n,), where the
    stretch began.
    """
    if straight_from is None:
        return None
    turns = (waypoints - straight_from) / (2.0 * np.pi)
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
