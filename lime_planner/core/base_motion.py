"""Data that was taken in one place and is used in another: where it lies when the robot has driven on meanwhile.

Data is seen from the planning frame at its own stamp. What a fixed frame tells of the planning frame's way since then carries it to
where it is now; without a fixed frame such a way makes it stale.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.core.transform_history import NoTransform
from lime_planner.core.types import Array

#: Returns T_target_source (4, 4) of two frames, target first.
Find = Callable[[str, str], Array]

_AT_REST_M = 1e-4  #: a base that moved less has not moved: its transforms are measured too


@dataclass(frozen=True)
class Seen:
    """Where data lay at its stamp.

    Attributes:
        T_planning_data: (4, 4) its frame in the planning frame, at its stamp.
        reference: the frame by which the planning frame's own motion is told; empty where nothing can tell.
        T_reference_planning: (4, 4) the planning frame in that one, at the stamp; None without one.
        fixed: whether the reference was named as the fixed frame, so that the data stays where it was in it.
    """

    T_planning_data: Array
    reference: str = ""
    T_reference_planning: Array | None = None
    fixed: bool = False


def seen_at_stamp(find: Find, planning_frame: str, source: str, fixed_frame: str, anchor: str | None, *, complete: bool = False) -> Seen:
    """Note where data lay.

    Args:
        find: at the data's stamp.
        planning_frame: where it is needed.
        source: its own frame.
        fixed_frame: the frame in which it stays; empty for the planning frame.
        anchor: see `TransformHistory.anchor`; used without a fixed frame.
        complete: whether an anchor whose place is not known counts as a transform that is missing; otherwise it tells nothing.

    Raises:
        NoTransform: see `TransformHistory.find`.
    """
    T_planning_data = np.eye(4) if source == planning_frame else find(planning_frame, source)
    fixed = fixed_frame not in ("", planning_frame)
    reference = fixed_frame if fixed else anchor
    if not reference or reference == planning_frame:
        return Seen(T_planning_data)
    try:
        return Seen(T_planning_data, reference, find(reference, planning_frame), fixed)
    except NoTransform:
        if fixed or complete:
            raise
        return Seen(T_planning_data)


def motion_since(seen: Seen, find_now: Find, planning_frame: str, name: str, max_base_motion_m: float) -> Array | None:
    """Return where the planning frame of the stamp lies in that of now, T_now_then (4, 4); None where it has not moved.

    Args:
        seen: where the data lay.
        find_now: at the newest time.
        planning_frame: whose motion is asked for.
        name: of the data, for the sentence.
        max_base_motion_m: how far it may have moved without a fixed frame, see `base_motion_m`.

    Raises:
        Refusal: STALE_INPUT, it moved farther and there is no fixed frame.
        NoTransform: the fixed frame is not known now.
    """
    if seen.T_reference_planning is None:
        return None
    try:
        T_now_then = find_now(planning_frame, seen.reference) @ seen.T_reference_planning
    except NoTransform:
        if seen.fixed:
            raise
        return None
    moved_m = base_motion_m(T_now_then)
    if seen.fixed:
        return T_now_then if moved_m > _AT_REST_M else None
    if moved_m > max_base_motion_m:
        sentence = f"{planning_frame!r} has moved by {moved_m:.3f} m in {seen.reference!r} since the stamp of {name}"
        advice = f"the limit is {max_base_motion_m:g} m; fixed_frame: {seen.reference} keeps the data where it was there"
        raise Refusal(Status.STALE_INPUT, f"{sentence}, {advice}")
    return None


def base_motion_m(T: Array) -> float:
    """Return how far a rigid motion T (4, 4) carries a point within a metre of the origin, at most [m]."""
    turn = float(np.arccos(np.clip(0.5 * (np.trace(T[:3, :3]) - 1.0), -1.0, 1.0)))
    return float(np.linalg.norm(T[:3, 3])) + turn
