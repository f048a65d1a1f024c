"""What arrives: ages, counts, refusals; joint history and stillness; frames; scenes from clouds."""

from __future__ import annotations

import dataclasses
import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from ros_fakes import JOINTS, cloud
from sensor_msgs.msg import JointState

from lime_planner.errors import ParameterError
from lime_planner.ros.convert import to_pose
from lime_planner.ros.frames import StaticFrames, TfFrames
from lime_planner.ros.inputs import Inputs
from lime_planner.ros.joints import ArmState, JointHistory
from lime_planner.ros.params import snapshot_from
from lime_planner.ros.refusal import Refusal
from lime_planner.ros.scene_source import SceneSource
from lime_planner.scene.scene import Scene
from lime_planner.status import Status

NOW_S = 1000.0
IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def never() -> bool:
    return False


@pytest.fixture
def warnings() -> list[str]:
    return []


@pytest.fixture
def inputs(warnings: list[str]) -> Inputs:
    inputs = Inputs(lambda: NOW_S, warnings.append)
    inputs.set_joints(JOINTS)
    return inputs


def source(inputs: Inputs, *transforms: str) -> SceneSource:
    return SceneSource(inputs, StaticFrames(transforms), "base", lambda scene, q, padding: scene)


def refusal_of(call: object) -> tuple[Status, str]:
    with pytest.raises(Refusal) as caught:
        call()  # type: ignore[operator]
    return caught.value.status, str(caught.value)


def stamped(msg: object, stamp_s: float) -> object:
    msg.header.stamp = Time(sec=int(stamp_s), nanosec=int(stamp_s % 1.0 * 1e9))  # type: ignore[attr-defined]
    return msg


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
        assert np.allclose(inputs.target(0.0, 0.0).T_frame_tool[:3, 3], [0.1, 0.2, 0.3])
        assert not inputs.on_target(target([math.nan, *IDENTITY[1:]]))
        status, sentence = refusal_of(lambda: inputs.target(0.0, 0.0))
        assert status is Status.BAD_INPUT, "the older target must not come back"
        assert "not finite" in sentence
        assert inputs.on_target(target(IDENTITY))
        inputs.target(0.0, 0.0)

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
        assert "0.50 s old" in sentence
        history.fresh(0.0)
        history.add(arm_state(1.0, time.monotonic(), 990.0, 10.0))
        assert "10.0" in refusal_of(lambda: history.fresh(0.3))[1]
        history.add(arm_state(1.0, time.monotonic(), 1005.0, -5.0))
        status, sentence = refusal_of(lambda: history.fresh(0.3, 1.0))
        assert status is Status.BAD_INPUT
        assert "5.00 s in the future" in sentence

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
        T = frames.lookup("base", "/camera", Time(), 0.0, never)
        assert np.allclose(T @ [1.0, 0.0, 0.0, 1.0], [-0.5, 0.0, 1.0, 1.0])
        assert np.allclose(frames.lookup("camera", "base", Time(), 0.0, never) @ T, np.eye(4))
        status, sentence = refusal_of(lambda: frames.lookup("base", "moon", Time(), 0.0, never))
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
        asked: list[int] = []

        class Buffer:
            def lookup_transform(self, target: str, source: str, stamp: object) -> object:
                asked.append(1)
                if len(asked) < 4:
                    raise LookupError("extrapolation into the future")
                transform = SimpleNamespace(
                    translation=SimpleNamespace(x=1.0, y=2.0, z=3.0), rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
                )
                return SimpleNamespace(transform=transform)

        frames = TfFrames(Buffer(), StaticFrames(["base fixed 0 0 7 0 0 0 1"]), poll_s=0.001)
        assert frames.lookup("base", "fixed", Time(), 0.0, never)[2, 3] == 7.0
        assert not asked
        status, sentence = refusal_of(lambda: frames.lookup("base", "camera", Time(), 0.0, never))
        assert status is Status.TF_ERROR
        assert "extrapolation" in sentence
        assert frames.lookup("base", "camera", Time(sec=3), 1.0, never)[0, 3] == 1.0


