"""What a plan is, once it is made or refused."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.atomic_files import write_json
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.parameters import PARAMETERS, Settings
from lime_planner.core.status import Status
from lime_planner.core.types import Array, Int64
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.goals import OUTCOMES
from lime_planner.pipeline.targets import Target
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

#: What is shown of a plan: name of the figure, words, unit, factor from the figure's unit, decimals.
ROWS: tuple[tuple[str, str, str, float, int], ...] = (
    ("planning_time_s", "planning time", "s", 1.0, 2),
    ("path_length_rad", "path length, joints", "rad", 1.0, 2),
    ("tool_path_length_m", "path length, tool", "m", 1.0, 3),
    ("leaf_contact_rad", "leaf contact, joints", "rad", 1.0, 2),
    ("tool_leaf_contact_m", "leaf contact, tool", "m", 1.0, 3),
    ("unseen_contact_rad", "in unseen space, joints", "rad", 1.0, 2),
    ("min_stem_clearance_m", "smallest clearance to stems", "mm", 1000.0, 1),
)

#: Of these, the one that says nothing where it is not known what was seen (`views` 0).
OF_VIEWS = "unseen_contact_rad"

#: The figures of a plan that are real numbers, NaN where there is no path.
NUMBERS = (
    "planning_time_s",
    "cost",
    "cost_error",
    "path_length_rad",
    "collision_cost",
    "leaf_contact_rad",
    "tool_path_length_m",
    "tool_leaf_contact_m",
    "min_stem_clearance_m",
    "unseen_contact_rad",
    "tool_unseen_m",
    "straight_approach_m",
    "goal_error_m",
    "goal_error_rad",
)


@dataclass(frozen=True, eq=False, repr=False)
class PlanResult:
    """The outcome of one plan. Figures about the path are NaN, arrays empty, where there is none.

    Attributes:
        status: what became of it.
        message: `CODE: sentence`.
        planner: which search.
        seed: of its random generator.
        iterations: configurations that it sampled.
        planning_time_s: wall time of the whole plan.
        cost: of the path, in the metric of the planner.
        cost_error: by how much `cost` may be off, because contact is not followed to its last hundredth of a milliradian.
        cost_metric: `integral` (length + weight · ∫ leaf ds) or `node` (the paper's).
        path_length_rad: length in joint space.
        collision_cost: the cost's part that leaves cause.
        n_collision_nodes: waypoints that touch leaves.
        leaf_contact_rad: length of the path in contact with leaves.
        tool_path_length_m: length of the tool's way.
        tool_leaf_contact_m: length of its part with leaf contact anywhere on the arm.
        min_stem_clearance_m: smallest distance between arm and stem points' surface along the path, points hidden by the exclusion
            sphere left out; 0.5 where it is more, or without any.
        views: from how many places the scene was seen, 0 where that is not known: then everything counts as seen.
        looks: how many looks were taken for it.
        unseen_contact_rad: length of the path in space that none of these views shows.
        tool_unseen_m: length of the tool's way with any part of the arm there.
        goal_error_m: distance of the tool at the end from the target.
        goal_error_rad: angle between the two.
        waypoints: (M, n) [rad].
        trajectory: the timed motion, None where the path was refused before.
        tool_path: (K, 7) poses x y z qx qy qz qw in the planning frame.
        tool_leaf: (K,) leaf intensity there.
        phases_s: wall time of the plan's parts.
        counts: numbers of points used, dropped, hidden, of goals, of checks.
        target: what was to be reached; None for a motion along given waypoints that leads from nowhere in particular.
        T_base_tool: the grasp, (4, 4): the pose that was asked for, or the one that was chosen; None where none was.
        straight_from: number of the waypoint from which the tool moves straight to the grasp.
        straight_approach_m: how far it does so.
        grasps_tried, grasps_free: approaches that were tried, and those seen to have a free grasp and a free stretch. An approach to a
            fruit that would be dearer than enough free ones is not looked at to its end, and not counted as free; of candidates all are.
        approaches: (A, 7) their poses; approach_outcomes: (A,) what became of each, see `pipeline.goals`.
        back: whether it is a motion that leads back from a target.
        q_start: (n,) configuration that was planned from [rad].
        parameters: what it was made with, but for the defaults (see `set_parameters`).
        warnings: sentences about what it was asked for that is hardly meant (see `lime_planner.pipeline.plausibility`).
    """

    status: Status
    message: str
    planner: str
    seed: int
    iterations: int = 0
    planning_time_s: float = 0.0
    cost: float = float("nan")
    cost_error: float = float("nan")
    cost_metric: str = "integral"
    path_length_rad: float = float("nan")
    collision_cost: float = float("nan")
    n_collision_nodes: int = 0
    leaf_contact_rad: float = float("nan")
    tool_path_length_m: float = float("nan")
    tool_leaf_contact_m: float = float("nan")
    min_stem_clearance_m: float = float("nan")
    views: int = 0
    looks: int = 0
    unseen_contact_rad: float = float("nan")
    tool_unseen_m: float = float("nan")
    goal_error_m: float = float("nan")
    goal_error_rad: float = float("nan")
    waypoints: Array = field(default_factory=lambda: np.zeros((0, 0)))
    trajectory: Trajectory | None = None
    tool_path: Array = field(default_factory=lambda: np.zeros((0, 7)))
    tool_leaf: Array = field(default_factory=lambda: np.zeros(0))
    phases_s: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    target: Target | None = None
    T_base_tool: Array | None = None
    straight_from: int = 0
    straight_approach_m: float = float("nan")
    grasps_tried: int = 0
    grasps_free: int = 0
    approaches: Array = field(default_factory=lambda: np.zeros((0, 7)))
    approach_outcomes: Int64 = field(default_factory=lambda: np.zeros(0, np.int64))
    back: bool = False
    q_start: Array | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def succeeded(self) -> bool:
        """Whether there is a certified, timed motion to the target."""
        return self.status is Status.SUCCEEDED

    def __bool__(self) -> bool:
        """Whether there is a motion."""
        return self.succeeded

    def __repr__(self) -> str:
        return f"<PlanResult {self.message}" + "".join(f"; warning: {sentence}" for sentence in self.warnings) + ">"

    def _repr_html_(self) -> str:
        """Return the figures that matter as a table, for notebooks."""
        rows = [("planner, seed", f"{self.planner}, {self.seed}")]
        shown = [row for row in ROWS if self.views or row[0] != OF_VIEWS]
        figures = [(words, unit, float(getattr(self, name)) * factor, decimals) for name, words, unit, factor, decimals in shown]
        if self.trajectory is not None:
            figures.append(("duration of the motion", "s", self.trajectory.duration_s, 2))
        rows += [(f"{words} [{unit}]", f"{value:.{decimals}f}") for words, unit, value, decimals in figures if np.isfinite(value)]
        cells = "".join(f"<tr><td>{html.escape(words)}</td><td>{html.escape(text)}</td></tr>" for words, text in rows)
        code, _, sentence = self.message.partition(": ")
        doubts = "".join(f"<p>warning: {html.escape(doubt)}</p>" for doubt in self.warnings)
        return f"<p><b>{html.escape(code)}</b>: {html.escape(sentence)}</p>{doubts}<table>{cells}</table>"

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        scene_path: str | os.PathLike[str] | None = None,
        robot_path: str | os.PathLike[str] | None = None,
    ) -> Path:
        """Write the file of `lime-planner plan --json`, for `lime-planner view` and `animate`; a reader never sees half of it.

        Args:
            path: the file, which holds `figures`, the target, the start and the parameters.
            scene_path: the scene's file, which a plan does not know; without it, `view` and `animate` must be told with `--scene`.
                A scene that is not as its file has it (moved, or with labels of its own) is saved with `Scene.save` first.
            robot_path: the URDF file of an arm that is not built in.

        Returns:
            The file's path.

        Raises:
            ParameterError: the file cannot be written.
        """
        values = {**self.figures(), **self.origin()}
        if scene_path is not None:
            values["scene"] = os.fspath(scene_path)
        if robot_path is not None:
            values["parameters"]["robot"] = os.fspath(robot_path)
        return write_json(path, values)

    def origin(self) -> dict[str, Any]:
        """What the plan was made from, as far as it knows, ready for JSON: target, start, parameters, approaches that were tried."""
        return {
            "target_pose": None if self.T_base_tool is None else matrix_to_pose(self.T_base_tool).tolist(),
            **({} if self.target is None else self.target.origin()),
            "start": None if self.q_start is None else np.asarray(self.q_start, dtype=np.float64).tolist(),
            "parameters": dict(self.parameters),
            "approaches": np.round(self.approaches, 4).tolist(),
            "approach_outcomes": [OUTCOMES[int(outcome)] for outcome in self.approach_outcomes],
        }

    def figures(self) -> dict[str, Any]:
        """Everything but the tool path as plain Python numbers, lists and dictionaries, ready for JSON; NaN becomes None."""
        values: dict[str, Any] = {"status": self.status.name, "message": self.message, "planner": self.planner, "seed": int(self.seed)}
        values["cost_metric"] = self.cost_metric
        values["warnings"] = list(self.warnings)
        values["target_kind"] = None if self.target is None else self.target.kind
        values["grasp"] = None if self.T_base_tool is None or not len(self.waypoints) else matrix_to_pose(self.T_base_tool).tolist()
        for name in ("iterations", "n_collision_nodes", "grasps_tried", "grasps_free", "straight_from", "views", "looks"):
            values[name] = int(getattr(self, name))
        for name in NUMBERS:
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


def set_parameters(settings: Settings, robot: Robot) -> dict[str, Any]:
    """Return the parameters that are not at their defaults, JSON-ready, with those of the arm that was really there.

    An arm that is not built in is there by its name only; where its description lies is for others to say.
    """
    values = {name: getattr(settings, name) for name in PARAMETERS}
    changed = {name: list(v) if isinstance(v, tuple) else v for name, v in values.items()}
    changed = {name: value for name, value in changed.items() if value != PARAMETERS[name].default}
    arm: dict[str, Any] = {
        "robot": robot.name,
        "arm_joints": list(robot.joint_names),
        "planning_frame": robot.planning_frame,
        "tool_frame": robot.tool_frame,
    }
    if robot.locked:
        arm["finger_positions"] = [f"{name}: {position!r}" for name, position in robot.locked]
    return {**changed, **arm}


@dataclass(frozen=True, eq=False)
class PlanRecord:
    """A finished plan with what it was made of.

    Attributes:
        number: tells plans apart; what Execute is confirmed for.
        scene, settings: as used.
        target: (7,) pose of the tool at the fruit, T_base_tool; None for a motion without one (a retreat).
        result: of any status.
    """

    number: int
    scene: Scene
    settings: Settings
    target: Array | None
    result: PlanResult

    @property
    def found(self) -> bool:
        """Whether there is a path to be shown."""
        return len(self.result.waypoints) > 1
