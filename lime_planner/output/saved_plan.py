"""Saved plans: what `lime-planner plan --json` and `PlanResult.save` write, read back with the scene that it was made in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.errors import LimePlannerError, ParameterError
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.core.validation import TextFileError, read_json
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.goals import OUTCOMES
from lime_planner.pipeline.result import NUMBERS, PlanResult
from lime_planner.pipeline.targets import Target, target_from
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class SavedPlan:
    """A plan file.

    Attributes:
        path: the file.
        figures: its content.
    """

    path: Path
    figures: dict[str, Any]

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that the plan was made with, but for the defaults."""
        return dict(self.figures.get("parameters") or {})

    @property
    def target(self) -> Array | None:
        """The grasp (7,): the target pose, or the one that was chosen; None where there is none."""
        pose = self.figures.get("target_pose")
        return None if pose is None else np.asarray(pose, dtype=np.float64)

    @property
    def asked(self) -> Target | None:
        """What was to be reached, None where the plan does not say.

        Raises:
            ParameterError: what it says is no target.
        """
        try:
            return target_from(self.figures)
        except (LimePlannerError, KeyError) as error:
            raise ParameterError(f"{self.path}: its target cannot be read ({error})") from None

    @property
    def q_start(self) -> Array | None:
        """Where the plan begins (n,) [rad], None for a plan without a path that does not say."""
        waypoints = self.figures["waypoints"]
        start = waypoints[0] if waypoints else self.figures.get("start")
        return None if start is None else np.asarray(start, dtype=np.float64)

    def load_scene(self, path: Path | None = None) -> Scene:
        """Load the scene, looked for where it was, and beside the plan.

        Args:
            path: where it is, for a plan that does not know; it is placed as the plan says.

        Raises:
            SceneError: it cannot be read.
            ParameterError: the plan does not name it, or it is not there any more.
        """
        placement = self.figures.get("placement") or {}
        place = self._scene_file() if path is None else path
        return Scene.load(place, **placement)

    def _scene_file(self) -> Path:
        name = self.figures.get("scene")
        if not isinstance(name, str):
            raise ParameterError(
                f"{self.path}: does not name its scene; give it with --scene SCENE (in Python: result.save(path, scene_path=...) names it)"
            )
        places = [Path(name), self.path.parent / name, self.path.parent / Path(name).name]
        place = next((place for place in places if place.exists()), None)
        if place is None:
            raise ParameterError(f"{self.path}: its scene {name} is not there; say where it is with --scene SCENE")
        return place

    def result(self, robot: Robot) -> PlanResult:
        """Return the plan as it was made.

        Raises:
            ParameterError: it was made for another arm.
        """
        figures = self.figures
        waypoints = np.asarray(figures["waypoints"], dtype=np.float64)
        waypoints = waypoints.reshape(len(waypoints), -1 if len(waypoints) else robot.n)  # refused plans are shown too
        if len(waypoints) and waypoints.shape[1] != robot.n:
            raise ParameterError(f"{self.path}: was made for an arm of {waypoints.shape[1]} joints; {robot.name} has {robot.n}")
        numbers: dict[str, Any] = {name: float("nan") if figures.get(name) is None else float(figures[name]) for name in NUMBERS}
        timed = figures.get("trajectory")
        trajectory = None
        if timed is not None:
            trajectory = Trajectory(
                tuple(timed["joint_names"]), timed["dt_s"], np.asarray(timed["positions"]), np.asarray(timed["velocities"])
            )
        try:  # a file of before has none
            approaches = np.asarray(figures.get("approaches") or [], dtype=np.float64).reshape(-1, 7)
            outcomes = np.array([OUTCOMES.index(word) for word in figures.get("approach_outcomes") or []], dtype=np.int64)
        except (TypeError, ValueError) as error:
            raise ParameterError(f"{self.path}: its approaches cannot be read ({error})") from None
        if len(approaches) != len(outcomes):
            raise ParameterError(f"{self.path}: has {len(approaches)} approaches and says of {len(outcomes)} what became of them")
        return PlanResult(
            Status[figures["status"]],
            figures["message"],
            figures["planner"],
            int(figures["seed"]),
            iterations=int(figures.get("iterations", 0)),
            waypoints=waypoints,
            trajectory=trajectory,
            target=self.asked,
            T_base_tool=None if self.target is None else pose_to_matrix(self.target),
            grasps_tried=int(figures.get("grasps_tried") or 0),
            grasps_free=int(figures.get("grasps_free") or 0),
            straight_from=int(figures.get("straight_from") or 0),
            approaches=approaches,
            approach_outcomes=outcomes,
            q_start=self.q_start,
            parameters=self.parameters,
            warnings=tuple(figures.get("warnings", ())),
            **numbers,
        )


def read_plan(path: Path) -> SavedPlan:
    """Read a plan file.

    Raises:
        ParameterError: it cannot be read, or is no plan.
    """
    try:
        figures = read_json(path)
    except TextFileError as error:
        raise ParameterError(f"{path}: cannot be read as a plan ({error})") from None
    needed = ("status", "message", "planner", "seed", "waypoints")
    missing = [name for name in needed if not isinstance(figures, dict) or name not in figures]
    if missing:
        raise ParameterError(f"{path}: is no plan of `lime-planner plan --json`; it lacks {', '.join(missing)}")
    if figures["status"] not in Status.__members__:
        raise ParameterError(f"{path}: has the unknown status {figures['status']!r}")
    return SavedPlan(path, figures)
