"""Which leaves a motion really touches: the arm's undecimated meshes against the leaves' triangles, through FCL and Embree.

Nothing here is shared with a planner's cost: no cloud points, no distance field, no leaf points' radius, only triangles. Between two
looked-at configurations no point of the arm moves more than `STEP_M`, so that nothing passes unseen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.jit import kernel
from lime_planner.core.quick_open3d import open3d
from lime_planner.core.types import Array, Bool, Int64
from lime_planner.motion.trajectory import Trajectory
from lime_planner.robot.meshes import LinkMesh, bvh_of
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene
from lime_planner.scene.voxels import thin

STEP_M = 0.002  #: no point of the arm moves farther between two looks
PATCH_M = 0.004  #: edge of the patch of leaf that a scan's point stands for
CELL_M = 0.003  #: leaves are cut into triangles with edges up to this, each swept or not as its centre is
FINE_RAD = 0.002  # the motion is first sampled this finely, then thinned by how far the arm's points move


@dataclass(frozen=True, eq=False)
class Swept:
    """What a motion does to a plant.

    Attributes:
        leaves: numbers of the leaves that a link's surface cuts, in order.
        area_m2: area of leaf (one side) that comes within `STEP_M` / 2 of a link's surface.
        configurations: how many were looked at.
    """

    leaves: Int64
    area_m2: float
    configurations: int


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion as link poses: frames (K, n + 1, 3, 4), and how far each link has moved at most until each of them, (links, K) [m]."""

    frames: Array
    ways: Array


def motion_samples(robot: Robot, configurations: Array, step_m: float = STEP_M) -> Motion:
    """Thin configurations (K, n) of a motion so that no point of the arm moves more than `step_m` in between, as far as they allow.

    A point's way between two configurations is taken for straight: they are milliradians apart.
    """
    frames = np.stack([robot.link_poses(q)[:, :3] for q in configurations])
    moved = np.zeros((len(robot.links), len(frames)))
    for row, link in zip(moved, robot.links, strict=True):
        # A link lies in the box of its vertices, and the farthest moved point of a box is a corner.
        low, high = link.vertices.min(axis=0), link.vertices.max(axis=0)
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1)
        places = frames[:, link.joint, :, :3] @ corners + frames[:, link.joint, :, 3:]
        row[1:] = np.linalg.norm(np.diff(places, axis=0), axis=1).max(axis=1)
    keep, gone = [0], 0.0
    for i, way in enumerate(moved.max(axis=0)):
        if gone + way > step_m and gone > 0.0:
            keep.append(i - 1)
            gone = 0.0
        gone += way
    if keep[-1] != len(frames) - 1:
        keep.append(len(frames) - 1)
    return Motion(np.ascontiguousarray(frames[keep]), np.ascontiguousarray(np.cumsum(moved, axis=1)[:, keep]))


@kernel
def _near_box(pose: Any, low: Any, high: Any, places: Any, reach: Any, way: float, look_at: Any, found: Any) -> int:
    """Collect the balls that are due and may touch the box [low, high] of a link's frame; how many.

    A ball that is d away from the box is not due again before the link has moved by d: `look_at` (C,) holds the way at which it is.
    """
    count = 0
    for i in range(places.shape[0]):
        if look_at[i] > way:
            continue
        total = 0.0
        for k in range(3):
            x = 0.0
            for j in range(3):
                x += pose[j, k] * (places[i, j] - pose[j, 3])
            gap = max(low[k] - x, x - high[k], 0.0)
            total += gap * gap
        distance = np.sqrt(total) - reach[i]
        if distance > 0.0:
            look_at[i] = way + distance
        else:
            found[count] = i
            count += 1
    return count


def leaf_cells(triangles: Array, cell_m: float = CELL_M) -> tuple[Array, Array, Int64]:
    """Cut triangles (L, 3, 3) [m] into similar ones with edges up to `cell_m`.

    Returns:
        Centres (C, 3), areas (C,) [m²], and the triangle that each lies on (C,).
    """
    if len(triangles) == 0:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(sides / cell_m).astype(np.int64), 1)
    area = 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    centres, areas, owners = [], [], []
    for n in np.unique(parts):
        chosen = np.flatnonzero(parts == n)
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        up, down = i + j < n, i + j < n - 1
        weights = np.concatenate([np.stack([i[up] + 1 / 3, j[up] + 1 / 3]), np.stack([i[down] + 2 / 3, j[down] + 2 / 3])], axis=1) / n
        a, b, c = triangles[chosen, 0], triangles[chosen, 1] - triangles[chosen, 0], triangles[chosen, 2] - triangles[chosen, 0]
        centres.append((a[:, None] + weights[0][:, None] * b[:, None] + weights[1][:, None] * c[:, None]).reshape(-1, 3))
        areas.append(np.repeat(area[chosen] / n**2, n**2))
        owners.append(np.repeat(chosen, n**2))
    return np.concatenate(centres), np.concatenate(areas), np.concatenate(owners)


