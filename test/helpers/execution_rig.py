"""An execution with everything around it played, for the tests of sending, watching and stopping."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from ros_fakes import START, FakeRobot, result

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.motion import stop as braking
from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros.execution.execution import Execution
from lime_planner.ros.execution.motion import Ended, Motion
from lime_planner.ros.execution.output import Verdict
from lime_planner.ros.inputs.joint_states import ArmState, JointHistory
from lime_planner.ros.parameters import Snapshot, snapshot_from

#: Waits for other threads, which live in real time.
real_sleep = time.sleep

QUICK = {"stillness_time_s": 0.06, "goal_time_s": 0.3, "stillness_timeout_s": 0.5, "progress_timeout_s": 3.0}


class PlayedOutput:
    """Keeps what would be sent, and how to tell what became of it."""

    def __init__(self) -> None:
        self.sent: list[Trajectory] = []
        self.listeners = 1
        self.tell: Callable[[Verdict], None] = lambda verdict: None

    def prepare(self, trajectory: Trajectory) -> Trajectory:
        return trajectory

    def trouble(self, controller: str) -> str:
        return "" if self.listeners else "joint_trajectory has no subscriber"

    def send(self, message: Trajectory, controller: str, on_verdict: Callable[[Verdict], None]) -> None:
        self.sent.append(message)
        self.tell = on_verdict

    def stop(self, message: Trajectory | None, controller: str) -> None:
        if message is not None:
            self.sent.append(message)


class Rig:
    """An execution with everything around it played; it is the execution's node itself."""

    def __init__(self) -> None:
        self.joints = JointHistory()
        self.output = PlayedOutput()
        self.sent = self.output.sent
        self.ended: list[Ended] = []
        self.stopped: list[Motion] = []
        self.allowed = True
        self.simulated: Callable[[], float | None] = lambda: None
        self.robot = FakeRobot
        self.on_stop = self.stopped.append
        self.on_end = self.ended.append
        self.execution = Execution(self.joints, self.output, self)  # type: ignore[arg-type]

    def may_move(self) -> bool:
        return self.allowed

    def simulated_s(self) -> float | None:
        return self.simulated()

    def state(self, q: np.ndarray) -> None:
        state = self.joints.add(ArmState(np.array(q, dtype=float), time.monotonic(), 0.0, 0.0))
        self.execution.on_state(state)
        self.execution.tick()

    def rest(self, q: np.ndarray, duration_s: float = 0.08) -> None:
        self.play(lambda t: q, duration_s)

    def play(self, q_of: Callable[[float], np.ndarray], duration_s: float) -> None:
        began = time.monotonic()
        while time.monotonic() - began < duration_s:
            self.state(q_of(time.monotonic() - began))
            time.sleep(0.005)

    def send(self, duration_s: float = 0.3, commit: Callable[[], bool] = lambda: True, **settings: object) -> Motion | None:
        plan = result(START, START + 0.2, duration_s)
        return self.execution.send(7, plan, plan.trajectory, snapshot(**settings), commit)


def snapshot(**settings: object) -> Snapshot:
    return snapshot_from({**QUICK, **settings})


def refusal_of(call: Callable[[], object]) -> tuple[Status, str]:
    with pytest.raises(Refusal) as caught:
        call()
    return caught.value.status, str(caught.value)


@pytest.fixture(name="rig")
def rested(monkeypatch: pytest.MonkeyPatch) -> Rig:
    """A rig at rest, in a time of its own that goes on when something sleeps: whatever the machine does, the test is the same."""
    braking.warm_up()  # as a node does: the first stop loads its kernels otherwise
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda duration_s: now.__setitem__(0, now[0] + duration_s))
    made = Rig()
    made.rest(START)
    return made
