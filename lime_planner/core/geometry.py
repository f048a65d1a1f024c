"""Poses as position and quaternion (messages, files) and as homogeneous matrices, turns of joints, and frames connected by transforms."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array, Bool
from lime_planner.core.validation import floats


def sphere_directions(count: int) -> Array:
    """Return unit vectors (count, 3) spread evenly over the sphere, a Fibonacci lattice."""
    at = np.arange(count) + 0.5
    height, turn = 1.0 - 2.0 * at / count, np.pi * (1.0 + np.sqrt(5.0)) * at
    flat = np.sqrt(1.0 - height * height)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])


def unit(vectors: Array) -> Array:
    """Return vectors (..., n) at length one; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


def pose_to_matrix(pose: npt.ArrayLike) -> Array:
    """Turn x y z qx qy qz qw [m, -] into a 4 x 4 matrix.

    Args:
        pose: (7,), the quaternion of any length above 1e-6 or so (it is normalised).

    Raises:
        ProblemError: not seven finite numbers, or a quaternion of length zero.
    """
    values = floats("a pose", pose)
    if values.shape != (7,):
        raise ProblemError(f"a pose needs 7 numbers x y z qx qy qz qw, got shape {values.shape}")
    if not np.isfinite(values).all():
        raise ProblemError(f"the pose has a number that is not finite: {values.tolist()}")
    largest = float(np.abs(values[3:]).max())
    if largest < 1e-6:
        raise ProblemError(f"the quaternion has length {float(np.linalg.norm(values[3:])):.1e}; it must describe a rotation")
    matrix = np.eye(4)
    # Divided by its largest number first: the squares of very large ones overflow.
    matrix[:3, :3] = Rotation.from_quat(values[3:] / largest).as_matrix()
    matrix[:3, 3] = values[:3]
    return matrix


def quaternion_doubt(pose: npt.ArrayLike) -> str:
    """Return a sentence where the quaternion of x y z qx qy qz qw is far from unit length, as no rounding makes it; else an empty text."""
    values = np.asarray(pose, dtype=np.float64).reshape(-1)[3:]
    length = math.hypot(*values)
    if not math.isfinite(length) or abs(length - 1.0) <= 0.02:
        return ""
    numbers = " ".join(f"{value:g}" for value in values)
    return f"the quaternion {numbers} has the length {length:.3g}, not 1: are its numbers in the order x y z w?"


def matrix_to_pose(T: npt.ArrayLike) -> Array:
    """Turn a 4 x 4 matrix into x y z qx qy qz qw [m, -], (7,); a stack of them (K, 4, 4) into (K, 7)."""
    matrix = np.asarray(T, dtype=np.float64)
    return np.concatenate([matrix[..., :3, 3], Rotation.from_matrix(matrix[..., :3, :3]).as_quat()], axis=-1)


def whole_turns(difference: Array, continuous: Bool) -> Array:
    """Return the whole turns nearest a difference of configurations, 0 for joints that have an end; all three (n,) [rad]."""
    return np.where(continuous, 2.0 * np.pi * np.round(difference / (2.0 * np.pi)), 0.0)


def clean_name(frame: str) -> str:
    """Return a frame's name without the leading slash of old publishers."""
    return frame.strip().lstrip("/")


class TransformTree:
    """Which frame lies where, seen from which other."""

    def __init__(self) -> None:
        """Start without any frame."""
        self._neighbours: dict[str, dict[str, Array]] = {}

    @property
    def frames(self) -> list[str]:
        """The names of all frames, sorted."""
        return sorted(self._neighbours)

    def add(self, parent: str, child: str, T_parent_child: npt.ArrayLike) -> None:
        """Add a transform (4, 4) [m], or replace the one between these two frames."""
        T = np.asarray(T_parent_child, dtype=np.float64)
        parent, child = clean_name(parent), clean_name(child)
        self._neighbours.setdefault(parent, {})[child] = T
        self._neighbours.setdefault(child, {})[parent] = np.asarray(np.linalg.inv(T), dtype=np.float64)

    def find(self, target: str, source: str) -> Array | None:
        """Return T_target_source (4, 4), or None where no chain connects them."""
        target, source = clean_name(target), clean_name(source)
        reached = {target: np.eye(4)}
        front = [target]
        while front and source not in reached:
            following = []
            for frame in front:
                for neighbour, T_frame_neighbour in self._neighbours.get(frame, {}).items():
                    if neighbour not in reached:
                        reached[neighbour] = reached[frame] @ T_frame_neighbour
                        following.append(neighbour)
            front = following
        return reached.get(source)
