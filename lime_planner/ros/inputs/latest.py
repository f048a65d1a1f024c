"""The newest message of every input, with its age and what became of the ones before: received, used, superseded, refused.

Callbacks only store and look at headers; points are decoded in the worker (`lime_planner.ros.inputs.scene_source`).
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt
from geometry_msgs.msg import PointStamped, PoseArray, PoseStamped
from sensor_msgs.msg import JointState, PointCloud2

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.pipeline.targets import Target as Aim
from lime_planner.ros.convert import JointReader, TargetMessage, read_target, stamp_s
from lime_planner.ros.inputs.arm_at_clouds import ArmAtClouds
from lime_planner.ros.inputs.clouds import check_layout
from lime_planner.ros.inputs.joint_states import ArmState, JointHistory
from lime_planner.scene.from_clouds import CLOUDS

#: Inputs that say what is to be reached; the newest of all counts.
TARGETS: dict[str, type[TargetMessage]] = {"grasp_target": PoseStamped, "fruit_target": PointStamped, "grasp_candidates": PoseArray}

#: Joint states kept as they came, for an arm that becomes known later.
_RECENT_STATES = 50
#: Of these, those kept with a cloud: the gripper's may come between the arm's.
_FEW_STATES = 6


def input_of(msg: TargetMessage) -> str:
    """The name of the input that a target's message belongs to."""
    return next(name for name, kind in TARGETS.items() if isinstance(msg, kind))


@dataclass(frozen=True)
class Sample:
    """One message as it came in.

    Attributes:
        number: counts the messages of its input from 1; tells two clouds apart.
        msg: the message.
        arrival_s: monotonic time of arrival.
        stamp_s: its stamp in ROS time; 0.0 when it had none.
        ahead_s: how far its stamp lay in the future when it arrived (negative: in the past); 0.0 without a stamp.
        refusal: why it cannot be used, if so.
    """

    number: int
    msg: Any
    arrival_s: float
    stamp_s: float
    ahead_s: float
    refusal: str | None = None

    def age_s(self) -> float:
        """Age now [s], the way here included where the clocks allow to tell."""
        return time.monotonic() - self.arrival_s + max(-self.ahead_s, 0.0)

    def check_time(self, name: str, max_age_s: float, max_ahead_s: float) -> None:
        """Check the age against its limits (0: any).

        Raises:
            Refusal: STALE_INPUT, or BAD_INPUT for a stamp in the future.
        """
        if max_age_s > 0.0 and self.age_s() > max_age_s:
            raise Refusal(Status.STALE_INPUT, f"the newest {name} is {self.age_s():.2f} s old, the limit is {max_age_s:g} s")
        if max_ahead_s > 0.0 and self.ahead_s > max_ahead_s:
            sentence = f"the stamp of {name} lies {self.ahead_s:.2f} s in the future, the limit is {max_ahead_s:g} s"
            raise Refusal(Status.BAD_INPUT, f"{sentence}: compare the clocks")


