"""What a plan is, once it is made or refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.motion.trajectory import Trajectory
from lime_planner.status import Status

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlanResult:
    """The outcome of one plan. Figures about the path are NaN, arrays empty, where there is none.

    Attributes:
        status: what became of it; message: `CODE: sentence`.
        planner, seed, iterations: which search, with which seed, and the configurations that it sampled.
        planning_time_s: wall time of the whole plan; phases_s: of its parts.
        cost: of the path, in the metric of the planner: `integral` (length + weight · ∫ leaf ds) or `node` (the paper's).
        path_length_rad: length in joint space; collision_cost: the cost's part that leaves cause.
        n_collision_nodes: waypoints that touch leaves; leaf_contact_rad: length of the path in contact with leaves.
        tool_path_length_m, tool_leaf_contact_m: length of the tool's way, and of its part with leaf contact anywhere on the arm.
        min_stem_clearance_m: smallest distance between arm and stem points' surface along the path, points hidden by the exclusion
            sphere left out; exact up to 2.5 cm, beyond that a lower bound, 0.5 without anything in reach.
        goal_error_m, goal_error_rad: tool pose at the end against the target.
        waypoints: (M, n) [rad]; trajectory: the timed motion, None where the path was refused before.
        tool_path: (K, 7) poses x y z qx qy qz qw in the planning frame; tool_leaf: (K,) leaf intensity there.
        counts: numbers of points used, dropped, hidden, of goals, of checks.
        T_base_tool: the target, (4, 4).
    """

    status: Status
    message: str
    planner: str
    seed: int
    iterations: int = 0
    planning_time_s: float = 0.0
    cost: float = float("nan")
    cost_metric: str = "integral"
    path_length_rad: float = float("nan")
    collision_cost: float = float("nan")
    n_collision_nodes: int = 0
    leaf_contact_rad: float = float("nan")
    tool_path_length_m: float = float("nan")
    tool_leaf_contact_m: float = float("nan")
    min_stem_clearance_m: float = float("nan")
    goal_error_m: float = float("nan")
    goal_error_rad: float = float("nan")
    waypoints: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    trajectory: Trajectory | None = None
    tool_path: Array = field(default_factory=lambda: np.zeros((0, 7)), repr=False)
    tool_leaf: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    phases_s: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    T_base_tool: Array | None = field(default=None, repr=False)

    def figures(self) -> dict[str, Any]:
        """Everything but the tool path as plain Python numbers, lists and dictionaries, ready for JSON; NaN becomes None."""
        values: dict[str, Any] = {"status": self.status.name, "message": self.message, "planner": self.planner, "seed": int(self.seed)}
        values["cost_metric"] = self.cost_metric
        for name in ("iterations", "n_collision_nodes"):
            values[name] = int(getattr(self, name))
        for name in (
            "planning_time_s",
            "cost",
            "path_length_rad",
            "collision_cost",
            "leaf_contact_rad",
            "tool_path_length_m",
            "tool_leaf_contact_m",
            "min_stem_clearance_m",
            "goal_error_m",
            "goal_error_rad",
        ):
            value = float(getattr(self, name))
            values[name] = value if np.isfinite(value) else None
        values["waypoints"] = self.waypoints.tolist()
        values["phases_s"] = {k: float(v) for k, v in self.phases_s.items()}
        values["counts"] = {k: int(v) for k, v in self.counts.items()}
        values["trajectory"] = None
        if self.trajectory is not None:
            values["trajectory"] = {
                "joint_names": list(self.trajectory.joint_names),
                "dt_s": float(self.trajectory.dt_s),
                "positions": self.trajectory.positions.tolist(),
                "velocities": self.trajectory.velocities.tolist(),
            }
        return values
