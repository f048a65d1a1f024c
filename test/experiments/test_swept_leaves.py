"""What motions sweep: cells of leaves, thinning of motions, leaves and areas against slower and simpler answers."""

from __future__ import annotations

import fcl
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lime_planner.core.errors import SceneError
from lime_planner.experiments.swept_leaves import STEP_M, CloudTruth, LeafTruth, leaf_cells, motion_samples
from lime_planner.motion.trajectory import Trajectory
from lime_planner.robot.meshes import bvh_of
from lime_planner.robot.model import Robot, home, load_robot
from lime_planner.scene.scene import Scene


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("kinova_j2s6s200")


def turning(robot: Robot, angle: float, steps: int = 60) -> Trajectory:
    """Joint 1 turns by an angle, the others stand still."""
    share = np.linspace(0.0, 1.0, steps)[:, None]
    positions = home(robot) + (3.0 * share**2 - 2.0 * share**3) * angle * np.eye(robot.n)[0]
    velocities = 6.0 * (share - share**2) * angle * np.eye(robot.n)[0] / (0.02 * (steps - 1))
    return Trajectory(robot.joint_names, 0.02, positions, velocities)


def square(centre: np.ndarray, normal: np.ndarray, edge: float) -> np.ndarray:
    """Two triangles."""
    one = np.cross(normal, [0.0, 0.0, 1.0])
    one /= np.linalg.norm(one)
    two = np.cross(normal, one)
    a, b, c, d = (centre + 0.5 * edge * (i * one + j * two) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return np.array([[a, b, c], [a, c, d]])


def scene_of(leaves: list[np.ndarray]) -> Scene:
    points = np.concatenate([leaf.reshape(-1, 3) for leaf in leaves])
    return Scene(
        leaf_points=points,
        leaf_costs=np.ones(len(points)),
        stem_points=np.zeros((0, 3)),
        fruit_points=np.zeros((0, 3)),
        leaf_triangles=np.concatenate(leaves),
        leaf_triangle_ids=np.repeat(np.arange(len(leaves)) + 10, [len(leaf) for leaf in leaves]),
    )


@given(seed=st.integers(0, 2**31), edge=st.floats(0.001, 0.05))
@settings(max_examples=30, deadline=None)
def test_cells_tile_their_triangles(seed: int, edge: float) -> None:
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-0.05, 0.05, (5, 3, 3))
    centres, areas, owners = leaf_cells(triangles, edge)
    whole = 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    assert np.allclose(np.bincount(owners, areas, 5), whole)
    for i in range(5):  # the cells' centre of mass is the triangle's, and every centre lies inside
        own = owners == i
        assert np.allclose(np.average(centres[own], axis=0, weights=areas[own]), triangles[i].mean(axis=0))
        basis = np.stack([triangles[i, 1] - triangles[i, 0], triangles[i, 2] - triangles[i, 0]], axis=1)
        weights = np.linalg.lstsq(basis, (centres[own] - triangles[i, 0]).T, rcond=None)[0]
        assert (weights > 0.0).all() and (weights.sum(axis=0) < 1.0).all()
    assert [len(part) for part in leaf_cells(np.zeros((0, 3, 3)))] == [0, 0, 0]


def test_thinned_motions_move_no_point_farther_than_the_step(robot: Robot) -> None:
    fine = turning(robot, 0.6).configurations(0.002)
    motion = motion_samples(robot, fine)
    assert 50 < len(motion.frames) < len(fine) + 1
    for link, ways in zip(robot.links, motion.ways, strict=True):
        frames = motion.frames[:, link.joint]
        places = np.einsum("kij,vj->kvi", frames[:, :, :3], link.vertices[::97]) + frames[:, None, :, 3]
        moved = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1)
        assert (moved <= STEP_M + 1e-9).all()
        assert (moved <= np.diff(ways) + 1e-9).all()
    assert np.allclose(motion.frames[-1, 1:], robot.link_poses(fine[-1])[1:, :3])


