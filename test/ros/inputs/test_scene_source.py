"""Scenes from clouds: labels, frames, ages, emptiness, and what is kept."""

from __future__ import annotations

import dataclasses
import threading
import time

import numpy as np
import pytest
from ros_fakes import JOINTS, cloud, never, refusal_of, stamped
from sensor_msgs.msg import JointState

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.ros.inputs.frames import StaticFrames
from lime_planner.ros.inputs.latest import Inputs
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.parameters import snapshot_from
from lime_planner.scene.scene import Scene

NOW_S = 1000.0


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


def test_leaf_and_stem_make_a_scene_once(inputs: Inputs) -> None:
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


def test_what_thinning_displaced_stays_known(inputs: Inputs) -> None:
    def thin(scene: Scene, q: object, padding_m: float) -> Scene:
        return dataclasses.replace(scene, stem_displacement_m=0.001 * len(scene.stem_points), leaf_displacement_m=0.002)

    inputs.on_cloud("leaf_cloud", cloud(10))
    inputs.on_cloud("stem_cloud", cloud(5))
    scene = SceneSource(inputs, StaticFrames(), "base", thin).scene(snapshot_from({}), never)
    assert (scene.stem_displacement_m, scene.leaf_displacement_m) == (0.005, 0.002)


def test_the_watch_looks_at_stems_alone(inputs: Inputs) -> None:
    made = source(inputs)
    inputs.on_cloud("leaf_cloud", cloud(10))
    inputs.on_cloud("stem_cloud", cloud(5))
    stems = made.stems(snapshot_from({}), never)
    assert (len(stems.leaf_points), len(stems.stem_points)) == (0, 5)
    assert inputs.slots["leaf_cloud"].used == 0
    whole = made.scene(snapshot_from({}), never)
    assert made.stems(snapshot_from({}), never) is stems
    assert made.scene(snapshot_from({}), never) is whole


def test_the_watch_waits_for_where_a_moving_arm_stood(inputs: Inputs) -> None:
    asked: list[float] = []

    def note(scene: Scene, q: np.ndarray | None, padding: float) -> Scene:
        assert q is not None
        asked.append(float(q[0]))
        return scene

    def move(stamp_s: float) -> None:
        inputs.on_joint_state(stamped(JointState(name=list(JOINTS), position=[stamp_s - NOW_S, 0.0, 0.0]), stamp_s))

    made = SceneSource(inputs, StaticFrames(), "base", note)
    move(NOW_S)
    inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S + 0.05))
    began_s = time.monotonic()
    made.stems(snapshot_from({}), never, 0.1)
    assert 0.09 < time.monotonic() - began_s < 0.5
    assert asked == [0.0], "a guess, after the wait"
    inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S + 0.05))
    later = threading.Timer(0.1, move, (NOW_S + 0.1,))
    later.start()
    made.stems(snapshot_from({}), never, 5.0)
    later.join()
    assert asked[1:] == [pytest.approx(0.05)]
    began_s = time.monotonic()
    made.stems(snapshot_from({}), never, 5.0)
    assert time.monotonic() - began_s < 0.1, "known by now"


def test_no_or_empty_stems_permit_nothing_unless_allowed(inputs: Inputs) -> None:
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
    inputs.on_cloud("labelled_cloud", cloud(8, label=np.array([0, 0, 0, 0, 0, 2, 2, 2], np.uint8)))
    status, sentence = refusal_of(lambda: made.scene(snapshot_from({}), never))
    assert status is Status.NO_CLOUD, "the lime itself is no stem"
    assert len(made.scene(allowed, never).fruit_points) == 3
    inputs.on_cloud("leaf_cloud", cloud(10))
    lost = cloud(4)
    lost.data = type(lost.data)("B", np.full(12, np.nan, np.float32).tobytes())
    inputs.on_cloud("stem_cloud", lost)
    status, sentence = refusal_of(lambda: made.scene(snapshot_from({}), never))
    assert status is Status.NO_CLOUD
    assert "(4 not finite)" in sentence


