"""Saved plans: what `lime-planner plan --json` writes, read back with the scene that it was made in."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.errors import ParameterError
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.result import NUMBERS, PlanResult
from lime_planner.poses import pose_to_matrix
from lime_planner.robot.model import Robot
from lime_planner.scene.files import load_scene
from lime_planner.scene.scene import Scene
from lime_planner.status import Status

Array = npt.NDArray[np.float64]


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
        """The target (7,), or None."""
        pose = self.figures.get("target_pose")
        return None if pose is None else np.asarray(pose, dtype=np.float64)

    @property
    def q_start(self) -> Array | None:
        """Where the plan begins (n,) [rad], None for a plan without a path."""
        waypoints = self.figures["waypoints"]
        return np.asarray(waypoints[0], dtype=np.float64) if waypoints else None

    def load_scene(self) -> Scene:
        """Load the scene, looked for where it was, and beside the plan.

        Raises:
            SceneError: it cannot be read.
            ParameterError: the plan does not name it.
        """
        name, placement = self.figures.get("scene"), self.figures.get("placement") or {}
        if not isinstance(name, str):
            raise ParameterError(
                f"{self.path}: does not name its scene; make it anew with `lime-planner plan SCENE --json {self.path.name}`"
            )
        places = [Path(name), self.path.parent / name, self.path.parent / Path(name).name]
        place = next((place for place in places if place.is_file()), places[0])
        options = {key: value for key, value in placement.items() if key != "fruit_labels"}
        if "fruit_labels" in placement:
            options["fruit_label"] = placement["fruit_labels"][0] if placement["fruit_labels"] else None
        return load_scene(place, default_frame="", **options)

    def result(self, robot: Robot) -> PlanResult:
        """Return the plan as it was made.

        Raises:
            ParameterError: it was made for another arm.
        """
        figures = self.figures
        waypoints = np.asarray(figures["waypoints"], dtype=np.float64).reshape(len(figures["waypoints"]), -1)
        if len(waypoints) and waypoints.shape[1] != robot.n:
            raise ParameterError(f"{self.path}: was made for an arm of {waypoints.shape[1]} joints; {robot.name} has {robot.n}")
        numbers: dict[str, Any] = {name: float("nan") if figures.get(name) is None else float(figures[name]) for name in NUMBERS}
        timed = figures.get("trajectory")
        trajectory = None
        if timed is not None:
            trajectory = Trajectory(
                tuple(timed["joint_names"]), timed["dt_s"], np.asarray(timed["positions"]), np.asarray(timed["velocities"])
            )
        return PlanResult(
            Status[figures["status"]],
            figures["message"],
            figures["planner"],
            int(figures["seed"]),
            iterations=int(figures.get("iterations", 0)),
            waypoints=waypoints,
            trajectory=trajectory,
            T_base_tool=None if self.target is None else pose_to_matrix(self.target),
            **numbers,
        )


def read_plan(path: Path) -> SavedPlan:
    """Read a plan file.

    Raises:
        ParameterError: it cannot be read, or is no plan.
    """
    try:
        figures = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read as a plan ({getattr(error, 'strerror', None) or error})") from None
    needed = ("status", "message", "planner", "seed", "waypoints")
    missing = [name for name in needed if not isinstance(figures, dict) or name not in figures]
    if missing:
        raise ParameterError(f"{path}: is no plan of `lime-planner plan --json`; it lacks {', '.join(missing)}")
    if figures["status"] not in Status.__members__:
        raise ParameterError(f"{path}: has the unknown status {figures['status']!r}")
    return SavedPlan(path, figures)
