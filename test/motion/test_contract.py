"""The trajectory contract: each rule broken alone gives one sentence that names joint, point, value and limit."""

import re
from dataclasses import replace

import numpy as np
import pytest

from lime_planner.core.errors import ProblemError
from lime_planner.motion.contract import violations
from lime_planner.motion.timing import time_path
from lime_planner.motion.trajectory import Trajectory

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
LIMITS = {
    "lower": np.array([-np.inf, 0.8, 0.3, -np.inf, 0.5, -np.inf]),
    "upper": np.array([np.inf, 5.5, 6.0, np.inf, 5.7, np.inf]),
    "velocity_limits": np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0]),
    "acceleration_limits": np.full(6, 1.2),
    "joint_names": NAMES,
}
START = np.array([4.7, 2.8, 1.3, 4.6 + 4 * np.pi, 2.1, -1.6])
OFFSETS = np.array([[0.0] * 6, [0.5, -0.2, 0.3, 0.4, 0.1, -0.6], [0.2, 0.1, 0.6, 0.9, 0.2, -0.6]])
PATH = START + OFFSETS


@pytest.fixture(scope="module")
def good() -> Trajectory:
    return time_path(PATH, LIMITS["velocity_limits"], LIMITS["acceleration_limits"], joint_names=NAMES)


def edited(trajectory, *, position=None, velocity=None):
    """Return the trajectory with single numbers replaced: (point, joint, value)."""
    q, v = trajectory.positions.copy(), trajectory.velocities.copy()
    for array, edit in ((q, position), (v, velocity)):
        if edit is not None:
            array[edit[0], edit[1]] = edit[2]
    return replace(trajectory, positions=q, velocities=v)


def check(trajectory, **changes):
    return violations(trajectory, **{"q_measured": START, **LIMITS, **changes})


def test_a_timed_path_keeps_every_rule(good):
    assert check(good) == []


def test_point_zero_may_differ_a_little_from_the_measurement(good):
    assert check(good, q_measured=START + 0.0099) == []


def resampled(trajectory, dt_s):
    t = np.arange(0.0, trajectory.duration_s + dt_s / 2, dt_s)
    q, v = trajectory.sample(t), trajectory.sample_velocity(t)
    v[[0, -1]] = 0.0
    return Trajectory(NAMES, dt_s, q, v)


def turned_midway(trajectory):
    q = trajectory.positions.copy()
    q[40:, 3] += 2 * np.pi
    return replace(trajectory, positions=q)


