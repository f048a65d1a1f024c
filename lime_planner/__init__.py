"""Plan the reach of a harvesting arm to a fruit inside a plant: around its stems and through as few leaves as it must.

    import lime_planner as lp

    robot = lp.load_robot("kinova_j2s6s200")
    scene = lp.load_scene("plant.npz")
    result = lp.Pipeline(robot).plan(scene, lp.pose_to_matrix(scene.target_pose), lp.home(robot), lp.settings_from({"seed": 1}))
    print(result.status, result.message)

The names here are loaded when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lime_planner.parameters import Settings, settings_from
    from lime_planner.pipeline import Pipeline, PlanResult
    from lime_planner.poses import matrix_to_pose, pose_to_matrix
    from lime_planner.robot.model import Robot, home, load_robot
    from lime_planner.scene.files import load_scene, save_scene
    from lime_planner.scene.plant import generate_plant
    from lime_planner.scene.scene import Scene
    from lime_planner.status import Status

__version__ = "0.1.0"

__all__ = [
    "Pipeline",
    "PlanResult",
    "Robot",
    "Scene",
    "Settings",
    "Status",
    "generate_plant",
    "home",
    "load_robot",
    "load_scene",
    "matrix_to_pose",
    "pose_to_matrix",
    "save_scene",
    "settings_from",
]

_MODULES = {
    "lime_planner.parameters": ("Settings", "settings_from"),
    "lime_planner.pipeline": ("Pipeline", "PlanResult"),
    "lime_planner.poses": ("matrix_to_pose", "pose_to_matrix"),
    "lime_planner.robot.model": ("Robot", "home", "load_robot"),
    "lime_planner.scene.files": ("load_scene", "save_scene"),
    "lime_planner.scene.plant": ("generate_plant",),
    "lime_planner.scene.scene": ("Scene",),
    "lime_planner.status": ("Status",),
}
_HOME_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name from the module that defines it."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'lime_planner' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted([*globals(), *__all__])
