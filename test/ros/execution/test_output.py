"""Motions by the action of a joint trajectory controller: its verdict counts, and a stop goes through it."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Iterator

import numpy as np
import pytest
from domains import DOMAIN
from execution_rig import Rig, refusal_of, rested  # noqa: F401  (a fixture)
from fake_node import BACK, FORTH, PATIENT
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_fakes import JOINTS, START, cloud
from ros_harness import Bench, Program, code_of, execution_code, plan_id, program

from lime_planner.core.status import Status
from lime_planner.ros.execution.output import Verdict

pytestmark = pytest.mark.timed

SUCCESS = Verdict(Status.SUCCEEDED, "the controller reports success")


@pytest.mark.parametrize("reports", [True, False])
def test_success_is_the_controllers_word_and_the_arms(rig: Rig, reports: bool) -> None:
    motion = rig.send(controller="jtc_action", goal_time_s=0.4)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t), 0.45)
    assert not rig.ended, "the arm rests at the end, and its controller has not said so"
    if reports:
        rig.output.tell(SUCCESS)
    rig.rest(motion.trajectory.positions[-1], 0.1 if reports else 0.6)
    assert [ended.status for ended in rig.ended] == [Status.SUCCEEDED]
    assert ("has not said so" in rig.ended[0].sentence) is not reports


def test_success_that_is_not_so_is_a_deviation(rig: Rig) -> None:
    motion = rig.send(controller="jtc_action", progress_timeout_s=0.4)
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(min(t, 0.15)), 0.3)
    rig.output.tell(SUCCESS)
    rig.rest(motion.trajectory.sample(0.15), 0.5)
    assert [ended.status for ended in rig.ended] == [Status.EXECUTION_DEVIATED]


def test_a_rejected_motion_ends_at_once_and_nothing_more_is_sent(rig: Rig) -> None:
    rig.send(controller="jtc_action")
    rig.output.tell(Verdict(Status.NO_CONTROLLER, "rejected"))
    assert [ended.status for ended in rig.ended] == [Status.NO_CONTROLLER] and len(rig.sent) == 1
    assert not rig.execution.active and not rig.stopped


def test_a_motion_that_the_controller_ended_is_seen_to_rest_and_not_commanded(rig: Rig) -> None:
    motion = rig.send(controller="jtc_action")
    assert motion is not None
    rig.play(lambda t: motion.trajectory.sample(t), 0.1)
    rig.output.tell(Verdict(Status.EXECUTION_DEVIATED, "the controller ended the motion: PATH_TOLERANCE_VIOLATED"))
    assert rig.stopped == [motion] and rig.execution.active
    rig.rest(motion.trajectory.sample(0.1), 0.15)
    assert [ended.status for ended in rig.ended] == [Status.EXECUTION_DEVIATED] and len(rig.sent) == 1
    rig.output.tell(SUCCESS)  # a word too late
    assert len(rig.ended) == 1


# --- a real node, and a controller in a process of its own ------------------------------------------------------------------------

MISSING = "control_msgs is not installed: scripts/control_msgs.sh generates it, or apt install ros-jazzy-control-msgs"
needs_action = pytest.mark.skipif(importlib.util.find_spec("control_msgs") is None, reason=MISSING)


class ActionBench(Bench):
    """The bench, beside an arm behind the action."""

    arm: Program

    def fault(self, name: str) -> None:
        """Have the arm's controller do something wrong from now on; empty: nothing."""
        client = self.node.create_client(SetParameters, "action_arm/set_parameters")
        assert client.wait_for_service(20.0)
        request = SetParameters.Request(parameters=[Parameter("fault", value=name).to_parameter_msg()])
        assert self.result(client.call_async(request)).results[0].successful


@pytest.fixture(scope="module")
def bench() -> Iterator[ActionBench]:
    planner = ["test/helpers/fake_planner.py", "--ros-args", *PATIENT, "-p", "controller:=jtc_action"]
    with (
        program(["test/helpers/action_arm.py"], DOMAIN, "the action is served") as arm,
        program(planner, DOMAIN, "ready to plan", FAKE_DURATION_S="2.5", FAKE_CANCEL_AFTER_S="2"),  # an arm in Python takes goals later
    ):
        made = ActionBench(JOINTS, START, domain=DOMAIN, plays_arm=False)
        made.arm = arm
        made.send_clouds(cloud(200), cloud(100))
        made.send_target(FORTH)
        made.wait_inputs()
        made.wait(lambda: made.health.get("controllers") == "1", 20.0, "the action")
        yield made
        made.close()


