"""Publishes a scene from a file or from the plant generator: clouds, whole or as depth cameras see them, and a target."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from lime_planner.core.errors import LimePlannerError, ParameterError
from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.core.types import Array
from lime_planner.pipeline.scene_targets import own_target
from lime_planner.ros import qos
from lime_planner.ros.convert import to_pose
from lime_planner.ros.inputs.clouds import encode_cloud
from lime_planner.ros.nodes import scene_cameras
from lime_planner.ros.nodes.scene_cameras import DEFAULT_RATE_HZ, SceneCameras
from lime_planner.ros.programs import answered
from lime_planner.ros.runtime import run_node
from lime_planner.scene.plants.generator import DENSITIES, PlantOptions, generate_plant
from lime_planner.scene.plants.grasp_targets import canopy_targets
from lime_planner.scene.scene import DEFAULT_FRAME, Scene

#: Name, default, meaning.
_PARAMETERS: tuple[tuple[str, Any, str], ...] = (
    ("file", "", "Scene file (.npz, .ply, .pcd); empty: grow a plant."),
    ("label_field", "label", "Name of the label in PLY and PCD files."),
    ("scale", 1.0, "Metres for each unit of the file."),
    ("offset", [0.0, 0.0, 0.0], "Then move the scene by this x y z [m]."),
    ("seed", 7, "Seed of the plant, and of the target where the file has none."),
    ("density", "medium", f"Foliage of the plant: one of {', '.join(DENSITIES)}."),
    ("target", [], "Grasp pose x y z qx qy qz qw; empty: the scene's own, or a drawn one."),
    ("approach", "free", "What the target is where the scene knows its fruit: `free` (fruit_target), `fixed` (grasp_target)."),
    ("labelled", False, "Publish `labelled_cloud` instead of `leaf_cloud` and `stem_cloud`."),
    (
        "rate_hz",
        0.0,
        f"Publish the clouds again this often with a new stamp; 0: once, for all who come; each camera {DEFAULT_RATE_HZ:g} Hz.",
    ),
    ("reliable", True, "Publish the clouds reliably and latched; false: best effort, as many camera drivers do."),
    *scene_cameras.PARAMETERS,
)
#: Set at start only: topics, profiles and frames depend on them.
_AT_START = frozenset(("labelled", "reliable", *(name for name, _, _ in scene_cameras.PARAMETERS)))
_TARGET_FRUIT_RADIUS_M = 0.06


@dataclass(frozen=True)
class _Published:
    """A scene and the target that goes with it: the pose of a grasp (7,), or the centre of a fruit (3,)."""

    scene: Scene
    target: Array | None
    fruit: Array | None = None


def make_scene(values: Mapping[str, Any]) -> _Published:
    """Load or grow the scene of some parameter values.

    Raises:
        LimePlannerError: the file cannot be used, or a value is out of range.
    """
    rng = np.random.default_rng(int(values["seed"]))
    offset = [float(v) for v in values["offset"]]
    if len(offset) != 3:
        raise ParameterError(f"offset needs 3 numbers, got {len(offset)}")
    if not 0.0 <= float(values["rate_hz"]) <= 100.0:
        raise ParameterError(f"rate_hz is {values['rate_hz']}; allowed: 0 to 100 Hz")
    if values["file"]:
        scene = Scene.load(
            values["file"],
            frame_id=DEFAULT_FRAME,
            scale=float(values["scale"]),
            offset=offset,
            label_field=str(values["label_field"]),
        )
    else:
        scene = generate_plant(rng, PlantOptions(density=str(values["density"]))).placed(float(values["scale"]), offset)
    given = [float(v) for v in values["target"]]
    if given:
        return _Published(scene, matrix_to_pose(pose_to_matrix(given)))
    if values["approach"] not in ("free", "fixed"):
        raise ParameterError(f"approach is {values['approach']!r}; allowed: free, fixed")
    own = own_target(scene, "exact", np.zeros(3)) if values["approach"] == "free" else None
    if own is not None and own.kind == "fruit":
        return _Published(scene, scene.target_pose, own.centre)
    if scene.target_pose is not None:
        return _Published(scene, scene.target_pose)
    drawn = canopy_targets(scene, rng, 1) if len(scene.leaf_points) else []
    return _Published(scene, drawn[0] if drawn else None)


def unused(given: Iterable[str], values: Mapping[str, Any]) -> list[str]:
    """Return which parameters given at start do nothing, a sentence each.

    Args:
        given: names of the parameters that were given.
        values: the values of the node's own.
    """
    known = [name for name, _, _ in _PARAMETERS]
    sentences = []
    for name in given:
        if name in ("use_sim_time", "start_type_description_service") or name.startswith("qos_overrides."):
            continue
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(known)}"
            sentences.append(f"there is no parameter {name!r}, its value is ignored; {hint}")
        elif name == "density" and values["file"]:
            sentences.append("density is not used: the scene comes from a file")
        elif not values.get("camera") and name in {other for other, _, _ in scene_cameras.PARAMETERS[1:]}:
            sentences.append(f"{name} is not used: it is about cameras, and camera is empty")
        elif name == "label_field" and not str(values["file"]).lower().endswith((".ply", ".pcd")):
            sentences.append("label_field is not used: it names a field of PLY and PCD files")
    return sentences


class SceneNode(Node):
    """The node `scene`."""

    def __init__(self) -> None:
        """Publish the scene of the parameters.

        Raises:
            LimePlannerError: see `make_scene`.
        """
        super().__init__("scene")
        for name, default, description in _PARAMETERS:
            self.declare_parameter(name, default, ParameterDescriptor(description=description, dynamic_typing=True))
        for sentence in unused(self._parameter_overrides, self._values()):
            self.get_logger().warning(sentence)
        values = self._values()
        self._published = make_scene(values)
        scene_cameras.check(values)
        self._cameras = SceneCameras(self, values) if values["camera"] else None
        for note in self._published.scene.notes:
            self.get_logger().warning(note)
        reliable = bool(self.get_parameter("reliable").value)
        profile = qos.LATCHED if reliable else _best_effort()
        self._clouds = {
            name: self.create_publisher(PointCloud2, name, profile)
            for name in (("labelled_cloud",) if self.get_parameter("labelled").value else ("leaf_cloud", "stem_cloud"))
        }
        self._target = self.create_publisher(PoseStamped, "grasp_target", qos.LATCHED)
        self._fruit = self.create_publisher(PointStamped, "fruit_target", qos.LATCHED)
        self._pending: _Published | None = None
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._apply)
        self._timer: Any = None
        self._set_rate()
        self._publish_all()

    def _values(self, changed: Sequence[Parameter] = ()) -> dict[str, Any]:
        values = {name: self.get_parameter(name).value for name, _, _ in _PARAMETERS}
        values.update({parameter.name: parameter.value for parameter in changed if parameter.name in values})
        return values

    def _check(self, changed: Sequence[Parameter]) -> SetParametersResult:
        names = {parameter.name for parameter in changed}
        if names & _AT_START:
            reason = f"{', '.join(sorted(names & _AT_START))} can be set at start only"
            return SetParametersResult(successful=False, reason=reason)
        if not names & {name for name, _, _ in _PARAMETERS}:
            return SetParametersResult(successful=True)
        try:
            self._pending = make_scene(self._values(changed))
        except (LimePlannerError, TypeError, ValueError, OverflowError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, changed: Sequence[Parameter]) -> None:
        if self._pending is not None:
            self._published, self._pending = self._pending, None
            self._set_rate()
            self._publish_all()

    def _set_rate(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        rate_hz = float(self.get_parameter("rate_hz").value)
        if self._cameras is not None:
            rate_hz = (rate_hz or DEFAULT_RATE_HZ) * len(self._cameras.cameras(self._published.scene))
        if rate_hz > 0.0:
            self._timer = self.create_timer(1.0 / rate_hz, self._publish_clouds)

    def _publish_all(self) -> None:
        self._publish_clouds()
        scene, target, fruit = self._published.scene, self._published.target, self._published.fruit
        if fruit is not None:
            point = PointStamped()
            point.point.x, point.point.y, point.point.z = (float(v) for v in fruit)
            point.header.frame_id, point.header.stamp = scene.frame_id, self.get_clock().now().to_msg()
            self._fruit.publish(point)
        elif target is not None:
            msg = PoseStamped(pose=to_pose(target))
            msg.header.frame_id, msg.header.stamp = scene.frame_id, self.get_clock().now().to_msg()
            self._target.publish(msg)
        place, what = (target, "target") if fruit is None else (fruit, "target fruit")
        where = "no target" if place is None else f"{what} at {place[0]:.3f} {place[1]:.3f} {place[2]:.3f}"
        leaves, stems, limes = len(scene.leaf_points), len(scene.stem_points), len(scene.fruit_points)
        if self._cameras is not None:
            for line in self._cameras.introduce(scene):
                self.get_logger().info(f"a camera, as static_transforms takes it: {line}")
        self.get_logger().info(f"publishing {leaves} leaf, {stems} stem and {limes} fruit points in {scene.frame_id}, {where}")

    def _publish_clouds(self) -> None:
        scene, target = self._published.scene, self._published.target
        if self._cameras is not None:
            spared = None if target is None or self._published.fruit is not None else target[:3]
            labelled = "labelled_cloud" in self._clouds
            for name, msg in self._cameras.take_picture(scene, labelled=labelled, spared=spared, spared_m=_TARGET_FRUIT_RADIUS_M):
                self._clouds[name].publish(msg)
            return
        stamp = self.get_clock().now().to_msg()
        for name, publisher in self._clouds.items():
            msg = self._cloud(name)
            msg.header.frame_id, msg.header.stamp = scene.frame_id, stamp
            publisher.publish(msg)

    def _cloud(self, name: str) -> PointCloud2:
        scene, target = self._published.scene, self._published.target
        if name == "labelled_cloud":
            points, labels, costs = scene.labelled_points()
            return encode_cloud(points, {"label": labels, "permeability_cost": costs})
        if name == "leaf_cloud":
            return encode_cloud(scene.leaf_points, {"permeability_cost": scene.leaf_costs})
        position = None if target is None or self._published.fruit is not None else target[:3]  # a fruit is hard until it is held
        return encode_cloud(scene.impermeable_points(position, _TARGET_FRUIT_RADIUS_M))


def _best_effort() -> QoSProfile:
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


def parameter_help() -> list[tuple[str, str]]:
    """Return every parameter's name and what it is, default included, for `--help`."""
    return [
        (name, text if default in ([], "") else f"{text} [default {str(default).lower() if isinstance(default, bool) else default}]")
        for name, default, text in _PARAMETERS
    ]


def main() -> int:
    """Run the node until a signal. A scene that cannot be used ends it with code 2 and a sentence."""
    code = answered("scene_node", sys.argv[1:])
    if code is not None:
        return code

    def factory() -> SceneNode:
        try:
            return SceneNode()
        except LimePlannerError as error:
            rclpy.try_shutdown()
            print(f"scene_node: {error}", file=sys.stderr)
            raise SystemExit(2) from None

    return run_node(factory)


if __name__ == "__main__":
    sys.exit(main())
