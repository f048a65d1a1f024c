"""From a recording to a scene and a start, as the node would have made them of the same messages."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.errors import ProblemError, SceneError
from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.core.transforms import TransformTree, clean_name
from lime_planner.core.types import Array
from lime_planner.scene.bag import CLOUD, JOINTS, POSE, Recorded, Recording
from lime_planner.scene.files import Start
from lime_planner.scene.point_cloud2 import decode_cloud
from lime_planner.scene.scene import FRUIT, LEAF, STEM, Scene, merged

#: Removes the arm from a cloud: (scene, configuration at the cloud's time or None, padding [m]) -> scene.
ArmFilter = Callable[[Scene, Array | None, float], Scene]

#: The inputs of the planner that a recording may hold, and their types.
INPUTS: Mapping[str, str] = {
    "leaf_cloud": CLOUD,
    "stem_cloud": CLOUD,
    "labelled_cloud": CLOUD,
    "grasp_target": POSE,
    "joint_states": JOINTS,
}
_COST = "permeability_cost"


class FrameError(SceneError):
    """No transform into the planning frame is known; the text names both frames."""

    status = Status.TF_ERROR


@dataclass(frozen=True)
class Labels:
    """How a labelled cloud is read; see `Scene.from_points`."""

    field: str = "label"
    leaf: Sequence[int] = (LEAF,)
    stem: Sequence[int] = (STEM,)
    fruit: int | None = FRUIT
    ignored: Sequence[int] = ()


@dataclass(frozen=True)
class Frame:
    """The arm that the recording is read for.

    Attributes:
        planning_frame: frame of the scene.
        joint_names: the arm's joints, in its order.
        arm_filter: removes the arm's own points.
        padding_m: how close to the arm these are.
    """

    planning_frame: str
    joint_names: Sequence[str]
    arm_filter: ArmFilter
    padding_m: float


@dataclass(frozen=True)
class RecordedScene:
    """What a recording gave.

    Attributes:
        scene: clouds and target, in the planning frame.
        start: the arm's configuration; None where it was not recorded.
        heard: topic and time [s] of each message used.
    """

    scene: Scene
    start: Start | None
    heard: Mapping[str, float] = field(default_factory=dict)


def read_recording(
    path: Path, frame: Frame, *, topics: Mapping[str, str] | None = None, at_s: float | None = None, labels: Labels | None = None
) -> RecordedScene:
    """Make a scene of the newest clouds and target of a recording at a time.

    Args:
        path: see `Recording`.
        frame: the arm.
        topics: topics by input (`INPUTS`); inputs without one are looked for under their own names, in any namespace.
        at_s: from the recording's beginning [s]; None for its end.
        labels: how a labelled cloud is read.

    Raises:
        SceneError: the recording cannot be read; a topic is missing, of another type, or comes later; a message cannot be used.
        FrameError: a message is in a frame from which no recorded transform leads to the planning frame.
    """
    given = dict(topics or {})
    with Recording(path) as recording:
        at = recording.duration_s if at_s is None else at_s
        recording.check_time(at)
        reader = _Reader(recording, frame, labels or Labels(), given, at)
        scene = reader.scene()
        target = reader.newest("grasp_target")
        if target is not None:
            scene = dataclasses.replace(scene, target_pose=reader.pose(target))
        state = reader.newest("joint_states")
        start = None if state is None else Start(tuple(frame.joint_names), _configuration(state, frame.joint_names))
        return RecordedScene(scene, start, reader.heard)


class _Reader:
    """Reads one moment of a recording."""

    def __init__(self, recording: Recording, frame: Frame, labels: Labels, topics: Mapping[str, str], at_s: float) -> None:
        self._recording = recording
        self._frame = frame
        self._labels = labels
        self._at_s = at_s
        found = {name: topics.get(name) or recording.find(name, kind) for name, kind in INPUTS.items()}
        self._topics = {name: topic for name, topic in found.items() if topic}
        if {"leaf_cloud", "stem_cloud"} & topics.keys() and "labelled_cloud" not in topics:
            self._topics.pop("labelled_cloud", None)  # what was asked for by name wins
        elif "labelled_cloud" in self._topics and ("labelled_cloud" in topics or "stem_cloud" not in self._topics):
            self._topics = {name: topic for name, topic in self._topics.items() if name not in ("leaf_cloud", "stem_cloud")}
        self._transforms: TransformTree | None = None
        self.heard: dict[str, float] = {}

    def newest(self, name: str, at_s: float | None = None) -> Recorded | None:
        """Return the newest message of an input; None where the recording has no such topic."""
        topic = self._topics.get(name)
        if topic is None:
            return None
        recorded = self._recording.newest(topic, INPUTS[name], self._at_s if at_s is None else at_s)
        if at_s is None:
            self.heard[topic] = recorded.at_s
        return recorded

    def scene(self) -> Scene:
        """Return the scene of the clouds, without a target."""
        names = [name for name in ("leaf_cloud", "stem_cloud", "labelled_cloud") if name in self._topics]
        if not {"stem_cloud", "labelled_cloud"} & set(names):
            there = ", ".join(self._recording.topics(CLOUD)) or "none"
            raise SceneError(
                f"{self._recording.path}: has no stem_cloud and no labelled_cloud; name one with --stem or --labelled: {there}"
            )
        parts = [self._part(name, recorded) for name in names if (recorded := self.newest(name)) is not None]
        return merged(parts, self._frame.planning_frame)

    def pose(self, recorded: Recorded) -> Array:
        """Return a target x y z qx qy qz qw in the planning frame."""
        header, p, o = recorded.msg.header, recorded.msg.pose.position, recorded.msg.pose.orientation
        try:
            T_frame_tool = pose_to_matrix([p.x, p.y, p.z, o.x, o.y, o.z, o.w])
        except ProblemError as error:
            raise SceneError(f"{recorded.topic} cannot be used: {error}") from None
        return matrix_to_pose(self._transform(header.frame_id, recorded.topic) @ T_frame_tool)

    def _part(self, name: str, recorded: Recorded) -> Scene:
        labelled, how = name == "labelled_cloud", self._labels
        cloud = decode_cloud(recorded.msg, recorded.topic, required=(how.field,) if labelled else (), optional=(_COST,))
        T = self._transform(recorded.msg.header.frame_id, recorded.topic)
        with np.errstate(invalid="ignore", over="ignore"):
            points = (cloud.points @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)).astype(np.float32)
        label = LEAF if name == "leaf_cloud" else STEM
        try:
            scene = Scene.from_points(
                points,
                cloud.columns[how.field] if labelled else np.full(len(points), label, np.int64),
                frame_id=self._frame.planning_frame,
                leaf_labels=how.leaf if labelled else (LEAF,),
                stem_labels=how.stem if labelled else (STEM,),
                fruit_label=how.fruit if labelled else None,
                ignored_labels=how.ignored if labelled else (),
                permeability_cost=cloud.columns.get(_COST),
            )
        except SceneError as error:
            raise SceneError(f"{recorded.topic}: {error}") from None
        return self._frame.arm_filter(scene, self._arm_at(recorded.at_s), self._frame.padding_m)

    def _arm_at(self, at_s: float) -> Array | None:
        """Return where the arm was when a cloud was recorded; None before its first state."""
        try:
            state = self.newest("joint_states", at_s)
        except SceneError:
            return None
        return None if state is None else _configuration(state, self._frame.joint_names)

    def _transform(self, frame_id: str, topic: str) -> Array:
        source, target = clean_name(frame_id), self._frame.planning_frame
        if not source:
            raise SceneError(f"{topic} has an empty frame_id; it must name the frame of its data")
        if source == target:
            return np.eye(4)
        if self._transforms is None:
            self._transforms = self._recording.transforms(self._at_s)
        T = self._transforms.find(target, source)
        if T is None:
            known = ", ".join(self._transforms.frames) or "none"
            raise FrameError(f"{topic}: no transform from {source!r} to {target!r} in the recording; /tf_static and /tf know: {known}")
        return T


def _configuration(recorded: Recorded, joint_names: Sequence[str]) -> Array:
    """Return the configuration (n,) [rad] in the arm's order."""
    names: list[Any] = list(recorded.msg.name)
    missing = [name for name in joint_names if name not in names]
    if missing:
        raise SceneError(f"{recorded.topic} has no joint {', '.join(missing)}; it has {', '.join(names) or 'none'}")
    if len(recorded.msg.position) != len(names):
        raise SceneError(f"{recorded.topic} has {len(names)} names but {len(recorded.msg.position)} positions")
    q = np.asarray(recorded.msg.position, dtype=np.float64)[[names.index(name) for name in joint_names]]
    if not np.isfinite(q).all():
        raise SceneError(f"{recorded.topic} is not finite: {q}")
    return np.asarray(q)
