"""What monitors read: `/diagnostics` and the latched status of a planner node in a namespace."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from domains import DOMAIN
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_fakes import build_fake

from lime_planner.core.errors import RobotError
from lime_planner.core.status import Status
from lime_planner.ros import qos
from lime_planner.ros.nodes import planner_node
from lime_planner.ros.requests.status_board import Phase, read_status

pytestmark = pytest.mark.timed


@pytest.fixture(name="make")
def maker(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., planner_node.PlannerNode]]:
    """Make planner nodes in this process; nothing spins them."""
    monkeypatch.setattr(planner_node, "make_arm_filter", lambda robot: lambda scene, q, padding_m: scene)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    made: list[planner_node.PlannerNode] = []

    def make(builder: Any = build_fake, **options: Any) -> planner_node.PlannerNode:
        made.append(planner_node.PlannerNode(builder, context=context, **options))
        return made[-1]

    yield make
    for node in made:
        node.shut_down()
        node.destroy_node()
    context.try_shutdown()


def health(node: planner_node.PlannerNode) -> DiagnosticStatus:
    sent: list[DiagnosticArray] = []
    publisher, node._health = node._health, type("Publisher", (), {"publish": staticmethod(sent.append)})()
    node._publish_health()
    node._health = publisher
    return sent[0].status[0]


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_names_carry_the_namespace(make: Callable[..., planner_node.PlannerNode]) -> None:
    left, plain = make(namespace="/farm/left"), make()
    assert health(left).name == "farm/left/lime_planner: health"
    assert health(plain).name == "lime_planner: health"
    assert left.board._name == "farm/left/lime_planner"


def test_a_robot_that_cannot_be_loaded_is_an_error(make: Callable[..., planner_node.PlannerNode]) -> None:
    def refuse(settings: object, urdf: str | None) -> Any:
        raise RobotError("no such arm")

    node = make(refuse)
    wait_until(lambda: bool(node.loader.failure))
    status = health(node)
    assert status.level == DiagnosticStatus.ERROR and "cannot be loaded: no such arm" in status.message
    # With an arm in use, another one that cannot be loaded is a warning: the node goes on.
    taken = make(
        lambda settings, urdf: build_fake(settings, None) if urdf == "good" else refuse(settings, urdf),
        namespace="b",
        parameter_overrides=[rclpy.parameter.Parameter("robot", value="topic")],
    )
    taken.loader.offer("good")
    wait_until(lambda: taken.loader.ready)
    assert health(taken).level == DiagnosticStatus.OK
    taken.loader.offer("bad")
    wait_until(lambda: bool(taken.loader.failure))
    status = health(taken)
    assert taken.loader.ready and status.level == DiagnosticStatus.WARN and "no such arm" in status.message
    taken.loader.offer("good")
    wait_until(lambda: not taken.loader.failure)


def test_a_refused_request_is_a_warning_until_one_is_served(make: Callable[..., planner_node.PlannerNode]) -> None:
    node = make()
    wait_until(lambda: node.loader.ready)
    for number, (code, level) in enumerate(
        (
            (Status.NO_TARGET, DiagnosticStatus.WARN),
            (Status.SUCCEEDED, DiagnosticStatus.OK),
            (Status.GOAL_IN_STEM, DiagnosticStatus.WARN),
            (Status.PREEMPTED, DiagnosticStatus.OK),
            (Status.INTERNAL_ERROR, DiagnosticStatus.ERROR),
            (Status.CANCELLED, DiagnosticStatus.OK),
        ),
        1,
    ):
        node.board.show(number, Phase.DONE, code, code.message("a sentence"))
        status = health(node)
        assert status.level == level, code
        assert (f"the last request: {code.name}: a sentence" in status.message) == (level != DiagnosticStatus.OK)


def test_whoever_subscribes_late_sees_the_newest_status_first(make: Callable[..., planner_node.PlannerNode]) -> None:
    node = make()
    for number in range(1, 6):
        node.board.show(number, Phase.DONE, Status.NO_TARGET, "NO_TARGET: none")
    heard: list[dict[str, str]] = []
    late = Node("late", context=node.context)
    late.create_subscription(DiagnosticArray, "lime_planner/status", lambda msg: heard.append(read_status(msg)), qos.EVERY_STATUS)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(late)
    done = threading.Event()
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline and not done.is_set():
        executor.spin_once(0.2)
        if heard:
            done.wait(0.3)
            executor.spin_once(0.2)
            break
    executor.shutdown()
    late.destroy_node()
    assert [status["plan_id"] for status in heard] == ["5"]
