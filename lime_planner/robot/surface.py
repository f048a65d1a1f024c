"""How far points are from the arm's own surface, by its undecimated meshes: what a camera saw of the arm is not an obstacle."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.robot.model import Robot

Array = npt.NDArray[np.float64]

#: Points farther from the arm than this are reported as this far: nobody asks [m].
FAR_M = 0.15


class ArmSurface:
    """The arm's collision meshes, one body for each joint, ready for distance queries. Building takes some 0.1 s."""

    def __init__(self, robot: Robot) -> None:
        """Build one search tree for each body.

        Args:
            robot: the arm.
        """
        import open3d

        self._robot = robot
        self._bodies: list[tuple[int, Any, Array, Array]] = []
        for joint in sorted({link.joint for link in robot.links}):
            links = [link for link in robot.links if link.joint == joint]
            scene = open3d.t.geometry.RaycastingScene(nthreads=1)
            for link in links:
                scene.add_triangles(link.vertices.astype(np.float32), link.triangles.astype(np.uint32))
            vertices = np.concatenate([link.vertices for link in links])
            self._bodies.append((joint, scene, vertices.min(axis=0), vertices.max(axis=0)))

    def distance(self, points: npt.ArrayLike, q: npt.ArrayLike) -> Array:
        """Return each point's distance from the nearest surface of the arm [m], negative inside, at most `FAR_M`.

        Args:
            points: (N, 3) [m], in the planning frame.
            q: configuration, (n,) [rad].
        """
        cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        distances = np.full(len(cloud), FAR_M)
        poses = self._robot.link_poses(q)
        for joint, scene, low, high in self._bodies:
            rotation, translation = poses[joint, :3, :3], poses[joint, :3, 3]
            # A ball around the body first: most of a plant is far from most of the arm.
            middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) + FAR_M
            offset = cloud - (rotation @ middle + translation)
            near = np.flatnonzero(np.einsum("ij,ij->i", offset, offset) <= radius**2)
            local = ((cloud[near] - translation) @ rotation).astype(np.float32)
            boxed = np.flatnonzero(((local >= low - FAR_M) & (local <= high + FAR_M)).all(axis=1))
            if not len(boxed):
                continue
            queried = local[boxed]
            found = scene.compute_distance(queried).numpy().astype(np.float64)
            inside = scene.compute_occupancy(queried, nsamples=3).numpy() > 0.5
            index = near[boxed]
            distances[index] = np.minimum(distances[index], np.where(inside, -found, found))
        return distances
