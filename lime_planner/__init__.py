"""Plan the reach of a harvesting arm to a fruit inside a plant: around its stems and through as few leaves as it must.

    from lime_planner import Robot, Scene, draw, plan

    result = plan("plant.npz", "kinova_j2s6s200", seed=1)
    print(result.message)

The same with the parts at hand:

    robot = Robot.load("kinova_j2s6s200")
    scene = Scene.load("plant.npz")
    result = plan(scene, robot, seed=1)
    result.save("plan.json", scene_path="plant.npz")
    draw(result, scene, robot, "plan.png")

The names here are loaded when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lime_planner.api import draw, plan
    from lime_planner.core.errors import LimePlannerError, PlausibilityWarning
    from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
    from lime_planner.core.parameters import Settings, settings_from
    from lime_planner.core.status import Status
    from lime_planner.pipeline import Pipeline, PlanResult
    from lime_planner.robot.model import Robot
    from lime_planner.scene.plants.generator import PlantOptions, generate_plant
    from lime_planner.scene.plants.grasp_targets import grasp_pose
    from lime_planner.scene.scene import Scene

__version__ = "0.2.0"

__all__ = [
    "LimePlannerError",
    "Pipeline",
    "PlanResult",
    "PlantOptions",
    "PlausibilityWarning",
    "Robot",
    "Scene",
    "Settings",
    "Status",
    "draw",
    "generate_plant",
    "grasp_pose",
    "matrix_to_pose",
    "plan",
    "pose_to_matrix",
    "settings_from",
]

_MODULES = {
    "lime_planner.api": ("draw", "plan"),
    "lime_planner.core.errors": ("LimePlannerError", "PlausibilityWarning"),
    "lime_planner.core.parameters": ("Settings", "settings_from"),
    "lime_planner.pipeline": ("Pipeline", "PlanResult"),
    "lime_planner.core.geometry": ("matrix_to_pose", "pose_to_matrix"),
    "lime_planner.robot.model": ("Robot",),
    "lime_planner.scene.plants.generator": ("PlantOptions", "generate_plant"),
    "lime_planner.scene.scene": ("Scene",),
    "lime_planner.scene.plants.grasp_targets": ("grasp_pose",),
    "lime_planner.core.status": ("Status",),
}
_HOME_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name from the module that defines it."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'lime_planner' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    """List the public names alone."""
    return sorted([*__all__, "__version__"])
