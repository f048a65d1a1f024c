"""The planner node as a process, with a pipeline that costs nothing: who is answered what and when, and what the arm is sent."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_fakes import JOINTS, START, cloud
from ros_harness import Bench, code_of, execution_code, plan_id, program
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

pytestmark = pytest.mark.alone

DOMAIN = 60 + os.getpid() % 40
FORTH = [0.3, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]
BACK = [-0.3, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]
SLOW = [0.3, 8.0, 0.4, 0.0, 0.0, 0.0, 1.0]
ENDLESS = [0.3, 9.0, 0.4, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def node() -> Iterator[Bench]:
    with program(["test/fake_planner.py"], DOMAIN, "ready to plan", FAKE_DURATION_S="1.5"):
        bench = Bench(JOINTS, START, domain=DOMAIN)
        bench.call("stop")
        yield bench
        bench.close()


@pytest.fixture
def bench(node: Bench) -> Iterator[Bench]:
    """The bench at rest, with good inputs."""
    node.publish_states = node.follow = True
    node.send_clouds(cloud(200), cloud(100))
    node.send_target(FORTH)
    time.sleep(0.4)
    node.commands.clear()
    yield node
    node.set(motion_enabled=True, controller="jtc", replan_attempts=0)
    node.follow = node.publish_states = True
    node.call("stop")
    time.sleep(0.7)


def test_a_plan_is_sent_followed_and_reported(bench: Bench) -> None:
    goal = bench.q + 0.3
    began = time.monotonic()
    response = bench.call("plan")
    assert time.monotonic() - began < 0.5
    assert response.success
    assert "target 0.3000 0.0000 0.4000 in base stamped" in response.message
    number = plan_id(response.message)
    assert execution_code(bench, number) == "SUCCEEDED"
    assert np.abs(bench.q - goal).max() < 1e-6
    phases = [s["phase"] for s in bench.statuses if s["plan_id"] == str(number)]
    assert list(dict.fromkeys(phases)) == ["PLANNING", "EXECUTING", "DONE"]
    last = bench.statuses[-1]
    assert last["code"] == "SUCCEEDED"
    assert last["target_position"] == "[0.3,0.0,0.4]"
    assert float(last["target_stamp"]) > 1e9
    for key in ("planner", "seed", "path_length_rad", "waypoints"):
        assert key in last
    assert len(bench.commands) == 1
    assert len(bench.paths[-1].poses) == 5
    retreat = bench.call("retreat")
    assert retreat.success
    assert execution_code(bench, plan_id(retreat.message)) == "SUCCEEDED"
    assert np.abs(bench.q - goal + 0.3).max() < 1e-3
    assert code_of(bench.call("retreat").message) == "NOTHING_TO_EXECUTE"


def test_preview_shows_and_execute_moves(bench: Bench) -> None:
    shown = len(bench.paths)
    assert bench.call("preview").success
    bench.wait(lambda: len(bench.paths) > shown, 2.0, "path")
    assert not bench.commands
    response = bench.call("execute")
    assert response.success
    assert code_of(bench.call("execute").message) == "NOTHING_TO_EXECUTE"
    assert execution_code(bench, plan_id(response.message)) == "SUCCEEDED"
    bench.call("preview")
    bench.q = bench.q + 0.2
    bench._motion = None
    time.sleep(0.5)
    assert code_of(bench.call("execute").message) == "START_INVALID"
    assert len(bench.commands) == 1


def test_motion_disabled_plans_and_says_so(bench: Bench) -> None:
    assert bench.set(motion_enabled=False) == [""]
    shown = len(bench.paths)
    response = bench.call("plan")
    assert not response.success
    assert response.message.startswith("MOTION_DISABLED: planned and published, but not sent")
    bench.wait(lambda: len(bench.paths) > shown, 2.0, "path")
    assert not bench.commands
    bench.set(motion_enabled=True)
    assert bench.call("plan").success


def test_nobody_listens(bench: Bench) -> None:
    bench.disconnect_controller()
    time.sleep(0.3)
    assert code_of(bench.call("plan").message) == "NO_CONTROLLER"
    bench.connect_controller()
    bench.wait(lambda: code_of(bench.call("plan").message) == "SUCCEEDED", 5.0, "a controller again")


def test_the_newest_request_wins_within_50_ms(bench: Bench) -> None:
    waits = []
    for _ in range(20):
        bench.send_target(ENDLESS)
        time.sleep(0.05)
        older = bench.call_async("preview")
        time.sleep(0.05)
        answered: list[float] = []
        older.add_done_callback(lambda future, answered=answered: answered.append(time.monotonic()))
        began = time.monotonic()
        newer = bench.call_async("preview")
        assert code_of(bench.result(older).message) == "PREEMPTED"
        waits.append(answered[0] - began)
        bench.call("stop")
        assert code_of(bench.result(newer).message) == "CANCELLED"
    print(f"PREEMPTED after {1e3 * np.median(waits):.1f} ms (median), {1e3 * max(waits):.1f} ms (worst)")
    assert np.median(waits) < 0.05


def test_stop_cancels_planning_and_succeeds_when_idle(bench: Bench) -> None:
    assert bench.call("stop").message == "SUCCEEDED: no motion was running; 0 request(s) cancelled"
    bench.send_target(ENDLESS)
    time.sleep(0.1)
    running = bench.call_async("plan")
    time.sleep(0.2)
    began = time.monotonic()
    response = bench.call("stop")
    assert response.success
    assert "1 request(s) cancelled" in response.message
    assert code_of(bench.result(running).message) == "CANCELLED"
    assert time.monotonic() - began < 0.3
    assert not bench.commands


@pytest.mark.parametrize("controller", ["jtc", "kinova"])
def test_a_new_plan_stops_the_arm_before_it_sends(bench: Bench, controller: str) -> None:
    bench.set(controller=controller)
    first = bench.call("plan")
    assert first.success
    time.sleep(0.6)
    bench.send_target(BACK)
    time.sleep(0.1)
    second = bench.call("plan")
    assert second.success, second.message
    assert execution_code(bench, plan_id(first.message)) == "PREEMPTED"
    assert len(bench.commands) == 3
    stop, again = bench.commands[1][1], bench.commands[2][1]
    assert list(stop.points[-1].velocities) == [0.0] * 3
    assert len(stop.points) == 1 if controller == "kinova" else len(stop.points) > 5
    assert np.allclose(again.points[0].positions, stop.points[-1].positions, atol=0.01), "planned from where it came to rest"
    assert bench.commands[2][0] - bench.commands[1][0] > 0.25, "not before stillness was seen"
    assert execution_code(bench, plan_id(second.message)) == "SUCCEEDED"


def test_an_arm_that_does_not_come_to_rest(bench: Bench) -> None:
    bench.follow = False
    bench.set(stillness_timeout_s=0.5)
    bench.publish_states = False
    deadline = time.monotonic() + 1.6
    future = None
    while time.monotonic() < deadline:
        bench.q = bench.q + 0.01
        bench.joints.publish(bench.joint_state(bench.q))
        if future is None and time.monotonic() > deadline - 1.3:
            future = bench.call_async("plan")
        time.sleep(0.01)
    assert code_of(bench.result(future).message) == "ARM_MOVING"
    assert not bench.commands
    bench.set(stillness_timeout_s=3.0)


def test_stop_is_on_the_wire_within_50_ms(bench: Bench) -> None:
    waits = []
    for target in (FORTH, BACK) * 3:
        bench.send_target(target)
        time.sleep(0.05)
        assert bench.call("plan").success
        time.sleep(0.3)
        busy = bench.call_async("preview")
        sent = len(bench.commands)
        began = time.monotonic()
        stopped = bench.call_async("stop")
        bench.wait(lambda sent=sent: len(bench.commands) > sent, 1.0, "the stop")
        waits.append(bench.commands[-1][0] - began)
        assert bench.result(stopped).success
        bench.result(busy)
        time.sleep(0.5)
    print(f"stop on the wire after {1e3 * np.median(waits):.1f} ms (median), {1e3 * max(waits):.1f} ms (worst)")
    assert np.median(waits) < 0.05


def test_a_stem_that_appears_stops_the_arm_and_leaves_do_not(bench: Bench) -> None:
    number = plan_id(bench.call("plan").message)
    time.sleep(0.2)
    bench.send_clouds(cloud(99), cloud(100))
    bench.send_clouds(None, cloud(0))
    bad = cloud(100)
    bad.fields = []
    bench.send_clouds(None, bad)
    time.sleep(0.3)
    assert len(bench.commands) == 1
    bench.send_clouds(None, cloud(99))
    assert execution_code(bench, number) == "STEM_APPEARED"
    assert len(bench.commands) == 2
    assert "a stem stands 0.3 m ahead" in bench.statuses[-1]["execution_message"]


def test_what_changes_while_a_plan_is_made_is_looked_at_before_it_is_sent(bench: Bench) -> None:
    withdrawn = [float("nan"), *FORTH[1:]]
    for change, code, words in (
        (lambda: bench.send_clouds(None, cloud(99)), "STEM_APPEARED", "came while planning, a stem stands 0.3 m ahead; nothing was sent"),
        (lambda: bench.send_clouds(None, cloud(0)), "NO_CLOUD", "the stem cloud that came while planning"),
        (lambda: bench.send_target(withdrawn), "BAD_INPUT", "withdrawn by the one after it"),
        (lambda: bench.set(motion_enabled=False), "MOTION_DISABLED", "motion_enabled is false"),
    ):
        bench.set(motion_enabled=True)
        bench.send_clouds(None, cloud(100))
        bench.send_target(SLOW)
        time.sleep(0.2)
        planning = bench.call_async("plan")
        time.sleep(0.2)
        change()
        if code == "STEM_APPEARED":  # planned again with that stem in sight, and another one comes
            time.sleep(0.7)
            change()
        message = bench.result(planning).message
        assert message.startswith(f"{code}: "), message
        assert words in message
        assert not bench.commands
    bench.set(motion_enabled=True)
    bench.send_target(SLOW)
    time.sleep(0.2)
    planning = bench.call_async("plan")
    time.sleep(0.2)
    bench.send_clouds(None, cloud(101))  # in nobody's way
    assert bench.result(planning).success


def test_a_preview_is_not_carried_out_after_its_target_was_withdrawn(bench: Bench) -> None:
    assert bench.call("preview").success
    bench.send_target([float("nan"), *FORTH[1:]])
    time.sleep(0.2)
    assert bench.call("execute").message.startswith("BAD_INPUT: the target was withdrawn by the one after it")
    assert not bench.commands


def test_forbidding_motion_stops_the_one_that_runs(bench: Bench) -> None:
    number = plan_id(bench.call("plan").message)
    time.sleep(0.3)
    bench.set(motion_enabled=False)
    assert execution_code(bench, number) == "CANCELLED"
    assert "motion_enabled was set to false" in bench.statuses[-1]["execution_message"]
    assert len(bench.commands) == 2


def test_deviation_and_silence_stop_the_arm(bench: Bench) -> None:
    number = plan_id(bench.call("plan").message)
    time.sleep(0.5)
    bench.follow = False
    assert execution_code(bench, number) == "EXECUTION_DEVIATED"
    assert len(bench.commands[1][1].points) == 1
    bench.follow = True
    time.sleep(0.5)
    number = plan_id(bench.call("plan").message)
    time.sleep(0.3)
    bench.publish_states = False
    bench.wait(lambda: len(bench.commands) == 4, 2.0, "stop on silence")
    time.sleep(0.3)
    bench.publish_states = True
    assert execution_code(bench, number) == "STALE_INPUT"


def test_it_plans_again_after_an_abort_if_told_to(bench: Bench) -> None:
    bench.set(replan_attempts=1)
    number = plan_id(bench.call("plan").message)
    time.sleep(0.3)
    bench.send_clouds(None, cloud(99))
    assert execution_code(bench, number) == "STEM_APPEARED"
    bench.send_clouds(None, cloud(100))
    bench.wait(lambda: any(s.get("kind") == "replan" and s["phase"] == "EXECUTING" for s in list(bench.statuses)), 5.0, "another plan")


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
