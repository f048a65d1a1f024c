"""The simulated arm, without ROS: both controllers' rules and rejections, and every fault."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import KroghInterpolator

from lime_planner.core.errors import ParameterError
from lime_planner.motion.controllers.command import Command
from lime_planner.motion.controllers.joint_trajectory_controller import JtcLaw
from lime_planner.motion.controllers.simulated_arm import Faults, SimulatedArm
from lime_planner.motion.stop import braking, one_point_stop
from lime_planner.motion.timing import time_path

NAMES = tuple(f"j2s6s200_joint_{i}" for i in range(1, 7))
FINGERS = ("j2s6s200_joint_finger_1", "j2s6s200_joint_finger_2")
START = np.array([4.7, 2.8, 1.3, 4.6, 2.1, 1.6])
GOAL = START + np.array([0.5, -0.2, 0.3, 0.4, 0.1, -0.6])
LIMITS = np.full(6, 0.8)
MOTION = time_path([START, GOAL], LIMITS, 2.0 * LIMITS, joint_names=NAMES)
GOOD = Command.from_trajectory(MOTION)


def arm(controller="jtc", **options) -> SimulatedArm:
    faults = Faults(**options.pop("faults", {}))
    return SimulatedArm(NAMES, START, rng=np.random.default_rng(1), controller=controller, finger_joints=FINGERS, faults=faults, **options)


def played(subject: SimulatedArm, command=GOOD, seconds=MOTION.duration_s + 0.5) -> np.ndarray:
    verdict = subject.command(command)
    assert verdict.accepted, verdict.sentence
    track = []
    for _ in range(round(seconds / 0.01)):
        subject.step(0.01)
        track.append(subject.configuration)
    return np.array(track)


@pytest.mark.parametrize("controller", ["jtc", "kinova"])
def test_a_good_motion_is_carried_out(controller):
    subject = arm(controller)
    assert subject.command(GOOD).sentence == ""
    subject.step(MOTION.duration_s / 2)
    assert subject.moving
    assert np.abs(subject.configuration - MOTION.sample(MOTION.duration_s / 2)).max() < 0.01
    subject.step(MOTION.duration_s)
    assert not subject.moving
    assert np.abs(subject.configuration - GOAL).max() < (1e-9 if controller == "jtc" else 1e-4)


def test_time_may_come_in_any_portions():
    a, b = arm("kinova"), arm("kinova")
    for subject, portion in ((a, 0.01), (b, 0.0137)):
        subject.command(GOOD)
        for _ in range(round(1.5 / portion)):
            subject.step(portion)
    assert np.abs(a.configuration - b.configuration).max() < 0.03


BAD = {
    "no points": (replace(GOOD, times_s=(), positions=(), velocities=()), "no points", "no points"),
    "joint missing": (replace(GOOD, joint_names=(*NAMES[:5], "other")), "joint other is not one of", f"{NAMES[5]} is not in the message"),
    "positions short": (replace(GOOD, positions=((0.0,) * 5, *GOOD.positions[1:])), "point 0 has 5 positions", "point 0 has 5 positions"),
    "velocities short": (replace(GOOD, velocities=((0.0,) * 5, *GOOD.velocities[1:])), "point 0 has 5 velocities", "has 5 velocities"),
    "not finite": (replace(GOOD, positions=((np.nan,) * 6, *GOOD.positions[1:])), "not finite", "not finite"),
    "no velocities": (replace(GOOD, velocities=((),) * len(GOOD.times_s)), None, "point 0 has no velocities; the real driver reads them"),
    "last velocity": (replace(GOOD, velocities=(*GOOD.velocities[:-1], (0.01,) * 6)), "last point must be zero", None),
    "times stand still": (replace(GOOD, times_s=(0.0, 0.0, *GOOD.times_s[2:])), "times of points 0 and 1 do not increase", None),
    "stamp in the past": (replace(GOOD, start_s=-60.0), "the motion ended 5", None),
    "joint twice": (replace(GOOD, joint_names=(*NAMES[:5], NAMES[0])), "exactly once", "is not in the message"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_the_real_controllers_reject_is_rejected(name):
    command, jtc, kinova = BAD[name]
    for controller, words in (("jtc", jtc), ("kinova", kinova)):
        subject = arm(controller)
        verdict = subject.command(command)
        assert verdict.accepted == (words is None), verdict
        if words is not None:
            assert words in verdict.sentence and verdict.sentence.startswith("rejected: ")
            subject.step(1.0)
            assert (subject.configuration == START).all()


def test_joint_order_matters_to_kinova_only():
    order = np.roll(np.arange(6), 1)
    command = replace(
        GOOD,
        joint_names=tuple(NAMES[i] for i in order),
        positions=tuple(tuple(np.array(row)[order]) for row in GOOD.positions),
        velocities=tuple(tuple(np.array(row)[order]) for row in GOOD.velocities),
    )
    assert np.abs(played(arm("jtc"), command)[-1] - GOAL).max() < 1e-9
    subject = arm("kinova")
    assert "read by position" in subject.command(command).sentence
    subject.step(MOTION.duration_s + 0.5)
    assert np.abs(subject.configuration - START - np.roll(GOAL - START, 1)).max() < 1e-4


def test_kinova_keeps_the_index_of_a_running_motion():
    subject = arm("kinova")
    subject.command(GOOD)
    subject.step(0.5)
    before = subject.configuration
    back = time_path([before, START], LIMITS, 2.0 * LIMITS, joint_names=NAMES)
    verdict = subject.command(Command.from_trajectory(back))
    assert verdict.accepted and "goes on with that index" in verdict.sentence
    subject.step(0.2)  # at the speed of that index from the beginning
    assert np.abs(subject.configuration - back.sample(0.2)).max() > 0.01


def test_kinova_replaced_after_a_stop_ends_where_it_should():
    subject = arm("kinova")
    subject.command(GOOD)
    subject.step(0.5)
    subject.command(Command.from_trajectory(one_point_stop(NAMES, subject.configuration)))
    subject.step(0.3)
    back = time_path([subject.configuration, START], LIMITS, 2.0 * LIMITS, joint_names=NAMES)
    assert subject.command(Command.from_trajectory(back)).sentence == ""
    subject.step(10.0)
    assert np.abs(subject.configuration - START).max() < 1e-3


def test_jtc_brakes_on_the_path():
    subject = arm("jtc")
    subject.command(GOOD)
    subject.step(0.8)
    stop = braking(MOTION, 0.8, 2.0 * LIMITS)
    track = np.concatenate([[subject.configuration], played(subject, Command.from_trajectory(stop), 1.0)])
    direction = (GOAL - START) / np.linalg.norm(GOAL - START)
    along = (track - START) @ direction
    assert np.abs(track - START - along[:, None] * direction).max() < 1e-6
    assert (np.diff(along) >= -1e-9).all() and np.ptp(along[-20:]) == 0.0
    assert np.abs(np.diff(track, n=2, axis=0)).max() / 0.01**2 < 2.1 * 0.8 * 2


def test_jtc_says_when_a_start_elsewhere_makes_the_arm_jump():
    command = Command.from_trajectory(time_path([START + 0.1, GOAL], LIMITS, 2.0 * LIMITS, joint_names=NAMES))
    subject = arm("jtc")
    assert "the arm jumps" in subject.command(command).sentence
    subject.step(0.01)
    assert np.abs(subject.configuration - START - 0.1).max() < 1e-3


def test_jtc_shifts_the_start_of_continuous_joints_only():
    moved = [START + 2 * np.pi * np.eye(6)[0], GOAL + 2 * np.pi * np.eye(6)[0]]
    command = Command.from_trajectory(time_path(moved, LIMITS, 2.0 * LIMITS, joint_names=NAMES))
    subject = arm("jtc")
    track = played(subject, command)
    assert track[0, 0] == pytest.approx(START[0] + 2 * np.pi, abs=1e-3) and np.abs(np.diff(track[:, 0])).max() < 0.01
    limited = arm("jtc", continuous=np.zeros(6, dtype=bool))
    played(limited, command, 0.01)
    assert limited.configuration[0] == pytest.approx(START[0] + 2 * np.pi, abs=1e-3)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_splines_of_every_order_hit_the_points(rows):
    rng = np.random.default_rng(rows)
    values = [tuple(map(tuple, rng.normal(size=(4, 6)))) for _ in range(3)]
    command = Command(NAMES, (0.1, 0.5, 1.0, 1.2), *values[:rows], *(((),) * (3 - rows)))
    law = JtcLaw(command, NAMES, START, np.full(6, 0.1), np.zeros(6, dtype=bool))
    assert np.allclose(law.sample(0.0), START) and np.allclose(law.sample(9.0), values[0][-1])
    for i, (a, b) in enumerate(itertools.pairwise(command.times_s)):
        knots = np.repeat([a, b], rows)
        spline = KroghInterpolator(knots, [values[k][j] for j in (i, i + 1) for k in range(rows)])
        for t_s in np.linspace(a, b, 7):
            assert np.allclose(law.sample(t_s), spline(t_s))
    approach = (law.sample(1e-6) - START) / 1e-6
    assert np.allclose(approach, 0.1 if rows > 1 else (np.array(values[0][0]) - START) / 0.1, atol=5e-3)


@pytest.mark.parametrize("controller", ["jtc", "kinova"])
class TestFaults:
    def test_gain(self, controller):
        end = played(arm(controller, faults={"gain_error": 0.1}))[-1]
        assert np.abs(end - START - 1.1 * (GOAL - START)).max() < 1e-3

    def test_lag(self, controller):
        sound, late = played(arm(controller), seconds=4.0), played(arm(controller, faults={"lag_s": 0.05}), seconds=4.0)
        middle = round(MOTION.duration_s / 2 / 0.01)
        behind = sound[middle] - late[middle]
        assert np.allclose(behind, 0.05 * MOTION.sample_velocity(MOTION.duration_s / 2), atol=0.006)
        assert np.abs(late[-1] - GOAL).max() < 1e-3

    def test_speed_scaling(self, controller):
        slow = played(arm(controller, faults={"speed_scaling": 0.5}), seconds=2.5 * MOTION.duration_s)
        half = slow[round(MOTION.duration_s / 0.01)]
        expected = MOTION.sample(MOTION.duration_s / 2) if controller == "jtc" else GOAL  # the driver knows no such thing
        assert np.abs(half - expected).max() < 0.02
        assert np.abs(slow[-1] - GOAL).max() < 0.01

    def test_stall_and_recovery(self, controller):
        subject = arm(controller, faults={"stall_at_fraction": 0.5})
        end = played(subject)[-1]
        assert np.abs(end - MOTION.sample(MOTION.duration_s / 2)).max() < 0.02 and not subject.moving
        subject.faults = Faults()
        back = time_path([end, START], LIMITS, 2.0 * LIMITS, joint_names=NAMES)
        assert np.abs(played(subject, Command.from_trajectory(back), 5.0)[-1] - START).max() < 1e-3

    def test_wrap_offset(self, controller):
        subject = arm(controller, faults={"wrap_offset_turns": (0, 0, 0, -2, 0, 1)})
        turned = 2 * np.pi * np.array([0, 0, 0, -2, 0, 1.0])
        assert np.allclose(subject.configuration, START + turned)
        motion = time_path([START + turned, GOAL + turned], LIMITS, 2.0 * LIMITS, joint_names=NAMES)
        track = played(subject, Command.from_trajectory(motion))
        assert np.abs(np.diff(track, axis=0)).max() < 0.01
        assert np.abs(track[-1] - GOAL - turned).max() < 1e-3

    def test_noise_and_drops(self, controller):
        subject = arm(controller, faults={"noise_rad": 0.01, "drop_probability": 0.3})
        states = [subject.state() for _ in range(400)]
        kept = [state for state in states if state is not None]
        assert 0.6 < len(kept) / 400 < 0.8
        assert np.std([state.positions[2] for state in kept]) == pytest.approx(0.01, rel=0.2)

    def test_late_states(self, controller):
        subject = arm(controller, faults={"state_delay_s": 0.3})
        subject.command(GOOD)
        subject.step(0.5)
        then = subject.configuration
        subject.step(0.3)
        state = subject.state()
        assert np.allclose(state.positions[:6], then) and state.age_s == pytest.approx(0.3)

    def test_shuffled_and_extra_joints(self, controller):
        subject = arm(controller, faults={"shuffle": True, "extra_joints": ("camera_tilt",)})
        states = [subject.state() for _ in range(20)]
        assert len({state.joint_names for state in states}) > 10
        for state in states:
            assert set(state.joint_names) == {*NAMES, *FINGERS, "camera_tilt"}
            assert [state.positions[state.joint_names.index(name)] for name in NAMES] == START.tolist()


def test_kinova_velocities_are_sometimes_doubled():
    subject = arm("kinova")
    subject.command(GOOD)
    subject.step(0.5)
    speeds = {round(float(subject.state().velocities[0]), 9) for _ in range(100)}
    assert len(speeds) == 2 and max(speeds) == pytest.approx(2 * min(speeds))


def test_bad_arms_are_named():
    with pytest.raises(ParameterError, match="controller is 'x'; it must be one of jtc, kinova"):
        arm("x")
    with pytest.raises(ParameterError, match="start must be 6 finite numbers"):
        SimulatedArm(NAMES, START[:5], rng=np.random.default_rng(0))
    with pytest.raises(ParameterError, match="wrap_offset_turns needs 0, 1 or 6 numbers, got 2"):
        arm(faults={"wrap_offset_turns": (1, 2)})