CASES = {
    "joint order": (lambda t: replace(t, joint_names=NAMES[::-1]), {}, "the joints are joint_6, .* they must be joint_1, .* in this order"),
    "a finger": (lambda t: t, {"joint_names": (*NAMES, "finger")}, "they must be joint_1, .*finger"),
    "too dense": (lambda t: resampled(t, 0.005), {}, "points are 0.005 s apart; at least 0.01 s"),
    "one point": (lambda t: Trajectory(NAMES, 0.02, [START], [np.zeros(6)]), {}, "has 1 point; it needs at least 2"),
    "late first point": (lambda t: replace(t, first_time_s=0.2), {}, "point 0 is at 0.2 s; it must be at 0 s"),
    "start elsewhere": (
        lambda t: t,
        {"q_measured": START + 0.0101 * np.eye(6)[2]},
        r"point 0 has joint_3 at 1.3000 rad, 0.0101 rad from the measured 1.3101 rad; at most 0.01 rad is allowed$",
    ),
    "start a turn away": (
        lambda t: t,
        {"q_measured": START - 4 * np.pi * np.eye(6)[3]},
        r"point 0 has joint_4 at 17.1664 rad, 12.5664 rad from .*\(it is \+2 turns off the measured branch\)",
    ),
    "measurement not finite": (
        lambda t: t,
        {"q_measured": np.where(np.arange(6) == 2, np.nan, START)},
        "joint_3 .* from the measured nan rad",
    ),
    "a jump of a turn": (turned_midway, {}, r"joint_4 jumps by 6\.\d+ rad from point 39 to 40"),
    "moving at the start": (
        lambda t: edited(t, velocity=(0, 1, 1e-9)),
        {},
        r"first velocity of joint_2 \(point 0\) is 1e-09 rad/s; it must be exactly 0",
    ),
    "moving at the end": (lambda t: edited(t, velocity=(-1, 5, -1e-7)), {}, r"last velocity of joint_6 \(point \d+\) is -1e-07 rad/s"),
    "wrong velocity": (
        lambda t: edited(t, velocity=(30, 0, t.velocities[30, 0] - 0.05)),
        {},
        r"velocities of joint_1 at points \d+ and \d+ differ by 0.02\d+ rad/s .* at most 0.0060 rad/s",
    ),
    "no velocities": (lambda t: replace(t, velocities=0.0 * t.velocities), {}, "velocities of joint_1 .* they must be the derivatives"),
    "not a position": (lambda t: edited(t, position=(7, 2, np.nan)), {}, "position of joint_3 at point 7 is nan; it must be finite"),
    "not a velocity": (lambda t: edited(t, velocity=(7, 2, np.inf)), {}, "velocity of joint_3 at point 7 is inf; it must be finite"),
    "below a limit": (
        lambda t: t,
        {"lower": np.array([-9, 2.7, 0, -99, 0, -9])},
        r"joint_2 is at 2.6\d+ rad at point \d+, below its limit of 2.7000 rad",
    ),
    "above a limit": (
        lambda t: t,
        {"upper": np.array([9, 5, 1.8, 99, 9, 9])},
        r"joint_3 is at 1.9\d+ rad at point \d+, above its limit of 1.8000 rad",
    ),
    "too fast": (
        lambda t: t,
        {"velocity_limits": LIMITS["velocity_limits"] * [1, 1, 1, 1, 1, 0.5]},
        r"joint_6 moves at 0.\d+ rad/s between points \d+ and \d+; its limit is 0.4189 rad/s",
    ),
    "accelerating too hard": (
        lambda t: t,
        {"acceleration_limits": LIMITS["acceleration_limits"] * [0.7, 1, 1, 1, 1, 1]},
        r"joint_1 accelerates at \d.\d+ rad/s² between points \d+ and \d+; its limit is 0.8400 rad/s²",
    ),
    "scaled velocity": (lambda t: t, {"velocity_scaling": 0.9}, r"moves at 0.\d+ rad/s .* its limit is 0.\d+ rad/s"),
    "scaled acceleration": (lambda t: t, {"acceleration_scaling": 0.9}, r"accelerates at 1.\d+ rad/s² .* its limit is 1.0800 rad/s²"),
}
SEVERAL = {"no velocities", "scaled velocity", "scaled acceleration", "a finger"}  # of these every joint may have its sentence


@pytest.mark.parametrize("name", CASES)
def test_each_rule_broken_alone_is_named(good, name):
    change, limits, words = CASES[name]
    found = check(change(good), **limits)
    assert found and re.search(words, found[0]), found
    if name not in SEVERAL:
        assert len(found) == 1, found


def test_all_broken_rules_are_listed(good):
    bad = edited(replace(turned_midway(good), first_time_s=0.1), velocity=(-1, 0, 0.2))
    assert len(check(bad, q_measured=START + 1.0, joint_names=NAMES[::-1])) >= 10


def test_a_random_edit_never_goes_unnoticed(good):
    rng = np.random.default_rng(0)
    for _ in range(200):
        point, joint = int(rng.integers(1, len(good) - 1)), int(rng.integers(6))
        size = float(rng.choice([-1, 1])) * 10 ** rng.uniform(-2, 1)
        if rng.random() < 0.5:
            bad = edited(good, position=(point, joint, good.positions[point, joint] + size))
        else:
            bad = edited(good, velocity=(point, joint, good.velocities[point, joint] + 2 * size))
        assert any(NAMES[joint] in sentence for sentence in check(bad)), (point, joint, size)


def test_wrong_shapes_are_mistakes(good):
    with pytest.raises(ProblemError, match=r"q_measured must have shape \(6,\), got \(5,\)"):
        check(good, q_measured=START[:5])
