"""The picture for RViz and Foxglove: clouds as used, tool path and touched leaves, arm at the goal, target, keep-outs, search tree."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.core.types import Array, Int64
from lime_planner.output.approach_lines import approach_lines
from lime_planner.pipeline.goals import ARM_BLOCKED, DEARER, FREE, HAND_BLOCKED, NO_ROOM, OUT_OF_REACH, OUTCOMES
from lime_planner.pipeline.result import PlanRecord
from lime_planner.ros.convert import to_pose

#: Points shown of each class; more only slows the display down.
_SHOWN = 10_000

_LEAF = (0.25, 0.65, 0.25, 0.6)
_STEM = (0.45, 0.30, 0.15, 1.0)
_FRUIT = (0.75, 0.85, 0.10, 1.0)
_FREE = (0.10, 0.45, 0.85, 1.0)
_TOUCHING = (0.90, 0.25, 0.10, 1.0)


#: Colour of the line of an approach, by what became of it; fainter the less it may matter.
_OUTCOME_COLOURS = {
    FREE: (0.15, 0.65, 0.30, 0.9),
    DEARER: (0.62, 0.80, 0.55, 0.6),
    HAND_BLOCKED: (0.85, 0.20, 0.10, 0.5),
    ARM_BLOCKED: (0.95, 0.55, 0.10, 0.6),
    NO_ROOM: (0.55, 0.35, 0.75, 0.6),
    OUT_OF_REACH: (0.5, 0.5, 0.5, 0.4),
}
_APPROACHES = 600  # lines at most
_GOAL_ARM = (0.55, 0.60, 0.70, 0.45)
_UNSEEN = (0.35, 0.30, 0.55, 0.35)
_TREE = (0.5, 0.5, 0.5, 0.4)


@dataclass(frozen=True, eq=False)
class Extras:
    """What has to be computed for the picture alone.

    Attributes:
        goal_arm: (T, 3, 3) triangles of the arm at the path's end [m].
        touched: (P, 3) leaf points that the arm touches on its way [m].
        tree: (S, 2, 3) tool positions at both ends of each piece of the search tree's edges [m].
        unseen: (U, 3) middles of the voxels that no camera has seen [m].
    """

    goal_arm: npt.NDArray[np.floating] = field(default_factory=lambda: np.empty((0, 3, 3)))
    touched: npt.NDArray[np.floating] = field(default_factory=lambda: np.empty((0, 3)))
    tree: npt.NDArray[np.floating] = field(default_factory=lambda: np.empty((0, 2, 3)))
    unseen: npt.NDArray[np.floating] = field(default_factory=lambda: np.empty((0, 3)))


def _colour(rgba: tuple[float, float, float, float]) -> ColorRGBA:
    return ColorRGBA(r=rgba[0], g=rgba[1], b=rgba[2], a=rgba[3])


def _points(xyz: npt.ArrayLike) -> list[Point]:
    rows = np.asarray(xyz, dtype=np.float64).reshape(-1, 3).tolist()
    return [Point(x=x, y=y, z=z) for x, y, z in rows]


class _Picture:
    """Collects markers of one frame and time."""

    def __init__(self, frame_id: str, stamp: Time) -> None:
        self.array = MarkerArray()
        self._frame_id = frame_id
        self._stamp = stamp
        clear = self._marker("", Marker.CUBE, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
        clear.action = Marker.DELETEALL

    def _marker(self, namespace: str, kind: int, scale: tuple[float, float, float], rgba: tuple[float, float, float, float]) -> Marker:
        marker = Marker(ns=namespace, id=len(self.array.markers), type=kind, action=Marker.ADD)
        marker.header.frame_id, marker.header.stamp = self._frame_id, self._stamp
        marker.scale.x, marker.scale.y, marker.scale.z = scale
        marker.color = _colour(rgba)
        marker.pose.orientation.w = 1.0
        self.array.markers.append(marker)
        return marker

    def cloud(
        self, namespace: str, points: npt.NDArray[np.floating], rgba: tuple[float, float, float, float], size_m: float = 0.004
    ) -> None:
        """Add points, thinned evenly to what can be shown."""
        if len(points):
            step = -(-len(points) // _SHOWN)
            self._marker(namespace, Marker.POINTS, (size_m, size_m, 0.0), rgba).points = _points(points[::step])

    def body(self, namespace: str, triangles: npt.NDArray[np.floating], rgba: tuple[float, float, float, float]) -> None:
        """Add a surface of triangles (T, 3, 3)."""
        if len(triangles):
            self._marker(namespace, Marker.TRIANGLE_LIST, (1.0, 1.0, 1.0), rgba).points = _points(triangles)

    def path(self, tool_path: Array, tool_leaf: Array) -> None:
        """Add the tool's line, touching parts in another colour."""
        if len(tool_path) < 2:
            return
        marker = self._marker("tool_path", Marker.LINE_STRIP, (0.006, 0.0, 0.0), _FREE)
        marker.points = _points(tool_path[:, :3])
        touching = np.zeros(len(tool_path), dtype=bool)
        known = np.asarray(tool_leaf, dtype=np.float64)[: len(tool_path)]
        touching[: len(known)] = known > 0.0
        marker.colors = [_colour(_TOUCHING if leaf else _FREE) for leaf in touching]

    def tree(self, edges: npt.NDArray[np.floating]) -> None:
        """Add the search tree as tool positions at both ends of each piece of its edges, (S, 2, 3)."""
        if len(edges):
            step = -(-len(edges) // (_SHOWN // 2))
            self._marker("tree", Marker.LINE_LIST, (0.001, 0.0, 0.0), _TREE).points = _points(edges[::step].reshape(-1, 3))

    def target(self, T_base_tool: Array, radius_m: float) -> None:
        """Add the approach direction (the tool's +z) and the excluded sphere."""
        tip = T_base_tool[:3, 3]
        arrow = self._marker("target", Marker.ARROW, (0.008, 0.016, 0.02), (0.85, 0.1, 0.6, 1.0))
        arrow.points = _points([tip - 0.1 * T_base_tool[:3, 2], tip])
        if radius_m > 0.0:
            sphere = self._marker("excluded_sphere", Marker.SPHERE, (2.0 * radius_m,) * 3, (0.85, 0.1, 0.6, 0.15))
            sphere.pose = to_pose(matrix_to_pose(T_base_tool))

    def approaches(self, poses: Array, outcomes: Int64) -> None:
        """Add the approaches that were tried, (A, 7), as short lines along the palm's axis, coloured by what became of them."""
        if not len(poses):
            return
        step = -(-len(poses) // _APPROACHES)
        lines = approach_lines(poses[::step])
        for outcome, rgba in _OUTCOME_COLOURS.items():
            chosen = outcomes[::step] == outcome
            if chosen.any():
                marker = self._marker(f"approaches_{OUTCOMES[outcome]}", Marker.LINE_LIST, (0.0015, 0.0, 0.0), rgba)
                marker.points = _points(lines[chosen].reshape(-1, 3))

    def boxes(self, boxes: tuple[float, ...]) -> None:
        """Add keep-out boxes: min x y z, max x y z each."""
        for k in range(0, len(boxes), 6):
            low, high = np.array(boxes[k : k + 3]), np.array(boxes[k + 3 : k + 6])
            size = tuple(float(v) for v in high - low)
            marker = self._marker("keep_out_boxes", Marker.CUBE, (size[0], size[1], size[2]), (0.8, 0.1, 0.1, 0.25))
            middle = (low + high) / 2.0
            marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = (float(v) for v in middle)


def markers(record: PlanRecord, stamp: Time, extras: Extras | None = None) -> MarkerArray:
    """Draw one plan.

    Args:
        record: the plan with what it was made of.
        stamp: now.
        extras: what was computed for the picture alone.
    """
    extras = extras or Extras()
    scene, result, settings = record.scene, record.result, record.settings
    picture = _Picture(scene.frame_id, stamp)
    picture.cloud("leaves", scene.leaf_points, _LEAF)
    picture.cloud("stems", scene.stem_points, _STEM)
    picture.cloud("fruit", scene.fruit_points, _FRUIT)
    picture.cloud("unseen", extras.unseen, _UNSEEN, 0.006)
    picture.boxes(settings.keep_out_boxes)
    if record.target is not None:
        exact = result.target is None or result.target.exact
        picture.target(pose_to_matrix(record.target), settings.target_exclusion_radius_m if exact else 0.0)
    picture.approaches(result.approaches, result.approach_outcomes)
    picture.cloud("touched_leaves", extras.touched, _TOUCHING, 0.007)
    picture.body("goal_arm", extras.goal_arm, _GOAL_ARM)
    picture.tree(extras.tree)
    picture.path(result.tool_path.reshape(-1, 7), result.tool_leaf)
    return picture.array
