"""What a camera saw of the arm is no obstacle: points close to its undecimated meshes, where it stood then, are removed from a cloud."""

from __future__ import annotations

import dataclasses
import functools
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.quick_open3d import open3d
from lime_planner.core.types import Array, Float32
from lime_planner.robot.model import Robot
from lime_planner.scene.clean import clean_scene, remove_arm
from lime_planner.scene.from_clouds import ArmFilter
from lime_planner.scene.scene import Scene

#: Points farther from the arm than this are reported as this far: no filter asks for more [m].
FAR_M = 0.15
#: Points of one query. Open3D keeps Python's lock meanwhile; a service that waits for it gets its turn between two queries.
_PART = 2000


class ArmSurface:
    """The arm's collision meshes, one body for each joint, for distance queries. The first one takes some 0.4 s more: Open3D, and trees."""

    def __init__(self, robot: Robot) -> None:
        """Keep the arm.

        Args:
            robot: the arm.
        """
        self._robot = robot

    @functools.cached_property
    def _bodies(self) -> list[tuple[int, Any, Array, Array]]:
        """Joint, search tree, and both corners of each body; made when first asked for, so that a node that only waits stays small."""
        o3d = open3d()
        bodies = []
        for joint in sorted({link.joint for link in self._robot.links}):
            links = [link for link in self._robot.links if link.joint == joint]
            scene = o3d.t.geometry.RaycastingScene(nthreads=1)
            for link in links:
                scene.add_triangles(link.vertices.astype(np.float32), link.triangles.astype(np.uint32))
            vertices = np.concatenate([link.vertices for link in links])
            bodies.append((joint, scene, vertices.min(axis=0), vertices.max(axis=0)))
        return bodies

    def distance(self, points: npt.ArrayLike, q: npt.ArrayLike, *, within_m: float = FAR_M, unsigned_below_m: float = 0.0) -> Array:
        """Return each point's distance from the nearest surface of the arm [m], negative inside, at most `within_m`.

        Args:
            points: (N, 3) [m], in the planning frame.
            q: configuration, (n,) [rad].
            within_m: farther points are reported as this far; the less, the quicker.
            unsigned_below_m: points this close to the surface are not asked on which side they are, which takes most of the time.
        """
        cloud = np.asarray(points, dtype=np.float32).reshape(-1, 3)
        distances = np.full(len(cloud), within_m)
        poses = self._robot.link_poses(q)
        for joint, scene, low, high in self._bodies:
            rotation, translation = poses[joint, :3, :3], poses[joint, :3, 3]
            # A ball around the body first: most of a plant is far from most of the arm.
            middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) + within_m
            offset = cloud - (rotation @ middle + translation).astype(np.float32)
            near = np.flatnonzero(np.einsum("ij,ij->i", offset, offset) <= radius**2)
            local = ((cloud[near] - translation) @ rotation).astype(np.float32)
            boxed = ((local >= low - within_m) & (local <= high + within_m)).all(axis=1)
            index, queried = near[boxed], local[boxed]
            if not len(index):
                continue
            for begin in range(0, len(index), _PART):
                part = slice(begin, begin + _PART)
                distances[index[part]] = np.minimum(distances[index[part]], _signed(scene, queried[part], low, high, unsigned_below_m))
        return distances


def _signed(scene: Any, points: Float32, low: Array, high: Array, unsigned_below_m: float) -> Array:
    """Distances of points (N, 3) from the surface of one body with the box `low` to `high`, negative inside where farther than given."""
    found = scene.compute_distance(points).numpy().astype(np.float64)
    inside = np.asarray(((points > low) & (points < high)).all(axis=1))  # who is outside the box is outside the body
    inside &= found >= unsigned_below_m
    if inside.any():
        inside[inside] = scene.compute_occupancy(points[inside], nsamples=3).numpy() > 0.5
    return np.asarray(np.where(inside, -found, found), dtype=np.float64)


_BEYOND_REACH_M = 0.1  #: what the arm's surface and the margins may reach beyond its reach
_SLACK_M = 0.001


def make_arm_filter(robot: Robot) -> ArmFilter:
    """Return the filter for one arm."""
    surface = ArmSurface(robot)

    def remove(scene: Scene, q: Array | None, padding_m: float, /, *, base_position: Array | None = None) -> Scene:
        centre = np.zeros(3) if base_position is None else base_position
        scene = clean_scene(scene, reach_m=robot.reach_m + _BEYOND_REACH_M, base_position=centre)
        if q is None:
            # Taken before the first joint state: where the arm was is unknown. Its points stay, as obstacles.
            return dataclasses.replace(scene, counts={**scene.counts, "arm_not_removed": scene.n_points})
        if base_position is None:
            scene = dataclasses.replace(scene, stood=q[None])
        return remove_arm(scene, partial(surface.distance, q=q, within_m=padding_m + _SLACK_M, unsigned_below_m=padding_m), padding_m)

    return remove
