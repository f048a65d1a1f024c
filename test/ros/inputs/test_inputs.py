"""What arrives: ages, counts, refusals; joint history and stillness; frames."""

from __future__ import annotations

import math
import sys
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped, PoseArray, PoseStamped
from rclpy.clock import ClockType, ROSClock
from rclpy.time import Time as RosTime
from ros_fakes import JOINTS, never, refusal_of, stamped, tf_message
from sensor_msgs.msg import JointState

from lime_planner.core.errors import ParameterError
from lime_planner.core.status import Status
from lime_planner.ros.convert import to_pose
from lime_planner.ros.inputs.frames import StaticFrames, TfFrames, lookup, make_frames
from lime_planner.ros.inputs.joint_states import ArmState, JointHistory
from lime_planner.ros.inputs.latest import Inputs

NOW_S = 1000.0
IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture
def warnings() -> list[str]:
    return []


@pytest.fixture
def inputs(warnings: list[str]) -> Inputs:
    inputs = Inputs(lambda: NOW_S, warnings.append)
    inputs.set_joints(JOINTS)
    return inputs


def target(pose: list[float], stamp_s: float = 0.0, frame_id: str = "base") -> PoseStamped:
    msg = PoseStamped(pose=to_pose(pose))
    msg.header.frame_id = frame_id
    return stamped(msg, stamp_s)  # type: ignore[return-value]


def arm_state(q: float, arrival_s: float, stamp_s: float = 0.0, latency_s: float = 0.0) -> ArmState:
    return ArmState(np.array([q, 0.0]), arrival_s, stamp_s, latency_s)


class TestTargets:
    def test_none_bad_and_good(self, inputs: Inputs) -> None:
        assert refusal_of(lambda: inputs.target(0.0, 0.0))[0] is Status.NO_TARGET
        assert inputs.on_target(target([0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 2.0]))
        assert np.allclose(inputs.target(0.0, 0.0).aim.centre, [0.1, 0.2, 0.3])
        assert not inputs.on_target(target([math.nan, *IDENTITY[1:]]))
        status, sentence = refusal_of(lambda: inputs.target(0.0, 0.0))
        assert status is Status.BAD_INPUT, "the older target must not come back"
        assert "not finite" in sentence
        assert inputs.on_target(target(IDENTITY))
        inputs.target(0.0, 0.0)

    def test_the_newest_of_three_kinds_counts_and_a_bad_one_clears(self, inputs: Inputs) -> None:
        fruit, poses = PointStamped(), PoseArray(poses=[to_pose(IDENTITY)] * 3)
        fruit.header.frame_id = poses.header.frame_id = "base"
        assert inputs.on_target(target(IDENTITY))
        assert inputs.on_target(fruit)
        assert inputs.target(0.0, 0.0).aim.kind == "fruit"
        assert inputs.on_target(poses)
        taken = inputs.target(0.0, 0.0)
        assert taken.aim.kind == "candidates" and len(taken.aim.poses) == 3
        empty = PoseArray()
        empty.header.frame_id = "base"
        assert not inputs.on_target(empty)
        status, sentence = refusal_of(lambda: inputs.target(0.0, 0.0))
        assert status is Status.BAD_INPUT and "empty list" in sentence, "neither the fruit nor the pose may come back"
        assert inputs.peek_target() is None
        assert refusal_of(lambda: inputs.check_target(taken, 0.0, 0.0))[0] is Status.BAD_INPUT
        assert inputs.on_target(target(IDENTITY))
        assert inputs.target(0.0, 0.0).aim.kind == "pose"

    def test_age_and_future(self, inputs: Inputs) -> None:
        inputs.on_target(target(IDENTITY, NOW_S - 5.0))
        inputs.target(6.0, 1.0)
        status, sentence = refusal_of(lambda: inputs.target(4.0, 1.0))
        assert status is Status.STALE_INPUT
        assert "5.0" in sentence
        inputs.on_target(target(IDENTITY, NOW_S + 3.0))
        status, sentence = refusal_of(lambda: inputs.target(0.0, 1.0))
        assert status is Status.BAD_INPUT
        assert "3.00 s in the future" in sentence
        inputs.target(0.0, 0.0)

    def test_trouble_names_every_input_that_is_in_it(self, inputs: Inputs) -> None:
        assert inputs.trouble(0.3) == []
        inputs.on_target(target([math.nan, *IDENTITY[1:]]))
        inputs.on_joint_state(JointState(name=["j1"], position=[0.0]))
        first, second = inputs.trouble(0.3)
        assert "not finite" in first
        assert "no joint j2" in second

    def test_counts(self, inputs: Inputs) -> None:
        for pose in (IDENTITY, IDENTITY, [math.nan] * 7, IDENTITY):
            inputs.on_target(target(pose))
        inputs.target(0.0, 0.0)
        inputs.target(0.0, 0.0)
        slot = inputs.slots["grasp_target"]
        assert (slot.received, slot.used, slot.superseded, slot.refused) == (4, 1, 2, 1)
        assert inputs.figures()["grasp_target.superseded"] == "2"


