"""The parameter table as ROS parameters, and quality of service by what publishers offer."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import pytest
import rclpy
from domains import DOMAIN
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS, unknown_names
from lime_planner.ros import qos
from lime_planner.ros.parameters import NodeParameters, snapshot_from

pytestmark = pytest.mark.timed


@pytest.fixture(scope="module")
def context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    yield context
    context.try_shutdown()


def make(context: rclpy.Context, *overrides: Parameter) -> tuple[Node, NodeParameters]:
    node = Node("parameters", context=context, parameter_overrides=list(overrides))
    return node, NodeParameters(node)


def test_all_are_declared_with_descriptions(context: rclpy.Context) -> None:
    node, params = make(context)
    for name, parameter in {**PARAMETERS, **NODE_PARAMETERS}.items():
        descriptor = node.describe_parameter(name)
        assert descriptor.description.startswith(parameter.description), name
        assert descriptor.read_only == parameter.read_only
        value = node.get_parameter(name).value
        assert (list(value) if isinstance(parameter.default, list) else value) == parameter.default, name
    assert params.snapshot.plan.time_budget_s == 0.5
    assert params.snapshot.node.motion_enabled is True
    node.destroy_node()


def test_start_values_are_checked_and_converted(context: rclpy.Context) -> None:
    given = [
        Parameter("time_budget_s", value=2),
        Parameter("keep_out_boxes", value=[0, 0, 0, 1, 1, 1]),
        Parameter("leaf_labels", value=[3, 4]),
    ]
    node, params = make(context, *given)
    assert params.snapshot.plan.time_budget_s == 2.0
    assert params.snapshot.plan.keep_out_boxes == (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
    assert params.snapshot.node.leaf_labels == (3, 4)
    node.destroy_node()
    for bad in (Parameter("time_budget_s", value=-1.0), Parameter("controller", value="hal"), Parameter("keep_out_boxes", value=[1.0])):
        node = Node("parameters", context=context, parameter_overrides=[bad])
        with pytest.raises(ParameterError, match=bad.name):
            NodeParameters(node)
        node.destroy_node()


def test_a_misspelt_name_is_refused_and_a_foreign_one_is_told(context: rclpy.Context) -> None:
    for slip, meant in (("motion_enable", "motion_enabled"), ("floor_z", "floor_z_m"), ("stem_margin", "stem_margin_m")):
        node = Node("parameters", context=context, parameter_overrides=[Parameter(slip, value=0.0)])
        with pytest.raises(ParameterError, match=f"no parameter '{slip}'; did you mean {meant}"):
            NodeParameters(node)
        node.destroy_node()
    own = ["use_sim_time", "start_type_description_service", "qos_overrides./clock.subscription.depth", "seed"]
    assert unknown_names(own) == []
    assert unknown_names([*own, "camera.rate"]) == ["there is no parameter 'camera.rate'; its value is ignored"]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("time_budget_s", -1.0, "time_budget_s"),
        ("time_budget_s", "soon", "time_budget_s must be a number"),
        ("time_budget_s", float("nan"), "out of range"),
        ("planner", "magic", "allowed: one of lime_star"),
        ("velocity_scaling", 1.5, "velocity_scaling"),
        ("motion_enabled", 1, "motion_enabled must be true or false"),
        ("keep_out_boxes", [0.0, 0.0], "multiple of 6"),
        ("keep_out_boxes", [1.0, 0.0, 0.0, 0.0, 1.0, 1.0], "minimum"),
        ("leaf_labels", [1], "leaf_labels and stem_labels share 1; a class has one meaning"),
        ("robot", "topic", "read-only"),
        ("iterations", 2.5, "whole number"),
        ("iterations", float("nan"), "iterations must be finite"),
        ("iterations", float("inf"), "iterations must be finite"),
        ("leaf_labels", [float("nan")], "leaf_labels must be finite"),
        ("leaf_labels", 3, "leaf_labels must be a list, got 3"),
        ("keep_out_boxes", 1.0, "keep_out_boxes must be a list"),
        ("label_field", "", "must name a field that holds nothing but the class"),
        ("label_field", "x", "must name a field"),
        ("label_field", "permeability_cost", "must name a field"),
    ],
)
def test_bad_values_are_refused_with_a_reason(context: rclpy.Context, name: str, value: object, words: str) -> None:
    node, params = make(context)
    before = params.snapshot
    outcome = node.set_parameters([Parameter(name, value=value)])[0]
    assert not outcome.successful
    assert words in outcome.reason
    assert params.snapshot == before
    node.destroy_node()


def test_a_snapshot_does_not_change(context: rclpy.Context) -> None:
    node, params = make(context)
    before = params.snapshot
    assert node.set_parameters([Parameter("c_perm", value=7.0), Parameter("motion_enabled", value=False)])[1].successful
    assert node.set_parameters([Parameter("workspace_box", value=[-1, -1, 0, 1, 1, 1])])[0].successful
    assert (before.plan.c_perm, before.node.motion_enabled) == (100.0, True)
    assert (params.snapshot.plan.c_perm, params.snapshot.node.motion_enabled) == (7.0, False)
    assert params.snapshot.plan.workspace_box == (-1.0, -1.0, 0.0, 1.0, 1.0, 1.0)
    atomic = node.set_parameters_atomically([Parameter("c_perm", value=8.0), Parameter("seed", value=-4)])
    assert not atomic.successful
    assert params.snapshot.plan.c_perm == 7.0
    node.destroy_node()


def test_classes_have_one_meaning() -> None:
    names = ("leaf_labels", "stem_labels", "fruit_labels", "ignored_labels")
    apart = dict(zip(names, ([10], [11], [12], [13]), strict=True))
    assert snapshot_from(apart).node.fruit_labels == (12,)
    for first, second in itertools.combinations(names, 2):
        with pytest.raises(ParameterError, match=f"{first} and {second} share 7; a class has one meaning"):
            snapshot_from(apart | {first: [7, 8], second: [9, 7]})
    # The default of the fruit gives way: whoever numbers his classes otherwise need not know of it.
    node = snapshot_from({"leaf_labels": [1], "stem_labels": [2], "ignored_labels": [0]}).node
    assert (node.leaf_labels, node.stem_labels, node.fruit_labels, node.ignored_labels) == ((1,), (2,), (), (0,))


def test_an_empty_list_in_a_file_is_one(context: rclpy.Context) -> None:
    node, params = make(context, Parameter("fruit_labels", Parameter.Type.NOT_SET))
    assert params.snapshot.node.fruit_labels == ()
    assert node.set_parameters([Parameter("stem_labels", value=[1, 2])])[0].successful
    assert params.snapshot.node.stem_labels == (1, 2)
    node.destroy_node()


def test_a_parameter_cannot_be_removed(context: rclpy.Context) -> None:
    node, params = make(context)
    before = params.snapshot
    for name in ("time_budget_s", "leaf_labels"):
        outcome = node.set_parameters([Parameter(name, Parameter.Type.NOT_SET)])[0]
        assert not outcome.successful
        assert outcome.reason == f"{name}: the value cannot be removed"
    assert params.snapshot == before
    node.destroy_node()


def offer(reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(depth=5, reliability=reliability, durability=durability)


RELIABLE, EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED, VOLATILE = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE


@pytest.mark.parametrize(
    ("offer_made", "best_effort", "latched"),
    [
        ((RELIABLE, VOLATILE), False, False),
        ((RELIABLE, LATCHED), False, True),
        ((EFFORT, VOLATILE), True, False),
        ((EFFORT, LATCHED), True, False),
    ],
)
def test_offers_ask_for_further_subscriptions(offer_made: tuple, best_effort: bool, latched: bool) -> None:
    assert qos.is_best_effort(offer(*offer_made)) == best_effort
    assert qos.is_latched(offer(*offer_made)) == latched


def test_every_publisher_is_heard_once(context: rclpy.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qos, "COLLECTING_S", 1.0)
    heard: list[str] = []
    node, executor = Node("listener", context=context), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    cameras = [
        node.create_publisher(String, "cloud", offer(*each)) for each in ((RELIABLE, LATCHED), (RELIABLE, VOLATILE), (EFFORT, VOLATILE))
    ]

    def spin(duration_s: float) -> None:
        deadline = time.monotonic() + duration_s
        while time.monotonic() < deadline:
            executor.spin_once(0.02)

    cameras[0].publish(String(data="before"))
    subscription = qos.AdaptiveSubscription(node, String, "cloud", offer(RELIABLE, VOLATILE), lambda msg: heard.append(msg.data))
    deadline = time.monotonic() + 5.0
    while "before" not in heard and time.monotonic() < deadline:
        subscription.check()
        spin(0.2)
    for round_number in range(2):  # while it collects, and when it has collected
        for name, camera in zip(("latched", "reliable", "effort"), cameras, strict=True):
            camera.publish(String(data=f"{name} {round_number}"))
            spin(0.2)
        spin(1.0)
        subscription.check()
        subscription.check()
    assert sorted(heard) == ["before", "effort 0", "effort 1", "latched 0", "latched 1", "reliable 0", "reliable 1"]
    late = node.create_publisher(String, "cloud", offer(RELIABLE, LATCHED))
    late.publish(String(data="late"))
    deadline = time.monotonic() + 5.0
    while "late" not in heard and time.monotonic() < deadline:
        subscription.check()
        spin(0.2)
    assert heard.count("late") == 1
    executor.shutdown()
    node.destroy_node()


def test_a_new_publisher_does_not_bring_old_messages_back(context: rclpy.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qos, "COLLECTING_S", 0.5)
    node, executor = Node("listener", context=context), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    heard: list[str] = []
    subscription = qos.AdaptiveSubscription(node, String, "target", offer(RELIABLE, VOLATILE), lambda msg: heard.append(msg.data))

    def spin(duration_s: float) -> None:
        deadline = time.monotonic() + duration_s
        while time.monotonic() < deadline:
            executor.spin_once(0.02)
            subscription.check()

    def until(word: str) -> None:
        deadline = time.monotonic() + 5.0
        while word not in heard and time.monotonic() < deadline:
            spin(0.05)
        assert word in heard

    hand = node.create_publisher(String, "target", offer(RELIABLE, LATCHED))
    hand.publish(String(data="old"))
    until("old")
    spin(1.0)
    detector = node.create_publisher(String, "target", offer(RELIABLE, VOLATILE))
    for number in range(20):  # more than are remembered one by one
        detector.publish(String(data=f"lime {number}"))
        spin(0.03)
    until("lime 19")
    silent = node.create_publisher(String, "target", offer(RELIABLE, LATCHED))
    spin(1.0)
    assert subscription._collected, "it was collected from"
    assert heard[-1] == "lime 19" and heard.count("old") == 1
    silent.publish(String(data="new"))
    until("new")
    assert heard[-1] == "new"
    executor.shutdown()
    node.destroy_node()


def test_an_older_message_does_not_take_the_place_of_a_newer_one(context: rclpy.Context) -> None:
    node = Node("listener", context=context)
    camera = node.create_publisher(String, "target", offer(RELIABLE, VOLATILE))
    heard: list[str] = []
    subscription = qos.AdaptiveSubscription(node, String, "target", offer(RELIABLE, VOLATILE), lambda msg: heard.append(msg.data))
    deadline = time.monotonic() + 5.0
    while not subscription._publishers and time.monotonic() < deadline:
        subscription.check()
    for number, sent in ((1, 1000), (3, 3000), (2, 2000), (3, 3000), (4, 4000)):  # as two profiles may hand them over
        subscription._receive(String(data=str(number)), {"source_timestamp": sent, "publication_sequence_number": number})
    assert heard == ["1", "3", "4"]
    assert subscription.lost == 1
    # A publisher that has taken the first one's place a moment ago counts from 1 again.
    subscription._receive(String(data="new"), {"source_timestamp": 5000, "publication_sequence_number": 1})
    assert heard[-1] == "new"
    node.destroy_publisher(camera)
    node.destroy_node()


def test_messages_that_never_arrive_are_counted(context: rclpy.Context) -> None:
    listener, camera = Node("listener", context=context), Node("camera", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listener)
    heard: list[String] = []
    subscription = qos.AdaptiveSubscription(listener, String, "counted", qos.NEWEST, heard.append)
    publisher = camera.create_publisher(String, "counted", qos.NEWEST)
    deadline = time.monotonic() + 10.0
    while publisher.get_subscription_count() == 0 and time.monotonic() < deadline:
        time.sleep(0.01)
    subscription.check()
    for burst in (1, 3, 1, 5):  # of a burst only the last is kept
        for _ in range(burst):
            publisher.publish(String())
        time.sleep(0.05)
        executor.spin_once(timeout_sec=1.0)
    assert (len(heard), subscription.lost) == (4, 6)
    executor.shutdown()
    listener.destroy_node()
    camera.destroy_node()


def test_a_motion_command_is_never_latched() -> None:
    assert (qos.COMMAND.durability, qos.COMMAND.reliability, qos.COMMAND.depth) == (VOLATILE, RELIABLE, 1)
