"""The cost of an edge in the arm's joint space, against the same edge sampled every thousandth of a radian."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from arm_helpers import box_of, near_configurations, obstacles_of, plant, robot_named, scan, scene_of
from hypothesis import given, settings
from hypothesis import strategies as st

from lime_planner.collision.fast import LEAF, SELF
from lime_planner.collision.joint_space import ArmSpace, make_arm_space, measure
from lime_planner.collision.leaves.sweep import FINEST_RAD
from lime_planner.collision.self_contact import SELF_CLEARANCE_M
from lime_planner.pipeline.leaf_spans import leaf_spans
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.space import N_EDGE_STATES, line, one
from lime_planner.robot.model import home

FINE_RAD = 0.001
TOLERANCE_M = 0.002  # by which clearance may be under the requirement inside an edge (less where little is required)
W = 1000.0


def wide_space(obstacles: Obstacles, **options) -> ArmSpace:
    n = obstacles.robot.n
    return obstacles.space(np.full(n, -50.0), np.full(n, 50.0), **options)


def cost(space: ArmSpace, a: np.ndarray, b: np.ndarray, weight: float = W, bound: float = np.inf) -> float:
    return line(space, np.ascontiguousarray(a), np.ascontiguousarray(b), weight, bound)


def sampled(obstacles: Obstacles, a: np.ndarray, b: np.ndarray, fine: float = FINE_RAD) -> tuple[np.ndarray, np.ndarray, float]:
    """Clearance over what is required (also of the arm from itself), leaf contact, and length of one step, along a → b."""
    steps = max(2, int(np.ceil(np.linalg.norm(b - a) / fine)))
    world, n = obstacles.world, obstacles.robot.n
    # Clearances are exact up to 1 cm here: what is farther does not matter.
    near = world._replace(margin=0.01, anchors=np.zeros((0, n)), anchor_need=np.zeros(0))
    space = make_arm_space(np.full(n, -50.0), np.full(n, 50.0), obstacles.robot.chain, obstacles.shapes, near)
    over, leaf = np.empty(steps + 1), np.empty(steps + 1)
    for k, t in enumerate(np.linspace(0.0, 1.0, steps + 1)):
        measure(space, a + t * (b - a))
        over[k] = min(space.state.clear.min() - world.margin, space.state.misc[SELF] - SELF_CLEARANCE_M)
        leaf[k] = space.state.misc[LEAF]
    return over, leaf, float(np.linalg.norm(b - a)) / steps


def allowed_error(leaf: np.ndarray, step: float) -> float:
    """What the length of contact may differ by from its samples: not a step where it begins or ends, or where all of it may be missed."""
    borders = np.count_nonzero(np.diff(leaf > 0.0))
    return (0.5 * borders + 2.0) * (step + FINEST_RAD)


@cache
def free_edges(name: str, count: int = 70):
    """Edges of 0.05 to 2.5 rad around a canopy whose ends are valid, and the space."""
    scene = scan("h01p429") if name == "scan" else plant()
    obstacles = obstacles_of(scene)
    space = wide_space(obstacles)
    rng = np.random.default_rng(11)
    rows = near_configurations(robot_named(), rng, 600, np.median(scene.leaf_points, axis=0), 0.25)
    rows = [q for q in rows if one(space, q) >= 0.0]
    edges = []
    for a in rows:
        direction = rng.normal(size=6)
        b = a + direction / np.linalg.norm(direction) * np.exp(rng.uniform(np.log(0.05), np.log(2.5)))
        if one(space, b) >= 0.0:
            edges.append((a, b))
    assert len(edges) >= count
    return obstacles, space, edges[:count]


@pytest.mark.parametrize("name", ["scan", "plant"])
def test_cost_and_blocks_agree_with_fine_sampling(name: str) -> None:
    obstacles, space, edges = free_edges(name)
    blocked, contact_error, contact_sum = 0, 0.0, 0.0
    for a, b in edges:
        over, leaf, step = sampled(obstacles, a, b)
        found = cost(space, a, b)
        if not np.isfinite(found):
            blocked += 1
            assert over.min() < 0.0  # something is nearer than required
            continue
        assert over.min() > -TOLERANCE_M - 2e-4  # nothing hides between the samples of an edge
        length = float(np.linalg.norm(b - a))
        contact, true = (found - length) / W, float(np.trapezoid(leaf, dx=step))
        assert abs(contact - true) <= allowed_error(leaf, step)
        contact_error += contact - true
        contact_sum += true
    print(f"\n{name}: {len(edges)} edges, {blocked} blocked, contact {contact_sum:.2f} rad, error of the sum {contact_error:.3f} rad")
    assert 3 < blocked < len(edges) - 20
    assert contact_sum > 1.0
    assert abs(contact_error) < 0.005 * contact_sum


@pytest.mark.parametrize("name", ["scan", "plant"])
def test_symmetric_and_never_below_the_distance(name: str) -> None:
    _, space, edges = free_edges(name)
    for a, b in edges:
        there, back = cost(space, a, b), cost(space, b, a)
        length = float(np.linalg.norm(b - a))
        assert there == pytest.approx(back, rel=1e-6) or (np.isinf(there) and np.isinf(back))
        assert there >= length * (1.0 - 1e-12)
        assert cost(space, a, a) == 0.0
        without = cost(space, a, b, weight=0.0)
        assert without == (np.inf if np.isinf(there) else pytest.approx(length, rel=1e-12))


@pytest.mark.parametrize("name", ["scan", "plant"])
def test_adds_up_under_subdivision(name: str) -> None:
    obstacles, space, edges = free_edges(name)
    rng = np.random.default_rng(1)
    difference = total = 0.0
    for a, b in edges:
        whole = cost(space, a, b)
        middle = a + rng.uniform(0.1, 0.9) * (b - a)
        parts = cost(space, a, middle) + cost(space, middle, b)
        if np.isinf(whole) or np.isinf(parts):
            # Only what is within the tolerance of the requirement may be judged differently.
            over, _, _ = sampled(obstacles, a, b)
            assert np.isinf(whole) == np.isinf(parts) or -TOLERANCE_M - 2e-4 < over.min() < 0.0
            continue
        _, leaf, _ = sampled(obstacles, a, b)
        assert abs(whole - parts) <= W * FINEST_RAD * (2.0 + np.count_nonzero(np.diff(leaf > 0.0)))
        difference += parts - whole
        total += whole
    assert abs(difference) < 0.002 * total


@pytest.mark.parametrize("name", ["scan", "plant"])
def test_no_less_than_a_finer_integral(name: str) -> None:
    obstacles, space, edges = free_edges(name)
    touching = 0
    for a, b in edges:
        found, fine = cost(space, a, b), leaf_spans(obstacles, np.array([a, b]))
        if np.isfinite(found):
            over = found - np.linalg.norm(b - a) - W * fine.charged_rad
            # Two borders to a contact at least, and as many again where contact is so short that only the finer integral tells it.
            assert -1e-9 * found <= over <= W * FINEST_RAD * 4.0 * (1.0 + len(fine.spans))
            touching += len(fine.spans) > 0
    assert touching > 5


@pytest.mark.parametrize("name", ["scan", "plant"])
def test_a_bound_ends_the_work_early(name: str) -> None:
    _, space, edges = free_edges(name)
    saved = 0
    for a, b in edges:
        before = space.counters[N_EDGE_STATES]
        whole, length = cost(space, a, b), float(np.linalg.norm(b - a))
        full = space.counters[N_EDGE_STATES] - before
        if np.isfinite(whole):
            assert cost(space, a, b, bound=whole) == pytest.approx(whole, rel=1e-12)
        for share in (0.0, 0.5, 0.9):
            top = whole if np.isfinite(whole) else length + W
            bound = share * length if share == 0.0 else length + share * (top - length)
            before = space.counters[N_EDGE_STATES]
            found = cost(space, a, b, bound=bound)
            spent = space.counters[N_EDGE_STATES] - before
            if np.isinf(whole):
                assert np.isinf(found) or found > bound
            elif bound < whole:
                assert bound < found <= whole * (1.0 + 1e-12)  # a lower bound of the cost
            assert spent <= full
            saved += full - spent
    assert saved > 0


def test_invalid_ends_and_the_sampling_box() -> None:
    obstacles, space, edges = free_edges("plant")
    a, b = edges[0]
    robot = robot_named()
    low, high = box_of(robot)
    bad = next(q for q in np.random.default_rng(0).uniform(low, high, (5000, 6)) if not one(space, q) >= 0.0)
    assert cost(space, a, bad) == cost(space, bad, a) == np.inf
    narrow = obstacles.space(np.minimum(a, b) + 1e-3 * np.abs(b - a), np.maximum(a, b) + 1.0)
    assert cost(narrow, a, b) == np.inf


def crossing(rng: np.random.Generator, spacing: float, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An edge of 0.5 to 4 rad, and a straight line of points through a place that the arm's surface passes on it."""
    robot = robot_named()
    low, high = box_of(robot)
    a = rng.uniform(low, high)
    direction = rng.normal(size=6)
    b = a + direction / np.linalg.norm(direction) * np.exp(rng.uniform(np.log(0.5), np.log(4.0)))
    q = a + rng.uniform(0.2, 0.8) * (b - a)
    link = robot.links[rng.integers(2, len(robot.links))]
    pose = robot.link_poses(q)[link.joint]
    place = pose[:3, :3] @ link.vertices[rng.integers(len(link.vertices))] + pose[:3, 3]
    along = rng.normal(size=3)
    along /= np.linalg.norm(along)
    points = place + np.arange(-length / 2, length / 2 + 1e-9, spacing)[:, None] * along if length else place[None]
    return a, b, points