class TestScenes:
    def test_leaf_and_stem_make_a_scene_once(self, inputs: Inputs) -> None:
        inputs.on_cloud("leaf_cloud", cloud(10, permeability_cost=np.full(10, 2.0, np.float32)))
        inputs.on_cloud("stem_cloud", cloud(5))
        made = source(inputs)
        scene = made.scene(snapshot_from({}), never)
        assert (len(scene.leaf_points), len(scene.stem_points), scene.frame_id) == (10, 5, "base")
        assert scene.leaf_costs.tolist() == [2.0] * 10
        assert scene.counts["received"] == 15
        assert made.scene(snapshot_from({}), never) is scene
        assert inputs.slots["stem_cloud"].used == 1
        inputs.on_cloud("stem_cloud", cloud(6))
        assert len(made.scene(snapshot_from({}), never).stem_points) == 6

    def test_what_thinning_displaced_stays_known(self, inputs: Inputs) -> None:
        def thin(scene: Scene, q: object, padding_m: float) -> Scene:
            return dataclasses.replace(scene, stem_displacement_m=0.001 * len(scene.stem_points), leaf_displacement_m=0.002)

        inputs.on_cloud("leaf_cloud", cloud(10))
        inputs.on_cloud("stem_cloud", cloud(5))
        scene = SceneSource(inputs, StaticFrames(), "base", thin).scene(snapshot_from({}), never)
        assert (scene.stem_displacement_m, scene.leaf_displacement_m) == (0.005, 0.002)

    def test_the_watch_looks_at_stems_alone(self, inputs: Inputs) -> None:
        made = source(inputs)
        inputs.on_cloud("leaf_cloud", cloud(10))
        inputs.on_cloud("stem_cloud", cloud(5))
        stems = made.stems(snapshot_from({}), never)
        assert (len(stems.leaf_points), len(stems.stem_points)) == (0, 5)
        assert inputs.slots["leaf_cloud"].used == 0
        whole = made.scene(snapshot_from({}), never)
        assert made.stems(snapshot_from({}), never) is stems
        assert made.scene(snapshot_from({}), never) is whole

    def test_no_or_empty_stems_permit_nothing_unless_allowed(self, inputs: Inputs) -> None:
        made, allowed = source(inputs), snapshot_from({"allow_empty_stem_cloud": True})
        assert refusal_of(lambda: made.scene(snapshot_from({}), never))[0] is Status.NO_CLOUD
        assert made.scene(allowed, never).n_points == 0
        inputs.on_cloud("leaf_cloud", cloud(10))
        assert refusal_of(lambda: made.scene(snapshot_from({}), never))[0] is Status.NO_CLOUD
        inputs.on_cloud("stem_cloud", cloud(5))
        made.scene(snapshot_from({}), never)
        inputs.on_cloud("stem_cloud", cloud(0))
        status, sentence = refusal_of(lambda: made.scene(snapshot_from({}), never))
        assert status is Status.NO_CLOUD
        assert "no stem point among the 10 points" in sentence
        assert len(made.scene(allowed, never).leaf_points) == 10
        lost = cloud(4)
        lost.data = type(lost.data)("B", np.full(12, np.nan, np.float32).tobytes())
        inputs.on_cloud("stem_cloud", lost)
        status, sentence = refusal_of(lambda: made.scene(snapshot_from({}), never))
        assert status is Status.NO_CLOUD
        assert "(4 not finite)" in sentence

    def test_an_empty_leaf_cloud_is_valid(self, inputs: Inputs) -> None:
        inputs.on_cloud("leaf_cloud", cloud(0))
        inputs.on_cloud("stem_cloud", cloud(1))
        scene = source(inputs).scene(snapshot_from({}), never)
        assert (len(scene.leaf_points), len(scene.stem_points)) == (0, 1)

    def test_labels(self, inputs: Inputs) -> None:
        labels = np.array([0, 1, 2, 3, 4, 9, 9], np.uint16)
        inputs.on_cloud("labelled_cloud", cloud(7, label=labels))
        made = source(inputs)
        scene = made.scene(snapshot_from({}), never)
        assert [len(points) for points in (scene.leaf_points, scene.stem_points, scene.fruit_points)] == [1, 5, 1]
        own = snapshot_from({"leaf_labels": [3, 4], "stem_labels": [1], "fruit_labels": [2, 9], "ignored_labels": [0]})
        scene = made.scene(own, never)
        assert [len(points) for points in (scene.leaf_points, scene.stem_points, scene.fruit_points)] == [2, 1, 3]
        status, sentence = refusal_of(lambda: made.scene(snapshot_from({"label_field": "class"}), never))
        assert status is Status.BAD_INPUT
        assert "no field 'class'; its fields are x, y, z, label" in sentence

    @pytest.mark.parametrize("labels", [np.array([0.5, 1.0], np.float32), np.array([np.nan, 1.0], np.float32)])
    def test_labels_must_be_whole(self, inputs: Inputs, labels: np.ndarray) -> None:
        inputs.on_cloud("labelled_cloud", cloud(2, label=labels))
        status, sentence = refusal_of(lambda: source(inputs).scene(snapshot_from({}), never))
        assert status is Status.BAD_INPUT
        assert "labelled_cloud" in sentence

    def test_the_newer_of_labelled_and_separate_clouds_counts(self, inputs: Inputs) -> None:
        made = source(inputs)
        inputs.on_cloud("stem_cloud", cloud(5))
        inputs.on_cloud("labelled_cloud", cloud(3, label=np.ones(3, np.uint8)))
        assert len(made.scene(snapshot_from({}), never).stem_points) == 3
        inputs.on_cloud("stem_cloud", cloud(6))
        assert len(made.scene(snapshot_from({}), never).stem_points) == 6

    @pytest.mark.parametrize("cost", [-1.0, np.nan, np.inf])
    def test_costs_must_be_finite_and_positive(self, inputs: Inputs, cost: float) -> None:
        inputs.on_cloud("leaf_cloud", cloud(2, permeability_cost=np.array([1.0, cost], np.float32)))
        inputs.on_cloud("stem_cloud", cloud(2))
        status, sentence = refusal_of(lambda: source(inputs).scene(snapshot_from({}), never))
        assert status is Status.BAD_INPUT
        assert "leaf_cloud" in sentence
        assert inputs.slots["leaf_cloud"].refused == 1

    def test_a_bad_cloud_answers_until_a_good_one_comes(self, inputs: Inputs, warnings: list[str]) -> None:
        made = source(inputs)
        inputs.on_cloud("stem_cloud", cloud(5))
        bad = cloud(5)
        bad.fields = bad.fields[:2]
        inputs.on_cloud("stem_cloud", bad)
        assert "no field 'z'" in warnings[0]
        assert refusal_of(lambda: made.scene(snapshot_from({}), never))[0] is Status.BAD_INPUT
        inputs.on_cloud("stem_cloud", cloud(5))
        made.scene(snapshot_from({}), never)
        slot = inputs.slots["stem_cloud"]
        assert (slot.received, slot.used, slot.superseded, slot.refused) == (3, 1, 1, 1)

    def test_ages_skew_and_future(self, inputs: Inputs) -> None:
        made = source(inputs)
        inputs.on_cloud("leaf_cloud", stamped(cloud(5), NOW_S - 3.0))
        inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S))
        made.scene(snapshot_from({}), never)
        status, sentence = refusal_of(lambda: made.scene(snapshot_from({"max_cloud_age_s": 2.0}), never))
        assert status is Status.STALE_INPUT
        assert "leaf_cloud is 3.0" in sentence
        status, sentence = refusal_of(lambda: made.scene(snapshot_from({"max_cloud_skew_s": 2.0}), never))
        assert status is Status.STALE_INPUT
        assert "3.00 s apart" in sentence
        inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S + 9.0))
        status, sentence = refusal_of(lambda: made.scene(snapshot_from({}), never))
        assert status is Status.BAD_INPUT
        assert "9.00 s in the future" in sentence

    def test_simulated_time_that_has_not_begun_refuses_nothing(self) -> None:
        inputs = Inputs(lambda: 0.0, print)
        inputs.on_cloud("stem_cloud", stamped(cloud(5), 1.7e9))
        source(inputs).scene(snapshot_from({"max_cloud_age_s": 1.0}), never)

    def test_clouds_come_into_the_planning_frame(self, inputs: Inputs) -> None:
        inputs.on_cloud("stem_cloud", cloud(5, "camera"))
        with pytest.raises(Refusal, match="'camera' to 'base'") as caught:
            source(inputs).scene(snapshot_from({}), never)
        assert caught.value.status is Status.TF_ERROR
        plain = cloud(5)
        inputs.on_cloud("stem_cloud", plain)
        expected = source(inputs).scene(snapshot_from({}), never).stem_points + np.float32([0.0, 0.0, 1.0])
        inputs.on_cloud("stem_cloud", cloud(5, "/camera"))
        moved = source(inputs, "base camera 0 0 1 0 0 0 1").scene(snapshot_from({}), never)
        assert np.allclose(moved.stem_points, expected)

    def test_the_arm_is_removed_where_it_was_at_the_stamp(self, inputs: Inputs) -> None:
        seen: list[object] = []

        def arm_filter(scene: Scene, q: object, padding_m: float) -> Scene:
            seen.append((None if q is None else q[0], padding_m))  # type: ignore[index]
            return scene

        made = SceneSource(inputs, StaticFrames(), "base", arm_filter)
        for k in range(3):
            state = stamped(JointState(name=list(JOINTS), position=[float(k), 0.0, 0.0]), NOW_S - 0.2 + 0.1 * k)
            inputs.on_joint_state(state)  # type: ignore[arg-type]
        inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S - 0.15))
        made.scene(snapshot_from({"self_filter_padding_m": 0.02}), never)
        inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S - 50.0))
        made.scene(snapshot_from({}), never)
        assert seen == [(pytest.approx(0.5, abs=1e-6), 0.02), (None, 0.01)]
