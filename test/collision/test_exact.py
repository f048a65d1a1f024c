"""The exact checker against an independent computation with Open3D's distances, and rule by rule."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from lime_planner.collision.exact import ExactChecker
from lime_planner.collision.exact_kernels import make_blocks
from lime_planner.core.errors import ProblemError
from lime_planner.robot.model import Robot, home, load_robot, robot_from_urdf

RADIUS = 0.004
robot_named = cache(load_robot)


def sticks(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points along random twigs in front of the arm, about 4 mm apart."""
    ends = rng.uniform([0.2, -0.3, 0.1], [0.7, 0.3, 0.8], (count, 2, 3))
    return np.concatenate([a + np.linspace(0, 1, max(2, int(np.linalg.norm(b - a) / 0.004)))[:, None] * (b - a) for a, b in ends])


def configurations(robot: Robot, rng: np.random.Generator, count: int, centre: np.ndarray, radius: float) -> list[np.ndarray]:
    low, high = np.where(np.isfinite(robot.lower), robot.lower, -np.pi), np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    found: list[np.ndarray] = []
    while len(found) < count:
        q = rng.uniform(low, high)
        if np.linalg.norm(robot.forward(q)[:3, 3] - centre) < radius:
            found.append(q)
    return found


class Reference:
    """Distance of points to a robot's surface, negative inside a link, from Open3D alone."""

    def __init__(self, robot: Robot) -> None:
        import open3d as o3d

        self.o3d, self.robot, self.scenes = o3d, robot, []
        for link in robot.links:
            self.scenes.append([])
            for vertices, triangles in _bodies(link.vertices, link.triangles):
                scene = o3d.t.geometry.RaycastingScene()
                scene.add_triangles(vertices.astype(np.float32), triangles.astype(np.uint32))
                self.scenes[-1].append(scene)

    def nearest(self, q: np.ndarray, points: np.ndarray, links: list[int], within: float) -> float:
        """Smallest distance to the links, or `within` if it is larger; exactly negative only in sign where inside."""
        poses, best = self.robot.link_poses(q), within
        for k in links:
            link = self.robot.links[k]
            local = (points - poses[link.joint, :3, 3]) @ poses[link.joint, :3, :3]
            close = (local > link.vertices.min(axis=0) - within).all(axis=1) & (local < link.vertices.max(axis=0) + within).all(axis=1)
            if close.any():
                tensor = self.o3d.core.Tensor(local[close].astype(np.float32))
                for scene in self.scenes[k]:
                    best = min(best, float(scene.compute_signed_distance(tensor, nsamples=5).numpy().min()))
        return best


