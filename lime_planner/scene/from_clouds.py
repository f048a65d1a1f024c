"""From point cloud messages to scenes, by the same rules for live clouds and for recorded ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import SceneError
from lime_planner.core.geometry import clean_name
from lime_planner.core.types import Array, Float32
from lime_planner.scene.arrays import precision_note
from lime_planner.scene.point_cloud2 import COST_FIELD, decode_cloud
from lime_planner.scene.scene import FRUIT, LEAF, STEM, Scene, merged
from lime_planner.scene.views.several import seen_by_several, without_hidden

Points = npt.NDArray[np.floating]

#: Inputs that carry points, in the order in which they are reported.
CLOUDS = ("leaf_cloud", "stem_cloud", "labelled_cloud")


class ArmFilter(Protocol):
    """Crops a scene to the arm's reach, and removes the arm from it."""

    def __call__(self, scene: Scene, q: Array | None, padding_m: float, /, *, base_position: Array | None = None) -> Scene:
        """Return the scene without the arm.

        Args:
            scene: in the planning frame where that was at the cloud's stamp.
            q: (n,) configuration at the cloud's stamp [rad]; None where that is not known.
            padding_m: points this close to the arm are its own.
            base_position: (3,) where the planning frame has moved to since [m]: what is in reach from there is kept.
        """
        ...


#: Frames of robots and maps (REP 105 names most of them), at whose origins no camera stands.
NO_CAMERAS = frozenset(("earth", "map", "odom", "world", "base", "base_link", "base_footprint"))

_BLOCK = 65_536  #: points that are moved at a time: they stay in the processor's cache


@dataclass(frozen=True)
class Labels:
    """How a labelled cloud is read; see `Scene.from_points`."""

    field: str = "label"
    leaf: tuple[int, ...] = (LEAF,)
    stem: tuple[int, ...] = (STEM,)
    fruit: tuple[int, ...] = (FRUIT,)
    ignored: tuple[int, ...] = ()
    class_costs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Origins:
    """Where clouds were seen from: the origin of their frame where that is a camera's; of the others by `viewpoints`.

    Attributes:
        viewpoints: x y z of each camera, in the planning frame [m]; none where that is not known.
        fixed_frame: a frame whose origin is no camera, like the planning frame and `NO_CAMERAS`.
    """

    viewpoints: tuple[float, ...] = ()
    fixed_frame: str = ""

    def of_frame(self, frame: str, planning_frame: str, T_planning_cloud: Array | None) -> Array | None:
        """Return the viewpoints (V, 3) [m] of a cloud, in the planning frame; None where they are not known."""
        name = clean_name(frame)
        no_camera = name in (planning_frame, clean_name(self.fixed_frame)) or name.rsplit("/", 1)[-1] in NO_CAMERAS
        if T_planning_cloud is not None and not no_camera:
            return np.asarray(T_planning_cloud[None, :3, 3])
        return np.array(self.viewpoints, dtype=np.float64).reshape(-1, 3) if self.viewpoints else None


def belonging_together(arrivals_s: Mapping[str, float]) -> tuple[str, ...]:
    """Return which of the newest clouds make one scene: the labelled one, or leaf and stem, whichever came last.

    A leaf cloud alone does not take the place of a labelled one: the stems are known from that one only.

    Args:
        arrivals_s: when the newest cloud of each input came, on any clock [s]; inputs without one are left out.

    Returns:
        Names of inputs. Without `stem_cloud` and `labelled_cloud` the stems are not known.
    """
    others = {name: arrival_s for name, arrival_s in arrivals_s.items() if name != "labelled_cloud"}
    labelled_s = arrivals_s.get("labelled_cloud")
    if labelled_s is not None and ("stem_cloud" not in others or all(labelled_s >= arrival_s for arrival_s in others.values())):
        return ("labelled_cloud",)
    return tuple(name for name in CLOUDS if name in others)


