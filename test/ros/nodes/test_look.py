"""Looks as a user sees them: the real nodes, with depth cameras that have the arm in their pictures."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from domains import DOMAIN
from fake_node import PATIENT
from ros_harness import Bench, Program, code_of, plan_id, program

from lime_planner.robot.model import home, load_robot
from lime_planner.ros.nodes.scene_cameras import WRIST_FRAME, arm_camera, fixed_cameras
from lime_planner.scene.plants.generator import generate_plant

pytestmark = pytest.mark.timed

SEED = 15
READY_S = 600.0  # with a cold kernel cache
ANSWER_S = 180.0


@pytest.fixture(scope="module")
def rig() -> Iterator[tuple[Bench, Program]]:
    robot = load_robot("kinova_j2s6s200")
    cameras = [arm_camera(robot.tool_frame), *fixed_cameras(generate_plant(np.random.default_rng(SEED)))]
    transforms = ", ".join(f"'{camera.transform}'" for camera in cameras)
    seen = ["--ros-args", "-p", "camera:=all", "-p", "labelled:=true", "-p", "rate_hz:=2.0", "-p", f"seed:={SEED}"]
    planner = ["--ros-args", *PATIENT, "-p", f"camera_frame:={WRIST_FRAME}", "-p", f"static_transforms:=[{transforms}]"]
    with (
        program(["-m", "lime_planner.ros.nodes.mock_arm_node"], DOMAIN),
        program(["-m", "lime_planner.ros.nodes.scene_node", *seen], DOMAIN, "publishing") as scene,
        program(["-m", "lime_planner.ros.nodes.planner_node", *planner], DOMAIN, "serving") as node,
    ):
        bench = Bench(robot.joint_names, home(robot), domain=DOMAIN, plays_arm=False)
        node.wait_for("ready to plan", READY_S)
        bench.wait_inputs("joint_states", "fruit_target")
        bench.wait(lambda: bench.received("labelled_cloud") > 3, 30.0, "pictures of both cameras")
        yield bench, scene
        bench.close()


def begin_look(bench: Bench, times: int = 1) -> object:
    """Ask for a look, so many times at most, and wait until the arm moves."""
    said = []
    for _ in range(times):
        count = len(bench.commands)
        future = bench.call_async("look")
        bench.wait(lambda count=count, future=future: len(bench.commands) > count or future.done(), ANSWER_S, "the motion to a view")
        if not future.done():
            time.sleep(0.4)
            return future
        said.append(future.result().message)
    raise AssertionError(said)


def assert_stays(bench: Bench) -> None:
    time.sleep(0.8)
    there = bench.q.copy()
    time.sleep(0.3)
    assert np.abs(bench.q - there).max() < 1e-3


def test_a_stop_ends_a_look(rig: tuple[Bench, Program]) -> None:
    bench, _ = rig
    look = begin_look(bench)
    assert bench.call("stop").message.startswith("SUCCEEDED: the motion is being stopped; 1 request(s) cancelled")
    answer = bench.result(look)
    assert (answer.success, code_of(answer.message)) == (False, "CANCELLED")
    assert_stays(bench)
    assert bench.wait_phase("DONE", plan_id(answer.message))["code"] == "CANCELLED"


def test_a_newer_request_ends_a_look(rig: tuple[Bench, Program]) -> None:
    bench, _ = rig
    look = begin_look(bench)
    preview = bench.call_async("preview")
    assert code_of(bench.result(look).message) == "PREEMPTED"
    assert_stays(bench)
    bench.result(preview, ANSWER_S)


def test_looks_show_what_is_unseen_and_then_the_lime_is_reached(rig: tuple[Bench, Program]) -> None:
    bench, _ = rig
    answer = bench.call("look", timeout_s=ANSWER_S)
    assert answer.success, answer.message
    status = bench.status_of(answer)
    before, after = (float(status[f"look_unseen_{when}_m3"]) for when in ("before", "after"))
    assert status["looks"] == "1" and after < before and f"{1e3 * after:.2f} are left" in answer.message
    assert bench.set(look_first=True, max_looks=2, replan_attempts=1) == ["", "", ""]
    reached = bench.call("plan_and_wait", timeout_s=ANSWER_S)
    assert code_of(reached.message) in ("SUCCEEDED", "STEM_APPEARED"), reached.message
    status = bench.status_of(reached)
    assert int(status["views"]) > 2 and int(status["looks"]) <= 2
    assert float(status["unseen_contact_rad"]) <= 0.02 or status["looks"] == "2" or "looks_ended" in status


def test_a_look_is_refused_in_words(rig: tuple[Bench, Program]) -> None:
    bench, _ = rig
    bench.set(motion_enabled=False)
    answer = bench.call("look")
    assert answer.message.startswith("MOTION_DISABLED: a look moves the arm, and motion_enabled is false")
    bench.set(motion_enabled=True)


def test_a_camera_that_falls_silent_ends_a_look(rig: tuple[Bench, Program]) -> None:
    bench, scene = rig
    assert bench.set(look_first=False, fuse_views=False) == ["", ""]  # what earlier views showed is forgotten: there is much to look at
    bench.call("retreat", timeout_s=ANSWER_S)
    bench.wait(lambda: bench.statuses[-1]["phase"] == "DONE", 60.0, "the way back")
    look = begin_look(bench, times=5)  # the way found first may lie where the newest camera sees all of it
    scene.end()
    answer = bench.result(look, ANSWER_S)
    assert answer.message.startswith("STALE_INPUT: the arm rests at the view, but no cloud that was taken there came from camera_frame")