@pytest.mark.parametrize("length", [0.0, 0.3])
@pytest.mark.parametrize("margin", [0.0, 0.005])
def test_a_thin_stem_across_an_edge_is_never_missed(margin: float, length: float) -> None:
    """A single line of points, or a single point, that the arm sweeps over in the middle of a long edge."""
    rng = np.random.default_rng(int(1e4 * margin + length * 10))
    tolerance = max(0.00025, min(TOLERANCE_M, 0.5 * margin))
    crossed = 0
    while crossed < 40:
        a, b, points = crossing(rng, 0.003, length)
        obstacles = obstacles_of(scene_of(points), stem_margin_m=margin)
        space = wide_space(obstacles)
        if not (one(space, a) and one(space, b) >= 0.0):
            continue
        if np.isinf(cost(wide_space(obstacles_of(scene_of(), stem_margin_m=margin)), a, b)):
            continue  # the arm is in its own way
        crossed += 1
        over, _, _ = sampled(obstacles, a, b)
        assert over.min() < 0.0 or margin == 0.0
        found = cost(space, a, b)
        if over.min() < -tolerance - 1e-6:
            assert np.isinf(found), (a.tolist(), b.tolist(), over.min())
        assert cost(space, a, b, weight=0.0) == found


def sheet(radial: tuple[float, float], height: tuple[float, float], angle: float) -> np.ndarray:
    """A vertical sheet of leaf points through the z axis."""
    r, z = np.meshgrid(np.arange(*radial, 0.004), np.arange(*height, 0.004))
    return np.column_stack([r.ravel() * np.cos(angle), r.ravel() * np.sin(angle), z.ravel()])


