"""Kinematics of the arm against Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from lime_planner.robot.builtin import share_directories
from lime_planner.robot.kinematics import forward_kinematics, forward_many, make_chain, sine_cosine, tool_jacobian, tool_pose
from lime_planner.robot.mesh_files import resolve_meshes
from lime_planner.robot.model import Robot, load_robot, robot_from_urdf
from lime_planner.robot.urdf import parse_urdf

BOX = '<collision><geometry><box size="0.05 0.04 0.1"/></geometry></collision>'


def random_arm_urdf(rng: np.random.Generator, n: int = 7) -> str:
    """Write a random arm with oblique axes."""
    text = '<robot name="random"><link name="base"/>'
    parent = "base"
    for i in range(n):
        axis = rng.normal(size=3)
        numbers = " ".join(str(v) for v in rng.uniform(-0.4, 0.4, 3)), " ".join(str(v) for v in rng.uniform(-3, 3, 3))
        text += f'<link name="l{i}">{BOX}</link><joint name="j{i}" type="{"continuous" if i % 2 else "revolute"}"><parent link="{parent}"/>'
        text += f'<child link="l{i}"/><origin xyz="{numbers[0]}" rpy="{numbers[1]}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
        text += '<limit lower="-2" upper="2.5" effort="1" velocity="1.5"/></joint>'
        parent = f"l{i}"
    text += f'<link name="tool0"/><joint name="jt" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
    return text + '<origin xyz="0.1 0.2 0.3" rpy="0.3 1 2"/></joint></robot>'


def reference(robot: Robot) -> tuple[pin.Model, pin.Data, int]:
    text = resolve_meshes(parse_urdf(robot.urdf), None, share_directories())
    model = pin.buildModelFromXML(text)
    return model, model.createData(), model.getFrameId(robot.tool_frame)


def pinocchio_q(model: pin.Model, q: np.ndarray) -> np.ndarray:
    values: list[float] = []
    for j in range(1, model.njoints):
        values += [np.cos(q[j - 1]), np.sin(q[j - 1])] if model.joints[j].nq == 2 else [q[j - 1]]
    return np.array(values)


@pytest.mark.parametrize("name", ["kinova_j2s6s200", "kinova_j2n6s300", "random"])
def test_kinematics_agree_with_pinocchio(name: str) -> None:
    rng = np.random.default_rng(1)
    robot = robot_from_urdf(random_arm_urdf(rng)) if name == "random" else load_robot(name)
    n = robot.n
    model, data, frame = reference(robot)
    poses, tool, jacobian = np.empty((n + 1, 3, 4)), np.empty((3, 4)), np.empty((6, n))
    worst = worst_jacobian = 0.0
    for q in rng.uniform(-7.0, 7.0, (3000, n)):
        forward_kinematics(robot.chain, q, poses)
        tool_pose(robot.chain, poses, tool)
        tool_jacobian(robot.chain, poses, jacobian)
        pin.framesForwardKinematics(model, data, pinocchio_q(model, q))
        worst = max(worst, np.abs(tool - data.oMf[frame].homogeneous[:3]).max())
        for j in range(1, n + 1):
            worst = max(worst, np.abs(poses[j, :, 3] - data.oMi[j].translation).max())
        expected = pin.computeFrameJacobian(model, data, pinocchio_q(model, q), frame, pin.LOCAL_WORLD_ALIGNED)
        worst_jacobian = max(worst_jacobian, np.abs(jacobian - expected).max())
    print(f"{name}: worst pose {worst:.1e}, worst Jacobian {worst_jacobian:.1e}")
    assert worst < 1e-9
    assert worst_jacobian < 1e-9


def test_link_meshes_lie_where_pinocchio_puts_them() -> None:
    rng = np.random.default_rng(2)
    robot = robot_from_urdf(random_arm_urdf(rng, 5))
    model, data, _ = reference(robot)
    q = rng.uniform(-3, 3, 5)
    pin.framesForwardKinematics(model, data, pinocchio_q(model, q))
    poses = robot.link_poses(q)
    for link in robot.links:
        placed = link.vertices @ poses[link.joint, :3, :3].T + poses[link.joint, :3, 3]
        corners = np.array([[x, y, z] for x in (-0.025, 0.025) for y in (-0.02, 0.02) for z in (-0.05, 0.05)])
        T = data.oMf[model.getFrameId(link.name)]
        expected = corners @ T.rotation.T + T.translation
        assert {tuple(v) for v in placed.round(9)} == {tuple(v) for v in expected.round(9)}


def test_sliding_joint_in_the_kernels() -> None:
    turn = np.eye(3)[:, [2, 0, 1]]
    placements = np.stack([np.hstack([turn, [[0.1], [0.2], [0.3]]]), np.hstack([np.eye(3), [[0.0], [0.4], [0.0]]])])
    chain, turns = make_chain(placements, np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([1, 0], dtype=np.uint8), np.eye(4)[:3])
    poses, jacobian = np.empty((3, 3, 4)), np.empty((6, 2))
    forward_kinematics(chain, np.array([0.7, 0.0]), poses)
    tool_jacobian(chain, poses, jacobian)
    # The first joint slides along -y of a frame turned by `turn`; its own frame does not turn.
    np.testing.assert_allclose(poses[1, :, 3], [0.1, 0.2, 0.3] - 0.7 * turn[:, 1], atol=1e-12)
    np.testing.assert_allclose(poses[1, :, :3] @ turns[0], turn, atol=1e-12)
    np.testing.assert_allclose(jacobian[:, 0], [*(-turn[:, 1]), 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(jacobian[:, 1], [0, 0, 0, *turn[:, 0]], atol=1e-12)


def test_sine_and_cosine() -> None:
    angles = np.concatenate([np.linspace(-10, 10, 5001), np.random.default_rng(0).uniform(-1e4, 1e4, 5000), np.pi / 4 * np.arange(-20, 21)])
    worst = max(max(abs(sine_cosine(a)[0] - np.sin(a)), abs(sine_cosine(a)[1] - np.cos(a))) for a in angles)
    assert worst < 5e-16
    assert np.isnan(sine_cosine(np.nan)).all()


def test_many_configurations_at_once() -> None:
    robot = load_robot("kinova_j2s6s200")
    path = np.random.default_rng(3).uniform(-3, 3, (5, 6))
    poses = np.empty((5, 7, 3, 4))
    forward_many(robot.chain, path, poses)
    for q, pose in zip(path, poses, strict=True):
        np.testing.assert_array_equal(robot.link_poses(q)[:, :3], pose)
