"""Removes the arm from live clouds, where it stood when the cloud was taken."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import numpy.typing as npt

from lime_planner.robot.model import Robot
from lime_planner.robot.surface import ArmSurface
from lime_planner.ros.scene_source import ArmFilter
from lime_planner.scene.clean import remove_arm
from lime_planner.scene.scene import Scene


def make_arm_filter(robot: Robot) -> ArmFilter:
    """Return the filter for one arm; its meshes are prepared with the first cloud."""
    surfaces: list[ArmSurface] = []

    def remove(scene: Scene, q: npt.NDArray[np.float64] | None, padding_m: float) -> Scene:
        if q is None:
            # Taken before the first joint state: where the arm was is unknown. Its points stay, as obstacles.
            return dataclasses.replace(scene, counts={**scene.counts, "arm_not_removed": scene.n_points})
        if not surfaces:
            surfaces.append(ArmSurface(robot))
        return remove_arm(scene, partial(surfaces[0].distance, q=q), padding_m)

    return remove
