"""Poses between their two forms: position and quaternion as in messages and files, and homogeneous matrices."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array, Bool
from lime_planner.core.validation import floats


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


def matrix_to_pose(T: npt.ArrayLike) -> Array:
    """Turn a 4 x 4 matrix into x y z qx qy qz qw [m, -], (7,); a stack of them (K, 4, 4) into (K, 7)."""
    matrix = np.asarray(T, dtype=np.float64)
    return np.concatenate([matrix[..., :3, 3], Rotation.from_matrix(matrix[..., :3, :3]).as_quat()], axis=-1)


def whole_turns(difference: Array, continuous: Bool) -> Array:
    """Return the whole turns nearest a difference of configurations, 0 for joints that have an end; all three (n,) [rad]."""
    return np.where(continuous, 2.0 * np.pi * np.round(difference / (2.0 * np.pi)), 0.0)
