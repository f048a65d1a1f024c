"""Fingers where a parameter puts them."""

from __future__ import annotations

import numpy as np
import pytest

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.errors import ParameterError, RobotError
from lime_planner.core.parameters import parse_assignment, settings_from
from lime_planner.core.types import Array
from lime_planner.robot.builtin import BUILTIN_ARMS
from lime_planner.robot.model import Robot, load_robot, robot_from_urdf

ARMS = ("kinova_j2s6s200", "kinova_j2n6s300")


def _fingertips(robot: Robot) -> Array:
    """Middles of the last links of the fingers in the frame of the last joint, (F, 3) [m]."""
    return np.array([link.vertices.mean(axis=0) for link in robot.links if "finger_tip" in link.name])


@pytest.mark.parametrize("name", ARMS)
def test_fingers_close_as_far_as_they_are_told(name: str) -> None:
    arm, robot = BUILTIN_ARMS[name], load_robot(name)
    assert robot.locked == ()
    bases = [joint for joint in arm.fingers if "tip" not in joint]
    given = dict.fromkeys(bases[:-1], 1.4)
    closed = load_robot(name, locked=given)  # but for the last one
    assert dict(closed.locked) == given
    np.testing.assert_allclose(closed.forward(closed.home), robot.forward(robot.home), atol=1e-9)
    before, after = _fingertips(robot), _fingertips(closed)
    np.testing.assert_allclose(after[-1], before[-1], atol=1e-9)
    # The middle of a tip is 5 to 8 cm away from the finger's joint, and moves on a circle towards the palm's axis.
    chord = 2.0 * np.sin(0.5 * (1.4 - arm.fingers[bases[0]]))
    moved = np.linalg.norm(after - before, axis=1)[:-1]
    assert moved.min() > 0.05 * chord and moved.max() < 0.08 * chord
    assert (np.linalg.norm(before[:-1, :2], axis=1) - np.linalg.norm(after[:-1, :2], axis=1)).min() > 0.02
    again = robot_from_urdf(closed.urdf, joint_names=arm.joint_names, tool_frame=arm.tool_frame)  # says where the fingers are
    np.testing.assert_allclose(_fingertips(again), after, atol=1e-9)
    # Between open fingers there is room for a fruit where the tool is, and not where one of them closes.
    ways = np.random.default_rng(1).normal(size=(400, 3))
    fruit = robot.forward(robot.home)[:3, 3] + 0.018 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    assert ExactChecker(robot, fruit, point_radius_m=0.001).stem_hit(robot.home) is None
    hit = ExactChecker(closed, fruit, point_radius_m=0.001).stem_hit(robot.home)
    assert hit is not None and "finger" in hit.link


def test_the_three_fingers_are_open_by_nine_centimetres_between_the_tips() -> None:
    robot = load_robot("kinova_j2n6s300")
    tips = [link.vertices for link in robot.links if "finger_tip" in link.name]
    # The outermost point of each finger along -z of the last joint, where the palm looks.
    ends = np.array([points[points[:, 2].argmin()] for points in tips])
    apart = np.linalg.norm(ends[:, None] - ends[None], axis=2)
    assert 0.07 < apart[0, 1] < 0.11


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"j2s6s200_joint_finger_9": 0.5}, "'j2s6s200_joint_finger_9': there is none of this name; .*: j2s6s200_joint_finger_1, "),
        ({"j2s6s200_joint_3": 1.0}, "'j2s6s200_joint_3': it is a joint of the arm"),
        ({"j2s6s200_joint_end_effector": 1.0}, "'j2s6s200_joint_end_effector': it is fixed"),
        ({"j2s6s200_joint_finger_1": 1.6}, "'j2s6s200_joint_finger_1' cannot be at 1.6: its limits are 0 to 1.51"),
        ({"j2s6s200_joint_finger_tip_2": -0.1}, "'j2s6s200_joint_finger_tip_2' cannot be at -0.1: its limits are 0 to 2"),
    ],
)
def test_what_no_finger_can_do(given: dict[str, float], sentence: str) -> None:
    with pytest.raises(RobotError, match=sentence):
        load_robot("kinova_j2s6s200", locked=given)


def test_the_parameter_names_joints_and_positions() -> None:
    name, value = parse_assignment('finger_positions=["a_1: 0.5", "ns/b:c: -1e-1"]')
    assert settings_from({name: value}).locked == {"a_1": 0.5, "ns/b:c": -0.1}
    assert settings_from({}).locked == {}
    for bad in ("a_1", "a_1: wide", "a_1: nan", ": 0.5", "a_1:"):
        with pytest.raises(ParameterError, match=r"finger_positions: .* is not JOINT: POSITION"):
            settings_from({"finger_positions": [bad]})
    with pytest.raises(ParameterError, match="names the joint a_1 twice"):
        settings_from({"finger_positions": ["a_1: 0.5", "a_1: 0.6"]})
