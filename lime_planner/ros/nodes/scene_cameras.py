"""What depth cameras see of a scene, the arm in the picture included: one that the arm carries, or some that stand still."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, PointCloud2

from lime_planner.core.errors import ParameterError, Refusal
from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.core.types import Array, Float32
from lime_planner.pipeline.looks import T_TOOL_CAMERA
from lime_planner.robot.model import Robot, home, load_robot
from lime_planner.ros import qos
from lime_planner.ros.convert import JointReader, to_pose
from lime_planner.ros.inputs.clouds import encode_cloud
from lime_planner.scene.camera import Camera, View, look_at, seen_in_views
from lime_planner.scene.from_clouds import moved
from lime_planner.scene.scene import Scene

#: What `camera` may be; empty: no camera, every point of the scene is published as it is.
KINDS = ("", "wrist", "fixed", "all")
DEFAULT_RATE_HZ = 5.0  #: of each camera
#: Label of the arm's own points: of no class of the plant, as a segmentation may well leave them.
ARM_LABEL = 255
_ARM_SPACING_M, _ARM_SHARE = 0.003, 4  # dense enough to hide what is behind; one in so many is published, as dense as the plant's
_TRUE_STATES = "mock_arm/true_joint_states"  # what a mock arm really does, whatever it reports

WRIST_FRAME = "wrist_camera"
DEFAULT_VIEWPOINTS = np.array([[-0.4, 0.2, 0.8]])  #: behind the arm
_MOUNT = [float(v) for v in matrix_to_pose(T_TOOL_CAMERA)]

#: Name, default, meaning: of `scene_node`.
PARAMETERS: tuple[tuple[str, Any, str], ...] = (
    ("camera", "", "Publish what depth cameras see: `wrist` (on the arm), `fixed` (those of `viewpoints`), `all`; empty: every point."),
    ("camera_frame", WRIST_FRAME, "Frame of the clouds of the camera on the arm, +z forwards; fixed ones are camera_1, camera_2, ..."),
    ("camera_pose", _MOUNT, "Where the tool carries it: x y z qx qy qz qw in the tool's frame [m]."),
    ("viewpoints", DEFAULT_VIEWPOINTS[0].tolist(), "Where fixed cameras stand: x y z of each [m]; they look at the middle of the scene."),
    ("robot", "kinova_j2s6s200", "The arm in the pictures, which carries the camera: a built-in one, or a URDF file; empty: none."),
    ("camera_noise_m", 0.001, "Standard deviation of the depth at one metre [m]; it grows with the square of the distance."),
    ("camera_drop_out", 0.3, "Share of the pixels at depth edges that return nothing."),
)


@dataclass(frozen=True, eq=False)
class Mounted:
    """A camera, and what carries it.

    Attributes:
        frame: of its clouds.
        parent: the frame that it does not move against.
        T_parent_camera: (4, 4).
    """

    frame: str
    parent: str
    T_parent_camera: Array

    @property
    def transform(self) -> str:
        """Its place as `static_transforms` takes it."""
        return f"{self.parent} {self.frame} {' '.join(f'{v:.6f}' for v in matrix_to_pose(self.T_parent_camera))}"


def arm_camera(tool_frame: str, T_tool_camera: Array = T_TOOL_CAMERA, frame: str = WRIST_FRAME) -> Mounted:
    """The camera that the tool carries."""
    return Mounted(frame, tool_frame, T_tool_camera)


def fixed_cameras(scene: Scene, viewpoints: Array = DEFAULT_VIEWPOINTS) -> list[Mounted]:
    """Cameras at (V, 3) [m] that look at the middle of a scene."""
    middle = np.concatenate([scene.leaf_points, scene.stem_points, scene.fruit_points]).mean(axis=0)
    return [Mounted(f"camera_{k + 1}", scene.frame_id, look_at(place, middle)) for k, place in enumerate(viewpoints)]


def check(values: Mapping[str, Any]) -> None:
    """Check the cameras' parameters.

    Raises:
        ParameterError: names the parameter, its value and what is allowed.
    """
    if values["camera"] not in KINDS:
        raise ParameterError(f"camera is {values['camera']!r}; allowed: {', '.join(KINDS[1:])}, or empty")
    if not values["camera_frame"]:
        raise ParameterError("camera_frame is empty; it must name the frame of the camera on the arm")
    if not values["viewpoints"] or len(values["viewpoints"]) % 3:
        raise ParameterError(f"viewpoints needs x y z of at least one camera, got {len(values['viewpoints'])} numbers")
    for name, highest in (("camera_noise_m", 0.1), ("camera_drop_out", 1.0)):
        if not 0.0 <= float(values[name]) <= highest:
            raise ParameterError(f"{name} is {values[name]}; allowed: 0 to {highest:g}")
    pose_to_matrix([float(v) for v in values["camera_pose"]])


def arm_surface(robot: Robot) -> list[tuple[int, Float32]]:
    """Points on the surface of every link, (N, 3) in the frame of its joint [m], with the number of that."""
    rng = np.random.default_rng(0)
    surface = []
    for link in robot.links:
        a, b, c = (link.vertices[link.triangles[:, k]] for k in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        which = rng.choice(len(area), int(area.sum() / _ARM_SPACING_M**2) + 1, p=area / area.sum())
        u, v = np.sqrt(rng.random(len(which))), rng.random(len(which))
        points = (1.0 - u)[:, None] * a[which] + (u * (1.0 - v))[:, None] * b[which] + (u * v)[:, None] * c[which]
        surface.append((link.joint, points.astype(np.float32)))
    return surface


class SceneCameras:
    """Takes pictures of a scene, and tells where they were taken from."""

    def __init__(self, node: Node, values: Mapping[str, Any]) -> None:
        """Read the arm's description and listen to its joints.

        Args:
            node: publishes for the cameras.
            values: of the parameters.

        Raises:
            LimePlannerError: see `check`; the arm's description cannot be used.
        """
        check(values)
        self._node = node
        self._kind = str(values["camera"])
        self._wrist = self._kind in ("wrist", "all")
        self._frame = str(values["camera_frame"])
        self._viewpoints = np.array(values["viewpoints"], dtype=np.float64).reshape(-1, 3)
        self._T_tool_camera = pose_to_matrix([float(v) for v in values["camera_pose"]])
        self._lens = Camera(edge_drop_out=float(values["camera_drop_out"]), noise_m=float(values["camera_noise_m"]))
        self._rng = np.random.default_rng(int(values["seed"]))
        self._states: dict[str, JointState] = {}
        self._robot: Robot | None = None
        self._next = 0
        if self._wrist and not values["robot"]:
            raise ParameterError("robot is empty; a camera on the arm needs one")
        if values["robot"]:
            robot = self._robot = load_robot(str(values["robot"]))
            self._surface = arm_surface(robot)
            self._reader = JointReader(tuple(robot.joint_names), robot.held_joints)
            for topic in ("joint_states", _TRUE_STATES):
                node.create_subscription(JointState, topic, lambda msg, topic=topic: self._take(topic, msg), qos.JOINT_STATES)
            self._look_once(Scene.from_points(np.zeros((1, 3)), [0]))  # compiled before the first picture
        self._tf = _transform_publisher(node)

    def _look_once(self, scene: Scene) -> None:
        assert self._robot is not None
        view = View(self._robot.forward(home(self._robot)) @ self._T_tool_camera, self._arm(home(self._robot)))
        seen_in_views(scene, [view], camera=self._lens, rng=self._rng)

    def _take(self, topic: str, msg: JointState) -> None:
        if self._reader.concerns_the_arm(msg):
            self._states[topic] = msg

    def _arm(self, q: Array) -> Float32:
        """Points on the arm's surface at a configuration (n,), (P, 3) [m]."""
        assert self._robot is not None
        poses = self._robot.link_poses(q)
        return np.concatenate([moved(points, poses[joint]) for joint, points in self._surface])

    def _state(self) -> tuple[Array, Any] | None:
        """Where the arm really is, (n,) [rad], and the stamp of that; None where it is not known yet."""
        msg = self._states.get(_TRUE_STATES) or self._states.get("joint_states")
        if msg is None:
            return None
        try:
            return self._reader.configuration(msg), msg.header.stamp
        except Refusal:
            return None

    def cameras(self, scene: Scene) -> list[Mounted]:
        """The cameras around a scene, the one on the arm first."""
        found = []
        if self._wrist:
            assert self._robot is not None
            found.append(arm_camera(self._robot.tool_frame, self._T_tool_camera, self._frame))
        return found if self._kind == "wrist" else [*found, *fixed_cameras(scene, self._viewpoints)]

    def introduce(self, scene: Scene) -> list[str]:
        """Publish where the cameras are where tf2's messages are there; return it as `static_transforms` takes it."""
        cameras = self.cameras(scene)
        if self._tf is not None:
            self._tf(cameras)
        return [camera.transform for camera in cameras]

    def take_picture(self, scene: Scene, *, labelled: bool, spared: Array | None, spared_m: float) -> list[tuple[str, PointCloud2]]:
        """Take a picture with the next of the cameras.

        Args:
            scene: the plant.
            labelled: one cloud with labels, or leaves and stems.
            spared: (3,) place of a fruit that is left out of the stems.
            spared_m: how far around it.

        Returns:
            Topic and cloud, in the camera's frame; none while the arm is not known.
        """
        state = None if self._robot is None else self._state()
        if self._robot is not None and state is None:
            return []
        arm = None if state is None else self._arm(state[0])
        cameras = self.cameras(scene)
        camera = cameras[self._next % len(cameras)]
        self._next += 1
        T = camera.T_parent_camera
        if self._wrist and camera is cameras[0]:
            assert state is not None and self._robot is not None
            T = self._robot.forward(state[0]) @ T
        stamp = self._node.get_clock().now().to_msg() if state is None else state[1]
        seen = seen_in_views(scene, [View(T, arm)], camera=self._lens, rng=self._rng)
        of_arm = np.empty((0, 3), np.float32) if seen.blocking_points is None else seen.blocking_points[::_ARM_SHARE]
        clouds = _clouds(seen, of_arm, np.asarray(np.linalg.inv(T)), labelled, spared, spared_m)
        for _, cloud in clouds:
            cloud.header.frame_id, cloud.header.stamp = camera.frame, stamp
        return clouds