@given(st.floats(0.15, 0.85), st.floats(0.8, 2.0), st.sampled_from([(0.05, 1.0), (0.3, 1.0), (0.05, 0.5)]))
@settings(max_examples=12, deadline=None)
def test_a_thin_leaf_sheet_in_the_middle_is_charged(where: float, sweep: float, radial: tuple[float, float]) -> None:
    """Joint 1 carries the arm through a sheet of leaf one point thick that stands in its way."""
    robot = robot_named()
    a = home(robot)
    b = a + sweep * np.eye(6)[0]
    tool = robot.forward(a + where * (b - a))[:3, 3]
    obstacles = obstacles_of(scene_of((), sheet(radial, (-0.2, 1.0), np.arctan2(tool[1], tool[0]))))
    space = wide_space(obstacles)
    _, leaf, step = sampled(obstacles, a, b)
    true = float(np.trapezoid(leaf, dx=step))
    assert true > 0.06
    for weight in (1.0, W):
        contact = (cost(space, a, b, weight=weight) - sweep) / weight
        assert contact > 0.0
        # What cannot be decided is charged: a search would find gaps.
        assert -allowed_error(leaf, step) <= contact - true <= allowed_error(leaf, step) + 0.01 * true


def test_without_leaves_their_contact_is_free() -> None:
    _, space, edges = free_edges("plant")
    obstacles, _, _ = free_edges("plant")
    bare = wide_space(obstacles, leaves=False)
    for a, b in edges[:20]:
        found = cost(space, a, b)
        assert cost(bare, a, b) == (np.inf if np.isinf(found) else pytest.approx(np.linalg.norm(b - a), rel=1e-12))