class Slot:
    """The newest message of one input and the counts of all."""

    def __init__(self, name: str) -> None:
        """Make an empty slot.

        Args:
            name: the topic's short name.
        """
        self.name = name
        self._lock = threading.Lock()
        self._newest: Sample | None = None
        self._open = False  # the newest is neither used nor refused yet
        self.received = self.used = self.superseded = self.refused = 0

    def put(self, msg: Any, stamp: float, now_s: float, check: Callable[[Any], object]) -> str | None:
        """Store a message; return the sentence when `check` refuses it.

        Args:
            msg: the message.
            stamp: its stamp [s], 0.0 for none.
            now_s: the ROS time now, 0.0 when it is not known.
            check: raises `Refusal` for a message that cannot be used.
        """
        refusal = None
        try:
            check(msg)
        except Refusal as error:
            refusal = str(error)
        with self._lock:
            self.received += 1
            self.superseded += self._open
            self.refused += refusal is not None
            self._open = refusal is None
            ahead_s = stamp - now_s if stamp > 0.0 and now_s > 0.0 else 0.0
            self._newest = Sample(self.received, msg, time.monotonic(), stamp, ahead_s, refusal)
        return refusal

    @property
    def newest(self) -> Sample | None:
        """The newest message, usable or not."""
        with self._lock:
            return self._newest

    def use(self, sample: Sample) -> None:
        """Count a message as used, once."""
        with self._lock:
            if self._open and self._newest is sample:
                self._open = False
                self.used += 1

    def reject(self, sample: Sample, sentence: str) -> None:
        """Count a message as refused after a closer look, once, and remember why."""
        with self._lock:
            if self._newest is sample and sample.refusal is None:
                if self._open:
                    self._open = False
                    self.refused += 1
                self._newest = Sample(sample.number, sample.msg, sample.arrival_s, sample.stamp_s, sample.ahead_s, sentence)

    def figures(self) -> dict[str, str]:
        """Return age and counts as text, for the diagnostics."""
        with self._lock:
            sample = self._newest
            counts = {"received": self.received, "used": self.used, "superseded": self.superseded, "refused": self.refused}
        figures = {f"{self.name}.{name}": str(count) for name, count in counts.items()}
        figures[f"{self.name}.age_s"] = "" if sample is None else f"{sample.age_s():.3f}"
        if sample is not None and sample.refusal is not None:
            figures[f"{self.name}.refusal"] = sample.refusal
        return figures


@dataclass(frozen=True)
class Target:
    """A target that passed its check.

    Attributes:
        aim: what is to be reached, in the frame of its message.
        msg: the message.
        sample: how it came in, if by the topic; such a one ages, and is withdrawn by an invalid one after it.
    """

    aim: Aim
    msg: TargetMessage
    sample: Sample | None = None


