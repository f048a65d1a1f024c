"""Paths and plans on the turns that the driver reports: it may count them anew, or report continuous joints within one."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from lime_planner.core.geometry import whole_turns
from lime_planner.core.types import Array, Bool
from lime_planner.pipeline.result import PlanResult
from lime_planner.ros.execution.retreat import nearest_on_path


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


def on_turns_of(result: PlanResult, q: Array, continuous: Bool) -> PlanResult:
    """Return a plan shifted by whole turns next to where the arm is, (n,) [rad]: its driver may report other turns by now."""
    if result.trajectory is None:
        return result
    turns = whole_turns(q - result.trajectory.positions[0], continuous)
    if not turns.any():
        return result
    trajectory = dataclasses.replace(result.trajectory, positions=result.trajectory.positions + turns)
    return dataclasses.replace(result, waypoints=result.waypoints + turns, trajectory=trajectory)
