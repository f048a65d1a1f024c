"""Stops: the braking motion stays on the path, within the limits, and is short; the one-point stop halts the Kinova law."""

import time

import numpy as np
import pytest

from lime_planner.core.errors import ProblemError
from lime_planner.motion.controllers.replay import replay_jtc, replay_kinova
from lime_planner.motion.stop import STOP_TIME_S, braking, one_point_stop
from lime_planner.motion.timing import time_path

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
VELOCITIES = np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0])
ACCELERATIONS = np.full(6, 1.0)


def random_motions(count, seed=0, scaling=1.0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        waypoints = np.cumsum(rng.normal(size=(int(rng.integers(2, 10)), 6)) * 10 ** rng.uniform(-2, -0.2), axis=0)
        motion = time_path(waypoints, VELOCITIES, ACCELERATIONS, joint_names=NAMES, acceleration_scaling=scaling)
        yield motion, float(rng.uniform(0.0, motion.duration_s))


@pytest.mark.timed
@pytest.mark.parametrize("scaling", [1.0, 0.4])
def test_braking_keeps_path_and_limits(scaling):
    hardest, off_path, taken = 0.0, 0.0, []
    for motion, elapsed in random_motions(40, scaling=scaling):
        start = time.perf_counter()
        stop = braking(motion, elapsed, ACCELERATIONS)
        taken.append(time.perf_counter() - start)
        assert stop.first_time_s == motion.dt_s == stop.dt_s
        assert not stop.velocities[-1].any()
        assert np.abs(stop.positions[0] - motion.sample(elapsed + motion.dt_s)).max() <= 0.5 * motion.dt_s**2 * 2.0
        # No longer than the motion itself would have taken.
        assert stop.duration_s <= motion.duration_s - elapsed + 2 * motion.dt_s
        if len(stop) > 1:
            hardest = max(hardest, max(np.abs(a).max() for a in stop.end_accelerations()))
            assert (stop.peak_velocities() <= VELOCITIES * 1.001).all()
            _, q = replay_jtc(stop, q_start=motion.sample(elapsed))
            dense = motion.sample(np.linspace(elapsed, motion.duration_s, 3000))
            off_path = max(off_path, *(distance_to_curve(point, dense) for point in q[stop_begins(stop) :: 5]))
    print(f"braking: hardest {hardest:.4f} of 1 rad/s², off the path {1e6 * off_path:.1f} µrad, median {1e3 * np.median(taken):.1f} ms")
    assert hardest <= 1.02
    assert off_path < 2e-4
    assert np.median(taken) < 0.02


def distance_to_curve(point, dense):
    step = np.diff(dense, axis=0)
    square = np.maximum((step**2).sum(axis=1), 1e-30)
    along = np.clip(((point - dense[:-1]) * step).sum(axis=1) / square, 0.0, 1.0)
    return np.linalg.norm(dense[:-1] + along[:, None] * step - point, axis=1).min()


def stop_begins(stop):
    return int(np.ceil(stop.first_time_s / 0.001)) + 1


def test_a_straight_motion_brakes_as_fast_as_it_can():
    motion = time_path([[0.0] * 6, [2.0] * 6], VELOCITIES, ACCELERATIONS, joint_names=NAMES)
    stop = braking(motion, 2.0, ACCELERATIONS)
    fastest_s = VELOCITIES[0] / ACCELERATIONS[0]
    assert stop.duration_s - stop.first_time_s < fastest_s + 3 * motion.dt_s
    assert stop.positions[-1, 0] - stop.positions[0, 0] == pytest.approx(0.5 * VELOCITIES[0] ** 2 / ACCELERATIONS[0], rel=0.1)


def test_before_the_first_point_and_after_the_end_there_is_nothing_to_brake():
    motion, _ = next(random_motions(1))
    over = braking(motion, motion.duration_s + 1.0, ACCELERATIONS)
    assert over.positions.tolist() == motion.positions[-1:].tolist() and not over.velocities.any()
    begun = braking(motion, 0.0, ACCELERATIONS)
    assert np.abs(begun.positions[-1] - motion.positions[0]).max() < 0.01


def test_the_one_point_stop_halts_the_kinova_law_wherever_it_is():
    for motion, elapsed in random_motions(20, seed=3):
        stop = one_point_stop(NAMES, motion.sample(elapsed))
        assert stop.times().tolist() == [STOP_TIME_S] == [0.2]
        t, q = replay_kinova([(0.0, motion), (elapsed, stop)], settle_s=1.0)
        halted = np.searchsorted(t, elapsed + 0.04)
        assert np.ptp(q[halted:], axis=0).max() == 0.0


def test_bad_calls_are_named():
    motion, _ = next(random_motions(1))
    with pytest.raises(ProblemError, match="q_measured must be 6 finite numbers"):
        one_point_stop(NAMES, [np.nan] * 6)
    with pytest.raises(ProblemError, match="acceleration_limits must be 6 numbers above 0"):
        braking(motion, 0.1, np.zeros(6))
    with pytest.raises(ProblemError, match="elapsed_s, lead_s and pace"):
        braking(motion, -0.1, ACCELERATIONS)