def test_an_empty_leaf_cloud_is_valid(inputs: Inputs) -> None:
    inputs.on_cloud("leaf_cloud", cloud(0))
    inputs.on_cloud("stem_cloud", cloud(1))
    scene = source(inputs).scene(snapshot_from({}), never)
    assert (len(scene.leaf_points), len(scene.stem_points)) == (0, 1)


def test_labels(inputs: Inputs) -> None:
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
def test_labels_must_be_whole(inputs: Inputs, labels: np.ndarray) -> None:
    inputs.on_cloud("labelled_cloud", cloud(2, label=labels))
    status, sentence = refusal_of(lambda: source(inputs).scene(snapshot_from({}), never))
    assert status is Status.BAD_INPUT
    assert "labelled_cloud" in sentence


def test_the_newer_of_labelled_and_separate_clouds_counts(inputs: Inputs) -> None:
    made = source(inputs)
    inputs.on_cloud("stem_cloud", cloud(5))
    inputs.on_cloud("labelled_cloud", cloud(3, label=np.ones(3, np.uint8)))
    assert len(made.scene(snapshot_from({}), never).stem_points) == 3
    inputs.on_cloud("stem_cloud", cloud(6))
    assert len(made.scene(snapshot_from({}), never).stem_points) == 6


@pytest.mark.parametrize("cost", [-1.0, np.nan, np.inf])
def test_costs_must_be_finite_and_positive(inputs: Inputs, cost: float) -> None:
    inputs.on_cloud("leaf_cloud", cloud(2, permeability_cost=np.array([1.0, cost], np.float32)))
    inputs.on_cloud("stem_cloud", cloud(2))
    status, sentence = refusal_of(lambda: source(inputs).scene(snapshot_from({}), never))
    assert status is Status.BAD_INPUT
    assert "leaf_cloud" in sentence
    assert inputs.slots["leaf_cloud"].refused == 1


def test_a_bad_cloud_answers_until_a_good_one_comes(inputs: Inputs, warnings: list[str]) -> None:
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


def test_ages_skew_and_future(inputs: Inputs) -> None:
    made = source(inputs)
    inputs.on_cloud("leaf_cloud", stamped(cloud(5), NOW_S - 3.0))
    inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S))
    made.scene(snapshot_from({}), never)
    status, sentence = refusal_of(lambda: made.scene(snapshot_from({"max_cloud_age_s": 2.0}), never))
    assert status is Status.STALE_INPUT
    assert "leaf_cloud is 3." in sentence  # time goes on
    status, sentence = refusal_of(lambda: made.scene(snapshot_from({"max_cloud_skew_s": 2.0}), never))
    assert status is Status.STALE_INPUT
    assert "3.00 s apart" in sentence
    inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S + 9.0))
    status, sentence = refusal_of(lambda: made.scene(snapshot_from({}), never))
    assert status is Status.BAD_INPUT
    assert "9.00 s in the future" in sentence


def test_simulated_time_that_has_not_begun_refuses_nothing() -> None:
    inputs = Inputs(lambda: 0.0, print)
    inputs.on_cloud("stem_cloud", stamped(cloud(5), 1.7e9))
    source(inputs).scene(snapshot_from({"max_cloud_age_s": 1.0}), never)


def test_clouds_come_into_the_planning_frame(inputs: Inputs) -> None:
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


def test_the_arm_is_removed_where_it_was_at_the_stamp(inputs: Inputs) -> None:
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


@pytest.mark.parametrize("stamped_cloud", [True, False])
def test_where_the_arm_was_is_known_for_as_long_as_the_cloud_is_used(inputs: Inputs, stamped_cloud: bool) -> None:
    def state(angle: float, at_s: float) -> JointState:
        return stamped(JointState(name=list(JOINTS), position=[angle, 0.0, 0.0]), at_s)  # type: ignore[return-value]

    seen: list[object] = []
    made = SceneSource(inputs, StaticFrames(), "base", lambda scene, q, _: seen.append(None if q is None else q[0]) or scene)  # type: ignore[index, func-returns-value]
    inputs.on_joint_state(state(1.0, NOW_S - 0.1))
    msg = cloud(5)
    inputs.on_cloud("stem_cloud", stamped(msg, NOW_S - 0.05) if stamped_cloud else msg)
    inputs.on_joint_state(state(2.0, NOW_S))  # what lies between is known once a later state is there
    inputs.joints.clear()  # and a minute passes
    inputs.on_joint_state(state(3.0, NOW_S + 60.0))
    made.scene(snapshot_from({}), never)
    assert seen == [pytest.approx(1.5 if stamped_cloud else 1.0, abs=1e-6)]