def scene_of_cloud(
    msg: Any,
    name: str,
    labels: Labels,
    planning_frame: str,
    transform: Callable[[Any], Array | None],
    *,
    origins: Origins = Origins(),
    topic: str | None = None,
    between: Callable[[], None] = lambda: None,
) -> Scene:
    """Make a scene of one cloud.

    Args:
        msg: the message: rclpy's, or another with the same attributes.
        name: of its input, one of `CLOUDS`.
        labels: how a labelled cloud is read.
        planning_frame: frame of the scene.
        transform: returns T_planning_cloud (4, 4) for the message's header, None where the frames are one.
        origins: where it was seen from.
        topic: what the cloud is called in sentences; by default its input.
        between: called between steps: each of them takes a fraction of a second where a cloud has millions of points.

    Raises:
        SceneError: the cloud cannot be used; the sentence begins with the topic.
    """
    topic, labelled = topic or name, name == "labelled_cloud"
    cloud = decode_cloud(msg, topic, required=(labels.field,) if labelled else (), optional=(COST_FIELD,))
    between()
    T_planning_cloud = transform(msg.header) if len(cloud.points) else None
    points = cloud.points if T_planning_cloud is None else moved(cloud.points, T_planning_cloud)
    between()
    viewpoints = origins.of_frame(msg.header.frame_id, planning_frame, T_planning_cloud) if len(points) else None
    seen: dict[str, Any] = {}
    if viewpoints is not None and len(viewpoints) > 1:
        seen = dict(zip(("view_ids", "blocking_points", "blocking_view_ids"), seen_by_several(points, viewpoints), strict=True))
        between()
    one_class = np.full(len(points), LEAF if name == "leaf_cloud" else STEM, np.uint8)
    try:
        scene = Scene.from_points(
            points,
            cloud.columns[labels.field] if labelled else one_class,
            frame_id=planning_frame,
            leaf_labels=labels.leaf if labelled else (LEAF,),
            stem_labels=labels.stem if labelled else (STEM,),
            fruit_labels=labels.fruit if labelled else (),
            ignored_labels=labels.ignored if labelled else (),
            class_costs=labels.class_costs if labelled else (),
            permeability_cost=cloud.columns.get(COST_FIELD),
            viewpoints=viewpoints,
            **seen,
            notes=tuple(f"{topic}: {note}" for note in precision_note(cloud.points)),
        )
    except SceneError as error:
        raise SceneError(f"{topic}: {error}") from None
    between()
    return scene


def one_picture(parts: Sequence[Scene], planning_frame: str) -> Scene:
    """Put the scenes of clouds of one moment together, leaves and stems.

    Where several cameras share a cloud, and who saw what was told by what hides what, a leaf may hide a stem from one of them.
    """
    if len(parts) == 1:
        return parts[0]
    scene = merged(parts, planning_frame, one_picture=True)
    shared = any(part.viewpoints is not None and len(part.viewpoints) > 1 for part in parts)
    return without_hidden(scene) if shared else scene


def unfiltered(scene: Scene, q: Array | None, padding_m: float, /, *, base_position: Array | None = None) -> Scene:
    """Leave a scene as it is: the filter of no arm."""
    return scene


def without_arm(scene: Scene, arm_filter: ArmFilter, q: Array | None, padding_m: float, T_now_then: Array | None) -> Scene:
    """Remove the arm from a scene, and bring that to where the planning frame is now.

    Args:
        scene: in the planning frame where that was at the cloud's stamp.
        arm_filter: see there.
        q: (n,) configuration at the cloud's stamp [rad]; None where that is not known.
        padding_m: points this close to the arm are its own.
        T_now_then: (4, 4) of the planning frame of the cloud's stamp in that of now; None where it has not moved.
    """
    if T_now_then is None:
        return arm_filter(scene, q, padding_m)
    there = arm_filter(scene, q, padding_m, base_position=np.asarray(np.linalg.inv(T_now_then)[:3, 3], dtype=np.float64))
    return there.transformed(T_now_then)


def moved(points: Points, T: Array) -> Float32:
    """Return points (N, 3) brought into another frame by T (4, 4), in double precision up to there: a map's coordinates are large."""
    result = np.empty((len(points), 3), np.float32)
    rotation, translation = np.ascontiguousarray(T[:3, :3].T), T[:3, 3]
    with np.errstate(invalid="ignore", over="ignore"):
        for begin in range(0, len(points), _BLOCK):
            block = points[begin : begin + _BLOCK].astype(np.float64)
            result[begin : begin + _BLOCK] = block @ rotation + translation
    return result
