"""A motion that was sent, and how it ended."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from lime_planner.core.geometry import whole_turns
from lime_planner.core.status import Status
from lime_planner.core.types import Array, Bool
from lime_planner.motion.progress import Follower
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.result import PlanResult
from lime_planner.ros.inputs.joint_states import ArmState
from lime_planner.ros.inputs.latest import Target
from lime_planner.ros.parameters import Snapshot

#: A simulation may be this many times slower than the real time.
_SLOWEST_CLOCK = 10.0
#: A motion whose joints all stay within this has no length [rad]: less than what an arm at rest is measured to.
_NO_MOTION_RAD = 5e-4


@dataclass(frozen=True)
class Motion:
    """A motion that was sent.

    Attributes:
        plan_id: the request it belongs to.
        result: the plan, as the pipeline returned it.
        trajectory: what was sent.
        started_s: monotonic time of sending.
        snapshot: the parameters of the plan.
        T_base_tool: the target it leads to, or on a retreat away from, (4, 4).
        replans_left: how often it may be planned again if it is aborted.
        target: the target of its request, as it came in.
        look: whether its request goes on from its end: it leads to a view, or back out.
        simulated: a simulation's time now [s], by which its controller goes; None without one.
        simulated_start_s: that time at sending.
        follower: how far the arm has come, by what was measured.
    """

    plan_id: int
    result: PlanResult
    trajectory: Trajectory
    started_s: float
    snapshot: Snapshot
    T_base_tool: Array | None = None
    replans_left: int = 0
    target: Target | None = None
    look: bool = False
    simulated: Callable[[], float | None] = lambda: None
    simulated_start_s: float | None = None
    follower: Follower = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Begin to follow the motion."""
        object.__setattr__(self, "follower", Follower(self.trajectory))

    def elapsed_s(self) -> float:
        """Time since sending [s]."""
        return time.monotonic() - self.started_s

    def clocks_s(self) -> tuple[float, ...]:
        """Return how long the motion runs [s], by each clock that the controller may go by: real time, and simulated time that runs."""
        elapsed_s, now_s = self.elapsed_s(), self.simulated()
        simulated_s = 0.0 if now_s is None or self.simulated_start_s is None else now_s - self.simulated_start_s
        # A simulation's clock may stand still or be set back.
        return (elapsed_s,) if simulated_s <= 0.0 else (elapsed_s, simulated_s)

    def follow(self, state: ArmState) -> None:
        """Take in a measurement: how far on its path the arm is, and how far off it (`follower`)."""
        if state is self.follower.seen:
            return
        self.follower.seen = state
        since_s = time.monotonic() - state.arrival_s
        self.follower.update(state.q, [clock_s - since_s for clock_s in self.clocks_s()], state.latency_s)

    def waited_s(self) -> float:
        """Return how long the arm has not come on along its path [s]: by the slowest clock, one that stands still not counted."""
        waits = [now_s - then_s for now_s, then_s in zip(self.clocks_s(), self.follower.progressed_s, strict=False)]
        return max(min(waits), waits[0] / _SLOWEST_CLOCK)


@dataclass(frozen=True)
class Ended:
    """How a motion ended.

    Attributes:
        motion, status, sentence: which one, how, and why.
        cancels: `Execution.cancels` at that moment.
    """

    motion: Motion
    status: Status
    sentence: str
    cancels: int = 0


def on_turns_of(result: PlanResult, q: Array, continuous: Bool) -> PlanResult:
    """Return a plan shifted by whole turns next to where the arm is, (n,) [rad]: its driver may report other turns by now."""
    if result.trajectory is None:
        return result
    turns = whole_turns(q - result.trajectory.positions[0], continuous)
    if not turns.any():
        return result
    trajectory = replace(result.trajectory, positions=result.trajectory.positions + turns)
    return replace(result, waypoints=result.waypoints + turns, trajectory=trajectory)


def moves(trajectory: Trajectory) -> bool:
    """Tell whether a motion goes anywhere: an arm that rests at its goal is not sent one."""
    return float(np.abs(trajectory.positions - trajectory.positions[0]).max()) > _NO_MOTION_RAD