class TestJoints:
    def test_no_state_bad_states_and_other_joints(self, inputs: Inputs, warnings: list[str]) -> None:
        assert refusal_of(lambda: inputs.joints.fresh(0.3))[0] is Status.NO_JOINT_STATE
        assert inputs.on_joint_state(JointState(name=["finger"], position=[0.0])) is None
        assert refusal_of(lambda: inputs.joints.fresh(0.3)) == (
            Status.NO_JOINT_STATE,
            "no joint state has been received; 1 messages named none of the arm's joints",
        )
        inputs.on_joint_state(JointState(name=["j1"], position=[0.0]))
        inputs.on_joint_state(JointState(name=["j1"], position=[0.0]))
        status, sentence = refusal_of(lambda: inputs.joints.fresh(0.3))
        assert status is Status.BAD_INPUT
        assert "no joint j2, j3" in sentence
        assert len(warnings) == 1
        inputs.on_joint_state(JointState(name=list(JOINTS), position=[1.0, 2.0, 3.0]))
        assert inputs.joints.fresh(0.3).q.tolist() == [1.0, 2.0, 3.0]
        assert inputs.joints.refused == 2

    def test_states_from_before_the_arm_was_known_are_read_again(self) -> None:
        inputs = Inputs(lambda: NOW_S, print)
        for k in range(3):
            inputs.on_joint_state(JointState(name=["finger", *JOINTS], position=[0.0, float(k), 2.0, 3.0]))
        inputs.on_joint_state(JointState(name=["other"], position=[0.0]))
        assert inputs.joints.newest is None
        inputs.set_joints(JOINTS)
        assert inputs.joints.fresh(0.3).q.tolist() == [2.0, 2.0, 3.0]
        assert (inputs.joints.received, inputs.joints.foreign) == (4, 1)

    def test_a_good_state_outlives_bad_ones_only_for_a_while(self) -> None:
        history = JointHistory()
        history.add(arm_state(1.0, time.monotonic() - 0.2))
        history.refuse(time.monotonic(), "garbage")
        assert history.fresh(0.3).q[0] == 1.0
        assert refusal_of(lambda: history.fresh(0.1)) == (Status.BAD_INPUT, "garbage")

    def test_silence_old_stamps_and_future_stamps(self) -> None:
        history = JointHistory()
        history.add(arm_state(1.0, time.monotonic() - 0.5))
        status, sentence = refusal_of(lambda: history.fresh(0.3))
        assert status is Status.STALE_INPUT
        assert 0.5 <= float(sentence.split(" s old")[0].split()[-1]) < 5.0  # whatever the machine adds
        history.fresh(0.0)
        history.add(arm_state(1.0, time.monotonic(), 990.0, 10.0))
        assert "10.0" in refusal_of(lambda: history.fresh(0.3))[1]
        history.add(arm_state(1.0, time.monotonic(), 1005.0, -5.0))
        status, sentence = refusal_of(lambda: history.fresh(0.3, 1.0))
        assert status is Status.BAD_INPUT
        assert 4.0 < float(sentence.split(" s in the future")[0].split()[-1]) <= 5.0

    def test_the_configuration_at_a_stamp(self) -> None:
        history = JointHistory()
        assert history.at(0.0) is None
        now = time.monotonic()
        for k in range(5):
            history.add(arm_state(float(k), now + 0.1 * k, 100.0 + 0.1 * k))
        assert history.at(100.25)[0] == pytest.approx(2.5)  # type: ignore[index]
        assert history.at(99.9)[0] == 0.0  # type: ignore[index]
        assert history.at(99.0) is None
        assert history.at(101.0)[0] == 4.0  # type: ignore[index]
        assert history.at(0.0)[0] == 4.0  # type: ignore[index]

    def test_a_clock_that_is_set_back_and_a_state_that_is_late(self) -> None:
        history, now = JointHistory(), time.monotonic()
        for k, stamp in enumerate((100.0, 100.2, 100.1)):
            history.add(arm_state(stamp, now + 0.01 * k, stamp))
        assert history.at(100.15)[0] == pytest.approx(100.15), "the late one comes in between"  # type: ignore[index]
        history.add(arm_state(7.0, now + 0.1, 3.0))
        assert history.at(3.0)[0] == 7.0  # type: ignore[index]
        assert history.at(2.0) is None
        assert history.newest is not None and history.newest.stamp_s == 3.0

    def test_stillness_needs_time_states_and_no_motion(self) -> None:
        history, now = JointHistory(), time.monotonic()
        assert not history.still(0.2, 0.003)
        history.add(arm_state(1.0, now - 0.25))
        history.add(arm_state(1.0, now))
        assert not history.still(0.2, 0.003), "two states tell nothing"
        history.clear()
        for k in range(6):
            history.add(arm_state(1.0 + 0.0005 * (k % 2), now - 0.25 + 0.05 * k))
        assert history.still(0.2, 0.003)
        assert not history.still(0.2, 0.0003)
        assert history.moving(0.2, 0.0003)
        assert not history.moving(0.2, 0.003)
        assert not history.still(0.5, 0.003), "the history does not reach back far enough"
        assert history.wait_still(0.2, 0.003, 0.1, never)
        assert not history.wait_still(0.2, 1e-5, 0.05, never)
        history.add(arm_state(1.1, now + 0.01))
        assert not history.still(0.2, 0.003)


