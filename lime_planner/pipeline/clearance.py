"""How near the arm comes to the stems: one measure for figures, tables and plots.

Close to a stem the signed distance grids of the meshes decide, as in the search. They end 3 cm outside of a body; farther away points on
the body's surface are close enough (6 mm apart, which overstates such a distance by half a millimetre at most).
"""

from __future__ import annotations

import heapq
import itertools

import numpy as np
from scipy.spatial import cKDTree

from lime_planner.collision.fast import ZONE
from lime_planner.collision.joint_space import measure
from lime_planner.collision.link_shapes import GRID_PADDING_M
from lime_planner.collision.world import CAP_M
from lime_planner.core.types import Array
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.robot.kinematics import forward_kinematics

_BELOW_GRIDS_M = 0.002  # grids are believed up to this much before they end
_MODEL_ERROR_M = 0.001  # the fast model may overstate a clearance by this


class StemClearance:
    """Distances between the arm's moving links and the stem points' surface, those that are spared left out."""

    def __init__(self, obstacles: Obstacles) -> None:
        """Prepare.

        Args:
            obstacles: the scene; boxes, floor and workspace do not count.
        """
        self._obstacles, world = obstacles, obstacles.world
        self._space = obstacles.measuring_space(stems_alone=True)
        self._grid_m = GRID_PADDING_M - world.stem_radius - _BELOW_GRIDS_M
        self._stems = cKDTree(obstacles.hard) if len(obstacles.hard) else None
        centre, radius = world.exclusion[:3], float(world.exclusion[3])
        kept = obstacles.hard[np.linalg.norm(obstacles.hard - centre, axis=1) >= radius] if radius > 0.0 else obstacles.hard
        self._unspared = cKDTree(kept) if len(kept) else None
        self._poses = np.empty((obstacles.robot.n + 1, 3, 4))
        shapes = obstacles.shapes
        #: How far the surface points around each fine sphere lie from its centre, (F,) [m].
        self._reach = np.zeros(len(shapes.fine))
        sphere_of = np.repeat(np.arange(len(shapes.fine)), np.diff(shapes.surface_start))
        np.maximum.at(self._reach, sphere_of, np.linalg.norm(shapes.surface - shapes.fine[sphere_of, :3], axis=1))

    def at(self, q: Array, most_m: float = CAP_M) -> float:
        """Return the distance at a configuration (n,), negative in a stem, at most `most_m` [m]."""
        return self._exact(q, self._bounds(q), most_m)

    def along(self, configurations: Array, most_m: float = CAP_M) -> Array:
        """Return the distances at configurations (K, n), at most `most_m` [m]."""
        return np.array([self.at(q, most_m) for q in np.ascontiguousarray(configurations)])

    def smallest(self, configurations: Array) -> float:
        """Return the smallest distance over configurations (K, n), at most `CAP_M` [m]."""
        rows = np.ascontiguousarray(configurations)
        bounds = np.array([self._bounds(q) for q in rows])
        nearest = float(bounds[:, :-1].min(initial=CAP_M))
        if self._stems is None or nearest < self._grid_m:
            return nearest
        # Far from stems: no place of the arm moves further from one row to another than this, and neither does its distance change.
        steps = np.abs(np.diff(rows, axis=0)) @ self._obstacles.shapes.lever
        moved = np.concatenate([[0.0], np.cumsum(steps.max(axis=1, initial=0.0))])
        best = CAP_M
        borders = np.flatnonzero(np.diff(bounds[:, -1])) + 1  # where points begin or cease to be spared
        for first, end in itertools.pairwise([0, *borders.tolist(), len(rows)]):
            best = self._smallest_between(rows, bounds, moved, first, end - 1, best)
        return best

    def _smallest_between(self, rows: Array, bounds: Array, moved: Array, first: int, last: int, best: float) -> float:
        """Return the smallest distance over rows `first` to `last` where it is less than `best`, by halving, the most promising first."""
        at = {k: self._exact(rows[k], bounds[k], CAP_M) for k in {first, last}}
        best = min(best, *at.values())

        def least_between(a: int, b: int) -> float:
            way = float(moved[b] - moved[a])
            return max(0.5 * (at[a] + at[b] - way), at[a] - way, at[b] - way)

        waiting = [(least_between(first, last), first, last)]
        while waiting:
            least, a, b = heapq.heappop(waiting)
            if least >= best:
                break
            if b - a < 2:
                continue
            middle = (a + b) // 2
            # More than this rules both halves out: how much more is not asked for.
            enough = best + float(max(moved[middle] - moved[a], moved[b] - moved[middle]))
            at[middle] = self._exact(rows[middle], bounds[middle], min(enough, CAP_M))
            best = min(best, at[middle])
            for c, d in ((a, middle), (middle, b)):
                heapq.heappush(waiting, (least_between(c, d), c, d))
        return best

    def _bounds(self, q: Array) -> Array:
        """Lower bounds for each body (B,), the distance itself where that is small [m]; the last one is whether points are spared."""
        measure(self._space, q)
        return np.append(self._space.state.clear, self._space.state.misc[ZONE] >= 0.0)

    def _exact(self, q: Array, bounds: Array, most_m: float) -> float:
        clear, sparing = bounds[:-1], bool(bounds[-1])
        best = min(float(clear.min(initial=CAP_M, where=clear < self._grid_m)), most_m)
        if self._stems is None or best < self._grid_m:
            return best
        shapes = self._obstacles.shapes
        forward_kinematics(self._obstacles.robot.chain, np.ascontiguousarray(q), self._poses)
        for body in np.argsort(clear):
            if clear[body] >= best:
                break
            tree = self._unspared if sparing and body == shapes.gripper else self._stems
            first, last = shapes.fine_start[shapes.coarse_start[body : body + 2]]
            pose, radius = self._poses[body], self._obstacles.world.stem_radius
            if tree is None or first == last:
                continue
            # Of the surface only what lies around a sphere that may be near: the rest of thousands of points need not be asked for.
            reach = self._reach[first:last]
            centres = shapes.fine[first:last, :3] @ pose[:, :3].T + pose[:, 3]
            apart = tree.query(centres, distance_upper_bound=best + radius + float(reach.max()))[0]
            # A sphere's surface points are no farther from a stem than its centre and they together.
            limit = min(best + radius, float((apart + reach).min(initial=np.inf, where=reach > 0.0)))
            near = first + np.flatnonzero(apart - reach <= limit)
            pieces = [shapes.surface[shapes.surface_start[sphere] : shapes.surface_start[sphere + 1]] for sphere in near]
            surface = np.concatenate(pieces) if pieces else np.empty((0, 3))
            if not len(surface):
                continue
            found = np.asarray(tree.query(surface @ pose[:, :3].T + pose[:, 3], distance_upper_bound=best + radius)[0])
            best = min(best, max(float(found.min()) - radius, self._grid_m))
        return best