class Inputs:
    """Everything that comes in, as the callbacks leave it."""

    def __init__(self, ros_now_s: Callable[[], float], warn: Callable[[str], None]) -> None:
        """Make empty inputs.

        Args:
            ros_now_s: the ROS time [s]; 0.0 while simulated time has not started.
            warn: is told, throttled by the caller, about each message that is refused.
        """
        self._ros_now_s = ros_now_s
        self.warn = warn
        self._reader: JointReader | None = None
        self._recent: deque[tuple[JointState, float, float]] = deque(maxlen=_RECENT_STATES)
        self.slots = {name: Slot(name) for name in (*CLOUDS, *TARGETS)}
        self.newest_target = "grasp_target"
        self.joints = JointHistory()
        self.arm_at_clouds = ArmAtClouds(self.joints)

    def set_joints(
        self, joint_names: tuple[str, ...], held: Sequence[tuple[str, float]] = (), continuous: npt.ArrayLike | None = None
    ) -> None:
        """Say which joints the arm has; what was measured for another arm is forgotten, what came lately is read again.

        Args:
            joint_names: the arm's, in its own order.
            held: see `JointReader`.
            continuous: which of them turn without end, (n,) bool; None: none of them.
        """
        reader = JointReader(joint_names, held)
        self.joints.clear(continuous)
        self._reader = reader
        for msg, _, _ in list(self._recent):
            reader.look_at_held(msg)
        for state in [self._read(reader, msg, arrival_s, now_s) for msg, arrival_s, now_s in list(self._recent)]:
            if state is not None:
                self.joints.add(state, counted=True)
        self.arm_at_clouds.begin_anew(lambda msg: self._read(reader, msg, time.monotonic(), 0.0))

    def on_cloud(self, name: str, msg: PointCloud2) -> None:
        """Take in a cloud."""
        refusal = self.slots[name].put(msg, stamp_s(msg.header.stamp), self._ros_now_s(), lambda m: check_layout(m, name))
        if refusal is not None:
            self.warn(refusal)
            return
        sample = self.slots[name].newest
        assert sample is not None
        self.arm_at_clouds.arrived(name, sample.number, sample.stamp_s, [msg for msg, _, _ in list(self._recent)[-_FEW_STATES:]])

    def on_target(self, msg: TargetMessage) -> bool:
        """Take in a target of any kind; the newest counts, and a bad one clears the one before: nothing falls back to an older lime."""
        name = input_of(msg)
        refusal = self.slots[name].put(msg, stamp_s(msg.header.stamp), self._ros_now_s(), read_target)
        self.newest_target = name
        if refusal is not None:
            self.warn(refusal)
        return refusal is None

    def on_joint_state(self, msg: JointState) -> ArmState | None:
        """Take in a joint state; return it when it can be used."""
        arrival_s, now_s, reader = time.monotonic(), self._ros_now_s(), self._reader
        self._recent.append((msg, arrival_s, now_s))
        if reader is not None:
            reader.look_at_held(msg)
        if reader is None or not reader.concerns_the_arm(msg):
            self.joints.skip()
            return None
        try:
            state = self._read(reader, msg, arrival_s, now_s, strict=True)
        except Refusal as error:
            if self.joints.refuse(arrival_s, str(error)):
                self.warn(str(error))
            return None
        if state is not None:
            state = self.joints.add(state)
            self.arm_at_clouds.look()
        return state

    @staticmethod
    def _read(reader: JointReader, msg: JointState, arrival_s: float, now_s: float, *, strict: bool = False) -> ArmState | None:
        try:
            q = reader.configuration(msg)
        except Refusal:
            if strict:
                raise
            return None
        stamp = stamp_s(msg.header.stamp)
        return ArmState(q, arrival_s, stamp, now_s - stamp if stamp > 0.0 and now_s > 0.0 else 0.0)

    def target(self, max_age_s: float, max_ahead_s: float) -> Target:
        """Return the newest target.

        Raises:
            Refusal: NO_TARGET, BAD_INPUT, STALE_INPUT.
        """
        name = self.newest_target
        slot = self.slots[name]
        sample = slot.newest
        if sample is None:
            raise Refusal(Status.NO_TARGET, "no grasp target has been received")
        if sample.refusal is not None:
            raise Refusal(Status.BAD_INPUT, sample.refusal)
        sample.check_time(name, max_age_s, max_ahead_s)
        slot.use(sample)
        return Target(read_target(sample.msg), sample.msg, sample)

    def peek_target(self) -> Target | None:
        """Return the newest target if it is a valid one, whatever its age, without counting it as used."""
        sample = self.slots[self.newest_target].newest
        return None if sample is None or sample.refusal is not None else Target(read_target(sample.msg), sample.msg, sample)

    def check_target(self, target: Target | None, max_age_s: float, max_ahead_s: float) -> None:
        """Check once more, before a motion is sent, a target that was taken from the topic.

        Raises:
            Refusal: BAD_INPUT when an invalid one came after it, STALE_INPUT when it has become too old.
        """
        if target is None or target.sample is None:
            return
        newest = self.slots[self.newest_target].newest
        if newest is not None and newest.refusal is not None:
            raise Refusal(Status.BAD_INPUT, f"the target was withdrawn by the one after it: {newest.refusal}")
        target.sample.check_time(self.newest_target, max_age_s, max_ahead_s)

    def trouble(self, max_joint_state_age_s: float) -> list[str]:
        """Return what is wrong with the inputs now, a sentence each; an input that nothing has come on yet is not in trouble."""
        newest = [slot.newest for slot in self.slots.values()]
        found = [sample.refusal for sample in newest if sample is not None and sample.refusal is not None]
        if self.joints.received > self.joints.foreign:
            try:
                self.joints.fresh(max_joint_state_age_s)
            except Refusal as refusal:
                found.append(str(refusal))
        return found

    def figures(self) -> dict[str, str]:
        """Return ages and counts of every input as text, for the diagnostics."""
        figures: dict[str, str] = {}
        for slot in self.slots.values():
            figures.update(slot.figures())
        joints, newest = self.joints, self.joints.newest
        figures["joint_states.received"] = str(joints.received)
        figures["joint_states.used"] = str(joints.received - joints.refused - joints.foreign)
        figures["joint_states.superseded"] = "0"
        figures["joint_states.refused"] = str(joints.refused)
        figures["joint_states.other_joints"] = str(joints.foreign)
        figures["joint_states.age_s"] = "" if newest is None else f"{newest.age_s(time.monotonic()):.3f}"
        return figures
