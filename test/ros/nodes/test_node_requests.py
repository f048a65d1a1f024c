"""Who is answered what, and when: the planner node as a process, with a pipeline that costs nothing."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from domains import DOMAIN
from fake_node import ENDLESS, FORTH, SLOW, at_rest, fake_node
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_fakes import cloud
from ros_harness import Bench, code_of, plan_id
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

pytestmark = pytest.mark.timed


@pytest.fixture(scope="module")
def node() -> Iterator[Bench]:
    with fake_node(DOMAIN) as made:
        yield made


@pytest.fixture
def bench(node: Bench) -> Iterator[Bench]:
    with at_rest(node):
        yield node


def test_the_newest_request_wins_within_50_ms(bench: Bench) -> None:
    waits = []
    for _ in range(20):
        bench.send_target(ENDLESS)
        time.sleep(0.05)
        older = bench.call_async("preview")
        time.sleep(0.05)
        answered: list[float] = []
        heard = threading.Event()
        older.add_done_callback(lambda future, answered=answered, heard=heard: (answered.append(time.monotonic()), heard.set()))
        began = time.monotonic()
        newer = bench.call_async("preview")
        assert code_of(bench.result(older).message) == "PREEMPTED"
        assert heard.wait(5.0)  # callbacks may come after the result is there
        waits.append(answered[0] - began)
        bench.call("stop")
        assert code_of(bench.result(newer).message) == "CANCELLED"
    print(f"PREEMPTED after {1e3 * np.median(waits):.1f} ms (median), {1e3 * max(waits):.1f} ms (worst)")
    assert np.median(waits) < 0.05


def test_stop_cancels_planning_and_succeeds_when_idle(bench: Bench) -> None:
    assert bench.call("stop").message.startswith("SUCCEEDED: no motion was running; 0 request(s) cancelled [plan_id ")
    bench.send_target(ENDLESS)
    time.sleep(0.1)
    running = bench.call_async("plan")
    time.sleep(0.2)
    began = time.monotonic()
    response = bench.call("stop")
    assert response.success
    assert "1 request(s) cancelled [plan_id " in response.message
    assert plan_id(response.message) == plan_id(bench.result(running).message)
    assert "target 0.3000 9.0000 0.4000 in base stamped" in response.message
    assert code_of(bench.result(running).message) == "CANCELLED"
    assert time.monotonic() - began < 0.3
    assert not bench.commands


def test_a_preview_is_not_carried_out_after_its_target_was_withdrawn(bench: Bench) -> None:
    assert bench.call("preview").success
    bench.send_target([float("nan"), *FORTH[1:]])
    time.sleep(0.2)
    assert bench.call("execute").message.startswith("BAD_INPUT: the target was withdrawn by the one after it")
    assert not bench.commands


def test_a_deadline_holds_for_the_whole_request(bench: Bench) -> None:
    bench.set(deadline_s=0.9)
    try:
        bench.send_target(ENDLESS)
        time.sleep(0.2)
        began = time.monotonic()
        message = bench.call("preview").message
        assert message.startswith("TIMED_OUT: the deadline of 0.90 s passed") and "target 0.3000 9.0000" in message
        assert 0.85 < time.monotonic() - began < 1.2
        bench.send_target(SLOW)  # takes 0.6 s: time enough for one plan, but not for another one after a stem came
        time.sleep(0.2)
        planning = bench.call_async("plan")
        time.sleep(0.3)
        bench.send_clouds(None, cloud(99))
        began = time.monotonic()
        assert bench.result(planning).message.startswith("TIMED_OUT: ")
        assert time.monotonic() - began < 1.0
        assert not bench.commands
        time.sleep(0.3)
        assert bench.statuses[-1]["phase"] == "DONE" and bench.statuses[-1]["code"] == "TIMED_OUT"
    finally:
        bench.set(deadline_s=0.0)


def test_a_target_ages_until_the_motion_is_sent(bench: Bench) -> None:
    bench.set(max_target_age_s=0.3)
    try:
        bench.send_target(SLOW)
        time.sleep(0.1)
        assert bench.call("plan").message.startswith("STALE_INPUT: the newest grasp_target is ")
        assert not bench.commands
        bench.send_target(FORTH)
        time.sleep(0.1)
        assert bench.call("preview").success
        time.sleep(0.4)  # whoever looks at a preview takes his time
        assert bench.call("execute").success
    finally:
        bench.set(max_target_age_s=0.0)


def test_a_request_that_never_began_tells_its_target_too(bench: Bench) -> None:
    bench.send_target(ENDLESS)
    time.sleep(0.1)
    waiting = [bench.call_async("preview") for _ in range(4)]
    answers = [bench.result(future).message for future in waiting[:3]]
    bench.call("stop")
    assert [code_of(message) for message in answers] == ["PREEMPTED"] * 3
    assert all("target 0.3000 9.0000 0.4000 in base stamped" in message for message in answers)
    bench.wait(lambda: sum(s.get("code") == "PREEMPTED" and "target_stamp" in s for s in list(bench.statuses)) >= 3, 2.0, "statuses")


def test_a_hundred_requests_at_once_get_one_answer_each(bench: Bench) -> None:
    answers: Counter[int] = Counter()
    futures = []
    for _ in range(100):
        future = bench.call_async("preview")
        future.add_done_callback(lambda future: answers.update([plan_id(future.result().message)]))
        futures.append(future)
    codes = Counter(code_of(bench.result(future).message) for future in futures)
    assert codes["SUCCEEDED"] >= 1
    assert codes["SUCCEEDED"] + codes["PREEMPTED"] == 100
    assert len(answers) == 100
    assert set(answers.values()) == {1}


def test_callers_that_vanish_harm_nobody(bench: Bench) -> None:
    bench.send_target(ENDLESS)
    time.sleep(0.1)
    for _ in range(3):
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=DOMAIN)
        node = Node("fleeting", context=context)
        client = node.create_client(Trigger, "lime_planner/preview")
        assert client.wait_for_service(5.0)
        client.call_async(Trigger.Request())
        time.sleep(0.1)
        node.destroy_node()
        context.try_shutdown()
    bench.send_target(FORTH)
    time.sleep(0.1)
    assert bench.call("preview").success


def test_a_best_effort_camera_is_heard(bench: Bench) -> None:
    camera = Node("camera", context=bench.context)
    publisher = camera.create_publisher(PointCloud2, "labelled_cloud", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    time.sleep(1.2)
    before = bench.received("labelled_cloud")
    for _ in range(15):
        publisher.publish(cloud(50, label=np.ones(50, np.uint8)))
        time.sleep(0.1)
    bench.wait(lambda: bench.received("labelled_cloud") >= before + 10, 3.0, "labelled clouds")
    assert bench.call("preview").success
    camera.destroy_node()
