"""From what was received to what is planned with: crop, thin, drop stray leaf points, remove the arm from its own picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.types import Bool, Float32, Int32
from lime_planner.scene.arrays import blocking_of
from lime_planner.scene.scene import Scene
from lime_planner.scene.voxels import displacement, lonely, thin

#: Classes are left as they are up to these numbers of points, and thinned by the first of these voxels that gets them to about that
#: (the last one if none does). Stems and fruit stay fine: what they are displaced by is added to the radius of their points.
MAX_STEM_POINTS = 100_000
MAX_LEAF_POINTS = 150_000
STEM_VOXELS_M = (0.001, 0.002, 0.003)
LEAF_VOXELS_M = (0.002, 0.003, 0.004, 0.005, 0.006, 0.008)

#: What is no obstacle and only hides what is behind it.
MAX_BLOCKING_POINTS = 100_000
BLOCKING_VOXELS_M = (0.005, 0.01, 0.02)
FARTHEST_BLOCKING_M = 20.0

OUTLIER_RADIUS_M = 0.02
OUTLIER_NEIGHBOURS = 4


def clean_scene(
    scene: Scene,
    *,
    reach_m: float,
    base_position: npt.ArrayLike = (0.0, 0.0, 0.0),
    voxel_m: float = 0.01,
    max_leaf_points: int = MAX_LEAF_POINTS,
    max_stem_points: int = MAX_STEM_POINTS,
    outlier_neighbours: int = OUTLIER_NEIGHBOURS,
) -> Scene:
    """Crop a scene to the arm's reach, thin it to a size that can be planned with, and drop leaf points that stand alone.

    No stem point is ever an outlier: a thin twig would be one. Thinning keeps points of the cloud; how far a dropped one lies from
    the one that stands for it is in `stem_displacement_m` and `leaf_displacement_m` of the result, on top of what the scene had,
    and the radius of stem points must grow by it. A thinned leaf point has the highest permeability cost of those it stands for. Ground
    truth and target stay as they are; what was dropped is added to `counts` as `cropped`, `thinned_stem`, `thinned_leaf`,
    `outliers`.

    Args:
        scene: the scene as received.
        reach_m: farther from `base_position` than this the arm touches nothing, its own thickness included.
        base_position: (3,) [m].
        voxel_m: cell of the distance fields; leaves are not thinned more coarsely than this.
        max_leaf_points: thin the leaves above this number.
        max_stem_points: thin the stems above this number, and the fruit.
        outlier_neighbours: a leaf point with fewer others within 2 cm (a little more, along the diagonals) is dropped; 0 keeps all.

    Raises:
        SceneError: the reach or the voxel is out of range.
    """
    if not 0.0 < reach_m <= 1000.0:
        raise SceneError(f"reach_m: {reach_m} is outside 0 to 1000")
    if not 0.001 <= voxel_m <= 1.0:
        raise SceneError(f"voxel_m: {voxel_m} is outside 0.001 to 1")
    centre = np.asarray(base_position, dtype=np.float32)
    near = tuple(_within(points, centre, reach_m) for points in (scene.leaf_points, scene.stem_points, scene.fruit_points))
    cropped = _with_fewer_blocking(subset(scene, *near, reason="cropped"))

    stem_kept, _, stem_moved = _thin_below(cropped.stem_points, max_stem_points, STEM_VOXELS_M)
    fruit_kept, _, fruit_moved = _thin_below(cropped.fruit_points, max_stem_points, STEM_VOXELS_M)
    leaf_voxels_m = tuple(edge for edge in LEAF_VOXELS_M if edge <= voxel_m) or (voxel_m,)
    leaf_kept, stands_for, leaf_moved = _thin_below(cropped.leaf_points, max_leaf_points, leaf_voxels_m)
    leaf_costs = cropped.leaf_costs[leaf_kept]
    if stands_for is not None and (cropped.leaf_costs != 1.0).any():
        np.maximum.at(leaf_costs, stands_for, cropped.leaf_costs)
    points = cropped.leaf_points[leaf_kept]
    stray = lonely(points, OUTLIER_RADIUS_M, outlier_neighbours) if outlier_neighbours else np.zeros(len(points), dtype=np.bool_)
    final = leaf_kept[~stray]
    counts = dict(cropped.counts)
    _add(counts, "thinned_leaf", len(cropped.leaf_points) - len(leaf_kept))
    _add(counts, "thinned_stem", cropped.n_points - len(cropped.leaf_points) - len(stem_kept) - len(fruit_kept))
    _add(counts, "outliers", int(stray.sum()))
    return dataclasses.replace(
        cropped,
        leaf_points=points[~stray],
        leaf_costs=leaf_costs[~stray],
        stem_points=cropped.stem_points[stem_kept],
        fruit_points=cropped.fruit_points[fruit_kept],
        leaf_ids=_taken(cropped.leaf_ids, final),
        leaf_view_ids=_taken(cropped.leaf_view_ids, final),
        stem_view_ids=_taken(cropped.stem_view_ids, stem_kept),
        fruit_view_ids=_taken(cropped.fruit_view_ids, fruit_kept),
        counts=counts,
        stem_displacement_m=scene.stem_displacement_m + max(stem_moved, fruit_moved),
        leaf_displacement_m=scene.leaf_displacement_m + leaf_moved,
    )


def remove_arm(scene: Scene, distance_to_arm: Callable[[Float32], npt.NDArray[np.floating]], padding_m: float) -> Scene:
    """Drop the points that are the arm itself as its camera saw it, counted as `on_arm`.

    Args:
        scene: a live cloud, in the planning frame.
        distance_to_arm: from points (N, 3) [m] to their distances (N,) [m] from the arm's exact surface where it stood when the
            cloud was taken, negative inside.
        padding_m: points nearer than this are the arm's.

    Raises:
        SceneError: the padding is not a finite number of at least 0.
    """
    if not (np.isfinite(padding_m) and padding_m >= 0.0):
        raise SceneError(f"padding_m: {padding_m} is below its limit 0")
    sizes = (len(scene.leaf_points), len(scene.stem_points), len(scene.fruit_points))
    distances = np.asarray(distance_to_arm(np.concatenate([scene.leaf_points, scene.stem_points, scene.fruit_points])))
    kept = np.split(distances >= padding_m, np.cumsum(sizes)[:2])
    return subset(scene, kept[0], kept[1], kept[2], reason="on_arm")


def _within(points: Float32, centre: Float32, reach_m: float) -> Bool:
    offset = points - centre
    # A point beyond 1e19 m overflows to infinity here, which is out of reach as well.
    with np.errstate(over="ignore"):
        return np.asarray(np.einsum("ij,ij->i", offset, offset) <= np.float32(reach_m) ** 2)


def subset(scene: Scene, leaf: Bool, stem: Bool, fruit: Bool, *, reason: str) -> Scene:
    """Return a scene of some of its points, (N,), (M,) and (K,) by class; the others are counted under `reason`.

    The others still hide what is behind them: those of known viewpoints join the blocking points.
    """
    counts = dict(scene.counts)
    blocking, by = scene.blocking_points, scene.blocking_view_ids
    classes = ((scene.leaf_points, scene.leaf_view_ids, leaf), (scene.stem_points, scene.stem_view_ids, stem))
    for points, ids, kept in (*classes, (scene.fruit_points, scene.fruit_view_ids, fruit)):
        if ids is not None and not kept.all():
            blocking, by = blocking_of(blocking, by, points[~kept], ids[~kept])
    _add(counts, reason, scene.n_points - int(leaf.sum()) - int(stem.sum()) - int(fruit.sum()))
    return dataclasses.replace(
        scene,
        leaf_points=scene.leaf_points[leaf],
        leaf_costs=scene.leaf_costs[leaf],
        stem_points=scene.stem_points[stem],
        fruit_points=scene.fruit_points[fruit],
        leaf_ids=_taken(scene.leaf_ids, leaf),
        leaf_view_ids=_taken(scene.leaf_view_ids, leaf),
        stem_view_ids=_taken(scene.stem_view_ids, stem),
        fruit_view_ids=_taken(scene.fruit_view_ids, fruit),
        blocking_points=blocking,
        blocking_view_ids=by,
        counts=counts,
    )


def _with_fewer_blocking(scene: Scene) -> Scene:
    """Thin what is no obstacle and hides something: a camera's picture of the room."""
    points, ids = scene.blocking_points, scene.blocking_view_ids
    if points is None or ids is None or len(points) <= MAX_BLOCKING_POINTS:
        return scene
    near = _within(points, np.zeros(3, np.float32), FARTHEST_BLOCKING_M)
    points, ids = points[near], ids[near]
    kept = _thin_below(points, MAX_BLOCKING_POINTS, BLOCKING_VOXELS_M)[0]
    return dataclasses.replace(scene, blocking_points=points[kept], blocking_view_ids=ids[kept])


def _taken(column: npt.NDArray[Any] | None, which: npt.NDArray[Any]) -> npt.NDArray[Any] | None:
    return None if column is None else column[which]


def _add(counts: dict[str, int], reason: str, n: int) -> None:
    counts[reason] = counts.get(reason, 0) + n


def _thin_below(points: Float32, limit: int, voxels_m: tuple[float, ...]) -> tuple[Int32, Int32 | None, float]:
    """Return the kept indices, the kept point that stands for each point (None: itself), and the largest displacement [m]."""
    if len(points) <= limit:
        return np.arange(len(points), dtype=np.int32), None, 0.0
    kept, stands_for = thin(points, voxels_m[0])
    trial, chosen_m = points[kept], voxels_m[0]
    for edge_m in voxels_m[1:]:
        if len(trial) <= limit:
            break
        # Counted on what the finer voxel kept, a fraction of the work; done on all points, for the smaller displacement.
        trial, chosen_m = trial[thin(trial, edge_m)[0]], edge_m
    if chosen_m != voxels_m[0]:
        kept, stands_for = thin(points, chosen_m)
    return kept, stands_for, displacement(points, kept, stands_for)
