"""What the arm is sent, and when: the planner node as a process, with a pipeline that costs nothing."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from domains import DOMAIN
from fake_node import BACK, FORTH, SLOW, at_rest, fake_node
from ros_fakes import cloud
from ros_harness import Bench, code_of, execution_code, plan_id

pytestmark = pytest.mark.timed


@pytest.fixture(scope="module")
def node() -> Iterator[Bench]:
    with fake_node(DOMAIN) as made:
        yield made


@pytest.fixture
def bench(node: Bench) -> Iterator[Bench]:
    with at_rest(node):
        yield node


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
    assert (len(stop.points) == 1) if controller == "kinova" else (stop.points[0].time_from_start.nanosec >= 8e7), "left to the controller"
    assert np.allclose(again.points[0].positions, stop.points[-1].positions, atol=0.01), "planned from where it came to rest"
    assert bench.commands[2][0] - bench.commands[1][0] > 0.25, "not before stillness was seen"
    assert execution_code(bench, plan_id(second.message)) == "SUCCEEDED"


def test_plan_and_wait_answers_when_the_arm_rests(bench: Bench) -> None:
    goal, began = bench.q + 0.3, time.monotonic()
    response = bench.call("plan_and_wait")
    assert time.monotonic() - began > 1.5, "the motion takes as long"
    assert response.success and "the arm rests" in response.message, response.message
    assert np.abs(bench.q - goal).max() < 1e-3
    waiting = bench.call_async("plan_and_wait")
    bench.wait_phase("EXECUTING", timeout_s=5.0)
    time.sleep(0.3)
    assert bench.call("stop").success
    stopped = bench.result(waiting, 5.0)
    assert (stopped.success, code_of(stopped.message)) == (False, "CANCELLED")
    bench.set(motion_enabled=False)
    assert code_of(bench.call("plan_and_wait", timeout_s=5.0).message) == "MOTION_DISABLED"
    bench.set(motion_enabled=True)
    waiting = bench.call_async("plan_and_wait")
    time.sleep(0.6)
    newer = bench.call_async("plan")
    assert code_of(bench.result(waiting, 5.0).message) == "PREEMPTED"
    assert bench.result(newer).success


def test_a_plan_to_where_the_arm_is_sends_nothing_and_leaves_the_way_out(bench: Bench) -> None:
    begin = bench.q
    assert bench.call("plan_and_wait").success
    bench.send_target([0.0, *FORTH[1:]])
    time.sleep(0.2)
    sent = len(bench.commands)
    for name in ("plan", "plan_and_wait"):
        response = bench.call(name, timeout_s=5.0)
        assert response.success and "no motion was sent" in response.message
        assert execution_code(bench, plan_id(response.message)) == "SUCCEEDED"
    assert bench.call("preview").success
    assert "no motion was sent" in bench.call("execute").message
    assert len(bench.commands) == sent
    bench.send_target([0.02, *FORTH[1:]])
    time.sleep(0.2)
    assert bench.call("plan_and_wait").success
    assert len(bench.commands) == sent + 1
    retreat = bench.call("retreat")
    assert retreat.success, retreat.message
    assert execution_code(bench, plan_id(retreat.message)) == "SUCCEEDED"
    assert np.abs(bench.q - begin).max() < 0.005


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
    bench.set(max_joint_state_age_s=0.3)
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


def test_where_no_plan_leads_on_it_goes_back_out_and_plans_from_there(bench: Bench) -> None:
    bench.set(replan_attempts=1)
    began = bench.q.copy()
    number = plan_id(bench.call("plan").message)
    time.sleep(0.5)
    bench.send_clouds(None, cloud(99))
    bench.wait(lambda: len(bench.commands) == 2, 2.0, "the stop")
    bench.send_clouds(None, cloud(77))
    assert execution_code(bench, number) == "STEM_APPEARED"
    bench.wait(lambda: len(bench.commands) == 4, 10.0, "the way out, and the plan from there")
    out, again = (bench.commands[k][1].points for k in (2, 3))
    assert np.abs(np.array(out[-1].positions) - began).max() < 0.02 < np.abs(np.array(out[0].positions) - began).max()
    assert np.abs(np.array(again[0].positions) - began).max() < 0.02
    bench.wait(
        lambda: any(s.get("kind") == "replan" and s.get("execution_code") == "SUCCEEDED" for s in list(bench.statuses)), 10.0, "its end"
    )


def test_a_look_needs_a_camera(bench: Bench) -> None:
    answer = bench.call("look")
    assert answer.message.startswith("BAD_INPUT: there is no camera to look with: camera_frame names the frame of one that the arm carries")
    assert not bench.commands
    bench.set(look_first=True)
    assert bench.call("plan").message.startswith("BAD_INPUT: there is no camera to look with")
    bench.set(look_first=False)


def test_after_a_stop_it_does_not_plan_again_by_itself(bench: Bench) -> None:
    bench.set(replan_attempts=1)
    number = plan_id(bench.call("plan").message)
    time.sleep(0.3)
    bench.send_clouds(None, cloud(99))
    bench.wait(lambda: len(bench.commands) == 2, 2.0, "the stop")
    response = bench.call("stop")  # before the arm is seen to rest
    assert response.message.startswith("SUCCEEDED: the motion is being stopped") and plan_id(response.message) == number
    bench.send_clouds(None, cloud(100))
    assert execution_code(bench, number) == "CANCELLED"
    time.sleep(0.6)
    assert len(bench.commands) == 2
