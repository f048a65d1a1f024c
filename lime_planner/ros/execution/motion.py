"""A motion that was sent, and how it ended."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.motion.progress import best_fit
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.result import PlanResult
from lime_planner.ros.inputs.joint_states import ArmState
from lime_planner.ros.inputs.latest import Target
from lime_planner.ros.parameters import Snapshot


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
        retreat: whether it leads back along an earlier one.
        replans_left: how often it may be planned again if it is aborted.
        target: the target of its request, as it came in.
        simulated: a simulation's time now [s], by which its controller goes; None without one.
        simulated_start_s: that time at sending.
    """

    plan_id: int
    result: PlanResult
    trajectory: Trajectory
    started_s: float
    snapshot: Snapshot
    T_base_tool: Array | None = None
    retreat: bool = False
    replans_left: int = 0
    target: Target | None = None
    simulated: Callable[[], float | None] = lambda: None
    simulated_start_s: float | None = None

    def elapsed_s(self) -> float:
        """Time since sending [s]."""
        return time.monotonic() - self.started_s

    def span_s(self) -> tuple[float, float]:
        """Return how far the controller should be [s], least and most: by real or by simulated time, whichever it goes by."""
        elapsed_s, now_s = self.elapsed_s(), self.simulated()
        simulated_s = 0.0 if now_s is None or self.simulated_start_s is None else now_s - self.simulated_start_s
        if simulated_s <= 0.0:  # no simulation, or one whose clock stands still or was set back
            return elapsed_s, elapsed_s
        return min(elapsed_s, simulated_s), max(elapsed_s, simulated_s)

    def fit(self, state: ArmState) -> tuple[float, Array]:
        """Compare a measurement with the plan: the moment that it fits best [s], and how far off each joint is, (n,) [rad]."""
        since_s = time.monotonic() - state.arrival_s
        least_s, most_s = self.span_s()
        return best_fit(self.trajectory, state.q, least_s - since_s - self.snapshot.node.execution_lag_s, most_s - since_s)


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
