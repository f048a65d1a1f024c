"""Timing: the motion stays beside the polyline, within the limits between the points too, and ends where both controllers take it."""

import itertools
import logging
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lime_planner.core.errors import ProblemError
from lime_planner.motion.blend import BlendedPath, thin
from lime_planner.motion.timing import LIMIT_SLACK, time_path
from lime_planner.motion.trajectory import Trajectory

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
VELOCITIES = np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0])
ACCELERATIONS = np.full(6, 1.0)
TOLERANCE = 0.01


def distance_to_polyline(q, waypoints):
    best = np.linalg.norm(q - waypoints[0], axis=1)
    for a, b in itertools.pairwise(waypoints):
        d = b - a
        along = np.clip((q - a) @ d / (d @ d), 0.0, 1.0) if d @ d > 0.0 else np.zeros(len(q))
        best = np.minimum(best, np.linalg.norm(q - a - along[:, None] * d, axis=1))
    return best


def assert_good(trajectory: Trajectory, waypoints, *, velocities=VELOCITIES, accelerations=ACCELERATIONS, tolerance=TOLERANCE):
    waypoints = np.asarray(waypoints, dtype=float)
    q, v, h = trajectory.positions, trajectory.velocities, trajectory.dt_s
    assert (q[0] == waypoints[0]).all() and (q[-1] == waypoints[-1]).all()
    assert not v[0].any() and not v[-1].any()
    # The cubics at a hundred times between every two points, against the limits.
    if len(trajectory) <= 2000:
        fine = np.linspace(0.0, trajectory.duration_s, 100 * (len(trajectory) - 1) + 1)
        speed = trajectory.sample_velocity(fine)
        assert (np.abs(speed) <= velocities * (1.0 + LIMIT_SLACK) + 1e-12).all()
        assert (np.abs(np.diff(speed, axis=0)) <= accelerations * (1.0 + LIMIT_SLACK) * (fine[1] - fine[0]) + 1e-12).all()
        dense = trajectory.sample(fine)
        assert distance_to_polyline(dense, waypoints).max() <= tolerance
        nearest = [np.linalg.norm(dense - w, axis=1).min() for w in waypoints]
        assert max(nearest) <= tolerance + np.abs(np.diff(dense, axis=0)).max()
    # Velocities are the derivatives: no other motion within the acceleration limits has these positions.
    assert (np.abs(np.diff(q, axis=0) - h * (v[1:] + v[:-1]) / 2.0) <= 0.25 * accelerations * h**2 * (1 + 1e-6) + 1e-12).all()
    # The Kinova driver's sum of velocities ends at the goal.
    assert np.abs(v.sum(axis=0) * h - (q[-1] - q[0])).max() <= 1e-3


def walk(rng, count, scale):
    return np.cumsum(rng.normal(size=(count, 6)) * scale, axis=0)


@pytest.mark.parametrize("count", [2, 3, 5, 12, 40])
@pytest.mark.parametrize("scale", [1e-6, 1e-3, 0.03, 0.4])
def test_random_paths(count, scale):
    rng = np.random.default_rng(count)
    for _ in range(3):
        waypoints = walk(rng, count, scale)
        assert_good(time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES), waypoints)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.floats(-6.0, 0.3), st.sampled_from([0.01, 0.013, 0.02, 0.05, 0.1]), st.floats(-0.5, 1.2))
def test_any_grid_and_acceleration(seed, log_scale, dt_s, log_acceleration):
    rng = np.random.default_rng(seed)
    waypoints = walk(rng, int(rng.integers(2, 9)), 10.0**log_scale)
    accelerations = np.full(6, 10.0**log_acceleration) * rng.uniform(0.5, 1.0, 6)
    trajectory = time_path(waypoints, VELOCITIES, accelerations, joint_names=NAMES, dt_s=dt_s)
    assert_good(trajectory, waypoints, accelerations=accelerations)
    assert trajectory.dt_s == dt_s


