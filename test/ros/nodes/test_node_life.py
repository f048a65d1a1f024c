"""The planner node from its start to its end: warm-up, the robot's description, signals in every phase."""

from __future__ import annotations

import signal
import time

import pytest
from domains import DOMAIN
from fake_node import ENDLESS, FORTH, PATIENT
from ros_fakes import JOINTS, START, cloud
from ros_harness import Bench, Program, code_of, execution_code, plan_id, program
from std_msgs.msg import String

from lime_planner.ros import qos

pytestmark = pytest.mark.timed


def test_requests_wait_for_the_warm_up_and_others_do_not() -> None:
    domain = DOMAIN + 1
    with program(["test/helpers/fake_planner.py"], domain, "serving", FAKE_WARM_UP_S="9.0"):
        bench = Bench(JOINTS, START, domain=domain)
        try:
            assert code_of(bench.call("plan").message) == "NO_TARGET"
            bench.send_target(FORTH)
            time.sleep(0.3)
            assert code_of(bench.call("plan").message) == "NO_CLOUD"
            bench.send_clouds(cloud(10), cloud(10))
            bench.wait(lambda: bench.health.get("engine") == "compiling the kernels", 3.0, "the engine's state")
            assert bench.set(warm_up_timeout_s=0.1) == [""]
            time.sleep(0.6)
            assert code_of(bench.call("plan").message) == "NOT_READY"
            bench.set(warm_up_timeout_s=20.0)
            waiting = bench.call_async("plan")
            time.sleep(0.2)
            began = time.monotonic()
            bench.call("stop")
            assert time.monotonic() - began < 0.2
            assert code_of(bench.result(waiting).message) == "CANCELLED"
            assert bench.call("plan").success
        finally:
            bench.close()


def test_the_robot_comes_from_its_topic_and_time_may_be_simulated() -> None:
    domain = DOMAIN + 1
    arguments = [
        "test/helpers/fake_planner.py",
        "--ros-args",
        *PATIENT,
        "-p",
        "robot:=topic",
        "-p",
        "use_sim_time:=true",
        "-p",
        "warm_up_timeout_s:=0.2",
    ]
    with program(arguments, domain, "serving"):
        bench = Bench(JOINTS, START, domain=domain)
        try:
            bench.call("stop")
            bench.send_clouds(None, cloud(10))
            bench.send_target(FORTH)
            bench.wait_inputs()
            assert bench.call("plan").message.startswith("NOT_READY: waiting for robot_description")
            bench.set(warm_up_timeout_s=20.0)
            description = bench.node.create_publisher(String, "robot_description", qos.LATCHED)
            waiting = bench.call_async("plan")
            description.publish(String(data="<robot name='fake'/>"))
            response = bench.result(waiting)
            assert response.success, response.message
            assert execution_code(bench, plan_id(response.message)) == "SUCCEEDED"
        finally:
            bench.close()


INT, TERM = signal.SIGINT, signal.SIGTERM


@pytest.mark.parametrize(
    ("when", "signals"),
    [
        ("at once", [TERM]),
        ("while warming up", [INT]),
        ("while planning", [TERM]),
        ("while planning", [INT, INT]),
        ("while moving", [INT]),
        ("while moving", [INT, INT]),
        ("idle", [INT, INT]),
    ],
)
def test_it_ends_cleanly_in_every_phase(when: str, signals: list[int]) -> None:
    domain = DOMAIN + 1
    warm_up = "30" if when == "while warming up" else "0"
    running = Program(["test/helpers/fake_planner.py", "--ros-args", *PATIENT], domain, FAKE_WARM_UP_S=warm_up, FAKE_DURATION_S="5")
    running.wait_for("serving" if when in ("at once", "while warming up") else "ready to plan")
    bench = Bench(JOINTS, START, domain=domain) if when in ("while planning", "while moving") else None
    try:
        future = None
        if bench is not None:
            bench.call("stop")
            bench.send_clouds(None, cloud(10))
            bench.send_target(ENDLESS if when == "while planning" else FORTH)
            bench.wait_inputs()
            future = bench.call_async("plan")
            if when == "while planning":
                bench.wait_phase("PLANNING")
            if when == "while moving":
                assert bench.result(future).success
        for number in signals[:-1]:
            running.process.send_signal(number)
        began = time.monotonic()
        assert running.end(signals[-1]) == 0, running.output
        assert time.monotonic() - began < 20.0
        assert "Traceback" not in running.output, running.output
        if when == "while planning":
            assert code_of(bench.result(future, 10.0).message) == "CANCELLED"  # type: ignore[union-attr]
        if when == "while moving":
            assert bench is not None
            bench.wait(lambda: len(bench.commands) == 2, 5.0, "the stop of a motion that nobody watches any more")
    finally:
        if bench is not None:
            bench.close()
