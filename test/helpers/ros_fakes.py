"""A robot, a pipeline and clouds that cost nothing, for the tests of the ROS side."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time

from lime_planner.core.errors import ProblemError, Refusal
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.targets import target_of
from lime_planner.ros.inputs.clouds import encode_cloud
from lime_planner.ros.model_loader import Loaded

JOINTS = ("j1", "j2", "j3")
START = np.array([0.1, 7.0, -0.2])  # joint 2 is more than a turn away from zero


@dataclass(frozen=True)
class FakeRobot:
    """Three joints without a body."""

    name: str = "fake"
    joint_names: tuple[str, ...] = JOINTS
    planning_frame: str = "base"
    tool_frame: str = "tool"
    links: tuple[Any, ...] = ()
    warnings: tuple[str, ...] = ()
    held_joints: tuple[tuple[str, float], ...] = ()
    velocity_limits: np.ndarray = field(default_factory=lambda: np.full(3, 1.0))
    acceleration_limits: np.ndarray = field(default_factory=lambda: np.full(3, 2.0))
    lower: np.ndarray = field(default_factory=lambda: np.full(3, -np.inf))
    upper: np.ndarray = field(default_factory=lambda: np.full(3, np.inf))
    warnings: tuple[str, ...] = ()
    continuous: np.ndarray = field(default_factory=lambda: np.zeros(3, dtype=bool))

    def link_poses(self, q: np.ndarray) -> np.ndarray:
        return np.eye(4)[None]


@dataclass(frozen=True)
class FakeResult:
    """A result with the attributes that the node reads."""

    status: Status
    message: str
    waypoints: np.ndarray
    trajectory: Trajectory | None
    tool_path: np.ndarray
    tool_leaf: np.ndarray
    seed: int = 1
    T_base_tool: np.ndarray | None = None
    target: Any = None
    straight_from: int = 10**9
    approaches: np.ndarray = field(default_factory=lambda: np.zeros((0, 7)))
    approach_outcomes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def figures(self) -> dict[str, Any]:
        known = {"status": self.status.name, "message": self.message, "planner": "fake", "seed": self.seed}
        return {**known, "path_length_rad": 1.0, "waypoints": self.waypoints}


def trajectory(start: np.ndarray, goal: np.ndarray, duration_s: float, dt_s: float = 0.02) -> Trajectory:
    """A smooth straight motion with exact zeros at both ends."""
    count = max(round(duration_s / dt_s), 2)
    u = np.linspace(0.0, 1.0, count + 1)[:, None]
    velocities = 6.0 * u * (1.0 - u) * (goal - start) / (count * dt_s)
    velocities[[0, -1]] = 0.0
    return Trajectory(JOINTS[: len(start)], dt_s, start + u * u * (3.0 - 2.0 * u) * (goal - start), velocities)


def result(start: np.ndarray, goal: np.ndarray, duration_s: float = 0.5, T_base_tool: np.ndarray | None = None) -> FakeResult:
    """A successful plan."""
    return FakeResult(
        Status.SUCCEEDED,
        "SUCCEEDED: path of 1.0 rad",
        np.array([start, goal]),
        trajectory(start, goal, duration_s),
        np.tile([0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0], (5, 1)),
        np.zeros(5),
        T_base_tool=T_base_tool,
    )


class FakePipeline:
    """Plans by moving every joint by the target's x; a target with y = 8 takes a while, y = 9 for ever, z below 0 is out of reach.

    With 77 stem points there is a path only from where the last plan began.
    """

    def __init__(self, robot: FakeRobot, warm_up_s: float = 0.0, plan_s: float = 0.05, duration_s: float = 0.5) -> None:
        self.robot = robot
        self.warm_up_s = warm_up_s
        self.plan_s = plan_s
        self.duration_s = duration_s
        self.began_at = START

    def warm_up(self) -> None:
        time.sleep(self.warm_up_s)

    def plan(self, scene: Any, target: Any, q_start: Any, settings: Any, *, should_stop: Any, seed: int, **_: Any) -> FakeResult:
        aim = target_of(target)
        T_base_tool = pose_to_matrix(aim.shown_pose())
        if len(scene.stem_points) == 13:
            raise ProblemError("thirteen stems bring bad luck")
        if len(scene.stem_points) == 666:
            raise ZeroDivisionError("a defect")
        deadline = time.monotonic() + {8.0: 0.6, 9.0: 60.0}.get(float(T_base_tool[1, 3]), self.plan_s)
        while time.monotonic() < deadline and not should_stop():
            time.sleep(0.002)
        nothing = np.empty((0, 3)), None, np.empty((0, 7)), np.empty(0)
        if len(scene.stem_points) == 77 and np.abs(np.asarray(q_start) - self.began_at).max() > 0.02:
            return FakeResult(Status.NO_PATH, "NO_PATH: stems all around", *nothing, seed, T_base_tool, target=aim)
        if T_base_tool[2, 3] < 0.0:
            return FakeResult(Status.NO_IK_SOLUTION, "NO_IK_SOLUTION: out of reach", *nothing, seed, T_base_tool, target=aim)
        self.began_at = np.array(q_start)
        return dataclasses.replace(result(q_start, q_start + T_base_tool[0, 3], self.duration_s, T_base_tool), target=aim)

    def recheck(self, plan: FakeResult, scene: Any, q: np.ndarray, settings: Any, *, should_stop: Any) -> tuple[Status, str]:
        if np.abs(plan.waypoints[0] - q).max() > 0.01:
            return Status.START_INVALID, "the arm has moved since"
        return Status.SUCCEEDED, "still free"

    def follow(self, waypoints: np.ndarray, scene: Any, target: Any, settings: Any, **_: Any) -> FakeResult:
        T_base_tool = None if target is None else pose_to_matrix(target.shown_pose())
        return dataclasses.replace(result(waypoints[0], waypoints[-1], self.duration_s, T_base_tool), target=target)

    def obstruction(self, plan: FakeResult, scene: Any, settings: Any, *, should_stop: Any, from_time_s: float = 0.0) -> str | None:
        return "a stem stands 0.3 m ahead" if len(scene.stem_points) == 99 else None


def build_fake(settings: Any, urdf: str | None) -> Loaded:
    """A builder of the model loader."""
    robot = FakeRobot()
    return Loaded(robot, FakePipeline(robot))


def cloud(count: int, frame_id: str = "base", seed: int = 0, **columns: np.ndarray) -> Any:
    """A cloud of random points in a box beside the base."""
    msg = encode_cloud(np.random.default_rng(seed).uniform(0.3, 0.6, (count, 3)), columns)
    msg.header.frame_id = frame_id
    return msg


def never() -> bool:
    """A `should_stop` that lets everything run."""
    return False


def refusal_of(call: Callable[[], object]) -> tuple[Status, str]:
    """The code and the sentence with which a call is refused."""
    with pytest.raises(Refusal) as caught:
        call()
    return caught.value.status, str(caught.value)


def stamped(msg: Any, stamp_s: float) -> Any:
    """The message with another stamp."""
    msg.header.stamp = Time(sec=int(stamp_s), nanosec=int(stamp_s % 1.0 * 1e9))
    return msg


def tf_message(parent: str, child: str, x: float, at_s: float, *, yaw: float = 0.0) -> Any:
    """What a tf2_msgs/TFMessage with one transform looks like; the type itself is not in every environment."""
    stamp = SimpleNamespace(sec=int(at_s), nanosec=round((at_s % 1.0) * 1e9))
    rotation = SimpleNamespace(x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
    transform = SimpleNamespace(translation=SimpleNamespace(x=x, y=0.0, z=0.0), rotation=rotation)
    header = SimpleNamespace(frame_id=parent, stamp=stamp)
    return SimpleNamespace(transforms=[SimpleNamespace(header=header, child_frame_id=child, transform=transform)])


def encode_at(x: float, count: int, *, doubles: np.ndarray | None = None) -> Any:
    """A cloud of `count` points at (x, 0, 0), or one of given points in double precision."""
    if doubles is None:
        return encode_cloud(np.tile([x, 0.0, 0.0], (count, 1)))
    msg = encode_cloud(np.zeros((len(doubles), 3)))
    for k, axis in enumerate(msg.fields):
        axis.offset, axis.datatype = 8 * k, 8
    msg.point_step, msg.row_step = 24, 24 * len(doubles)
    msg.data = type(msg.data)("B")
    msg.data.frombytes(np.ascontiguousarray(doubles, dtype="<f8").tobytes())
    return msg
