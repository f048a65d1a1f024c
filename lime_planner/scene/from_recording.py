"""From a recording to a scene and a start, as the node would have made them of the same messages."""

from __future__ import annotations

import bisect
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.base_motion import motion_since, seen_at_stamp
from lime_planner.core.errors import ProblemError, Refusal, SceneError
from lime_planner.core.geometry import clean_name, matrix_to_pose, pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.core.transform_history import TF_HISTORY_S, NoTransform, TransformHistory
from lime_planner.core.types import Array
from lime_planner.scene.bag import CLOUD, JOINTS, POINT, POSE, POSES, Recorded, Recording
from lime_planner.scene.files import Start
from lime_planner.scene.from_clouds import CLOUDS, ArmFilter, Labels, Origins, belonging_together, one_picture, scene_of_cloud, without_arm
from lime_planner.scene.scene import Scene

#: The inputs of the planner that a recording may hold, and their types.
INPUTS: Mapping[str, str] = {
    "leaf_cloud": CLOUD,
    "stem_cloud": CLOUD,
    "labelled_cloud": CLOUD,
    "grasp_target": POSE,
    "fruit_target": POINT,
    "grasp_candidates": POSES,
    "joint_states": JOINTS,
}
#: Those that say what is to be reached; the newest counts.
TARGETS = ("grasp_target", "fruit_target", "grasp_candidates")
#: How far joint states reach back from a cloud, and how long later ones are waited for, as in the node [s].
_HISTORY_S, _SETTLING_S = 5.0, 1.0
#: A cloud's stamp may lie this far before the first joint state before the arm's state counts as unknown [s].
_STAMP_SLACK_S = 0.2


