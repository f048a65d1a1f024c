"""Replay: the published facts of the driver's loop come out of the law, and timed motions end where they should under both controllers."""

import numpy as np
import pytest

from lime_planner.core.errors import ProblemError
from lime_planner.motion.controllers.replay import TICK_S, KinovaLaw, replay_jtc, replay_kinova
from lime_planner.motion.stop import one_point_stop
from lime_planner.motion.timing import time_path
from lime_planner.motion.trajectory import Trajectory

VELOCITIES = np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0])
ACCELERATIONS = np.full(6, 1.0)
NAMES = tuple(f"joint_{i}" for i in range(1, 7))


def quintic(angle, duration_s, dt_s, start=0.0):
    """One joint by `angle`, at rest and without acceleration at both ends."""
    x = np.arange(round(duration_s / dt_s) + 1) / round(duration_s / dt_s)
    q = start + angle * x**3 * (10 - 15 * x + 6 * x**2)
    v = angle / duration_s * 30 * x**2 * (1 - x) ** 2
    return Trajectory(("joint",), dt_s, q[:, None], v[:, None])


@pytest.mark.parametrize(("dt_s", "least", "most"), [(0.01, 0, 0.007), (0.02, 0, 0.007), (0.1, 0.018, 0.024), (0.2, 0.042, 0.047)])
def test_tracking_error_grows_with_the_spacing_as_measured_on_the_driver(dt_s, least, most):
    motion = quintic(1.0, 4.0, dt_s)
    t, q = replay_kinova(motion)
    error = np.abs(q - motion.sample(t)).max()
    assert least <= error <= most
    assert q[-1, 0] == pytest.approx(1.0, abs=5e-4)


def test_points_denser_than_the_tick_overshoot_in_proportion():
    _, q = replay_kinova(quintic(1.0, 4.0, 0.005), settle_s=5.0)
    assert q[-1, 0] == pytest.approx(2.0, abs=1e-3)


def test_a_replacement_keeps_the_index():
    first, second = quintic(1.0, 4.0, 0.02), quintic(0.3, 2.0, 0.02)
    moved = []
    for sent_at in np.arange(0.1, 4.0, 0.05):
        t, q = replay_kinova([(0.0, first), (sent_at, second)])
        moved.append(q[-1, 0] - q[np.searchsorted(t, sent_at - 1e-9), 0])
    moved = np.array(moved)
    # Seen on the driver: a 0.300 rad move came out as 0.318, 0.385, 0.359, 0.033 and 0.000.
    assert moved.max() > 0.40 and moved.min() < 0.001
    for seen in (0.318, 0.385, 0.359, 0.033, 0.0):
        assert np.abs(moved - seen).min() < 0.02
    assert (np.abs(moved - 0.3) > 0.01).mean() > 0.8


@pytest.mark.parametrize("sent_at", [0.05, 0.5, 1.0, 1.99, 2.5, 3.9, 4.2])
def test_after_a_one_point_stop_the_next_motion_is_exact(sent_at):
    first, second = quintic(1.0, 4.0, 0.02), quintic(0.3, 2.0, 0.02)
    stop = Trajectory(("joint",), 0.2, [[0.123]], [[0.0]], first_time_s=0.2)
    t, q = replay_kinova([(0.0, first), (sent_at, stop), (sent_at + 0.3, second)])
    halted, begun = np.searchsorted(t, [sent_at + 0.03, sent_at + 0.3])
    assert np.ptp(q[halted : begun + 1, 0]) == 0.0
    assert q[-1, 0] - q[begun, 0] == pytest.approx(0.3, abs=1e-5)


def test_the_last_velocity_is_kept():
    motion = quintic(0.3, 2.0, 0.02)
    v = motion.velocities.copy()
    v[-1] = 0.1
    _, q = replay_kinova(Trajectory(("joint",), 0.02, motion.positions, v), settle_s=1.0)
    assert q[-1, 0] - q[-51, 0] == pytest.approx(0.05)


def test_the_index_returns_to_zero_by_itself():
    law = KinovaLaw(1)
    law.command([0.0, 0.02], [[0.0], [0.0]])
    for _ in range(4):
        law.tick()
    assert (law.index, law.running) == (0, False)


def random_motion(rng, dt_s=0.02):
    waypoints = np.cumsum(rng.normal(size=(int(rng.integers(2, 12)), 6)) * 10 ** rng.uniform(-5, -0.3), axis=0)
    return time_path(waypoints, VELOCITIES, ACCELERATIONS * 10 ** rng.uniform(-0.3, 0.7), joint_names=NAMES, dt_s=dt_s)


@pytest.mark.parametrize("dt_s", [0.01, 0.013, 0.02, 0.05])
def test_timed_motions_end_at_the_goal_under_both_controllers(dt_s):
    rng = np.random.default_rng(7)
    kinova, jtc, track = 0.0, 0.0, 0.0
    for _ in range(50):
        motion = random_motion(rng, dt_s)
        t, q = replay_kinova(motion)
        kinova = max(kinova, np.abs(q[-1] - motion.positions[-1]).max())
        track = max(track, np.abs(q - motion.sample(t)).max())
        t, q = replay_jtc(motion)
        jtc = max(jtc, np.abs(q[-1] - motion.positions[-1]).max())
        assert (q[0] == motion.positions[0]).all()
    print(f"dt {dt_s} s: largest end error Kinova {1e3 * kinova:.4f} mrad, cubic {1e3 * jtc:.6f} mrad, on the way {1e3 * track:.1f} mrad")
    # 3 mrad in a joint is under 5 mm at the tool. Where the spacing is no multiple of the tick, points get a tick more or less.
    assert kinova < 3e-3
    assert jtc < 1e-12


def test_two_hundred_preempted_motions_end_at_the_newest_goal():
    rng = np.random.default_rng(11)
    worst = 0.0
    for _ in range(200):
        first = random_motion(rng)
        sent_at = float(rng.uniform(0.0, first.duration_s))
        t, q = replay_kinova(first)
        stop = one_point_stop(NAMES, q[np.searchsorted(t, sent_at)])
        halt = replay_kinova([(0.0, first), (sent_at, stop)])[1][-1]
        second = time_path([halt, halt + rng.normal(size=6) * 0.3], VELOCITIES, ACCELERATIONS, joint_names=NAMES)
        _, q = replay_kinova([(0.0, first), (sent_at, stop), (sent_at + 0.3, second)])
        worst = max(worst, np.abs(q[-1] - second.positions[-1]).max())
    print(f"200 preempted motions: largest end error {1e3 * worst:.3f} mrad")
    assert worst < 3e-3


def test_a_stop_is_reached_by_a_cubic():
    stop = Trajectory(("joint",), 0.02, [[0.5], [0.52], [0.53]], [[1.0], [0.5], [0.0]], first_time_s=0.04)
    t, q = replay_jtc(stop, q_start=[0.48])
    assert q[0, 0] == 0.48 and q[-1, 0] == 0.53 and t[-1] == pytest.approx(0.08)
    assert np.abs(np.diff(q[:, 0])).max() < 0.0015


def test_bad_calls_are_named():
    with pytest.raises(ProblemError, match="at least one command"):
        replay_kinova([])
    with pytest.raises(ProblemError, match="must ascend"):
        replay_kinova([(1.0, quintic(1, 1, 0.02)), (0.5, quintic(1, 1, 0.02))])
    assert TICK_S == 0.01
