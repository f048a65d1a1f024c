"""A caller's arrays, taken as points, labels and columns of one cloud, or refused in a sentence that names the field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Bool, Float32, Int16

#: Points that are rounded to this or more are not where they were measured, beside margins of millimetres.
_COARSE_M = 0.0005


def numbers(name: str, value: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return numbers in the type that they have, whatever their shape.

    Args:
        name: of the field, for the sentence.
        value: numbers.

    Raises:
        SceneError: they are something else: text, dates, complex numbers, records.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise SceneError(f"{name}: cannot be read as numbers ({error})") from error
    if array.dtype.kind not in "biuf" and array.size:
        raise SceneError(f"{name}: of type {array.dtype}, expected numbers")
    return array


def frozen(name: str, value: Any, dtype: Any, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Copy numbers to a read-only array.

    Args:
        name: of the field, for the sentence.
        value: numbers.
        dtype: type of the result.
        shape: of the result; -1 for any length.

    Raises:
        SceneError: they are something else, of another shape, or not finite.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        array = np.array(numbers(name, value), dtype=dtype, order="C")
    if array.size == 0 and shape[0] == -1 and array.ndim == 1:
        array = array.reshape(0, *shape[1:])
    if array.ndim != len(shape) or any(want not in (-1, got) for want, got in zip(shape, array.shape, strict=True)):
        raise SceneError(f"{name}: shape {array.shape}, expected {str(shape).replace('-1', 'N')}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise SceneError(f"{name}: {int((~np.isfinite(array)).sum())} numbers are not finite")
    array.flags.writeable = False
    return array


def points_of(name: str, value: npt.ArrayLike) -> Float32:
    """Return points (N, 3) float32 [m]; those beyond float32 become infinite, and are left out as not finite by the caller.

    Args:
        name: of the field, for the sentence.
        value: numbers.

    Raises:
        SceneError: they are something else, or of another shape.
    """
    with np.errstate(over="ignore"):
        array = np.asarray(numbers(name, value), dtype=np.float32)
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise SceneError(f"{name}: shape {array.shape}, expected (N, 3)")
    return array


def seen_from(viewpoints: npt.ArrayLike, view_ids: npt.ArrayLike | None, n: int) -> Int16:
    """Return the number of each point's viewpoint, (n,).

    Args:
        viewpoints: (V, 3).
        view_ids: (n,) integers; may be left out where there is one viewpoint.
        n: the number of points.

    Raises:
        SceneError: they do not fit, or there are several viewpoints and no numbers.
    """
    n_views = len(points_of("viewpoints", viewpoints))
    if view_ids is None:
        if n_views != 1:
            raise SceneError(f"view_ids: missing; there are {n_views} viewpoints")
        return np.zeros(n, np.int16)
    ids = column("view_ids", view_ids, n)
    if ids.dtype.kind not in "iu" or (n and not -1 <= int(ids.min()) <= int(ids.max()) < min(n_views, 32_768)):
        raise SceneError(f"view_ids: expected integers from -1 to {min(n_views, 32_768) - 1}, one of {n_views} viewpoints or none")
    return ids.astype(np.int16)


def view_ids_of(ids: Int16 | None, n: int) -> Int16:
    """Return the numbers of the viewpoints of n points, -1 where there are none."""
    return np.full(n, -1, np.int16) if ids is None else ids


def blocking_of(
    given: npt.ArrayLike | None, given_ids: npt.ArrayLike | None, more: Float32, more_ids: Int16 | None
) -> tuple[Float32 | None, Int16 | None]:
    """Put together what cameras saw and what is no obstacle: points (B, 3) and the number of each one's viewpoint (B,), or two Nones.

    Args:
        given, given_ids: such points as they came, or None.
        more, more_ids: further points (M, 3), (M,); those of no known viewpoint, or without any, are left out.

    Raises:
        SceneError: points and numbers do not fit.
    """
    points, ids = np.empty((0, 3), np.float32), np.empty(0, np.int16)
    if given is not None:
        points = points_of("blocking_points", given)
        ids = column("blocking_view_ids", () if given_ids is None else given_ids, len(points)).astype(np.int16)
        finite = finite_rows(points)
        points, ids = points[finite], ids[finite]
    if more_ids is not None:
        known = more_ids >= 0
        points, ids = np.concatenate([points, more[known]]), np.concatenate([ids, more_ids[known]])
    return (points, ids) if len(points) else (None, None)


def precision_note(points: npt.NDArray[Any], scale: float = 1.0) -> tuple[str, ...]:
    """Say that coordinates are too large for their single precision, if they are.

    Args:
        points: (N, 3), as they came.
        scale: metres for each of their units.

    Returns:
        One sentence, or none.
    """
    if points.dtype.kind != "f" or points.dtype.itemsize > 4 or not len(points):
        return ()
    some = np.abs(points[:: len(points) // 1000 + 1]).max(axis=1)  # of stray points a few may lie anywhere
    typical = float(np.median(some[np.isfinite(some)])) if np.isfinite(some).any() else 0.0
    step_m = float(np.spacing(np.float32(typical))) * scale
    if step_m < _COARSE_M:
        return ()
    sentence = f"coordinates of {typical:.0f} in single precision are {1e3 * step_m:.2g} mm apart"
    return (f"{sentence}: write them in double precision, or from an origin nearby",)


def finite_rows(points: npt.NDArray[np.floating]) -> Bool:
    """Return which points (N, 3) are finite, (N,)."""
    ok = np.isfinite(points)
    return np.asarray(ok[:, 0] & ok[:, 1] & ok[:, 2])  # three times as fast as all(axis=1)


def any_of(labels: npt.NDArray[Any], wanted: Sequence[int]) -> Bool:
    """Return which labels (N,) are one of those that are wanted, (N,)."""
    # A comparison for each label; np.isin takes ten times as long on the few that there are.
    found = np.zeros(len(labels), dtype=bool)
    for label in wanted:
        found |= labels == label
    return found


def column(name: str, value: npt.ArrayLike, n: int) -> npt.NDArray[Any]:
    """Return one number for each of n points, (n,).

    Args:
        name: of the field, for the sentence.
        value: numbers, (n,) or (n, 1).
        n: the number of points.

    Raises:
        SceneError: there are more or fewer.
    """
    array = np.asarray(value)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.shape != (n,):
        raise SceneError(f"{name}: shape {array.shape}, expected ({n},), one for each point")
    return array


def whole_labels(value: npt.ArrayLike, counted: Bool) -> npt.NDArray[Any]:
    """Return labels (N,), all whole numbers where they count; in a float field they are accepted, as some writers know no integers.

    Args:
        value: a label for each point.
        counted: (N,) which points can be used; what the others carry is of no account.

    Raises:
        SceneError: a label is no whole number, or there are more or fewer.
    """
    array = column("labels", value, len(counted))
    if array.dtype.kind not in "iubf":
        raise SceneError(f"labels: of type {array.dtype}, expected integers")
    if array.dtype.kind == "f":
        whole = np.isfinite(array) & (array == np.trunc(array))
        broken = np.flatnonzero(counted & ~whole)
        if len(broken):
            raise SceneError(
                f"labels: {len(broken)} are not whole numbers, the first ({array[broken[0]]:g}) at point {broken[0]} (counted from 0)"
            )
        array = np.where(whole, array, 0.0) if not whole.all() else array
    return array