def test_scaled_limits_are_kept_and_used():
    waypoints = np.array([[0.0] * 6, [2.0] * 6])
    full = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    slow = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES, velocity_scaling=0.5, acceleration_scaling=0.3)
    assert_good(slow, waypoints, velocities=0.5 * VELOCITIES, accelerations=0.3 * ACCELERATIONS)
    assert (np.abs(full.velocities) / VELOCITIES).max() > 0.98
    assert (np.abs(slow.velocities) / VELOCITIES).max() == pytest.approx(0.5, rel=0.02)
    # Two radians at 36 degrees a second and 1 rad/s²: 2 / v + v / a = 3.81 s is the fastest there is.
    assert 3.81 < full.duration_s < 3.81 * 1.05


@pytest.mark.parametrize("waypoints", [[[0.3] * 6], [[0.3] * 6] * 2, [[0.3] * 6] * 5], ids=["one", "two equal", "five equal"])
def test_no_motion_is_two_equal_points(waypoints):
    trajectory = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    assert trajectory.positions.tolist() == [[0.3] * 6] * 2
    assert not trajectory.velocities.any()


def test_repeated_waypoints_and_a_round_trip():
    a, b = np.zeros(6), np.full(6, 0.4)
    for waypoints in ([a, a, b, b, b], [a, b, a], [a, b, b, a, a]):
        assert_good(time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES), waypoints)


def test_a_reversal_stands_still_at_its_tip():
    tip = np.full(6, 0.5)
    waypoints = np.array([np.zeros(6), tip, np.full(6, 0.1)])
    trajectory = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    assert_good(trajectory, waypoints)
    fine = np.linspace(0.0, trajectory.duration_s, 20001)
    q, v = trajectory.sample(fine), np.linalg.norm(trajectory.sample_velocity(fine), axis=1)
    turn = int(np.argmin(np.linalg.norm(q - tip, axis=1)))
    assert np.linalg.norm(q[turn] - tip) <= TOLERANCE
    assert v[turn - 50 : turn + 51].min() < 1e-3


def test_corners_are_rounded_not_stopped_at():
    corner = np.array([[0.0] * 6, [0.6, 0, 0, 0, 0, 0], [0.6, 0.6, 0, 0, 0, 0]])
    trajectory = time_path(corner, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    middle = int(np.argmin(np.linalg.norm(trajectory.positions - corner[1], axis=1)))
    assert np.linalg.norm(trajectory.velocities, axis=1)[middle - 3 : middle + 4].min() > 0.05
    tight = time_path(corner, VELOCITIES, ACCELERATIONS, joint_names=NAMES, corner_tolerance_rad=1e-4)
    assert_good(tight, corner, tolerance=1e-4)
    assert tight.duration_s > trajectory.duration_s


def test_hundreds_of_tiny_segments_cost_no_stops():
    t = np.linspace(0.0, 1.0, 300)
    curve = np.stack([np.sin((k + 1) * t) for k in range(6)], axis=1)
    jittered = curve + np.random.default_rng(1).normal(size=curve.shape) * 1e-4
    straight = time_path(curve, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    rough = time_path(jittered, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    assert_good(straight, curve)
    assert_good(rough, jittered)
    assert rough.duration_s < 1.3 * straight.duration_s


def test_speed_caps_hold_where_they_apply_and_only_there():
    waypoints = np.array([[0.0] * 6, [1.0, 0.3, 0, 0, 0, 0], [1.0, 1.6, 0.2, 0, 0, 0]])
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
    leaf = (0.6, 1.5)

    def scale(s):
        assert s.min() >= 0.0 and s.max() <= lengths[-1] + 1e-9
        return np.where((s >= leaf[0]) & (s <= leaf[1]), 0.2, 1.0)

    free = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    capped = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES, speed_scale=scale)
    assert_good(capped, waypoints)
    fine = np.linspace(0.0, capped.duration_s, 5001)
    q, used = capped.sample(fine), (np.abs(capped.sample_velocity(fine)) / VELOCITIES).max(axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])  # shorter than the polyline at the corner
    inside = (along > leaf[0]) & (along < leaf[1] - 0.02)
    assert used[inside].max() <= 0.2 * 1.01
    assert used[inside].min() > 0.05 and used[~inside].max() > 0.8
    assert capped.duration_s > 1.5 * free.duration_s


def test_graded_caps():
    waypoints = np.array([[0.0] * 6, [1.5] * 6])
    trajectory = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES, speed_scale=lambda s: 1.0 - 0.8 * np.sin(s) ** 2)
    s = np.linalg.norm(trajectory.positions - waypoints[0], axis=1)
    used = (np.abs(trajectory.velocities) / VELOCITIES).max(axis=1)
    assert (used <= (1.0 - 0.8 * np.sin(s) ** 2) * 1.02).all()


