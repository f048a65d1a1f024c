"""The trajectory's arrays: immutable, checked for shape, sampled as the controllers sample them."""

import numpy as np
import pytest

from lime_planner.core.errors import ProblemError
from lime_planner.motion.trajectory import Trajectory

NAMES = ("a", "b")


def cubic(dt_s=0.05, count=21, first_time_s=0.0):
    """Two joints on cubics in time, which the points' own cubics repeat exactly."""
    t = dt_s * np.arange(count)
    q = np.stack([t**3 - 0.4 * t**2 + 1.0, -(t**2) + 7.0], axis=1)
    v = np.stack([3 * t**2 - 0.8 * t, -2 * t], axis=1)
    return Trajectory(NAMES, dt_s, q, v, first_time_s)


def test_a_cubic_motion_is_sampled_exactly():
    motion = cubic()
    t = np.linspace(0.0, 1.0, 333)
    assert np.allclose(motion.sample(t), np.stack([t**3 - 0.4 * t**2 + 1.0, -(t**2) + 7.0], axis=1), atol=1e-12)
    assert np.allclose(motion.sample_velocity(t), np.stack([3 * t**2 - 0.8 * t, -2 * t], axis=1), atol=1e-12)
    start, end = motion.end_accelerations()
    assert np.allclose(start[:, 0], 6 * motion.times()[:-1] - 0.8) and np.allclose(end[:, 1], -2.0)
    assert motion.sample(0.5).shape == (2,) and motion.sample([[0.1, 0.2]]).shape == (1, 2, 2)


def test_outside_the_motion_the_arm_stands():
    motion = cubic(first_time_s=0.2)
    assert motion.duration_s == pytest.approx(1.2) and motion.times()[0] == 0.2 and len(motion) == 21
    for t_s, point in ((-1.0, 0), (0.1, 0), (0.2, 0), (9.0, -1)):
        assert (motion.sample(t_s) == motion.positions[point]).all()
    assert not motion.sample_velocity([0.1, 9.0]).any()
    assert (Trajectory(NAMES, 0.2, [[1.0, 2.0]], [[0.0, 0.0]], 0.2).sample([0.0, 5.0]) == [1.0, 2.0]).all()


def test_peak_velocities_between_the_points_are_found():
    rng = np.random.default_rng(0)
    motion = Trajectory(NAMES, 0.1, rng.normal(size=(30, 2)), rng.normal(size=(30, 2)))
    fine = np.abs(motion.sample_velocity(np.linspace(0.0, motion.duration_s, 29 * 500 + 1)))
    dense = np.stack([fine[500 * i : 500 * (i + 1) + 1].max(axis=0) for i in range(29)])
    assert np.allclose(motion.peak_velocities(), dense, rtol=1e-3)


def test_configurations_are_never_further_apart_than_asked():
    motion = cubic()
    for step in (0.5, 0.05, 0.003):
        q = motion.configurations(step)
        assert np.abs(np.diff(q, axis=0)).max() <= step
        assert (q[0] == motion.positions[0]).all() and (q[-1] == motion.positions[-1]).all()
        assert len(q) >= len(motion)
    assert len(motion.configurations(0.5)) == len(motion)
    with pytest.raises(ProblemError, match="step_rad must be above 0"):
        motion.configurations(0.0)


def test_it_is_immutable_and_owns_its_arrays():
    q = np.zeros((2, 2))
    motion = Trajectory(NAMES, 0.02, q, q)
    q[0, 0] = 1.0
    assert motion.positions[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        motion.positions[0, 0] = 1.0


def test_samples_with_times():
    motion = cubic(first_time_s=0.2)
    again = Trajectory.from_samples(NAMES, motion.times(), motion.positions, motion.velocities)
    assert again.dt_s == pytest.approx(0.05) and again.first_time_s == 0.2
    times = motion.times().copy()
    times[5] += 0.01
    with pytest.raises(ProblemError, match=r"points 4 and 5 are 0.060000 s apart, 0.050000 s on average"):
        Trajectory.from_samples(NAMES, times, motion.positions, motion.velocities)


def test_one_motion_after_another():
    first = Trajectory(NAMES, 0.5, np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 3.0]]), np.array([[0.0, 0.0], [1.0, 2.0], [0.0, 0.0]]))
    second = Trajectory(NAMES, 0.5, np.array([[2.0, 3.0], [4.0, 3.0]]), np.zeros((2, 2)))
    both = first.then(second)
    assert both.duration_s == first.duration_s + second.duration_s and both.positions[:, 0].tolist() == [0.0, 1.0, 2.0, 4.0]
    for t in (0.3, 0.9, 1.0):
        np.testing.assert_array_equal(both.sample(t), first.sample(t))
    np.testing.assert_allclose(both.sample(1.2), second.sample(0.2), atol=1e-14)
    for other in (first, Trajectory(NAMES, 0.5, second.positions, np.ones((2, 2)))):
        with pytest.raises(ProblemError, match="ends, at rest, where it begins"):
            first.then(other)
    for names, dt_s in ((("a", "c"), 0.5), (NAMES, 0.1)):
        with pytest.raises(ProblemError, match="the same joints and spacing"):
            first.then(Trajectory(names, dt_s, second.positions, second.velocities))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"positions": np.zeros((3, 3))}, r"positions must have shape \(points >= 1, 2 joints\), got \(3, 3\)"),
        ({"positions": np.zeros((0, 2))}, "positions must have shape"),
        ({"velocities": np.zeros((4, 2))}, "3 positions and 4 velocities"),
        ({"dt_s": 0.0}, "dt_s must be above 0"),
        ({"first_time_s": -0.1}, "first_time_s must be 0 or more"),
    ],
)
def test_mistakes_are_named(change, words):
    good = {"joint_names": NAMES, "dt_s": 0.02, "positions": np.zeros((3, 2)), "velocities": np.zeros((3, 2))}
    with pytest.raises(ProblemError, match=words):
        Trajectory(**{**good, **change})
