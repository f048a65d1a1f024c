"""What a depth camera sees of a plant: a z-buffer over its points, drawn as discs, so that near leaves hide what is behind them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.jit import kernel
from lime_planner.core.types import Array, Bool, Float32, Int16
from lime_planner.scene.clean import subset
from lime_planner.scene.scene import Scene


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        width, height: of the picture [pixels].
        field_of_view_rad: horizontal angle of view [rad].
        nearest_m, farthest_m: range of the sensor [m].
        edge_drop_out: share of the pixels at depth edges that return nothing, as stereo cameras have it.
        noise_m: standard deviation of the depth at one metre [m]; it grows with the square of the distance.
    """

    width: int = 640
    height: int = 480
    field_of_view_rad: float = 1.2
    nearest_m: float = 0.1
    farthest_m: float = 5.0
    edge_drop_out: float = 0.0
    noise_m: float = 0.0

    @property
    def focal_px(self) -> float:
        """Focal length [pixels]."""
        return 0.5 * self.width / float(np.tan(0.5 * self.field_of_view_rad))


def look_at(origin: npt.ArrayLike, target: npt.ArrayLike) -> Array:
    """Return (4, 4) T_base_camera of a camera at `origin` that looks at `target`: +z forwards, +x to the right, +y down.

    Raises:
        ProblemError: the two are the same place, or not finite.
    """
    eye, aim = np.asarray(origin, dtype=np.float64).reshape(3), np.asarray(target, dtype=np.float64).reshape(3)
    forwards = aim - eye
    length = float(np.linalg.norm(forwards))
    if not np.isfinite(length) or length < 1e-6:
        raise ProblemError(f"a camera at {eye.tolist()} cannot look at {aim.tolist()}: they must be two places")
    forwards /= length
    down = np.array([0.0, 0.0, -1.0]) if abs(forwards[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    right = np.cross(down, forwards)
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = right, np.cross(forwards, right), forwards, eye
    return T


@kernel
def _depth_picture(local: Any, radius: float, focal: float, width: int, height: int, nearest: float, farthest: float) -> Any:
    picture = np.full((height, width), np.float32(np.inf))
    for i in range(local.shape[0]):
        z = local[i, 2]
        if not (nearest <= z <= farthest):
            continue
        u, v = focal * local[i, 0] / z + 0.5 * width, focal * local[i, 1] / z + 0.5 * height
        reach = focal * radius / z
        for row in range(max(0, int(np.floor(v - reach))), min(height - 1, int(np.floor(v + reach))) + 1):
            for column in range(max(0, int(np.floor(u - reach))), min(width - 1, int(np.floor(u + reach))) + 1):
                off_u, off_v = column + 0.5 - u, row + 0.5 - v
                if (off_u * off_u + off_v * off_v <= reach * reach or (int(u) == column and int(v) == row)) and z < picture[row, column]:
                    picture[row, column] = z
    return picture


@kernel
def _visible(local: Any, picture: Any, focal: float, tolerance: float, nearest: float, farthest: float) -> Any:
    height, width = picture.shape
    seen = np.zeros(local.shape[0], np.bool_)
    for i in range(local.shape[0]):
        z = local[i, 2]
        if nearest <= z <= farthest:
            column, row = int(np.floor(focal * local[i, 0] / z + 0.5 * width)), int(np.floor(focal * local[i, 1] / z + 0.5 * height))
            if 0 <= column < width and 0 <= row < height:
                seen[i] = z <= picture[row, column] + tolerance
    return seen


def visible_points(
    points: npt.ArrayLike,
    T_base_camera: Array,
    *,
    camera: Camera | None = None,
    blockers: Float32 | None = None,
    point_radius_m: float = 0.004,
    rng: np.random.Generator | None = None,
) -> tuple[Bool, Float32]:
    """Tell which points of a cloud a camera sees, and where it takes them to be.

    Args:
        points: (N, 3) of the plant [m].
        T_base_camera: (4, 4) pose of the camera, +z forwards.
        camera: its picture, range and noise.
        blockers: (M, 3) points of other bodies that hide the plant, such as the arm itself [m].
        point_radius_m: radius of the discs that points are drawn as: more than half the spacing of the cloud, or it is full of holes [m].
        rng: for noise and drop-outs; not needed without them.

    Returns:
        (N,) which points are seen, and (N, 3) where the camera takes them to be [m].
    """
    lens = camera or Camera()
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    rotation, origin = T_base_camera[:3, :3], T_base_camera[:3, 3]
    local = np.ascontiguousarray((cloud - origin) @ rotation, dtype=np.float32)
    others = (
        np.empty((0, 3), np.float32) if blockers is None else ((np.asarray(blockers, np.float64) - origin) @ rotation).astype(np.float32)
    )
    limits = lens.nearest_m, lens.farthest_m
    drawn = np.ascontiguousarray(np.concatenate([local, others]))
    picture = _depth_picture(drawn, point_radius_m, lens.focal_px, lens.width, lens.height, *limits)
    seen: Bool = _visible(local, picture, lens.focal_px, 2.0 * point_radius_m, *limits)
    if rng is None or (lens.edge_drop_out <= 0.0 and lens.noise_m <= 0.0):
        return seen, np.ascontiguousarray(cloud, dtype=np.float32)
    chosen = np.flatnonzero(seen)
    if lens.edge_drop_out > 0.0 and len(chosen):
        z = local[chosen, 2]
        column = np.floor(lens.focal_px * local[chosen, 0] / z + 0.5 * lens.width).astype(np.intp)
        row = np.floor(lens.focal_px * local[chosen, 1] / z + 0.5 * lens.height).astype(np.intp)
        framed = np.pad(picture, 1, mode="edge")
        near = np.min([framed[row + i, column + j] for i in range(3) for j in range(3)], axis=0)
        far = np.max([framed[row + i, column + j] for i in range(3) for j in range(3)], axis=0)
        at_edge = far - near > 4.0 * point_radius_m
        seen[chosen[at_edge & (rng.random(len(chosen)) < lens.edge_drop_out)]] = False
    moved = local.astype(np.float64)
    if lens.noise_m > 0.0:
        depth = np.maximum(moved[:, 2:3], 1e-6)
        moved *= 1.0 + lens.noise_m * depth * rng.standard_normal((len(moved), 1))  # along the ray
    return seen, np.ascontiguousarray(moved @ rotation.T + origin, dtype=np.float32)


def in_sight(
    places: npt.ArrayLike, T_base_camera: Array, things: Float32, *, camera: Camera | None = None, point_radius_m: float = 0.004
) -> Bool:
    """Tell which places (N, 3) a camera would see, (N,): inside its picture, and not behind any of the `things` (M, 3) [m]."""
    lens = camera or Camera()
    rotation, origin = T_base_camera[:3, :3], T_base_camera[:3, 3]
    local, hiding = (
        np.ascontiguousarray((np.asarray(points, np.float64).reshape(-1, 3) - origin) @ rotation, np.float32) for points in (places, things)
    )
    picture = _depth_picture(hiding, point_radius_m, lens.focal_px, lens.width, lens.height, lens.nearest_m, lens.farthest_m)
    result: Bool = _visible(local, picture, lens.focal_px, point_radius_m, lens.nearest_m, lens.farthest_m)
    return result


def seen_scene(
    scene: Scene,
    viewpoints: Sequence[npt.ArrayLike],
    *,
    target: npt.ArrayLike | None = None,
    camera: Camera | None = None,
    point_radius_m: float = 0.004,
    rng: np.random.Generator | None = None,
) -> Scene:
    """Return what cameras see of a scene, with the viewpoint of each point; what is known of the plant itself stays as it is.

    Args:
        scene: the whole plant.
        viewpoints: where the cameras stand, (3,) each [m].
        target: (3,) what they look at [m]; the middle of the points by default.
        camera: the same for all.
        point_radius_m: see `visible_points`.
        rng: see `visible_points`.

    Returns:
        The points that some camera sees, once each, where the first of them takes it to be; the others are counted as `not_seen`.

    Raises:
        ProblemError: there is no viewpoint, or one of them lies where the cameras look.
    """
    if not len(viewpoints):
        raise ProblemError("there is no viewpoint: at least one camera must look at the scene")
    points = np.concatenate([scene.leaf_points, scene.stem_points, scene.fruit_points])
    aim = points.mean(axis=0) if target is None else np.asarray(target, dtype=np.float64)
    views = [View(look_at(origin, aim)) for origin in viewpoints]
    return seen_in_views(scene, views, camera=camera, point_radius_m=point_radius_m, rng=rng)


@dataclass(frozen=True, eq=False)
class View:
    """One picture that a camera takes.

    Attributes:
        T_base_camera: (4, 4) where the camera is, +z forwards.
        blockers: (B, 3) points of what else is in the picture, the arm [m]; None for nothing.
        seed: of this picture's noise and drop-outs, so that it stays the same when others join it; None for the common generator.
    """

    T_base_camera: Array
    blockers: Float32 | None = None
    seed: int | None = None


@dataclass(frozen=True, eq=False)
class Picture:
    """What one view shows of a scene.

    Attributes:
        seen: (N,) which of its leaf, stem and fruit points, in this order.
        places: (N, 3) where the camera takes them to be [m].
        blocking: (B, 3) what it shows of the view's blockers [m].
    """

    seen: Bool
    places: Float32
    blocking: Float32


def take_picture(
    scene: Scene,
    view: View,
    *,
    camera: Camera | None = None,
    point_radius_m: float = 0.004,
    rng: np.random.Generator | None = None,
) -> Picture:
    """Take one picture of a scene; see `seen_in_views`."""
    points = np.concatenate([scene.leaf_points, scene.stem_points, scene.fruit_points])
    chance = rng if view.seed is None else np.random.default_rng(view.seed)
    seen, places = visible_points(
        points, view.T_base_camera, camera=camera, blockers=view.blockers, point_radius_m=point_radius_m, rng=chance
    )
    blocking = np.empty((0, 3), np.float32)
    if view.blockers is not None and len(view.blockers):
        blocking = view.blockers[in_sight(view.blockers, view.T_base_camera, points, camera=camera, point_radius_m=point_radius_m)]
    return Picture(seen, places, blocking)


def scene_in_pictures(scene: Scene, views: Sequence[View], pictures: Sequence[Picture]) -> Scene:
    """Return what pictures show of a scene together.

    Args:
        scene: the whole plant.
        views: what the pictures were taken from; pictures: one for each view.

    Returns:
        See `seen_scene`.
    """
    classes = (scene.leaf_points, scene.stem_points, scene.fruit_points)
    places = np.concatenate(classes)
    seen_by: Int16 = np.full(len(places), -1, dtype=np.int16)
    for number, picture in enumerate(pictures):
        new = picture.seen & (seen_by < 0)
        seen_by[new] = number
        places[new] = picture.places[new]
    ends = np.cumsum([len(part) for part in classes])[:2]
    leaf, stem, fruit = np.split(places, ends)
    leaf_ids, stem_ids, fruit_ids = np.split(seen_by, ends)
    whole = dataclasses.replace(
        scene,
        leaf_points=leaf,
        stem_points=stem,
        fruit_points=fruit,
        viewpoints=np.array([view.T_base_camera[:3, 3] for view in views], dtype=np.float32),
        leaf_view_ids=leaf_ids,
        stem_view_ids=stem_ids,
        fruit_view_ids=fruit_ids,
        blocking_points=np.concatenate([np.empty((0, 3), np.float32), *(picture.blocking for picture in pictures)]),
        blocking_view_ids=np.repeat(np.arange(len(pictures), dtype=np.int16), [len(picture.blocking) for picture in pictures]),
    )
    return subset(whole, leaf_ids >= 0, stem_ids >= 0, fruit_ids >= 0, reason="not_seen")


def seen_in_views(
    scene: Scene,
    views: Sequence[View],
    *,
    camera: Camera | None = None,
    point_radius_m: float = 0.004,
    rng: np.random.Generator | None = None,
) -> Scene:
    """Return what cameras see of a scene from given poses, with what else was in their pictures as blocking points.

    Args:
        scene: the whole plant.
        views: the pictures, at least one.
        camera: the same for all.
        point_radius_m: see `visible_points`.
        rng: see `visible_points`; for the views without a seed of their own.

    Returns:
        See `seen_scene`.
    """
    pictures = [take_picture(scene, view, camera=camera, point_radius_m=point_radius_m, rng=rng) for view in views]
    return scene_in_pictures(scene, views, pictures)
