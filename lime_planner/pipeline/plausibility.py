"""What about a scene, a target and a start looks like another unit, another axis, or other labels than it should."""

from __future__ import annotations

import numpy as np

from lime_planner.core.geometry import quaternion_doubt
from lime_planner.core.types import Array
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

_FAR = 10.0  #: times the arm's reach: what is that far away is hardly meant
_PLANT = 5.0  #: times the arm's reach, at most, and at least as small a part of it: so large is a scene that is in metres
_FRAME = "is that in the frame of the arm's base? move it with --offset"
_NEAR_SHARE = 0.01  #: of the points that must be within reach, for the rest to be a background
_UNKNOWN_SHARE = 0.9  #: of labels that are in no class
_TURNS_RAD = 4.0 * np.pi  #: no joint with limits starts beyond two turns
_COUNTED_RAD = 40.0 * np.pi  #: nor one without beyond twenty, though drivers count them
_UPRIGHT = 0.8  #: cosine of the angle within which a plant's long axis follows a frame's axis
_SLENDER = 1.5  #: times the spread along the other axes, for a plant to have a long axis


def doubts_about(scene: Scene, robot: Robot, target: Array, q_start: Array) -> tuple[str, ...]:
    """Return sentences about what a plan was asked for with that is hardly meant; empty where all is plausible.

    Args:
        scene: in the planning frame [m].
        robot: the arm.
        target: where the tool is to be, (3,) [m].
        q_start: (n,) [rad].
    """
    found = [_about_target(robot, target, scene), _about_start(robot, q_start), *_about_points(scene, robot)]
    return tuple(filter(None, found))


def doubts_about_scene(scene: Scene, robot: Robot) -> tuple[str, ...]:
    """Return the same sentences about a scene and its own target, whatever will be planned in it.

    Args:
        scene: in the planning frame [m]; of a scene in another one, only the labels and the target's quaternion are judged.
        robot: an arm that is to reach into it.
    """
    pose = scene.target_pose
    found = ["" if pose is None else quaternion_doubt(pose)]
    if scene.frame_id not in ("", robot.planning_frame):
        return tuple(filter(None, [*found, _about_labels(scene)]))
    found.append("" if pose is None else _about_target(robot, np.asarray(pose[:3], dtype=np.float64), scene))
    return tuple(filter(None, [*found, *_about_points(scene, robot)]))


def _about_points(scene: Scene, robot: Robot) -> tuple[str, str]:
    return _about_labels(scene), _about_place(scene, robot) or _about_axes(scene)


def _about_target(robot: Robot, place: Array, scene: Scene) -> str:
    distance_m = float(np.linalg.norm(place))
    if distance_m <= _FAR * robot.reach_m:
        return ""
    points = _points(scene)
    if len(points) and as_large_as_a_plant(points, robot) and (np.abs(place - points.mean(axis=0)) <= _PLANT * robot.reach_m).all():
        return f"the target is {distance_m:.4g} m away with its scene, the arm reaches {robot.reach_m:.2f} m: {_FRAME}"
    return f"the target is {distance_m:.4g} m away, the arm reaches {robot.reach_m:.2f} m: {_unit(distance_m / robot.reach_m)}"


def _about_start(robot: Robot, q_start: Array) -> str:
    if (np.abs(q_start) <= np.where(robot.continuous, _COUNTED_RAD, _TURNS_RAD)).all():
        return ""
    angles = ", ".join(f"{value:g}" for value in q_start)
    return f"the start is {angles} rad, {float(np.abs(q_start).max()) / (2.0 * np.pi):.0f} turns: is it in degrees?"


def _about_labels(scene: Scene) -> str:
    unknown, received = scene.counts.get("unknown_label", 0), scene.counts.get("received", 0)
    if not unknown or unknown < _UNKNOWN_SHARE * received:
        return ""
    what = "all" if unknown == received else f"{unknown} of"
    return f"{what} {received} points have labels that are not named, and count as stems: set leaf_labels and stem_labels"


def _about_place(scene: Scene, robot: Robot) -> str:
    points = _points(scene)
    if not len(points):
        return ""
    distances = np.linalg.norm(points, axis=1)
    near, nearest_m = int((distances <= robot.reach_m).sum()), float(distances.min())
    size_m = float(np.ptp(points, axis=0).max())
    if near == 0:
        farthest_m = max(nearest_m, size_m)
        if farthest_m <= _FAR * robot.reach_m:
            hint = "move it with --offset?"
        else:
            hint = _FRAME if as_large_as_a_plant(points, robot) else _unit(farthest_m / robot.reach_m)
        return (
            f"none of the scene's {len(points)} points is within the arm's reach of {robot.reach_m:.2f} m; the nearest is "
            f"{nearest_m:.4g} m away, and the scene extends over {size_m:.4g} m: {hint}"
        )
    if near < _NEAR_SHARE * len(points) and float(np.median(distances)) > _FAR * robot.reach_m:
        return (
            f"only {near} of the scene's {len(points)} points are within the arm's reach of {robot.reach_m:.2f} m, and it extends over "
            f"{size_m:.4g} m: {_unit(size_m / robot.reach_m)}"
        )
    return ""


def as_large_as_a_plant(points: Array, robot: Robot) -> bool:
    """Whether a scene of points (N, 3), N at least 1, is as large as what stands before an arm: then it is in metres, wherever it is."""
    return 1.0 / _PLANT <= float(np.ptp(points, axis=0).max()) / robot.reach_m <= _PLANT


def _about_axes(scene: Scene) -> str:
    """Tell a plant that grows along y from one that grows along z: its stems are long in y from 0 on, and lie on both sides of z = 0."""
    stems = scene.stem_points
    if len(stems) < 50:
        return ""
    centred = stems - stems.mean(axis=0)
    spread, axes = np.linalg.eigh(centred.T @ centred / len(stems))
    deviation = np.sqrt(np.maximum(spread, 0.0))
    low, high = np.percentile(stems, (1.0, 99.0), axis=0)
    upright = abs(axes[1, 2]) >= _UPRIGHT and deviation[2] >= _SLENDER * deviation[1]
    grounded = abs(low[1]) <= 0.15 * (high[1] - low[1])
    astride = low[2] < 0.0 < high[2] and abs(low[2] + high[2]) <= 0.6 * (high[2] - low[2])
    if upright and grounded and astride:
        return (
            "the plant grows along y, and half of it lies below the arm's base: is the scene y-up? z is up here (x, -z, y of a y-up scene)"
        )
    return ""


def _points(scene: Scene) -> Array:
    return np.concatenate([np.asarray(part, dtype=np.float64) for part in (scene.leaf_points, scene.stem_points, scene.fruit_points)])


def _unit(ratio: float) -> str:
    """Guess the unit of a length that is `ratio` times what an arm can reach."""
    if ratio > 1e5:
        return "is that in metres, and in the frame of the arm's base?"
    return "is that in millimetres?" if ratio >= 100.0 else "is that in centimetres, or in another frame?"
