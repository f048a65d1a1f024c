"""What a click in the scene meets: which leaf, or a stem, and what the plan does to it."""

from __future__ import annotations

import numpy as np

from lime_planner.core.types import Array, Float32
from lime_planner.output.timeline import Timeline
from lime_planner.scene.scene import Scene

_WIDTH_M = 0.006  # a point is hit by a ray that passes it this near
_EPSILON = 1e-12


def what_is_under(scene: Scene, origin: Array, direction: Array, timeline: Timeline | None) -> tuple[str, str] | None:
    """Return title and sentence about the first thing on a ray, None where it meets nothing, or a lime.

    Args:
        scene: the plant.
        origin, direction: (3,) of the ray [m].
        timeline: of the plan that is shown, which knows what is touched when.
    """
    direction = direction / max(float(np.linalg.norm(direction)), _EPSILON)
    fruit_m, _ = _first_point(scene.fruit_points, origin, direction)
    stem_m, stem = _first_point(scene.stem_points, origin, direction)
    leaf_m, leaf = _first_leaf(scene, origin, direction)
    nearest = min(fruit_m, stem_m, leaf_m)
    if not np.isfinite(nearest) or nearest == fruit_m:
        return None
    place = "{:.2f} {:.2f} {:.2f} m".format(*(origin + nearest * direction))
    if nearest == stem_m:
        return f"Stem point {stem}", f"At {place}. Never touched."
    title = f"Leaf {leaf}" if leaf is not None else "Leaf"
    touched = None if timeline is None or leaf is None else _touched(scene, leaf, timeline)
    return title, f"At {place}. {touched or 'The plan does not touch it.' if timeline is not None else ''}".strip()


def _first_point(points: Array | Float32, origin: Array, direction: Array) -> tuple[float, int]:
    """Return the distance along a ray to the first of some points (N, 3) that it passes closely, inf where none is, and its number."""
    if not len(points):
        return np.inf, -1
    apart = points - origin
    along = apart @ direction
    off = np.linalg.norm(apart - along[:, None] * direction, axis=1)
    along = np.where((off < _WIDTH_M) & (along > 0.0), along, np.inf)
    first = int(along.argmin())
    return float(along[first]), first


def _first_leaf(scene: Scene, origin: Array, direction: Array) -> tuple[float, int | None]:
    """Return the distance along a ray to the first leaf, inf where none is, and its number where leaves are told apart."""
    if scene.leaf_triangles is None or not len(scene.leaf_triangles):
        along, point = _first_point(scene.leaf_points, origin, direction)
        return along, None if point < 0 or scene.leaf_ids is None else int(scene.leaf_ids[point])
    import open3d as o3d

    caster = o3d.t.geometry.RaycastingScene(nthreads=1)
    corners = np.ascontiguousarray(scene.leaf_triangles, dtype=np.float32).reshape(-1, 3)
    caster.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    met = caster.cast_rays(np.concatenate([origin, direction]).astype(np.float32)[None])
    along = float(met["t_hit"].numpy()[0])  # inf where it meets none
    if not np.isfinite(along) or scene.leaf_triangle_ids is None:
        return along, None
    return along, int(scene.leaf_triangle_ids[int(met["primitive_ids"].numpy()[0])])


def _touched(scene: Scene, leaf: int, timeline: Timeline) -> str | None:
    """Say when a leaf is touched, None where it never is."""
    if scene.leaf_ids is None:
        return None
    which = scene.leaf_ids[timeline.leaf_points] == leaf
    at = np.flatnonzero(timeline.touched[:, which].any(axis=1))
    if not len(at):
        return None
    unit = "s" if timeline.timed else "rad"
    return f"The plan touches it from {timeline.times_s[at[0]]:.1f} to {timeline.times_s[at[-1]]:.1f} {unit}."
