"""Stops in closed loop with an ideal joint trajectory controller: what it is made to command, from joint states that are old and few."""

from __future__ import annotations

import functools
import time
from types import SimpleNamespace

import numpy as np
import pytest

from lime_planner.motion.controllers.command import Command, judge_jtc
from lime_planner.motion.controllers.joint_trajectory_controller import JtcLaw
from lime_planner.motion.timing import time_path
from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros.execution.motion import Motion
from lime_planner.ros.execution.stopping import make_stop
from lime_planner.ros.inputs.joint_states import ArmState, JointHistory
from lime_planner.ros.parameters import snapshot_from

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
VELOCITIES = np.deg2rad([36.0, 36.0, 36.0, 48.0, 48.0, 48.0])
ACCELERATIONS = np.full(6, 1.0)
ROBOT = SimpleNamespace(
    joint_names=NAMES, velocity_limits=VELOCITIES, acceleration_limits=ACCELERATIONS, lower=np.full(6, -np.inf), upper=np.full(6, np.inf)
)
STEP_S = 0.001
STOPS = 80
#: The stated braking distance of a joint: v² / 2a and a fifth more where the path bends, and what it goes on the way [s].
SHARE, LATE_S = 1.2, 0.06


@functools.cache
def plans() -> list[Trajectory]:
    """Random motions with corners."""
    rng = np.random.default_rng(0)
    scales = 10 ** rng.uniform(-0.8, 0.2, 24)
    paths = [np.cumsum(scale * rng.normal(size=(int(rng.integers(2, 6)), 6)), axis=0) for scale in scales]
    return [time_path(path, VELOCITIES, ACCELERATIONS, joint_names=NAMES) for path in paths]


def one_stop(
    rng: np.random.Generator, now: list[float], rate_hz: float, *, pace: float = 1.0, noise_rad: float = 0.0, beside_rad: float = 0.0
) -> dict[str, float]:
    """Stop a random motion at a random moment.

    States come late by 1 to 8 ms and are stamped, the stop comes 1 to 15 ms after it was sent; the controller is where it wants to be.
    """
    plan = plans()[int(rng.integers(len(plans())))]
    beside = beside_rad * rng.choice([-1.0, 1.0], 6)
    at_s = float(rng.uniform(0.05, plan.duration_s)) / pace
    began_s = now[0]
    motion = Motion(1, None, plan, began_s, snapshot_from({"controller": "jtc"}))
    history, state = JointHistory(), None
    for measured_s in np.arange(float(rng.uniform(0.0, 1.0 / rate_hz)) + max(0.0, at_s - 0.6), at_s, 1.0 / rate_hz):
        late_s = float(rng.uniform(0.001, 0.008))
        if measured_s + late_s > at_s:
            break
        now[0] = began_s + measured_s + late_s
        q = (
            plan.sample(pace * measured_s) + beside + rng.normal(scale=noise_rad, size=6)
            if noise_rad
            else plan.sample(pace * measured_s) + beside
        )
        state = history.add(ArmState(q, now[0], 100.0 + began_s + measured_s, late_s))
        motion.follow(state)
    now[0] = began_s + at_s
    stop = make_stop(ROBOT, motion, state, True, "jtc")
    assert stop is not None
    begins_s = at_s + float(rng.uniform(0.001, 0.015))
    q, v = plan.sample(pace * begins_s) + beside, pace * plan.sample_velocity(pace * begins_s)
    command = Command.from_trajectory(stop)
    assert judge_jtc(command, NAMES, q.tolist()).accepted
    law = JtcLaw(command, NAMES, q, v, np.zeros(6, dtype=bool))
    played = np.array([law.sample(t) for t in np.arange(0.0, law.duration_s + STEP_S, STEP_S)])
    speed = np.diff(np.concatenate([[q - v * STEP_S], played]), axis=0) / STEP_S
    acceleration = np.abs(np.diff(speed, axis=0)) / STEP_S
    later = plan.sample_velocity(pace * begins_s + np.linspace(0.0, 1.2, 121))
    forth = (later * np.sign(v) >= -1e-9).all(axis=0)  # joints that the plan itself does not turn round
    back = np.where(forth, np.maximum(-(speed * np.sign(v)), 0.0).sum(axis=0) * STEP_S, 0.0)
    ahead = np.abs(later).max(axis=0)
    ahead = np.maximum(np.abs(v), np.minimum(ahead * pace, VELOCITIES))
    time_s = float((ahead / ACCELERATIONS).max())
    stated = ahead * (LATE_S + 0.5 * SHARE * time_s) + 0.002
    now[0] += 10.0
    return {
        "acceleration": float((acceleration / ACCELERATIONS).max()),
        "back": float(back.max()),
        "distance": float((np.abs(played - q).max(axis=0) - stated).max()),
        "speed": float((np.abs(speed) / VELOCITIES).max()),
        "duration": law.duration_s,
    }


def stops(monkeypatch: pytest.MonkeyPatch, rate_hz: float, count: int = STOPS, **more: float) -> dict[str, np.ndarray]:
    rng, now = np.random.default_rng(int(rate_hz)), [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    found = [one_stop(rng, now, rate_hz, **more) for _ in range(count)]
    columns = {name: np.array([figures[name] for figures in found]) for name in found[0]}
    text = ", ".join(f"{name} {np.median(column):.4f} (most {column.max():.4f})" for name, column in columns.items())
    print(f"{rate_hz:g} Hz {more}: {text}")
    return columns


@pytest.mark.parametrize("rate_hz", [50.0, 250.0])
def test_a_stop_is_smooth_short_and_never_goes_back(monkeypatch: pytest.MonkeyPatch, rate_hz: float) -> None:
    found = stops(monkeypatch, rate_hz)
    assert found["acceleration"].max() <= 3.0
    assert found["back"].max() <= 2e-4
    assert found["distance"].max() <= 0.0
    assert found["speed"].max() <= 1.05


@pytest.mark.parametrize(
    ("more", "hardest"),
    [
        ({"pace": 0.5}, 2.0),
        ({"pace": 0.1}, 2.0),
        ({"beside_rad": 0.008}, 3.0),
        ({"noise_rad": 0.0005}, 3.0),
    ],
)
def test_slow_controllers_and_arms_beside_their_path_stop_as_smoothly(
    monkeypatch: pytest.MonkeyPatch, more: dict[str, float], hardest: float
) -> None:
    found = stops(monkeypatch, 50.0, 40, **more)
    assert found["acceleration"].max() <= hardest
    assert found["distance"].max() <= more.get("beside_rad", 0.0)
    # An arm beside its path comes part of the way back to it while it brakes.
    assert found["back"].max() <= max(2e-3, 0.5 * more.get("beside_rad", 0.0))