def test_leaves_in_the_way_are_found_and_others_are_not(robot: Robot) -> None:
    motion = turning(robot, 0.6)
    tool = robot.forward(home(robot) + 0.3 * np.eye(robot.n)[0])[:3, 3]
    ahead = np.cross([0.0, 0.0, 1.0], tool)  # where the tool goes
    ahead /= np.linalg.norm(ahead)
    in_the_way = square(tool, ahead, 0.06)
    above = square(tool + [0.0, 0.0, 0.3], ahead, 0.06)
    beyond = square(1.5 * tool, ahead, 0.06)
    truth = LeafTruth(robot, scene_of([above, in_the_way, beyond]))
    swept = truth.swept(motion)
    assert swept.leaves.tolist() == [11]
    assert 0.0 < swept.area_m2 < 0.06**2
    assert truth.touched_at(home(robot)).tolist() == []
    nothing = LeafTruth(robot, scene_of([above, beyond])).swept(motion)
    assert (nothing.leaves.tolist(), nothing.area_m2) == ([], 0.0)


def test_swept_cells_are_those_that_a_ball_in_their_place_would_touch(robot: Robot) -> None:
    motion = turning(robot, 0.25, 30)
    T_base_tool = robot.forward(home(robot) + 0.12 * np.eye(robot.n)[0])
    tool = T_base_tool[:3, 3] - 0.07 * T_base_tool[:3, 2]  # where the hand is, not between the fingers
    leaf = square(tool, np.cross([0.0, 0.0, 1.0], tool) / np.linalg.norm(tool[:2]), 0.05)
    truth = LeafTruth(robot, scene_of([leaf]))
    centres, areas, _ = leaf_cells(leaf)
    frames = motion_samples(robot, motion.configurations(0.002)).frames
    chosen = np.random.default_rng(0).choice(len(centres), 60, replace=False)
    meshes = [(link, fcl.CollisionObject(bvh_of(link))) for link in robot.links]

    def touches(place: np.ndarray) -> bool:
        for poses in frames:
            for link, mesh in meshes:
                pose = poses[link.joint]
                at = pose[:, :3].T @ (place - pose[:, 3])
                ball = fcl.CollisionObject(fcl.Sphere(STEP_M / 2.0), fcl.Transform(at))
                if fcl.collide(ball, mesh, fcl.CollisionRequest(), fcl.CollisionResult()) > 0:
                    return True
        return False

    share = np.mean([touches(place) for place in centres[chosen]])
    assert 0.1 < share < 0.95
    reached = truth._sweeper.reached(motion_samples(robot, motion.configurations(0.002)), centres[chosen], STEP_M / 2.0)
    assert reached.mean() == pytest.approx(share, abs=0.02)  # one ball on the border
    assert truth.swept(motion).area_m2 == pytest.approx(share * areas.sum(), rel=0.2)  # 60 of the cells


def test_scans_count_patches(robot: Robot) -> None:
    motion = turning(robot, 0.6)
    tool = robot.forward(home(robot) + 0.3 * np.eye(robot.n)[0])[:3, 3]
    offsets = np.linspace(-0.01, 0.01, 11)
    grid = tool + np.array([[0.0, a, b] for a in offsets for b in offsets])
    cloud = Scene(grid, np.ones(len(grid)), np.zeros((0, 3)), np.zeros((0, 3)))
    area = CloudTruth(robot, cloud).swept_area_m2(motion)
    assert 0.0 < area <= 9 * 9 * 0.004**2
    far = Scene(grid + 2.0, np.ones(len(grid)), np.zeros((0, 3)), np.zeros((0, 3)))
    assert CloudTruth(robot, far).swept_area_m2(motion) == 0.0
    with pytest.raises(SceneError, match="leaf_triangles"):
        LeafTruth(robot, cloud)
