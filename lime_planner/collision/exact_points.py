"""Balls around cloud points against the arm's meshes: compiled code sorts out what is far, FCL decides the rest."""

from __future__ import annotations

from collections.abc import Callable
from weakref import WeakKeyDictionary

import numpy as np

from lime_planner.collision.exact_kernels import LinkBoxes, lower_bounds, make_blocks, near_points, winding_number
from lime_planner.collision.link_grids import HALF_DIAGONAL_M, LinkGrids, build_grids
from lime_planner.core.types import Array
from lime_planner.robot.meshes import LinkMesh, LinkObjects
from lime_planner.robot.model import Robot

_BOXES: WeakKeyDictionary[Robot, LinkBoxes] = WeakKeyDictionary()
_GRIDS: WeakKeyDictionary[Robot, LinkGrids] = WeakKeyDictionary()


def boxes_of(robot: Robot) -> LinkBoxes:
    """Return the bounds of a robot's links, computed once."""
    if robot not in _BOXES:
        corners = [_hull_corners(link) for link in robot.links]
        low = np.stack([link.vertices.min(axis=0) for link in robot.links])
        high = np.stack([link.vertices.max(axis=0) for link in robot.links])
        _BOXES[robot] = LinkBoxes(
            np.array([link.joint for link in robot.links], dtype=np.int64),
            np.array([link.gripper for link in robot.links], dtype=np.bool_),
            0.5 * (low + high),
            0.5 * (high - low),
            np.ascontiguousarray(np.concatenate(corners)),
            np.concatenate([[0], np.cumsum([len(c) for c in corners])]).astype(np.int64),
        )
    return _BOXES[robot]


def _hull_corners(link: LinkMesh) -> Array:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return link.vertices[ConvexHull(link.vertices).vertices]
    except QhullError:  # a flat mesh
        return link.vertices


def grids_of(robot: Robot, padding_m: float, should_stop: Callable[[], bool] = lambda: False) -> LinkGrids:
    """Return voxels around a robot's links that reach at least `padding_m` beyond them, computed once."""
    grids = _GRIDS.get(robot)
    if grids is None or grids.padding < padding_m - 1e-9:
        grids = _GRIDS[robot] = build_grids(robot.links, padding_m, should_stop)
    return grids


def winds_round(link: LinkMesh, point: Array) -> bool:
    """Tell whether a link's mesh, be it inside out, encloses a point (3,) in the joint's frame, by its winding number."""
    return bool(abs(winding_number(link.vertices, link.triangles, point[0], point[1], point[2])) > 0.5)


class PointTest:
    """A cloud of balls that the links of one robot may touch. Not for two threads at once."""

    def __init__(
        self,
        robot: Robot,
        points: Array,
        radius_m: float,
        spared_centre: Array | None,
        spared_radius_m: float,
        spared_heights_m: tuple[float, float] = (0.0, 0.0),
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Sort the cloud.

        Args:
            robot: the arm.
            points: (N, 3) in the planning frame [m].
            radius_m: radius of the balls.
            spared_centre: (3,) centre of the sphere whose points do not count for the gripper's links when asked so, or None.
            spared_radius_m: its radius.
            spared_heights_m: lowest and highest height over the centre of an upright segment, around which that radius holds.
            should_stop: cancels; voxels for a larger radius take seconds the first time.

        Raises:
            Refusal: CANCELLED.
        """
        import fcl

        self._fcl = fcl
        self._links = robot.links
        self._boxes = boxes_of(robot)
        self.blocks = make_blocks(points, radius_m, robot.reach_m)
        self._grids = grids_of(robot, self.blocks.largest + HALF_DIAGONAL_M, should_stop)
        self.spared = np.zeros(len(self.blocks.points), dtype=np.bool_)
        if spared_centre is not None:
            offset = self.blocks.points - spared_centre
            offset[:, 2] -= np.clip(offset[:, 2], *spared_heights_m)
            self.spared = np.linalg.norm(offset, axis=1) <= spared_radius_m
        self._meshes = LinkObjects(robot.links)
        self._collision, self._distance = fcl.CollisionRequest(), fcl.DistanceRequest()
        self._resize(4096)

    def first_hit(self, poses: Array, sparing: bool) -> tuple[int, Array] | None:
        """Return a link that touches a ball, as its index, and the ball's centre (3,); None if there is none.

        Args:
            poses: joint frames (n + 1, 3, 4).
            sparing: whether the spared points do not count for the gripper's links.
        """
        if len(self.blocks.points) == 0:
            return None
        arguments = (self._boxes, self._grids, poses, self.blocks, self.spared, sparing)
        count = near_points(*arguments, *self._buffers)
        if count > len(self._buffers[0]):
            self._resize(2 * count)
            count = near_points(*arguments, *self._buffers)
        links, points, gaps = (buffer[:count] for buffer in self._buffers)
        for k in np.argsort(gaps) if count > 1 else range(count):
            link, point = int(links[k]), self.blocks.points[points[k]]
            if gaps[k] == -np.inf or self._touches(poses, link, point, float(self.blocks.radii[points[k]])):
                return link, point
        return None

    def distance(self, poses: Array, sparing: bool) -> float:
        """Return the smallest distance between a link's surface and a ball [m]; see `ExactChecker.stem_distance`."""
        count = len(self.blocks.points)
        if count == 0:
            return float("inf")
        bound = np.empty((len(self._links), count))
        lower_bounds(self._boxes, self._grids, poses, self.blocks, self.spared, sparing, bound)
        bound -= self.blocks.radii
        if np.isposinf(bound.min()):
            return float("inf")
        best = self._gap(poses, *divmod(int(bound.argmin()), count), bound)
        candidates = np.flatnonzero(bound < best)
        for index in candidates[np.argsort(bound.flat[candidates])]:
            if bound.flat[index] >= best:
                break
            best = min(best, self._gap(poses, *divmod(int(index), count), bound))
        return best

    def _resize(self, size: int) -> None:
        self._buffers = (np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64), np.empty(size))

    def _local(self, poses: Array, link: int, point: Array) -> Array:
        pose = poses[self._boxes.joint[link]]
        return np.asarray(pose[:, :3].T @ (point - pose[:, 3]))

    def _touches(self, poses: Array, link: int, point: Array, radius_m: float) -> bool:
        # In the link's frame, where the mesh need not be moved: the pose is applied once, in double precision, to the point.
        at = self._local(poses, link, point)
        ball = self._fcl.CollisionObject(self._fcl.Sphere(max(radius_m, 1e-6)), self._fcl.Transform(at))
        if self._fcl.collide(ball, self._meshes[link], self._collision, self._fcl.CollisionResult()) > 0:
            return True
        # Inside but not touching the surface: only balls smaller than a voxel can hide in the voxels at the surface.
        return radius_m < 2.0 * HALF_DIAGONAL_M and winds_round(self._links[link], at)

    def _gap(self, poses: Array, link: int, point: int, bound: Array) -> float:
        at = self._local(poses, link, self.blocks.points[point])
        tiny = self._fcl.CollisionObject(self._fcl.Sphere(1e-9), self._fcl.Transform(at))
        distance = max(self._fcl.distance(tiny, self._meshes[link], self._distance, self._fcl.DistanceResult()), 0.0)
        inside = bound[link, point] == -np.inf or (distance < 2.0 * HALF_DIAGONAL_M and winds_round(self._links[link], at))
        return float((-distance if inside else distance) - self.blocks.radii[point])