class TestFrames:
    def test_static_chains_both_ways(self) -> None:
        frames = StaticFrames(["base mast 0 0 1 0 0 0 1", "mast camera 0.5 0 0 0 0 1 0"])
        T = lookup(frames, "base", "/camera", Time(), 0.0, never)
        assert np.allclose(T @ [1.0, 0.0, 0.0, 1.0], [-0.5, 0.0, 1.0, 1.0])
        assert np.allclose(lookup(frames, "camera", "base", Time(), 0.0, never) @ T, np.eye(4))
        status, sentence = refusal_of(lambda: lookup(frames, "base", "moon", Time(), 0.0, never))
        assert status is Status.TF_ERROR
        assert "'moon'" in sentence
        assert "'base'" in sentence
        assert "base, camera, mast" in sentence

    @pytest.mark.parametrize(
        "text", ["base camera", "base camera 0 0 0 0 0 0 0", "base camera x 0 0 0 0 0 1", "base camera nan 0 0 0 0 0 1"]
    )
    def test_bad_static_transforms(self, text: str) -> None:
        with pytest.raises(ParameterError, match="static_transforms"):
            StaticFrames([text])

    def test_tf_waits_for_a_transform_that_is_late(self) -> None:
        frames = TfFrames(StaticFrames(["base fixed 0 0 7 0 0 0 1"]))
        frames.take(tf_message("base", "camera", 1.0, 2.0), static=False)
        assert lookup(frames, "base", "fixed", Time(), 0.0, never)[2, 3] == 7.0
        status, sentence = refusal_of(lambda: lookup(frames, "base", "/camera", Time(sec=3), 0.05, never))
        assert status is Status.TF_ERROR
        assert sentence == "no transform from 'camera' to 'base' within 0.05 s: 'camera' in 'base' is known up to 1.000 s before the stamp"
        later = threading.Timer(0.1, lambda: frames.take(tf_message("base", "camera", 3.0, 4.0), static=False))
        later.start()
        assert lookup(frames, "base", "camera", Time(sec=3), 5.0, never)[0, 3] == pytest.approx(2.0)
        later.join()
        began_s = time.monotonic()
        assert refusal_of(lambda: lookup(frames, "base", "camera", Time(sec=1), 5.0, never))[0] is Status.TF_ERROR
        assert time.monotonic() - began_s < 1.0, "what lies before the history will not come"

    def test_without_the_messages_the_parameters_are_the_source(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "tf2_msgs.msg", None)
        frames = make_frames(None, ["base mast 0 0 1 0 0 0 1"])
        assert isinstance(frames, StaticFrames)
        assert frames.source == "static_transforms alone (1 given): tf2_msgs cannot be imported"

    def test_the_two_topics_are_read_and_a_clock_that_is_set_back_forgets(self, monkeypatch: pytest.MonkeyPatch) -> None:
        heard: dict[str, Any] = {}
        clock = ROSClock()

        def subscribe(kind: object, topic: str, callback: Any, profile: Any, *, callback_group: object) -> None:
            heard[topic] = (callback, profile.durability.name)

        node = SimpleNamespace(get_clock=lambda: clock, create_subscription=subscribe)
        monkeypatch.setitem(sys.modules, "tf2_msgs", SimpleNamespace())
        monkeypatch.setitem(sys.modules, "tf2_msgs.msg", SimpleNamespace(TFMessage=object))
        frames = make_frames(node, [])
        assert isinstance(frames, TfFrames)
        assert {topic: durability for topic, (_, durability) in heard.items()} == {"/tf": "VOLATILE", "/tf_static": "TRANSIENT_LOCAL"}
        # A recording that is played again: what it told the first time lies in its future.
        clock._set_ros_time_is_active(True)
        for second, known in ((100, True), (101, True), (1, False), (2, False)):
            clock.set_ros_time_override(RosTime(seconds=second, clock_type=ClockType.ROS_TIME))
            if second == 100:
                heard["/tf"][0](tf_message("base", "camera", 1.0, 100.0))
                heard["/tf_static"][0](tf_message("camera", "lens", 0.5, 0.0))
            assert ("base" in frames.known()) is known, second
        assert frames.find("camera", "lens")[0, 3] == 0.5
