"""The arm as a few hundred triangles, for displays that cannot take its meshes: each link's convex hull, in few directions."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from lime_planner.core.geometry import sphere_directions
from lime_planner.core.types import Array, Float32
from lime_planner.robot.meshes import LinkMesh
from lime_planner.robot.model import Robot

_DIRECTIONS = 48  #: in which a link's outermost vertex is kept

_HULLS: WeakKeyDictionary[LinkMesh, Array] = WeakKeyDictionary()


def arm_hull(robot: Robot, q: npt.ArrayLike) -> Float32:
    """Return the arm at a configuration as triangles (T, 3, 3) in the planning frame [m].

    Args:
        robot: the arm.
        q: (n,) [rad].
    """
    poses = robot.link_poses(q)
    parts = [_hull(link) @ poses[link.joint][:3, :3].T + poses[link.joint][:3, 3] for link in robot.links]
    return np.concatenate([np.zeros((0, 3, 3)), *parts]).astype(np.float32)


def _hull(link: LinkMesh) -> Array:
    """Return triangles (T, 3, 3) in the frame of the link's joint, computed once for each link."""
    from scipy.spatial import ConvexHull, QhullError

    kept = _HULLS.get(link)
    if kept is None:
        outermost = link.vertices[np.unique((link.vertices @ sphere_directions(_DIRECTIONS).T).argmax(axis=0))]
        try:
            kept = outermost[ConvexHull(outermost).simplices]
        except QhullError:  # a flat link
            kept = link.vertices[link.triangles]
        _HULLS[link] = kept
    return kept