def test_the_approach_zone_is_entered_at_its_border() -> None:
    """Edges in and out of a zone in which the hand is spared a cluster of stem points around the target."""
    robot = robot_named()
    rng = np.random.default_rng(5)
    scene = scan("h01p429")
    target = scene.stem_points[len(scene.stem_points) // 3].astype(float)
    obstacles = obstacles_of(scene, target, target_exclusion_radius_m=0.12, approach_zone_m=0.10)
    space, checker = wide_space(obstacles), obstacles.exact_checker()
    rows = [q for q in near_configurations(robot, rng, 2000, target, 0.25) if one(space, q) >= 0.0]
    inside = [np.linalg.norm(robot.forward(q)[:3, 3] - target) < 0.10 for q in rows]
    assert 3 < sum(inside) < len(rows)
    passed = 0
    for q in [q for q, within in zip(rows, inside, strict=True) if within][:12]:
        for _ in range(4):
            direction = rng.normal(size=6)
            b = q + direction / np.linalg.norm(direction) * rng.uniform(0.1, 0.8)
            if not one(space, b) >= 0.0:
                continue
            over, _, _ = sampled(obstacles, q, b, 2.0 * FINE_RAD)
            found = cost(space, q, b)
            if np.isfinite(found):
                passed += 1
                # Where the tool crosses the border a body may move by 2 mm unseen.
                assert over.min() > -TOLERANCE_M - 0.0025
                path = q + np.linspace(0.0, 1.0, 40)[:, None] * (b - q)
                assert checker.certify(path).ok
            else:
                assert over.min() < 0.0
    assert passed > 5


def test_a_start_with_less_clearance_is_left_towards_more() -> None:
    """An anchor lets an edge begin inside the margin; the requirement grows with the distance from it."""
    robot = robot_named()
    q = home(robot)
    obstacles = obstacles_of(scene_of([[5.0, 5.0, 5.0]]))
    hand = next(link for link in robot.links if link.name.endswith("link_6"))
    pose = robot.link_poses(q)[hand.joint]
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    # A point 3 mm outside the hand, by the fast model's own measure.
    for d in directions:
        place = pose[:3, :3] @ hand.vertices[0] + pose[:3, 3] + 0.05 * d / np.linalg.norm(d)
        obstacles = obstacles_of(scene_of([place]))
        space = obstacles.measuring_space()
        measure(space, q)
        if 0.002 < space.state.clear.min() < 0.004:
            break
    clear = float(space.state.clear.min())
    assert 0.002 < clear < 0.004
    away = np.array([robot.forward(q + 0.02 * e)[:3, 3] - robot.forward(q)[:3, 3] for e in np.eye(6)])
    toward = place - robot.forward(q)[:3, 3]
    step = -np.sign(away @ toward)[0] * np.eye(6)[0]
    anchored = obstacles.with_anchors(q[None], np.array([clear - 0.0004]))
    assert np.isinf(cost(wide_space(obstacles), q, q + 0.5 * step))
    left, other = (cost(wide_space(anchored), q, q + 0.5 * sign * step) for sign in (1.0, -1.0))
    assert min(left, other) == pytest.approx(0.5)
    assert np.isinf(max(left, other))


def test_a_very_long_edge_has_an_end() -> None:
    """Ten turns of every joint: an answer, not an endless loop, and within the memory of an edge."""
    _, space, _ = free_edges("plant")
    q = home(robot_named())
    assert cost(space, q, q + 20.0 * np.ones(6)) >= 20.0 * np.sqrt(6.0)
    free = wide_space(obstacles_of(scene_of()))
    turn = q + 20.0 * np.eye(6)[0]
    assert cost(free, q, turn) == pytest.approx(20.0)