def test_blend_is_twice_differentiable_and_bounded():
    rng = np.random.default_rng(5)
    for _ in range(20):
        waypoints = walk(rng, 6, 0.3)
        path = BlendedPath(waypoints, 0.02)
        p = np.linspace(0.0, path.length, 4001)
        assert distance_to_polyline(path(p), waypoints).max() <= 0.02
        assert np.linalg.norm(path(p, 1), axis=1).max() <= 1.0 + 1e-9
        for order in (0, 1, 2):
            before, after = path(path.knots[1:-1] - 1e-9, order), path(path.knots[1:-1] + 1e-9, order)
            assert np.abs(after - before).max() < 1e-4 / 10 ** (2 - order)
        step = 1e-6
        assert np.allclose((path(p[5:-5] + step) - path(p[5:-5] - step)) / (2 * step), path(p[5:-5], 1), atol=1e-6)


def test_thinning_keeps_what_matters():
    t = np.linspace(0.0, 1.0, 101)
    line = np.stack([t, 2 * t, -t], axis=1)
    assert thin(line, 1e-9)[0].tolist() == [0, 100]
    bent = line.copy()
    bent[50] += [0.0, 0.0, 0.1]
    kept, worst = thin(bent, 0.01)
    assert 50 in kept and worst <= 0.01


def test_ordinary_paths_take_under_50_ms():
    rng = np.random.default_rng(2)
    paths = [walk(rng, int(rng.integers(2, 41)), 0.2) for _ in range(20)]
    time_path(paths[0], VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    taken = []
    for path in paths:
        start = time.process_time()  # others' work on the machine does not count
        time_path(path, VELOCITIES, ACCELERATIONS, joint_names=NAMES)
        taken.append(time.process_time() - start)
    print(f"time_path: median {1e3 * np.median(taken):.1f} ms, largest {1e3 * max(taken):.1f} ms")
    assert np.median(taken) < 0.05


def test_toppra_is_silent(caplog, capfd):
    with caplog.at_level(logging.DEBUG):
        time_path(walk(np.random.default_rng(3), 8, 0.1), VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    assert not [record for record in caplog.records if record.name.startswith("toppra")]
    assert capfd.readouterr() == ("", "")


GOOD = {"waypoints": [[0.0] * 6, [0.1] * 6], "velocity_limits": VELOCITIES, "acceleration_limits": ACCELERATIONS, "joint_names": NAMES}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"waypoints": [[0.0] * 5]}, "waypoints must have shape"),
        ({"waypoints": np.empty((0, 6))}, "waypoints must have shape"),
        ({"waypoints": [[0.0] * 6, [np.nan] * 6]}, "waypoint 1 is not finite"),
        ({"velocity_limits": [1.0, 1, 0, 1, 1, 1]}, "velocity limit of joint_3 must be finite and above 0, got 0.0"),
        ({"acceleration_limits": [1.0, np.inf, 1, 1, 1, 1]}, "acceleration limit of joint_2"),
        ({"acceleration_limits": [1.0]}, "acceleration_limits must have shape"),
        ({"dt_s": 0.005}, "dt_s must be at least 0.01 s, got 0.005"),
        ({"velocity_scaling": 1.5}, "velocity_scaling must be above 0 and at most 1, got 1.5"),
        ({"acceleration_scaling": 0.0}, "acceleration_scaling"),
        ({"corner_tolerance_rad": 0.0}, "corner_tolerance_rad must be above 0"),
        ({"speed_scale": lambda s: 0.0 * s}, "speed_scale must return"),
        ({"speed_scale": lambda s: 1.0}, "speed_scale must return"),
    ],
)
def test_mistakes_are_named(change, words):
    with pytest.raises(ProblemError, match=words):
        time_path(**{**GOOD, **change})
