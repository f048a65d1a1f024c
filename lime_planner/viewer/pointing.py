"""What stands under the pointer: which leaf, stem, lime or link of the arm, and what the plan does to it."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any
from urllib.parse import parse_qs

import numpy as np

from lime_planner.core.quick_open3d import open3d
from lime_planner.core.types import Array, Float32
from lime_planner.output.timeline import Timeline
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

_WIDTH_M = 0.006  # a point is hit by a ray that passes it this near
_EPSILON = 1e-12


@dataclass(frozen=True)
class Ray:
    """A line of sight.

    Attributes:
        origin: (3,) [m].
        direction: (3,) of length one.
    """

    origin: Array
    direction: Array

    @classmethod
    def through(cls, origin: Array, direction: Array) -> Ray:
        """Return the ray from a point (3,) [m] along a direction (3,) of any length but 0."""
        origin, direction = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
        return cls(origin, direction / max(float(np.linalg.norm(direction)), _EPSILON))

    @classmethod
    def read(cls, query: str) -> Ray | None:
        """Return the ray of `ray=x,y,z,x,y,z` (origin [m], direction) in an address, None where there is none in it."""
        try:
            numbers = np.array([float(word) for word in parse_qs(query).get("ray", [""])[0].split(",")])
        except ValueError:
            return None
        if numbers.shape != (6,) or not np.isfinite(numbers).all() or np.linalg.norm(numbers[3:]) < _EPSILON:
            return None
        return cls.through(numbers[:3], numbers[3:])


@dataclass(frozen=True)
class Named:
    """The first thing on a ray.

    Attributes:
        kind: `leaf`, `stem`, `lime` or `arm`.
        title: its name.
        sentence: where it is, and what the plan does to it.
    """

    kind: str
    title: str
    sentence: str

    def json(self) -> str:
        """Return title and sentence for the browser."""
        return json.dumps({"title": self.title, "sentence": self.sentence})


class Pointing:
    """Names what is drawn of one plant, and the arm in front of it; from any thread."""

    def __init__(self, scene: Scene, *, reach_m: float) -> None:
        """Take a plant in.

        Args:
            scene: the plant.
            reach_m: what is farther than this from the arm's base is not drawn, and not named.
        """

        def near(points: Float32) -> Array:
            return np.asarray(np.linalg.norm(points, axis=-1) < reach_m)

        self._scene = scene
        self._leaf_points, self._stem_points = (np.flatnonzero(near(points)) for points in (scene.leaf_points, scene.stem_points))
        self._fruit_points = scene.fruit_points[near(scene.fruit_points)]
        has_leaves = scene.leaf_triangles is not None and len(scene.leaf_triangles)
        self._triangles = np.flatnonzero(near(scene.leaf_triangles[:, 0])) if has_leaves and scene.leaf_triangles is not None else None
        self._leaf_caster: Any = None
        self._lock = threading.Lock()

    def under(
        self,
        ray: Ray,
        *,
        timeline: Timeline | None = None,
        arm: tuple[Robot, Array] | None = None,
        shows: Callable[[str], bool] = lambda _: True,
    ) -> Named | None:
        """Return the first thing on a ray, None where it meets nothing.

        Args:
            ray: from the eye.
            timeline: of the plan that is shown, which knows what is touched when.
            arm: the robot and its configuration (n,) [rad].
            shows: tells whether `leaves`, `stems`, `limes` and `arm` are drawn.
        """
        scene = self._scene
        with self._lock:
            leaf_m, leaf = self._first_leaf(ray) if shows("leaves") else (np.inf, None)
            link_m, link = _first_link(*arm, ray) if arm is not None and shows("arm") else (np.inf, "")
        stem_m, stem = _first_point(scene.stem_points[self._stem_points], ray) if shows("stems") else (np.inf, -1)
        lime_m, lime = self._first_lime(ray) if shows("limes") else (np.inf, None)
        nearest = min(leaf_m, link_m, stem_m, lime_m)
        if not np.isfinite(nearest):
            return None
        place = "{:.2f} {:.2f} {:.2f} m".format(*(ray.origin + nearest * ray.direction))
        if nearest == link_m:
            return Named("arm", "Arm", f"Its link {link}.")
        if nearest == lime_m:
            return Named(
                "lime", "Lime" if lime is None else f"Lime {lime}", f"At {place}." + ("" if lime is None else " A click chooses it.")
            )
        if nearest == stem_m:
            return Named("stem", f"Stem point {self._stem_points[stem]}", f"At {place}. Never touched.")
        touched = None if timeline is None or leaf is None else _touched(scene, leaf, timeline)
        said = "" if timeline is None or leaf is None else touched or "The plan does not touch it."
        return Named("leaf", "Leaf" if leaf is None else f"Leaf {leaf}", f"At {place}. {said}".strip())

    def _first_leaf(self, ray: Ray) -> tuple[float, int | None]:
        """Return the distance along a ray to the first leaf, inf where none is, and its number where leaves are told apart."""
        scene = self._scene
        if self._triangles is None or scene.leaf_triangles is None:
            along, point = _first_point(scene.leaf_points[self._leaf_points], ray)
            return along, None if point < 0 or scene.leaf_ids is None else int(scene.leaf_ids[self._leaf_points[point]])
        if self._leaf_caster is None:
            corners = scene.leaf_triangles[self._triangles].reshape(-1, 3)
            self._leaf_caster = _caster(corners, np.arange(len(corners)).reshape(-1, 3))
        along, triangle = _cast(self._leaf_caster, ray.origin, ray.direction)
        if not np.isfinite(along) or scene.leaf_triangle_ids is None:
            return along, None
        return along, int(scene.leaf_triangle_ids[self._triangles[triangle]])

    def _first_lime(self, ray: Ray) -> tuple[float, int | None]:
        """Return the distance along a ray to the first lime, inf where none is, and its number where limes are told apart."""
        scene = self._scene
        if scene.fruit_centres is None or scene.fruit_radii is None or not len(scene.fruit_centres):
            return _first_point(self._fruit_points, ray)[0], None
        apart = scene.fruit_centres.astype(np.float64) - ray.origin
        along = apart @ ray.direction
        inside = scene.fruit_radii.astype(np.float64) ** 2 - np.sum(apart**2, axis=1) + along**2
        along = np.where(inside >= 0.0, along - np.sqrt(np.maximum(inside, 0.0)), np.inf)
        along = np.where(along > 0.0, along, np.inf)
        first = int(along.argmin())
        return float(along[first]), first


def _first_point(points: Float32, ray: Ray) -> tuple[float, int]:
    """Return the distance along a ray to the first of some points (N, 3) that it passes closely, inf where none is, and its number."""
    if not len(points):
        return np.inf, -1
    apart = points - ray.origin
    along = apart @ ray.direction
    off = np.linalg.norm(apart - along[:, None] * ray.direction, axis=1)
    along = np.where((off < _WIDTH_M) & (along > 0.0), along, np.inf)
    first = int(along.argmin())
    return float(along[first]), first


def _caster(vertices: Any, triangles: Any) -> Any:
    """Make a mesh ready for rays."""
    o3d = open3d()

    caster = o3d.t.geometry.RaycastingScene(nthreads=1)
    caster.add_triangles(np.ascontiguousarray(vertices, dtype=np.float32), np.ascontiguousarray(triangles, dtype=np.uint32))
    return caster


def _cast(caster: Any, origin: Array, direction: Array) -> tuple[float, int]:
    """Return the distance to where a ray meets a mesh, inf where it does not, and the triangle's number."""
    met = caster.cast_rays(np.concatenate([origin, direction]).astype(np.float32)[None])
    return float(met["t_hit"].numpy()[0]), int(met["primitive_ids"].numpy()[0])


@cache
def _link_casters(robot: Robot) -> tuple[tuple[str, int, Any], ...]:
    """Return name, joint and mesh of each link."""
    return tuple((link.name, link.joint, _caster(link.vertices, link.triangles)) for link in robot.links if len(link.triangles))


def _first_link(robot: Robot, q: Array, ray: Ray) -> tuple[float, str]:
    """Return the distance along a ray to the arm, inf where it passes it, and the link's name."""
    poses, first = robot.link_poses(q), (np.inf, "")
    for name, joint, caster in _link_casters(robot):
        R, t = poses[joint][:3, :3], poses[joint][:3, 3]
        first = min(first, (_cast(caster, R.T @ (ray.origin - t), R.T @ ray.direction)[0], name))
    return first


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
