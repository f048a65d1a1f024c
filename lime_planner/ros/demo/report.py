"""What the demo shows at its end: a table, a picture, and whether the arm is where it should be, by its own joint states."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.parameters import settings_from
from lime_planner.core.status import Status
from lime_planner.output.console import headline, print_plans, write_json

if TYPE_CHECKING:
    from lime_planner.core.types import Array
    from lime_planner.robot.model import Robot
    from lime_planner.scene.scene import Scene


#: Heading and figures of each plan that was made for comparison.
Columns = list[tuple[str, Mapping[str, Any]]]

GOAL_ERROR_M = 0.005  #: the demo fails above this
GOAL_ERROR_RAD = 0.05
MOTION_TIMEOUT_S = 90.0  #: no motion takes longer
_PICTURE_STATES = 160


@dataclass(frozen=True)
class Driven:
    """What became of the request.

    Attributes:
        success: whether `~/plan` sent a motion.
        message: its answer.
        figures: the plan's figures and how the motion ended, from the status topic.
        states: (S, n) configurations measured from the request on [rad].
    """

    success: bool
    message: str
    figures: Mapping[str, Any]
    states: Array


def report(args: argparse.Namespace, robot: Robot, scene: Scene, driven: Driven, comparisons: Columns) -> Path:
    """Write figures and picture, print the table; return the picture's file."""
    figures = _numbers(driven)
    error_m, error_rad = _goal_error(robot, scene, driven)
    picture = _picture(args, robot, scene, driven, figures)
    write_json(args.out / "demo.json", {"driven": figures, **{heading.replace(" ", "_"): dict(column) for heading, column in comparisons}})
    measured = driven.success
    known = ["all known"] * len(comparisons)
    extra = [
        *([("looks", [f"{float(figures['looks']):.0f}", *known])] if figures.get("looks") else []),
        ("motion", [str(figures.get("execution_code", "–")), *["not driven"] * len(comparisons)]),
        ("goal error, measured [mm]", [f"{1000.0 * error_m:.3f}" if measured else "–", *["–"] * len(comparisons)]),
        ("goal error, measured [mrad]", [f"{1000.0 * error_rad:.3f}" if measured else "–", *["–"] * len(comparisons)]),
    ]
    print()
    driven_as = "free approach" if figures.get("target_kind") == "fruit" else "leaves cost"
    where = args.scene.name if args.scene else "a generated lime plant"
    print_plans(
        f"Reach to a target in {where}",
        [(driven_as, figures), *comparisons],
        extra,
    )
    print()
    return picture


def reached_for(scene: Scene, figures: Mapping[str, Any]) -> Array | None:
    """Return the grasp (7,) that the planner chose, as its status says, else the scene's own; None without either."""
    import numpy as np

    chosen = figures.get("grasp")
    return np.array(json.loads(chosen)) if chosen else scene.target_pose


def verdict(robot: Robot, scene: Scene, driven: Driven) -> int:
    """Print how it ended and return the exit status: 0 only if the arm is at the target."""
    error_m, error_rad = _goal_error(robot, scene, driven)
    trouble = _trouble(driven, _numbers(driven), error_m, error_rad)
    if trouble:
        print(trouble, file=sys.stderr)
        return 1
    print(Status.SUCCEEDED.message(f"the arm reached the target to {1000.0 * error_m:.3f} mm and {1000.0 * error_rad:.3f} mrad"))
    return 0


def _trouble(driven: Driven, figures: Mapping[str, Any], error_m: float, error_rad: float) -> str:
    """Say what went wrong, as `CODE: sentence`; empty when the arm is at the target."""
    if not driven.success:
        return driven.message
    code = str(figures.get("execution_code") or "")
    if code != Status.SUCCEEDED.name:
        unended = Status.EXECUTION_DEVIATED.message(f"the motion did not end within {MOTION_TIMEOUT_S:g} s")
        return str(figures.get("execution_message") or unended)
    if error_m > GOAL_ERROR_M or error_rad > GOAL_ERROR_RAD:
        sentence = f"the arm ended {1000.0 * error_m:.1f} mm and {error_rad:.3f} rad from the target"
        return Status.EXECUTION_DEVIATED.message(f"{sentence}; {1000.0 * GOAL_ERROR_M:g} mm and {GOAL_ERROR_RAD:g} rad are allowed")
    return ""


def _numbers(driven: Driven) -> dict[str, Any]:
    """Return the status topic's pairs with numbers as numbers, and the outcome under `status`."""
    figures: dict[str, Any] = {}
    for key, value in driven.figures.items():
        try:
            figures[key] = float(value)
        except ValueError:
            figures[key] = value or None
    figures["status"] = figures.get("code") or driven.message.partition(":")[0]
    return figures


def _goal_error(robot: Robot, scene: Scene, driven: Driven) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between the target and the tool at the last joint state."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from lime_planner.core.geometry import pose_to_matrix

    grasp = reached_for(scene, driven.figures)
    if not len(driven.states) or grasp is None:
        return float("inf"), float("inf")
    T_base_target, T_base_tool = pose_to_matrix(grasp), robot.forward(driven.states[-1])
    turn = Rotation.from_matrix(T_base_target[:3, :3].T @ T_base_tool[:3, :3])
    return float(np.linalg.norm(T_base_tool[:3, 3] - T_base_target[:3, 3])), float(turn.magnitude())


def _picture(args: argparse.Namespace, robot: Robot, scene: Scene, driven: Driven, figures: Mapping[str, Any]) -> Path:
    """Draw plant, arm and the path that the tool really took, by the joint states, coloured by the meshes' own leaf contact."""
    import numpy as np

    from lime_planner.collision.exact import ExactChecker
    from lime_planner.output.picture import draw_picture
    from lime_planner.robot.model import home

    states = driven.states if len(driven.states) else home(robot)[None]
    moved = len(states) > 1 and driven.success
    code, _, sentence = ("", "", "") if moved else driven.message.partition(" [")[0].partition(": ")
    options: dict[str, Any] = {}
    if moved:
        shown = states[np.unique(np.linspace(0, len(states) - 1, _PICTURE_STATES).round().astype(int))]
        settings = settings_from({})
        checker = ExactChecker(
            robot,
            scene.impermeable_points(None, 0.0),
            point_radius_m=settings.stem_point_radius_m,
            leaf_points=scene.leaf_points,
            leaf_point_radius_m=settings.leaf_point_radius_m,
        )
        options = {
            "q_goal": states[-1],
            "tool_path": np.array([robot.forward(q)[:3, 3] for q in shown]),
            "tool_leaf": np.array([float(checker.leaf_contact(q)) for q in shown]),
        }
    options |= {
        "q_start": states[0],
        "target_pose": reached_for(scene, driven.figures),
        "title": code or headline(figures),
        "sentence": sentence,
    }
    return draw_picture(args.out / "demo.png", scene, robot, **options)
