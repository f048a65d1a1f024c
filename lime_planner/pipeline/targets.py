"""What a plan is to reach: a fruit, any of several grasps, or one pose of the tool, each checked where it comes in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix, quaternion_doubt
from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array
from lime_planner.core.validation import floats, shown
from lime_planner.pipeline.context import checked_target
from lime_planner.pipeline.grasps.approaches import frames_along
from lime_planner.pipeline.spots import Spot, shown_radius_m
from lime_planner.scene.scene import Scene

Kind = Literal["fruit", "candidates", "pose"]
Freedom = Literal["exact", "roll", "cone"]

MAX_CANDIDATES = 2000
LARGEST_RADIUS_M = 0.2  #: of a fruit
_SAME_FRUIT_M = 0.04  # candidates this close to their middle are for one fruit


@dataclass(frozen=True, eq=False)
class Target:
    """What the tool is to reach.

    Attributes:
        kind: `fruit`, `candidates` or `pose`.
        centre: (3,) of the fruit, the candidates' middle, or the pose's position [m].
        poses: (P, 4, 4) T_base_tool of the candidates or of the pose; P is 0 for a fruit.
        freedom: of a pose: `exact`, `roll` (any turn about the approach) or `cone` (also approaches around its own).
        radius_m: of the fruit where it is known, else None.
        doubt: a sentence about how it was given that is hardly meant, empty for none.
    """

    kind: Kind
    centre: Array
    poses: Array
    freedom: Freedom = "exact"
    radius_m: float | None = None
    doubt: str = ""

    @property
    def exact(self) -> bool:
        """Whether there is nothing to choose."""
        return self.kind == "pose" and self.freedom == "exact"

    def spot(self, scene: Scene, settings: Settings) -> Spot:
        """The place of the target in a scene.

        Raises:
            ProblemError: a fruit of which neither the scene nor the target nor the settings say how large it is.
        """
        x, y, z = (float(v) for v in self.centre)
        if self.exact:
            return Spot((x, y, z))
        radius_m = self.radius_m or shown_radius_m(scene, self.centre)
        if radius_m is None and self.kind == "fruit":
            radius_m = settings.fruit_radius_m
            if not radius_m > 0.0:
                raise ProblemError(
                    f"the scene shows no fruit at {x:.3f} {y:.3f} {z:.3f}, and fruit_radius_m is 0: how large is the fruit there?"
                )
        one = self.has_one_fruit
        return Spot((x, y, z), (radius_m or 0.0) if one else 0.0, stalk=one and radius_m is not None)

    def moved(self, T: Array) -> Target:
        """The same target in another frame; T (4, 4) takes coordinates from its frame into that one."""
        return dataclasses.replace(self, centre=T[:3, :3] @ self.centre + T[:3, 3], poses=T @ self.poses)

    @property
    def has_one_fruit(self) -> bool:
        """Whether all of it is at one fruit, whose stalk may then be let go."""
        return self.kind != "candidates" or float(np.linalg.norm(self.poses[:, :3, 3] - self.centre, axis=1).max()) <= _SAME_FRUIT_M

    def shown_pose(self) -> Array:
        """A pose (7,) that stands for the target in a picture before a grasp is chosen: a fruit is shown as seen from the base."""
        if self.kind != "fruit":
            return matrix_to_pose(self.poses[0])
        away = float(np.linalg.norm(self.centre))
        direction = self.centre / away if away > 1e-9 else np.array([0.0, 0.0, 1.0])
        T = np.eye(4)
        T[:3, :3] = frames_along(direction[None], np.zeros(1))[0]
        T[:3, 3] = self.centre
        return matrix_to_pose(T)

    def origin(self) -> dict[str, Any]:
        """What was asked for, ready for JSON; `target_from` reads it."""
        if self.kind == "fruit":
            return {"target_kind": "fruit", "fruit": self.centre.tolist(), "fruit_radius_m": self.radius_m}
        poses = [matrix_to_pose(T).tolist() for T in self.poses]
        if self.kind == "candidates":
            return {"target_kind": "candidates", "candidates": poses}
        return {"target_kind": "pose", "grasp_freedom": self.freedom}

    def __str__(self) -> str:
        """Say in words what is to be reached."""
        where = "{:.3f} {:.3f} {:.3f}".format(*self.centre)
        if self.kind == "fruit":
            return f"the fruit at {where}"
        if self.kind == "candidates":
            return f"{len(self.poses)} grasp candidates around {where}"
        return f"the pose at {where}" + {"exact": "", "roll": ", any roll", "cone": ", any approach around its own"}[self.freedom]


def pose_target(pose: npt.ArrayLike, freedom: str = "exact") -> Target:
    """Make a target of one pose.

    Args:
        pose: (4, 4) T_base_tool, or (7,) x y z qx qy qz qw.
        freedom: see `Target`.

    Raises:
        ProblemError: no such pose, or no such freedom.
    """
    values = floats("the target", pose)
    T = pose_to_matrix(values) if values.shape == (7,) else checked_target(values)
    if freedom not in get_args(Freedom):
        raise ProblemError(f"the grasp's freedom is {freedom!r}; allowed: one of {', '.join(get_args(Freedom))}")
    chosen: Any = freedom
    return Target("pose", T[:3, 3].copy(), T[None], chosen, doubt=_doubt(values))


def fruit_target(centre: npt.ArrayLike, radius_m: float | None = None) -> Target:
    """Make a target of a fruit.

    Args:
        centre: (3,) in the planning frame [m].
        radius_m: where it is known.

    Raises:
        ProblemError: not three finite numbers, or no such radius.
    """
    values = floats("the fruit", centre)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ProblemError(f"the fruit's centre needs 3 finite numbers x y z, got {shown(centre)}")
    if radius_m is not None and not (np.isfinite(radius_m) and 0.0 < radius_m <= LARGEST_RADIUS_M):
        raise ProblemError(f"the fruit's radius is {radius_m:.4g} m; it must be above 0 and at most {LARGEST_RADIUS_M:g} m")
    return Target("fruit", values, np.zeros((0, 4, 4)), "cone", radius_m)


def candidates_target(poses: npt.ArrayLike) -> Target:
    """Make a target of several poses, any of which will do.

    Args:
        poses: (P, 7) x y z qx qy qz qw or (P, 4, 4) T_base_tool, at most `MAX_CANDIDATES`.

    Raises:
        ProblemError: none, too many, or one that is no pose; the text says which.
    """
    values = floats("the grasp candidates", poses)
    if values.size == 0:
        raise ProblemError("the grasp candidates are an empty list; at least one pose is needed")
    if values.ndim not in (2, 3) or values.shape[1:] not in ((7,), (4, 4)):
        raise ProblemError(f"the grasp candidates need the shape (P, 7) or (P, 4, 4), got {values.shape}")
    if len(values) > MAX_CANDIDATES:
        raise ProblemError(f"there are {len(values)} grasp candidates; at most {MAX_CANDIDATES} are allowed")
    matrices = []
    for number, pose in enumerate(values, start=1):
        try:
            matrices.append(pose_to_matrix(pose) if pose.shape == (7,) else checked_target(pose))
        except ProblemError as error:
            raise ProblemError(f"grasp candidate {number} of {len(values)}: {error}") from None
    stacked = np.stack(matrices)
    doubts = [f"grasp candidate {number} of {len(values)}: {found}" for number, pose in enumerate(values, 1) if (found := _doubt(pose))]
    return Target("candidates", np.median(stacked[:, :3, 3], axis=0), stacked, doubt=doubts[0] if doubts else "")


def _doubt(pose: Array) -> str:
    return quaternion_doubt(pose) if pose.shape == (7,) else ""


def target_of(value: Target | npt.ArrayLike, freedom: str = "exact") -> Target:
    """Return a target as it is, and an array as what its shape says: (4, 4) or (7,) a pose of some freedom, (3,) a fruit.

    Raises:
        ProblemError: neither.
    """
    if isinstance(value, Target):
        return value
    values = floats("the target", value)
    if values.ndim == 1 and values.shape not in ((3,), (7,)):
        raise ProblemError(f"a target needs 3 numbers x y z (a fruit) or 7 numbers x y z qx qy qz qw (a pose), got {len(values)}")
    return fruit_target(values) if values.shape == (3,) else pose_target(values, freedom)


def target_from(data: dict[str, Any]) -> Target | None:
    """Read what `Target.origin` wrote, together with `target_pose` for a pose; None where there was no target.

    Raises:
        ProblemError: it is none.
    """
    kind = data.get("target_kind", "pose")
    if kind == "fruit":
        return fruit_target(data["fruit"], data.get("fruit_radius_m"))
    if kind == "candidates":
        return candidates_target(data["candidates"])
    pose = data.get("target_pose")
    return None if pose is None else pose_target(pose, data.get("grasp_freedom", "exact"))
