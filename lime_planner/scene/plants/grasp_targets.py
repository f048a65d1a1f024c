"""Grasp poses: on the limes of a generated plant, and inside the foliage of a scan that has no fruit.

A grasp pose is T_base_tool as x y z qx qy qz qw: the tool frame's origin at the lime's centre, its +z axis, which points out of
the palm, along the direction of approach. That direction lies within 45° of the ray from the arm's base to the lime, so the hand
comes from the robot's side. The roll about it is free for a two-fingered hand and drawn at random.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lime_planner.core.errors import ProblemError, SceneError
from lime_planner.core.geometry import unit
from lime_planner.core.types import Array, Int64
from lime_planner.core.validation import finite_vector, floats, shown
from lime_planner.scene.plants.surface import perpendicular
from lime_planner.scene.scene import Scene

MAX_APPROACH_RAD = np.pi / 4.0
CORRIDOR_RADIUS_M = 0.05  #: half the width of what a hand sweeps on its way in
CORRIDOR_M = 0.20  #: how far out from the lime the way in is judged
HIDDEN_REACH_M = 0.85  #: the target of a plant is chosen within this distance of the base if any lime is
_DIRECTIONS = 48
_SHORTEST_DIRECTION, _LONG_DIRECTION = 1e-6, 1e6


def approach_directions(
    rng: np.random.Generator, position: npt.ArrayLike, n: int, *, base_position: npt.ArrayLike = (0.0, 0.0, 0.0)
) -> Array:
    """Draw n unit directions (n, 3), even over the cap within 45° of the ray from `base_position` to `position` (3,) [m]."""
    ray = unit(np.asarray(position, dtype=np.float64) - np.asarray(base_position, dtype=np.float64))
    one, two = perpendicular(ray)
    cosine = rng.uniform(np.cos(MAX_APPROACH_RAD), 1.0, n)[:, None]
    turn = rng.uniform(0.0, 2.0 * np.pi, n)[:, None]
    return unit(cosine * ray + np.sqrt(1.0 - cosine**2) * (np.cos(turn) * one + np.sin(turn) * two))


def grasp_pose(position: npt.ArrayLike, direction: npt.ArrayLike, roll_rad: float = 0.0) -> Array:
    """Return the pose (7,) at `position` (3,) [m] whose +z points along `direction` (3,), turned about it by `roll_rad`.

    Args:
        position: where the tool's origin is to be, finite.
        direction: of the approach, of any length from 1e-6 on (it is normalised).
        roll_rad: angle about the approach [rad].

    Returns:
        x y z qx qy qz qw [m, -].

    Raises:
        ProblemError: it names the argument, what was given and what is allowed.
    """
    place, way = finite_vector("position", position, 3), finite_vector("direction", direction, 3)
    largest = float(np.abs(way).max())
    if largest < _SHORTEST_DIRECTION:
        raise ProblemError(f"direction must have a length of at least {_SHORTEST_DIRECTION:g}, got {shown(direction)}")
    if floats("roll_rad", roll_rad).shape != () or not np.isfinite(roll_rad):
        raise ProblemError(f"roll_rad must be a finite angle, got {shown(roll_rad)}")
    # The squares of very large numbers overflow; others are left as they are, to the last bit.
    z = unit(way / largest if largest > _LONG_DIRECTION else way)
    one, two = perpendicular(z)
    x = np.cos(roll_rad) * one + np.sin(roll_rad) * two
    quaternion = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1)).as_quat()
    return np.concatenate([place, quaternion])


def lime_targets(scene: Scene, rng: np.random.Generator, *, base_position: npt.ArrayLike = (0.0, 0.0, 0.0)) -> list[Array]:
    """Return one grasp pose (7,) for each lime of a generated plant, in the order of `scene.fruit_centres`.

    Of 48 directions drawn for each lime the one is taken whose way in holds the fewest stem points, then the one nearest to the
    ray from the base. Whether the arm can get there is for inverse kinematics to say.

    Raises:
        SceneError: the scene does not say where its fruit is.
    """
    if scene.fruit_centres is None:
        raise SceneError("the scene has no fruit_centres; only generated plants have them")
    stems = cKDTree(scene.stem_points)
    base = np.asarray(base_position, dtype=np.float64)
    poses = []
    for centre in scene.fruit_centres.astype(np.float64):
        directions = approach_directions(rng, centre, _DIRECTIONS, base_position=base)
        blocked = _in_corridor(stems, centre, directions)
        aligned = directions @ unit(centre - base)
        best = np.lexsort((-aligned, blocked))[0]
        poses.append(grasp_pose(centre, directions[best], float(rng.uniform(0.0, 2.0 * np.pi))))
    return poses


def hidden_lime_target(scene: Scene, rng: np.random.Generator, *, base_position: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Array | None:
    """Return the grasp pose (7,) of the lime that is best hidden among leaves on the robot's side; None without limes.

    Limes within `HIDDEN_REACH_M` of the base come first, then those that have a way in free of stems, then the one with the most
    leaf points on its ways in (the median over them). Of these ways, those with at least the median of leaf points remain, and
    the one nearest to the ray from the base is taken: the hand cannot help meeting leaves.
    """
    if scene.fruit_centres is None or not len(scene.fruit_centres):
        return None
    leaves, stems = cKDTree(scene.leaf_points), cKDTree(scene.stem_points)
    base = np.asarray(base_position, dtype=np.float64)
    best: tuple[tuple[bool, int, float], Array, Array] | None = None
    for centre in scene.fruit_centres.astype(np.float64):
        directions = approach_directions(rng, centre, _DIRECTIONS, base_position=base)
        blocked, touched = _in_corridor(stems, centre, directions), _in_corridor(leaves, centre, directions)
        open_ways = blocked == blocked.min()
        directions, touched = directions[open_ways], touched[open_ways]
        middle = float(np.median(touched))
        key = (bool(np.linalg.norm(centre - base) > HIDDEN_REACH_M), int(blocked.min()), -middle)
        if best is None or key < best[0]:
            leafy = directions[touched >= middle]
            best = (key, centre, leafy[np.argmax(leafy @ unit(centre - base))])
    assert best is not None
    return grasp_pose(best[1], best[2], float(rng.uniform(0.0, 2.0 * np.pi)))


def canopy_targets(
    scene: Scene,
    rng: np.random.Generator,
    n: int,
    *,
    base_position: npt.ArrayLike = (0.0, 0.0, 0.0),
    stem_distance_m: float = 0.03,
) -> list[Array]:
    """Draw n grasp poses (7,) inside the foliage of a scan without fruit.

    Each is a random leaf point of the middle 60 % of the canopy along every axis, at least `stem_distance_m` from a stem,
    approached within 45° of the ray from the base, at a random roll.

    Raises:
        SceneError: no leaf point qualifies.
    """
    if not len(scene.leaf_points):
        raise SceneError("the scene has no leaf points to put a target among")
    low, high = np.quantile(scene.leaf_points, (0.2, 0.8), axis=0)
    middle = scene.leaf_points[((scene.leaf_points >= low) & (scene.leaf_points <= high)).all(axis=1)]
    if len(scene.stem_points) and len(middle):
        middle = middle[cKDTree(scene.stem_points).query(middle, workers=1)[0] >= stem_distance_m]
    if not len(middle):
        raise SceneError(f"no leaf point of the canopy's middle is {stem_distance_m} m away from every stem")
    poses = []
    for position in middle[rng.integers(len(middle), size=n)].astype(np.float64):
        direction = approach_directions(rng, position, 1, base_position=base_position)[0]
        poses.append(grasp_pose(position, direction, float(rng.uniform(0.0, 2.0 * np.pi))))
    return poses


def _in_corridor(tree: cKDTree, centre: Array, directions: Array) -> Int64:
    """Count the tree's points (D,) in cylinders of `CORRIDOR_RADIUS_M` that lead out of `centre` against each direction."""
    near = np.asarray(tree.data)[tree.query_ball_point(centre, np.hypot(CORRIDOR_M, CORRIDOR_RADIUS_M))] - centre
    along = -near @ directions.T
    aside = np.sqrt(np.maximum((near**2).sum(axis=1)[:, None] - along**2, 0.0))
    # What the fingers will hold, the lime and its pedicel, is not in the way.
    return np.asarray(((along > 0.03) & (along < CORRIDOR_M) & (aside < CORRIDOR_RADIUS_M)).sum(axis=0))