def _clouds(
    seen: Scene, arm: Float32, T_camera_base: Array, labelled: bool, spared: Array | None, spared_m: float
) -> list[tuple[str, PointCloud2]]:
    if labelled:
        points, labels, costs = seen.labelled_points()
        whole = moved(np.concatenate([points, arm]), T_camera_base)
        columns: dict[str, Any] = {
            "label": np.append(labels, np.full(len(arm), ARM_LABEL, np.uint8)),
            "permeability_cost": np.append(costs, np.ones(len(arm), np.float32)),
        }
        return [("labelled_cloud", encode_cloud(whole, columns))]
    leaves = encode_cloud(moved(seen.leaf_points, T_camera_base), {"permeability_cost": seen.leaf_costs})
    hard = np.concatenate([seen.impermeable_points(spared, spared_m), arm])
    return [("leaf_cloud", leaves), ("stem_cloud", encode_cloud(moved(hard, T_camera_base)))]


def _transform_publisher(node: Node) -> Any:
    """What publishes static transforms of cameras; None where tf2's messages cannot be imported."""
    try:
        from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        return None
    profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(TFMessage, "/tf_static", profile)

    def publish(cameras: Sequence[Mounted]) -> None:
        stamped = []
        for camera in cameras:
            pose = to_pose(matrix_to_pose(camera.T_parent_camera))
            transform = TransformStamped()
            transform.header.frame_id, transform.child_frame_id = camera.parent, camera.frame
            transform.header.stamp = node.get_clock().now().to_msg()
            t = transform.transform.translation
            t.x, t.y, t.z = pose.position.x, pose.position.y, pose.position.z
            transform.transform.rotation = pose.orientation
            stamped.append(transform)
        publisher.publish(TFMessage(transforms=stamped))

    return publish