def _bodies(vertices: np.ndarray, triangles: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Split a mesh into its connected parts, so that overlapping closed parts keep their insides."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    _, label = connected_components(coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2))
    return [(vertices, triangles[label[triangles[:, 0]] == k]) for k in np.unique(label[triangles[:, 0]])]


@pytest.mark.parametrize("name", ["kinova_j2s6s200", "kinova_j2n6s300"])
def test_agrees_with_an_independent_computation(name: str) -> None:
    rng = np.random.default_rng(1)
    robot, points = robot_named(name), sticks(rng, 6)
    checker = ExactChecker(robot, points, point_radius_m=RADIUS, leaf_points=points, leaf_point_radius_m=RADIUS)
    reference, every = Reference(robot), list(range(len(robot.links)))
    hits = mismatches = 0
    for q in configurations(robot, rng, 400, np.array([0.45, 0.0, 0.45]), 0.3):
        distance = reference.nearest(q, points, every, 0.02)
        touching = checker.leaf_contact(q)
        hits += touching
        if abs(distance - RADIUS) > 2e-6:  # Open3D computes in single precision
            mismatches += touching != (distance < RADIUS)
    print(f"{name}: 400 configurations, {hits} in contact, {mismatches} mismatches")
    assert 80 < hits < 320
    assert mismatches == 0


@pytest.mark.timed
def test_on_a_real_scan(shared_data: Path) -> None:
    rng = np.random.default_rng(2)
    scan = np.load(shared_data / "tomato_wur_h01p179_pred.npz")
    points = scan["points"][scan["labels"] == 1].astype(float) + np.array([0.55, 0.0, 0.05])
    robot = robot_named("kinova_j2s6s200")
    checker = ExactChecker(robot, points, point_radius_m=RADIUS)
    reference, every = Reference(robot), list(range(len(robot.links)))
    checker.stem_hit(home(robot))
    times, hits = [], 0
    for q in configurations(robot, rng, 100, np.array([0.55, 0.0, 0.35]), 0.3):
        started = perf_counter()
        hit = checker.stem_hit(q)
        times.append(perf_counter() - started)
        if hit is None or hit.what != "stem":
            hit_self = hit is not None
            assert hit_self or reference.nearest(q, points, every, 0.02) > RADIUS - 2e-6
        else:
            hits += 1
            assert reference.nearest(q, points, every, 0.02) < RADIUS + 2e-6
    print(f"{len(points)} stem points: median {1e6 * np.median(times):.0f} us, 95th percentile {1e6 * np.percentile(times, 95):.0f} us")
    assert hits > 12
    assert np.median(times) < 1e-3


def test_distance_agrees_with_the_reference() -> None:
    rng = np.random.default_rng(3)
    robot, points = robot_named("kinova_j2s6s200"), sticks(rng, 4)
    checker = ExactChecker(robot, points, point_radius_m=RADIUS)
    reference, every = Reference(robot), list(range(len(robot.links)))
    for q in configurations(robot, rng, 60, np.array([0.45, 0.0, 0.45]), 0.3):
        assert checker.stem_distance(q) == pytest.approx(reference.nearest(q, points, every, 2.0) - RADIUS, abs=3e-6)
    assert ExactChecker(robot, np.zeros((0, 3)), point_radius_m=RADIUS).stem_distance(home(robot)) == np.inf


@pytest.mark.parametrize("radius", [0.0, 0.001, 0.004])
def test_a_point_inside_a_link_is_a_hit(radius: float) -> None:
    robot = robot_named("kinova_j2s6s200")
    poses = robot.link_poses(home(robot))
    import trimesh

    for link in robot.links:
        mesh = trimesh.Trimesh(link.vertices, link.triangles, process=False)
        samples, faces = trimesh.sample.sample_surface(mesh, 40, seed=1)
        for depth in (0.0005, 0.002, 0.004):
            inside = samples - depth * mesh.face_normals[faces]
            keep = [np.abs(p - link.vertices).max(axis=1).min() > 0.0 for p in inside]
            for point in inside[keep][:10]:
                winding = _winding(link.vertices, link.triangles, point)
                if winding < 0.9:  # came out on the other side of a thin wall
                    continue
                at = poses[link.joint, :3, :3] @ point + poses[link.joint, :3, 3]
                checker = ExactChecker(robot, at[None], point_radius_m=radius)
                assert checker.stem_hit(home(robot)) is not None, (link.name, depth)
                assert checker.stem_distance(home(robot)) < 0.0


def _winding(vertices: np.ndarray, triangles: np.ndarray, point: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dot = np.einsum
    angle = np.arctan2(volume, la * lb * lc + dot("ij,ij->i", a, b) * lc + dot("ij,ij->i", b, c) * la + dot("ij,ij->i", c, a) * lb)
    return float(angle.sum() / (2.0 * np.pi))


def test_merged_points_are_covered_and_little_enlarged() -> None:
    cloud = np.random.default_rng(4).uniform(0, 0.012, (2000, 3))
    blocks = make_blocks(cloud, RADIUS, 1.0)
    assert len(blocks.points) < len(cloud)
    assert blocks.radii.min() >= RADIUS
    assert blocks.radii.max() <= RADIUS + 0.0018
    for chunk in np.array_split(cloud, 10):
        overhang = np.linalg.norm(chunk[:, None] - blocks.points[None], axis=2) + RADIUS - blocks.radii[None]
        assert overhang.min(axis=1).max() < 1e-12  # every ball lies within a merged one
    within = np.linalg.norm(blocks.points - np.repeat(blocks.centres, np.diff(blocks.start), axis=0), axis=1)
    assert (within <= np.repeat(blocks.bounds, np.diff(blocks.start)) + 1e-12).all()
    lattice = np.stack(np.meshgrid(*[np.arange(10) * 0.002] * 3), axis=-1).reshape(-1, 3)
    assert (make_blocks(lattice, RADIUS, 1.0).radii == RADIUS).all()
    assert len(make_blocks(lattice, RADIUS, 0.005).points) < len(lattice)  # out of reach


def test_self_collision_by_the_meshes() -> None:
    import fcl

    from lime_planner.robot.meshes import bvh_of

    rng, robot = np.random.default_rng(5), robot_named("kinova_j2s6s200")
    checker = ExactChecker(robot, np.zeros((0, 3)), point_radius_m=RADIUS)
    objects = [fcl.CollisionObject(bvh_of(link)) for link in robot.links]
    seen = 0
    for q in rng.uniform(-np.pi, np.pi, (300, 6)):
        poses, expected = robot.link_poses(q), False
        for link, thing in zip(robot.links, objects, strict=True):
            thing.setTransform(fcl.Transform(poses[link.joint, :3, :3], poses[link.joint, :3, 3]))
        for i, j in robot.collision_pairs:
            expected = expected or fcl.collide(objects[i], objects[j], fcl.CollisionRequest(), fcl.CollisionResult()) > 0
        hit = checker.stem_hit(q)
        assert (hit is not None and hit.what == "self") == expected
        seen += expected
    assert 10 < seen < 290
    for name in ("kinova_j2s6s200", "kinova_j2n6s300"):
        robot = robot_named(name)
        assert ExactChecker(robot, np.zeros((0, 3)), point_radius_m=RADIUS).stem_hit(home(robot)) is None


def test_keep_out_floor_and_workspace() -> None:
    robot = robot_named("kinova_j2s6s200")
    q, none = home(robot), np.zeros((0, 3))
    poses = robot.link_poses(q)
    placed = np.concatenate([v.vertices @ poses[v.joint, :3, :3].T + poses[v.joint, :3, 3] for v in robot.links if v.joint > 0])
    low, high = placed.min(axis=0), placed.max(axis=0)

    def what(**options: object) -> str | None:
        hit = ExactChecker(robot, none, point_radius_m=RADIUS, **options).stem_hit(q)  # type: ignore[arg-type]
        assert hit is None or hit.link in str(hit)
        return None if hit is None else hit.what

    assert what(floor_z_m=low[2] - 1e-6) is None
    assert what(floor_z_m=low[2] + 1e-6) == "floor"
    assert what(workspace_box=[*low - 1e-6, *high + 1e-6]) is None
    for axis in range(3):
        assert what(workspace_box=[*(low + 1e-6 * np.eye(3)[axis]), *(high + 1e-6)]) == "workspace"
        assert what(workspace_box=[*(low - 1e-6), *(high - 1e-6 * np.eye(3)[axis])]) == "workspace"
    assert what(workspace_box=[*low, np.inf, np.inf, high[2] + 1e-6]) is None
    top = placed[placed[:, 2].argmax()]
    assert what(keep_out_boxes=[[*(top - [0.01, 0.01, 1e-5]), *(top + 0.01)]]) == "keep_out"
    assert what(keep_out_boxes=[[*(top - np.array([0.01, 0.01, -1e-5])), *(top + 0.01)]]) is None
    assert what(keep_out_boxes=[[-np.inf, -np.inf, top[2] + 1e-5, np.inf, np.inf, np.inf]]) is None
    assert what(keep_out_boxes=[[-np.inf] * 3 + [np.inf] * 3]) == "keep_out"
    # A box wholly inside the upper arm, and one that holds the whole hand.
    arm = next(link for link in robot.links if link.name.endswith("link_2"))
    middle = poses[2, :3, :3] @ (0.5 * (arm.vertices.min(axis=0) + arm.vertices.max(axis=0))) + poses[2, :3, 3]
    assert what(keep_out_boxes=[[*(middle - 0.001), *(middle + 0.001)]]) == "keep_out"
    assert what(keep_out_boxes=[[*(poses[6, :3, 3] - 0.3), *(poses[6, :3, 3] + 0.3)]]) == "keep_out"


def test_exclusion_sphere_spares_the_gripper_only_and_only_in_the_zone() -> None:
    robot = robot_named("kinova_j2s6s200")
    q = home(robot)
    poses, T_base_tool = robot.link_poses(q), robot.forward(q)
    hand = next(link for link in robot.links if link.name.endswith("link_6"))
    centre = T_base_tool[:3, 3]
    on_hand = poses[6, :3, :3] @ hand.vertices[hand.vertices[:, 2].argmin()] + poses[6, :3, 3]
    wrist = next(link for link in robot.links if link.name.endswith("link_5"))
    on_wrist = poses[5, :3, :3] @ wrist.vertices[wrist.vertices[:, 1].argmin()] + poses[5, :3, 3]
    apart = float(np.linalg.norm(on_hand - centre))

    def hit(point: np.ndarray, radius: float, zone: float, at: np.ndarray = centre) -> bool:
        checker = ExactChecker(
            robot, [point], point_radius_m=RADIUS, exclusion_centre=at, exclusion_radius_m=radius, approach_zone_m=zone, leaf_points=[point]
        )
        assert checker.leaf_contact(q)  # leaves are not spared
        assert (checker.stem_distance(q) < 0.0) == (checker.stem_hit(q) is not None)
        return checker.stem_hit(q) is not None

    assert not hit(on_hand, apart + 1e-6, 0.1)
    assert hit(on_hand, apart - 1e-6, 0.1)
    assert hit(on_hand, 0.2, 0.1, centre + np.array([0.0, 0.0, 0.11]))
    assert not hit(on_hand, 0.2, 0.12, centre + np.array([0.0, 0.0, 0.11]))
    assert hit(on_wrist, 0.5, 0.1)


def test_certificate() -> None:
    robot = robot_named("kinova_j2s6s200")
    start = home(robot)
    goal = start + 0.6 * np.eye(6)[0]
    path = start + np.linspace(0, 1, 61)[:, None] * (goal - start)
    free = ExactChecker(robot, np.zeros((0, 3)), point_radius_m=RADIUS)
    assert free.certify(path) == free.certify(path, lambda: False)
    assert (free.certify(path).ok, free.certify(path).index, free.certify(path).hit) == (True, 61, None)
    blocked = ExactChecker(robot, [robot.forward(path[40])[:3, 3] + robot.forward(path[40])[:3, 2] * -0.03], point_radius_m=RADIUS)
    certificate = blocked.certify(path)
    assert not certificate.ok
    assert 0 < certificate.index < 60
    assert certificate.hit is not None and certificate.hit.what == "stem"
    assert blocked.stem_hit(path[certificate.index]) is not None and blocked.stem_hit(path[certificate.index - 1]) is None
    stopped = free.certify(path, lambda: True)
    assert (stopped.ok, stopped.index, stopped.hit) == (False, 0, None)


def test_mistakes_are_named() -> None:
    robot = robot_named("kinova_j2n6s300")
    none = np.zeros((0, 3))
    with pytest.raises(ProblemError, match="impermeable_points"):
        ExactChecker(robot, [[0.0, np.nan, 0.0]], point_radius_m=RADIUS)
    with pytest.raises(ProblemError, match="point_radius_m is -1"):
        ExactChecker(robot, none, point_radius_m=-1.0)
    with pytest.raises(ProblemError, match="keep_out_boxes"):
        ExactChecker(robot, none, point_radius_m=RADIUS, keep_out_boxes=[[0, 0, 0, 1, 1]])
    with pytest.raises(ProblemError, match="highest corner"):
        ExactChecker(robot, none, point_radius_m=RADIUS, keep_out_boxes=[[0, 0, 0, 1, 1, -1]])
    with pytest.raises(ProblemError, match="6 finite numbers"):
        ExactChecker(robot, none, point_radius_m=RADIUS).stem_hit([0.0, np.nan, 0, 0, 0, 0])
    with pytest.raises(ProblemError, match="6 finite numbers"):
        ExactChecker(robot, none, point_radius_m=RADIUS).certify([[0.0] * 5])


def test_large_radii_and_crowded_clouds() -> None:
    """More candidates than the first buffer holds, and radii beyond the usual padding."""
    robot = robot_from_urdf(
        '<robot name="r"><link name="base"/><link name="l"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>'
        '<joint name="j" type="continuous"><parent link="base"/><child link="l"/></joint></robot>'
    )
    grid = np.stack(np.meshgrid(*[np.linspace(-0.2, 0.2, 41)] * 3), axis=-1).reshape(-1, 3)
    for radius in (0.005, 0.015):
        gap = np.maximum(np.abs(grid) - 0.1, 0.0)
        outside = grid[np.linalg.norm(gap, axis=1) > radius + 1e-9]
        assert ExactChecker(robot, outside, point_radius_m=radius).stem_hit([0.0]) is None
        assert ExactChecker(robot, outside, point_radius_m=radius + 0.006).stem_hit([0.0]) is not None
        assert ExactChecker(robot, outside, point_radius_m=radius).stem_distance([0.0]) > 0.0
