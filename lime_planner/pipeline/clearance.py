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
        #: The surface points around each coarse sphere, and how far they lie from its centre, (C,) [m].
        ends = shapes.surface_start[shapes.fine_start]
        self._pieces = [shapes.surface[first:end] for first, end in itertools.pairwise(ends)]
        self._reach = np.array(
            [np.linalg.norm(piece - c[:3], axis=1).max(initial=0.0) for piece, c in zip(self._pieces, shapes.coarse, strict=True)]
        )
        self._body_of = np.repeat(np.arange(len(shapes.coarse_start) - 1), np.diff(shapes.coarse_start))

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
        shapes, radius = self._obstacles.shapes, self._obstacles.world.stem_radius
        forward_kinematics(self._obstacles.robot.chain, np.ascontiguousarray(q), self._poses)
        asked = np.flatnonzero((self._reach > 0.0) & (clear[self._body_of] < best))
        poses = self._poses[self._body_of[asked]]
        centres = np.einsum("cij,cj->ci", poses[:, :, :3], shapes.coarse[asked, :3]) + poses[:, :, 3]
        unspared = (self._body_of[asked] == shapes.gripper) & sparing
        apart = np.full(len(asked), np.inf)
        for tree, own in ((self._stems, ~unspared), (self._unspared, unspared)):
            if tree is not None and own.any():
                apart[own] = tree.query(centres[own], distance_upper_bound=best + radius + float(self._reach.max()))[0]
        nearest = apart - self._reach[asked]  # no surface point of a sphere is nearer to a stem than this
        for i in np.argsort(nearest):
            tree = self._unspared if unspared[i] else self._stems
            if nearest[i] >= best + radius or tree is None:
                break
            surface = self._pieces[asked[i]] @ poses[i, :, :3].T + poses[i, :, 3]
            found = np.asarray(tree.query(surface, distance_upper_bound=best + radius)[0])
            best = min(best, max(float(found.min()) - radius, self._grid_m))
        return best