class Sweeper:
    """Asks which of a set of balls the links of an arm come near to along a motion."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.boxes = [(link.vertices.min(axis=0), link.vertices.max(axis=0)) for link in robot.links]
        self.surfaces = [surface_of(link) for link in robot.links]

    def visits(self, motion: Motion, places: Array, reach: Array) -> Iterator[tuple[int, Array, Int64, Array, float]]:
        """Yield link, pose, balls that may touch it there, all balls' `look_at` (to be raised by the caller), and the link's way."""
        look_at = np.zeros((len(self.boxes), len(places)))
        found = np.empty(len(places), dtype=np.int64)
        for k, frames in enumerate(motion.frames):
            for i, (low, high) in enumerate(self.boxes):
                pose, way = np.ascontiguousarray(frames[self.robot.links[i].joint]), float(motion.ways[i, k])
                count = _near_box(pose, low, high, places, reach, way, look_at[i], found)
                if count:
                    yield i, pose, found[:count], look_at, way

    def reached(self, motion: Motion, places: Array, radius_m: float) -> Bool:
        """Tell which of the places (C, 3) [m] come within a radius of a link's surface."""
        swept = np.zeros(len(places), dtype=np.bool_)
        for i, pose, near, look_at, way in self.visits(motion, places, np.full(len(places), radius_m)):
            local = (places[near] - pose[:, 3]) @ pose[:, :3]
            distance = self.surfaces[i].compute_distance(local.astype(np.float32), nthreads=1).numpy() - radius_m
            look_at[i, near] = way + distance  # not sooner can the link have come here
            there = near[distance <= 0.0]
            swept[there] = True
            look_at[:, there] = np.inf
        return swept


class LeafTruth:
    """The leaves of one generated plant, ready to be asked what motions sweep through them."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        """Take the leaves of a scene.

        Raises:
            SceneError: the scene has no leaf triangles: only generated plants have.
        """
        import fcl

        if scene.leaf_triangles is None or scene.leaf_triangle_ids is None:
            raise SceneError("the scene has no leaf_triangles; only generated plants have them")
        self._fcl, self._sweeper = fcl, Sweeper(robot)
        self._triangles = scene.leaf_triangles.astype(np.float64)
        self._ids = scene.leaf_triangle_ids.astype(np.int64)
        self._numbers = np.unique(self._ids)
        self._leaves = []
        centres, radii = [], []
        for number in self._numbers:
            own = self._triangles[self._ids == number]
            model = fcl.BVHModel()
            model.beginModel(3 * len(own), len(own))
            model.addSubModel(own.reshape(-1, 3), np.arange(3 * len(own)).reshape(-1, 3))
            model.endModel()
            self._leaves.append(fcl.CollisionObject(model))
            corners = own.reshape(-1, 3)
            centres.append(0.5 * (corners.min(axis=0) + corners.max(axis=0)))
            radii.append(np.linalg.norm(corners - centres[-1], axis=1).max())
        self._centres, self._radii = np.array(centres), np.array(radii)
        self._links = [fcl.CollisionObject(bvh_of(link)) for link in robot.links]

    def swept(self, trajectory: Trajectory) -> Swept:
        """Find the leaves and the area that a motion sweeps through."""
        motion = motion_samples(self._sweeper.robot, trajectory.configurations(FINE_RAD))
        cut = self._cut(motion)
        centres, areas, _ = leaf_cells(self._triangles[np.isin(self._ids, self._numbers[cut])])
        area = float(areas[self._sweeper.reached(motion, centres, STEP_M / 2.0)].sum())
        return Swept(self._numbers[cut], area, len(motion.frames))

    def cut_along(self, motion: Motion) -> Int64:
        """Return the numbers of the leaves that a link's surface cuts along a motion."""
        return np.asarray(self._numbers[self._cut(motion)])

    def touched_at(self, q: npt.ArrayLike) -> Int64:
        """Return the numbers of the leaves that a link's surface cuts at one configuration (n,)."""
        return self.cut_along(motion_samples(self._sweeper.robot, np.atleast_2d(np.asarray(q, dtype=np.float64))))

    def _cut(self, motion: Motion) -> Int64:
        fcl, request = self._fcl, self._fcl.CollisionRequest()
        touched = np.zeros(len(self._numbers), dtype=np.bool_)
        for i, pose, near, look_at, _ in self._sweeper.visits(motion, self._centres, self._radii):
            self._links[i].setTransform(fcl.Transform(pose[:, :3], pose[:, 3]))
            for leaf in near:
                if fcl.collide(self._links[i], self._leaves[leaf], request, fcl.CollisionResult()) > 0:
                    touched[leaf] = True
                    look_at[:, leaf] = np.inf
        return np.flatnonzero(touched)


class CloudTruth:
    """The leaf points of a scan, each of which stands for a patch of leaf."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        """Take the leaf points of a scene, one of each voxel of `PATCH_M`."""
        self._sweeper = Sweeper(robot)
        kept, _ = thin(scene.leaf_points, PATCH_M) if len(scene.leaf_points) else (np.zeros(0, np.int32), None)
        self._points = scene.leaf_points[kept].astype(np.float64)

    def swept_area_m2(self, trajectory: Trajectory) -> float:
        """Return the area of the patches that come within `STEP_M` of a link's surface."""
        motion = motion_samples(self._sweeper.robot, trajectory.configurations(FINE_RAD))
        return float(self._sweeper.reached(motion, self._points, STEP_M).sum()) * PATCH_M**2


_SURFACES: WeakKeyDictionary[LinkMesh, Any] = WeakKeyDictionary()


def surface_of(link: LinkMesh) -> Any:
    """Return Open3D's (Embree's) tree of a link's triangles, which answers distances to the surface, built once for each link."""
    surface = _SURFACES.get(link)
    if surface is None:
        o3d = open3d()

        surface = o3d.t.geometry.RaycastingScene(nthreads=1)
        surface.add_triangles(o3d.core.Tensor(link.vertices.astype(np.float32)), o3d.core.Tensor(link.triangles.astype(np.uint32)))
        _SURFACES[link] = surface
    return surface
