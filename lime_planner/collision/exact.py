"""The exact collision check: undecimated meshes, in double precision, through FCL.

Cloud points are balls of their radius, with nothing added where the cloud is thinned to 2 mm or so (see
`lime_planner.collision.exact_kernels`). Compiled code first sorts out what cannot touch (`lime_planner.collision.exact_kernels`); FCL
decides the rest: ball against mesh, mesh against mesh, box against mesh. It shares no geometry with the fast model it is there to check.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from lime_planner.collision.exact_kernels import link_extents, near_pairs
from lime_planner.collision.exact_points import PointTest, boxes_of, winds_round
from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array
from lime_planner.robot.kinematics import forward_kinematics, tool_pose
from lime_planner.robot.meshes import LinkObjects
from lime_planner.robot.model import Robot

_POLL_EVERY = 16  # configurations between two looks at should_stop
_BOX_LIMIT_M = 100.0  # keep-out boxes may be infinite; FCL's may not


@dataclass(frozen=True)
class Hit:
    """A contact with something hard.

    Attributes:
        link: name of the link.
        what: what it touches: a stem point, the arm itself, a keep-out box, the floor, or the border of the workspace.
        other: what exactly, in words: the point, the other link, the number of the box.
        place: the stem point, (3,) [m]; None for everything else.
    """

    link: str
    what: Literal["stem", "self", "keep_out", "floor", "workspace"]
    other: str
    place: Array | None = field(default=None, compare=False)

    def __str__(self) -> str:
        """Return the contact in words."""
        verb = {"stem": "touches the stem point", "self": "touches", "keep_out": "touches", "floor": "is", "workspace": "is"}[self.what]
        return f"{self.link} {verb} {self.other}"


@dataclass(frozen=True)
class Certificate:
    """What `ExactChecker.certify` found.

    Attributes:
        ok: True if no configuration touches anything hard.
        index: of the first configuration that does, or where the check was stopped; the number of configurations if ok.
        hit: the contact; None if ok or stopped.
    """

    ok: bool
    index: int
    hit: Hit | None


class ExactChecker:
    """Checks configurations of one robot in one scene. Not to be used by two threads at once; make one for each.

    Links that stand still are checked like the others, but not against the floor and the workspace box: the base stands on the one
    and may stand outside the other.
    """

    def __init__(
        self,
        robot: Robot,
        impermeable_points: npt.ArrayLike,
        *,
        point_radius_m: float,
        leaf_points: npt.ArrayLike | None = None,
        leaf_point_radius_m: float = 0.004,
        keep_out_boxes: npt.ArrayLike | None = None,
        floor_z_m: float = -np.inf,
        workspace_box: npt.ArrayLike | None = None,
        exclusion_centre: npt.ArrayLike | None = None,
        exclusion_radius_m: float = 0.06,
        exclusion_heights_m: tuple[float, float] = (0.0, 0.0),
        approach_zone_m: float = 0.10,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare the check of a scene, everything in the planning frame.

        Args:
            robot: the arm.
            impermeable_points: (N, 3) stems and all that is as hard [m].
            point_radius_m: radius of the balls around them.
            leaf_points: (M, 3) points that `leaf_contact` looks at [m].
            leaf_point_radius_m: radius of the balls around them.
            keep_out_boxes: (K, 6) lowest x y z, highest x y z [m]; infinite is allowed.
            floor_z_m: height that no moving link may be below, -inf for none.
            workspace_box: (6,) lowest x y z, highest x y z, that no moving link may leave [m].
            exclusion_centre: (3,) centre of the sphere around the target in which stem points do not count for the gripper's links.
            exclusion_radius_m: its radius.
            exclusion_heights_m: lowest and highest height over the centre of an upright segment, around which that radius holds.
            approach_zone_m: the sphere counts only while the tool is at most this far from its centre.
            should_stop: cancels; the first check with larger points takes seconds to prepare.

        Raises:
            Refusal: CANCELLED.
            ProblemError: an array of the wrong shape, with NaN, or a negative length; the text names it.
        """
        import fcl

        self._fcl = fcl
        self.robot = robot
        self._exclusion = None if exclusion_centre is None else _checked("exclusion_centre", exclusion_centre, (3,))
        self._exclusion_radius_m = _length("exclusion_radius_m", exclusion_radius_m)
        self._approach_zone_m = _length("approach_zone_m", approach_zone_m)
        sphere = (self._exclusion, self._exclusion_radius_m, exclusion_heights_m)
        stems = _checked("impermeable_points", impermeable_points, (-1, 3))
        leaves = _checked("leaf_points", np.zeros((0, 3)) if leaf_points is None else leaf_points, (-1, 3))
        self._stems = PointTest(robot, stems, _length("point_radius_m", point_radius_m), *sphere, should_stop)
        self._leaves = PointTest(robot, leaves, _length("leaf_point_radius_m", leaf_point_radius_m), *sphere, should_stop)
        self._keep_out = _checked("keep_out_boxes", np.zeros((0, 6)) if keep_out_boxes is None else keep_out_boxes, (-1, 6), finite=False)
        self._floor_z_m = float(floor_z_m)
        box = [-np.inf] * 3 + [np.inf] * 3 if workspace_box is None else workspace_box
        self._workspace = _checked("workspace_box", box, (6,), finite=False).reshape(2, 3)
        self._boxes = boxes_of(robot)
        self._pairs = np.array(robot.collision_pairs, dtype=np.int64).reshape(-1, 2)
        self._moving = np.flatnonzero(self._boxes.joint > 0)
        self._poses = np.empty((robot.n + 1, 3, 4))
        self._extents = np.empty((len(robot.links), 2, 3))
        self._tool = np.empty((3, 4))
        self._near = np.empty(len(self._pairs), dtype=np.int64)
        self._objects = LinkObjects(robot.links)
        self._box_objects = [self._fcl_box(box) for box in self._keep_out]
        self._request = fcl.CollisionRequest()

    def stem_hit(self, q: npt.ArrayLike) -> Hit | None:
        """Return a contact of configuration q (n,) with something hard, or None.

        Self-collision, workspace, floor, keep-out boxes and stems are looked at in this order.
        """
        self._place(q)
        return self._self_hit() or self._border_hit() or self._keep_out_hit() or self._stem_hit()

    def leaf_contact(self, q: npt.ArrayLike) -> bool:
        """Tell whether any link touches a leaf point at configuration q (n,)."""
        self._place(q)
        return self._leaves.first_hit(self._poses, False) is not None

    def stem_distance(self, q: npt.ArrayLike) -> float:
        """Return the distance between the arm's surface and the nearest stem ball at configuration q (n,) [m].

        Negative where they overlap: the distance of the ball's centre to the surface less the radius, and for a centre inside a
        link minus both. Spared points do not count. Infinite without points.
        """
        self._place(q)
        return self._stems.distance(self._poses, self._sparing())

    def certify(self, path: npt.ArrayLike, should_stop: Callable[[], bool] | None = None) -> Certificate:
        """Check every configuration of a path (K, n) as it is given: sample it as finely as the certificate is to be.

        Args:
            path: the configurations [rad].
            should_stop: asked now and then; True ends the check with `ok` False and no hit.
        """
        rows = np.atleast_2d(np.asarray(path, dtype=np.float64))
        for index, q in enumerate(rows):
            if should_stop is not None and index % _POLL_EVERY == 0 and should_stop():
                return Certificate(False, index, None)
            hit = self.stem_hit(q)
            if hit is not None:
                return Certificate(False, index, hit)
        return Certificate(True, len(rows), None)

    def spared_count(self) -> int:
        """Return how many stem points (merged ones counted once) the exclusion sphere hides from the gripper."""
        return int(self._stems.spared.sum())

    def _fcl_box(self, box: Array) -> Any:
        low, high = np.clip(box.reshape(2, 3), -_BOX_LIMIT_M, _BOX_LIMIT_M)
        if (high <= low).any():
            raise ProblemError(f"keep_out_boxes holds the box {box.tolist()}, whose highest corner is not above its lowest")
        return self._fcl.CollisionObject(self._fcl.Box(*(high - low)), self._fcl.Transform(0.5 * (low + high)))

    def _place(self, q: npt.ArrayLike) -> None:
        values = np.ascontiguousarray(q, dtype=np.float64)
        if values.shape != (self.robot.n,) or not np.isfinite(values).all():
            raise ProblemError(f"a configuration needs {self.robot.n} finite numbers, got {values.tolist()}")
        forward_kinematics(self.robot.chain, values, self._poses)

    def _sparing(self) -> bool:
        if self._exclusion is None:
            return False
        tool_pose(self.robot.chain, self._poses, self._tool)
        return float(np.linalg.norm(self._tool[:, 3] - self._exclusion)) <= self._approach_zone_m

    def _set(self, link: int) -> Any:
        pose = self._poses[self._boxes.joint[link]]
        self._objects[link].setTransform(self._fcl.Transform(pose[:, :3], pose[:, 3]))
        return self._objects[link]

    def _touch(self, a: Any, b: Any) -> bool:
        return bool(self._fcl.collide(a, b, self._request, self._fcl.CollisionResult()) > 0)

    def _self_hit(self) -> Hit | None:
        count = near_pairs(self._boxes, self._poses, self._pairs, self._near)
        for k in self._near[:count]:
            i, j = self._pairs[k]
            if self._touch(self._set(i), self._set(j)):
                return Hit(self.robot.links[i].name, "self", self.robot.links[j].name)
        return None

    def _border_hit(self) -> Hit | None:
        if not (np.isfinite(self._floor_z_m) or np.isfinite(self._workspace).any() or self._box_objects):
            return None
        link_extents(self._boxes, self._poses, self._extents)
        moving = self._extents[self._moving]
        out = (moving[:, 0] < self._workspace[0]) | (moving[:, 1] > self._workspace[1])
        if out.any():
            row, axis = np.argwhere(out)[0]
            low, high = self._workspace[:, axis]
            reached = f"reaches {'xyz'[axis]} = {moving[row, 0, axis]:.3f} to {moving[row, 1, axis]:.3f} m"
            return Hit(
                self.robot.links[self._moving[row]].name, "workspace", f"outside the workspace box ({low:.3f} to {high:.3f} m): {reached}"
            )
        below = moving[:, 0, 2] - self._floor_z_m
        if below.min() < 0.0:
            link = self.robot.links[self._moving[int(below.argmin())]].name
            return Hit(link, "floor", f"{-below.min():.3f} m below the floor at z = {self._floor_z_m:.3f} m")
        return None

    def _keep_out_hit(self) -> Hit | None:
        for number, (box, thing) in enumerate(zip(self._keep_out, self._box_objects, strict=True)):
            overlap = (self._extents[:, 0] <= box[3:]) & (self._extents[:, 1] >= box[:3])
            for link in np.flatnonzero(overlap.all(axis=1)):
                centre = 0.5 * (np.clip(box[:3], -_BOX_LIMIT_M, None) + np.clip(box[3:], None, _BOX_LIMIT_M))
                if self._touch(self._set(int(link)), thing) or self._inside(int(link), centre):
                    return Hit(self.robot.links[link].name, "keep_out", f"keep-out box {number}")
        return None

    def _stem_hit(self) -> Hit | None:
        found = self._stems.first_hit(self._poses, self._sparing())
        if found is None:
            return None
        link, point = found
        return Hit(self.robot.links[link].name, "stem", "({:.3f}, {:.3f}, {:.3f})".format(*point), np.asarray(point))

    def _inside(self, link: int, point: Array) -> bool:
        pose = self._poses[self._boxes.joint[link]]
        return winds_round(self.robot.links[link], pose[:, :3].T @ (point - pose[:, 3]))


def _checked(name: str, values: npt.ArrayLike, shape: tuple[int, ...], finite: bool = True) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if shape[0] == -1 and array.size == 0:
        array = array.reshape(0, shape[1])
    if array.ndim != len(shape) or array.shape[-1] != shape[-1]:
        raise ProblemError(f"{name} needs the shape {shape} (-1 for any number), got {array.shape}")
    if np.isnan(array).any() or (finite and not np.isfinite(array).all()):
        raise ProblemError(f"{name} holds numbers that are not finite")
    return array


def _length(name: str, value: float) -> float:
    if not (np.isfinite(value) and value >= 0.0):
        raise ProblemError(f"{name} is {value}; it must be finite and not negative")
    return float(value)
