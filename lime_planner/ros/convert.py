"""Messages to arrays and back, for everything but clouds and markers.

Every scalar that goes into a message passes through `float()`, `int()` or `bool()`: the generated Python classes accept an int in
a float field and send garbage.
"""

from __future__ import annotations

import array
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PointStamped, Pose, PoseArray, PoseStamped
from nav_msgs.msg import Path
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from lime_planner.core.errors import ProblemError, Refusal
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.targets import MAX_CANDIDATES, Target, candidates_target, fruit_target, pose_target


def stamp_s(stamp: Time) -> float:
    """Return a stamp in seconds; 0.0 means "not stamped"."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def stamp_text(stamp: Time) -> str:
    """Return a stamp with all its digits (a double holds only 0.2 µs today)."""
    return f"{stamp.sec}.{stamp.nanosec:09d}"


def to_duration(time_s: float) -> Duration:
    """Return a duration, rounded to whole nanoseconds."""
    nanoseconds = round(time_s * 1e9)
    return Duration(sec=int(nanoseconds // 1_000_000_000), nanosec=int(nanoseconds % 1_000_000_000))


#: How far a joint that plans take to stay may be from its place [rad or m].
_HELD_TOLERANCE = 0.01


class JointReader:
    """Picks the arm's joints out of joint states, by name."""

    def __init__(self, joint_names: Sequence[str], held: Sequence[tuple[str, float]] = ()) -> None:
        """Make a reader.

        Args:
            joint_names: the arm's joints in its own order.
            held: joints that carry the arm, or a part of it, and where plans take them to stay [rad or m].
        """
        self.joint_names = tuple(joint_names)
        self._held = tuple(held)
        self._elsewhere: dict[str, str] = {}
        self._known: tuple[tuple[str, ...], npt.NDArray[np.intp]] | None = None

    def configuration(self, msg: JointState) -> Array:
        """Return the configuration (n,) in arm order [rad], turns kept as measured.

        Raises:
            Refusal: BAD_INPUT: a joint is missing, named twice, or not finite; names and positions differ in number; a joint that is
                held was last seen elsewhere.
        """
        names = tuple(msg.name)
        if len(msg.position) != len(names):
            raise Refusal(Status.BAD_INPUT, f"the joint state has {len(names)} names but {len(msg.position)} positions")
        if self._known is None or self._known[0] != names:
            self._known = (names, self._indices(names))
        q = np.frombuffer(msg.position, dtype=np.float64)[self._known[1]]
        if not np.isfinite(q).all():
            bad = [f"{name} = {value}" for name, value in zip(self.joint_names, q, strict=True) if not np.isfinite(value)]
            raise Refusal(Status.BAD_INPUT, f"the joint state is not finite: {', '.join(bad)}")
        if self._elsewhere:
            raise Refusal(Status.BAD_INPUT, "; ".join(self._elsewhere.values()))
        return q

    def look_at_held(self, msg: JointState) -> None:
        """Notice where held joints are; they may come in messages of their own."""
        for name, position in self._held:
            if name not in msg.name or msg.name.index(name) >= len(msg.position):
                continue
            measured = msg.position[msg.name.index(name)]
            self._elsewhere.pop(name, None)
            if not abs(measured - position) <= _HELD_TOLERANCE:
                sentence = f"the joint {name} is at {measured:.3f}, but every plan takes it to stay at {position:.3f}"
                self._elsewhere[name] = f"{sentence}: set planning_frame to a link beyond it"

    def concerns_the_arm(self, msg: JointState) -> bool:
        """Tell whether a message names any of the arm's joints; fingers may come in messages of their own."""
        return not set(self.joint_names).isdisjoint(msg.name)

    def _indices(self, names: tuple[str, ...]) -> npt.NDArray[np.intp]:
        missing = [name for name in self.joint_names if name not in names]
        if missing:
            raise Refusal(Status.BAD_INPUT, f"the joint state has no joint {', '.join(missing)}; it has {', '.join(names) or 'none'}")
        twice = [name for name in self.joint_names if names.count(name) > 1]
        if twice:
            raise Refusal(Status.BAD_INPUT, f"the joint state names {', '.join(twice)} more than once")
        return np.array([names.index(name) for name in self.joint_names], dtype=np.intp)


def pose_array(pose: Pose) -> Array:
    """Return x y z qx qy qz qw [m, -], (7,), as they are in the message."""
    p, o = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w], dtype=np.float64)


#: Messages that say what is to be reached: a pose of the tool, a fruit, or candidates.
TargetMessage: TypeAlias = PoseStamped | PointStamped | PoseArray


def read_target(msg: TargetMessage) -> Target:
    """Return what a target message asks for, in its own frame; a pose is exact until the parameters say otherwise.

    Raises:
        Refusal: BAD_INPUT: empty frame, a number that is not finite, a quaternion of length zero, no candidate, or too many.
    """
    if not msg.header.frame_id.strip("/ "):
        raise Refusal(Status.BAD_INPUT, "the target has an empty frame_id; it must name the frame of its pose")
    try:
        if isinstance(msg, PointStamped):
            return fruit_target([msg.point.x, msg.point.y, msg.point.z])
        if isinstance(msg, PoseArray):
            if len(msg.poses) > MAX_CANDIDATES:  # before anything is done with each of them
                raise ProblemError(f"there are {len(msg.poses)} grasp candidates; at most {MAX_CANDIDATES} are allowed")
            return candidates_target([pose_array(pose) for pose in msg.poses])
        return pose_target(pose_array(msg.pose))
    except ProblemError as error:
        raise Refusal(Status.BAD_INPUT, f"the target cannot be used: {error}") from None


def to_pose(values: npt.ArrayLike) -> Pose:
    """Make a pose of x y z qx qy qz qw."""
    x, y, z, qx, qy, qz, qw = (float(v) for v in np.asarray(values, dtype=np.float64))
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = qx, qy, qz, qw
    return pose


def to_pose_stamped(T: npt.ArrayLike, frame_id: str, stamp: Time) -> PoseStamped:
    """Make a stamped pose of a matrix (4, 4)."""
    msg = PoseStamped()
    msg.header.frame_id, msg.header.stamp = frame_id, stamp
    msg.pose = to_pose(matrix_to_pose(T))
    return msg


def to_path(tool_path: npt.ArrayLike, frame_id: str, stamp: Time) -> Path:
    """Make a path of tool poses (K, 7); empty when there are none."""
    msg = Path()
    msg.header.frame_id, msg.header.stamp = frame_id, stamp
    for values in np.asarray(tool_path, dtype=np.float64).reshape(-1, 7):
        pose = PoseStamped(header=msg.header)
        pose.pose = to_pose(values)
        msg.poses.append(pose)
    return msg


def to_joint_trajectory(trajectory: Trajectory) -> JointTrajectory:
    """Make the motion command: stamp zero, positions and velocities in every point, nothing else."""
    msg = JointTrajectory()
    msg.joint_names = list(trajectory.joint_names)
    for time_s, position, velocity in zip(trajectory.times(), trajectory.positions, trajectory.velocities, strict=True):
        point = JointTrajectoryPoint()
        point.positions = array.array("d", position.tobytes())
        point.velocities = array.array("d", velocity.tobytes())
        point.time_from_start = to_duration(float(time_s))
        msg.points.append(point)
    return msg