def test_where_the_arm_was_is_known_although_its_joints_were_not_yet() -> None:
    inputs = Inputs(lambda: NOW_S, print)
    seen: list[object] = []
    made = SceneSource(inputs, StaticFrames(), "base", lambda scene, q, _: seen.append(None if q is None else q[0]) or scene)  # type: ignore[index, func-returns-value]
    for number in range(200):  # more than are kept
        inputs.on_joint_state(stamped(JointState(name=list(JOINTS), position=[float(number), 0.0, 0.0]), NOW_S - 200.0 + number))  # type: ignore[arg-type]
        inputs.on_joint_state(stamped(JointState(name=["finger"], position=[9.0]), NOW_S - 200.0 + number))  # type: ignore[arg-type]
        if number == 5:
            inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S - 195.0))
    inputs.set_joints(JOINTS)
    made.scene(snapshot_from({}), never)
    assert seen == [5.0]


def test_a_newer_cloud_does_not_hide_where_the_arm_was(inputs: Inputs) -> None:
    seen: list[float] = []

    def arm_filter(scene: Scene, q: np.ndarray, padding_m: float) -> Scene:
        if not seen:  # while the first cloud is decoded, others come
            for _ in range(5):
                inputs.on_cloud("stem_cloud", cloud(6))
        seen.append(q[0])
        return scene

    made = SceneSource(inputs, StaticFrames(), "base", arm_filter)
    inputs.on_joint_state(stamped(JointState(name=list(JOINTS), position=[1.0, 0.0, 0.0]), NOW_S))  # type: ignore[arg-type]
    inputs.on_cloud("stem_cloud", cloud(5))
    inputs.on_joint_state(stamped(JointState(name=list(JOINTS), position=[2.0, 0.0, 0.0]), NOW_S + 0.1))  # type: ignore[arg-type]
    for count in (5, 6, 6):
        assert len(made.scene(snapshot_from({}), never).stem_points) == count
    assert seen == [1.0, 2.0]


def test_a_scene_is_made_again_once_it_is_known_where_the_arm_was(inputs: Inputs) -> None:
    seen: list[object] = []
    made = SceneSource(inputs, StaticFrames(), "base", lambda scene, q, _: seen.append(None if q is None else q[0]) or scene)  # type: ignore[index, func-returns-value]
    inputs.on_cloud("stem_cloud", stamped(cloud(5), NOW_S))
    for at_s in (-0.1, 0.1, 0.2, 0.3):
        made.scene(snapshot_from({}), never)
        names = list(JOINTS) if at_s < 0.15 else ["finger"]
        inputs.on_joint_state(stamped(JointState(name=names, position=[10.0 * at_s, 0.0, 0.0][: len(names)]), NOW_S + at_s))  # type: ignore[arg-type]
    made.scene(snapshot_from({}), never)
    assert seen == [None, -1.0, pytest.approx(0.0, abs=1e-5)]


def test_a_stop_is_noticed_between_the_steps(inputs: Inputs) -> None:
    inputs.on_cloud("stem_cloud", cloud(5))
    asks = [0]

    def stop_at(number: int) -> bool:
        asks[0] += 1
        return asks[0] >= number

    for number in (1, 2):
        asks[0] = 0
        with pytest.raises(Refusal) as caught:
            source(inputs).scene(snapshot_from({}), lambda number=number: stop_at(number))
        assert caught.value.status is Status.CANCELLED
    assert len(source(inputs).scene(snapshot_from({}), never).stem_points) == 5