@dataclass(frozen=True)
class Frame:
    """The arm that the recording is read for.

    Attributes:
        planning_frame: frame of the scene.
        joint_names: the arm's joints, in its order.
        arm_filter: removes the arm's own points.
        padding_m: how close to the arm these are.
        fixed_frame: the frame in which clouds and target stay while the base moves; empty: the planning frame.
        max_base_motion_m: how far the base may have moved since a stamp without one [m].
        viewpoints: x y z of each camera whose clouds do not come in its own frame, in the planning frame [m].
    """

    planning_frame: str
    joint_names: Sequence[str]
    arm_filter: ArmFilter
    padding_m: float
    fixed_frame: str = ""
    max_base_motion_m: float = 0.01
    viewpoints: tuple[float, ...] = ()


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
        Refusal: TF_ERROR, a message is in a frame from which no recorded transform leads to the planning frame; STALE_INPUT, the
            base has moved since a stamp.
    """
    given = dict(topics or {})
    with Recording(path) as recording:
        at = recording.duration_s if at_s is None else at_s
        recording.check_time(at)
        reader = _Reader(recording, frame, labels or Labels(), given, at)
        scene = reader.scene()
        scene = dataclasses.replace(scene, **reader.target())
        state = reader.newest_state(at)
        start = None if state is None else Start(tuple(frame.joint_names), _configuration(state, frame.joint_names))
        if state is not None:
            reader.heard[state.topic] = state.at_s
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
        elif "labelled_cloud" in topics:
            self._topics = {name: topic for name, topic in self._topics.items() if name not in ("leaf_cloud", "stem_cloud")}
        self._histories: dict[tuple[float, float], TransformHistory] = {}
        self.heard: dict[str, float] = {}

    def newest(self, name: str) -> Recorded | None:
        """Return the newest message of an input; None where the recording has no such topic."""
        topic = self._topics.get(name)
        if topic is None:
            return None
        recorded = self._recording.newest(topic, INPUTS[name], self._at_s)
        self.heard[topic] = recorded.at_s
        return recorded

    def newest_state(self, at_s: float) -> Recorded | None:
        """Return the newest joint state that is about the arm at a time; fingers may come in messages of their own."""
        topic, arm = self._topics.get("joint_states"), set(self._frame.joint_names)
        return None if topic is None else self._recording.newest(topic, JOINTS, at_s, lambda msg: not arm.isdisjoint(msg.name))

    def scene(self) -> Scene:
        """Return the scene of the clouds that belong together, without a target."""
        there = [name for name in CLOUDS if name in self._topics]
        if not {"stem_cloud", "labelled_cloud"} & set(there):
            known = ", ".join(self._recording.topics(CLOUD)) or "none"
            raise SceneError(
                f"{self._recording.path}: has no stem_cloud and no labelled_cloud; name one with --stem or --labelled: {known}"
            )
        clouds: dict[str, Recorded] = {}
        for name in there:
            try:
                clouds[name] = self._recording.newest(self._topics[name], CLOUD, self._at_s)
            except SceneError:
                # Where both kinds are recorded, one that begins later does not count yet.
                if "labelled_cloud" not in there or len(there) == 1 or (name == there[-1] and "stem_cloud" not in clouds):
                    raise
        names = belonging_together({name: recorded.at_s for name, recorded in clouds.items()})
        for name in names:
            self.heard[clouds[name].topic] = clouds[name].at_s
        return one_picture([self._part(name, clouds[name]) for name in names], self._frame.planning_frame)

    def target(self) -> dict[str, Any]:
        """Return the newest target of any kind as the fields of a scene, in the planning frame; none where none was recorded."""
        newest: dict[str, Recorded] = {}
        for name in TARGETS:
            try:
                recorded = self.newest(name)
            except SceneError:
                if len([other for other in TARGETS if other in self._topics]) == 1:
                    raise
                continue  # of several kinds, one that begins later does not count yet
            if recorded is not None:
                newest[name] = recorded
        if not newest:
            return {}
        name = max(newest, key=lambda name: newest[name].at_s)
        recorded = newest[name]
        for other in newest.values():
            if other is not recorded:
                self.heard.pop(other.topic, None)
        T_planning_data, T_now_then = self._place(recorded)
        T = T_planning_data if T_now_then is None else T_now_then @ T_planning_data
        if name == "fruit_target":
            p = recorded.msg.point
            centre = np.array([p.x, p.y, p.z])
            if not np.isfinite(centre).all():
                raise SceneError(f"{recorded.topic} cannot be used: the fruit's centre has a number that is not finite")
            return {"fruit_centres": (T[:3, :3] @ centre + T[:3, 3])[None]}
        poses = recorded.msg.poses if name == "grasp_candidates" else [recorded.msg.pose]
        placed = [self._pose(pose, T, recorded.topic) for pose in poses]
        return {"target_pose": placed[0]} if name == "grasp_target" else {"grasp_candidates": np.array(placed).reshape(-1, 7)}

    @staticmethod
    def _pose(pose: Any, T: Array, topic: str) -> Array:
        p, o = pose.position, pose.orientation
        try:
            return matrix_to_pose(T @ pose_to_matrix([p.x, p.y, p.z, o.x, o.y, o.z, o.w]))
        except ProblemError as error:
            raise SceneError(f"{topic} cannot be used: {error}") from None

    def _part(self, name: str, recorded: Recorded) -> Scene:
        frame = self._frame
        T_planning_data, T_now_then = self._place(recorded)
        origins = Origins(frame.viewpoints, frame.fixed_frame)
        scene = scene_of_cloud(
            recorded.msg, name, self._labels, frame.planning_frame, lambda _: T_planning_data, origins=origins, topic=recorded.topic
        )
        return without_arm(scene, frame.arm_filter, self._arm_at(recorded), frame.padding_m, T_now_then)

    def _arm_at(self, cloud: Recorded) -> Array | None:
        """Return where the arm was at a cloud's stamp, interpolated; None where its recorded states do not reach back to it."""
        stamp_s = _stamp_s(cloud.msg.header)
        if "joint_states" not in self._topics:
            return None
        arm, topic = set(self._frame.joint_names), self._topics["joint_states"]
        near = self._recording.between(topic, JOINTS, cloud.at_s - _HISTORY_S, cloud.at_s + _SETTLING_S)
        states = [recorded for recorded in near if not arm.isdisjoint(recorded.msg.name)]
        stamped = sorted((state for state in states if _stamp_s(state.msg.header) > 0.0), key=lambda state: _stamp_s(state.msg.header))
        if stamp_s <= 0.0 or not stamped:
            before = [state for state in states if state.at_s <= cloud.at_s]
            return _configuration(before[-1], self._frame.joint_names) if before else None
        stamps = [_stamp_s(state.msg.header) for state in stamped]
        after = bisect.bisect_left(stamps, stamp_s)
        if after == 0:
            return _configuration(stamped[0], self._frame.joint_names) if stamps[0] - stamp_s <= _STAMP_SLACK_S else None
        q_before = _configuration(stamped[after - 1], self._frame.joint_names)
        if after == len(stamped):
            return q_before
        share = (stamp_s - stamps[after - 1]) / max(stamps[after] - stamps[after - 1], 1e-9)
        step = _configuration(stamped[after], self._frame.joint_names) - q_before
        # A driver that reports within half a turn jumps by a whole one; no joint really moves that far between two states.
        step = np.where(np.abs(step) > np.pi, np.remainder(step + np.pi, 2.0 * np.pi) - np.pi, step)
        return np.asarray(q_before + share * step)

    def _place(self, recorded: Recorded) -> tuple[Array, Array | None]:
        """Return where a message's frame was at its stamp, T_planning_data, and where the planning frame went since, T_now_then."""
        source, target, topic = clean_name(recorded.msg.header.frame_id), self._frame.planning_frame, recorded.topic
        if not source:
            raise SceneError(f"{topic} has an empty frame_id; it must name the frame of its data")
        stamp_s = _stamp_s(recorded.msg.header)
        # A transform may come after the data that it belongs to; data without a stamp takes what was known when it came.
        until_s = max(self._at_s, recorded.at_s + _SETTLING_S) if stamp_s > 0.0 else recorded.at_s
        error: NoTransform | None = None
        for since_s in (max(recorded.at_s - TF_HISTORY_S, 0.0), 0.0):  # all of a long recording only where there is need
            then, now = self._history(since_s, until_s), self._history(since_s, self._at_s)
            try:
                seen = seen_at_stamp(
                    partial(then.find, stamp_s=stamp_s, clamp=True),
                    target,
                    source,
                    self._frame.fixed_frame,
                    now.anchor(target, source),
                )
                return seen.T_planning_data, motion_since(seen, now.find, target, topic, self._frame.max_base_motion_m)
            except NoTransform as found:
                error = found
        raise Refusal(Status.TF_ERROR, f"{topic}: no transform from {source!r} to {target!r} in the recording: {error}")

    def _history(self, since_s: float, until_s: float) -> TransformHistory:
        key = (since_s, until_s)
        if key not in self._histories:
            self._histories[key] = self._recording.transforms(until_s, since_s)
        return self._histories[key]


def _stamp_s(header: Any) -> float:
    """Return a header's stamp [s]; 0.0 where it has none."""
    return float(header.stamp.sec) + float(header.stamp.nanosec) * 1e-9


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
