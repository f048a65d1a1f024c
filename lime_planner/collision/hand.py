"""The hand alone against everything hard: what a tool pose says before any configuration of the arm is known."""

from __future__ import annotations

from typing import Any

from lime_planner.collision.fast import scan_body
from lime_planner.collision.point_contact import place
from lime_planner.core.jit import kernel


@kernel
def hand_clearances(shapes: Any, world: Any, scratch: Any, state: Any, frames: Any, need: float, clearances: Any) -> None:
    """Write the clearance of the gripper's body to everything hard for each of its placements.

    Args:
        shapes, world: the arm's bodies and the obstacles; scratch, state: memory of this thread.
        frames: (P, 3, 4) placements of the frame of the gripper's joint, in the planning frame.
        need: clearance of interest [m].
        clearances: (P,) written, exact near `need`, some value below it where the body is closer [m].
    """
    b = shapes.gripper
    for p in range(frames.shape[0]):
        for r in range(3):
            for c in range(4):
                scratch.poses[b, r, c] = frames[p, r, c]
        x, y, z = place(scratch.poses[b], shapes.bound[b])
        scratch.centres[b, 0] = x
        scratch.centres[b, 1] = y
        scratch.centres[b, 2] = z
        scan_body(world, shapes, scratch, b, True, need, need, False, state)
        clearances[p] = state.clear[b]