def motion(bench: ActionBench, target: list[float], service: str = "plan") -> tuple[object, np.ndarray]:
    bench.send_clouds(cloud(200), cloud(100))
    bench.send_target(target)
    time.sleep(0.4)
    begin = bench.q.copy()
    return bench.call(service), begin


def moves(bench: ActionBench, begin: np.ndarray) -> None:
    """Wait until the arm is well on its way."""
    bench.wait(lambda: np.abs(bench.q - begin).max() > 0.03, 5.0, "the motion")


@needs_action
def test_the_action_carries_motions_out(bench: ActionBench) -> None:
    before = bench.q.copy()
    response, _ = motion(bench, FORTH, "plan_and_wait")
    assert response.success and code_of(response.message) == "SUCCEEDED", response.message  # type: ignore[attr-defined]
    np.testing.assert_allclose(bench.q, before + 0.3, atol=1e-3)
    assert not bench.commands, "nothing goes by the topic"


@needs_action
def test_a_stop_brakes_through_the_action_and_cancels(bench: ActionBench) -> None:
    response, begin = motion(bench, BACK)
    assert response.success  # type: ignore[attr-defined]
    moves(bench, begin)
    said = len(bench.arm.lines)
    assert bench.call("stop").success
    assert execution_code(bench, plan_id(response.message)) == "CANCELLED"  # type: ignore[attr-defined]
    bench.wait(lambda: any("took over" in line for line in bench.arm.lines[said:]), 5.0, "the end of the motion's goal")
    assert bench.arm.lines[said].startswith("goal of "), "the braking motion goes first"
    assert "cancel of the active goal" not in bench.arm.lines[said:]
    rest = bench.q.copy()
    time.sleep(0.3)
    np.testing.assert_allclose(bench.q, rest, atol=1e-4)


@needs_action
def test_a_stop_that_is_not_taken_is_a_cancellation(bench: ActionBench) -> None:
    bench.fault("reject_stops")
    response, begin = motion(bench, FORTH)
    assert response.success  # type: ignore[attr-defined]
    moves(bench, begin)
    said = len(bench.arm.lines)
    assert bench.call("stop").success
    assert execution_code(bench, plan_id(response.message)) == "CANCELLED"  # type: ignore[attr-defined]
    bench.wait(lambda: "cancel of the active goal" in bench.arm.lines[said:], 5.0, "the cancellation")
    bench.fault("")


@needs_action
@pytest.mark.parametrize(
    ("fault", "code", "words"),
    [("reject", "NO_CONTROLLER", "rejected the motion"), ("violate", "EXECUTION_DEVIATED", "PATH_TOLERANCE_VIOLATED (j1 is 0.3 rad off)")],
)
def test_what_the_controller_says_is_how_the_motion_ended(bench: ActionBench, fault: str, code: str, words: str) -> None:
    bench.fault(fault)
    response, _ = motion(bench, FORTH, "plan_and_wait")
    bench.fault("")
    assert not response.success and code_of(response.message) == code, response.message  # type: ignore[attr-defined]
    assert words in response.message  # type: ignore[attr-defined]
    again, _ = motion(bench, BACK, "plan_and_wait")
    assert again.success, again.message  # type: ignore[attr-defined]


@needs_action
def test_without_a_server_nothing_is_sent() -> None:
    domain = DOMAIN + 1
    names = ["--ros-args", *PATIENT, "-p", "controller:=jtc_action", "-p", "trajectory_action:=elsewhere/follow_joint_trajectory"]
    with program(["test/helpers/fake_planner.py", *names], domain, "ready to plan"):
        made = Bench(JOINTS, START, domain=domain)
        made.send_clouds(cloud(200), cloud(100))
        made.send_target(FORTH)
        made.wait_inputs()
        response = made.call("plan")
        made.close()
    assert response.message.startswith("NO_CONTROLLER: no controller serves the action elsewhere/follow_joint_trajectory")
