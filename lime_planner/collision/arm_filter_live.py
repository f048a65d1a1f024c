"""Makes a live cloud fit to plan with: cropped and thinned, and without the arm where it stood when the cloud was taken."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np

from lime_planner.collision.arm_filter import ArmSurface
from lime_planner.core.types import Array
from lime_planner.robot.model import Robot
from lime_planner.scene.clean import clean_scene, remove_arm
from lime_planner.scene.from_clouds import ArmFilter
from lime_planner.scene.scene import Scene

_BEYOND_REACH_M = 0.1  #: what the arm's surface and the margins may reach beyond its reach
_SLACK_M = 0.001


def make_arm_filter(robot: Robot) -> ArmFilter:
    """Return the filter for one arm."""
    surface = ArmSurface(robot)

    def remove(scene: Scene, q: Array | None, padding_m: float, /, *, base_position: Array | None = None) -> Scene:
        centre = np.zeros(3) if base_position is None else base_position
        scene = clean_scene(scene, reach_m=robot.reach_m + _BEYOND_REACH_M, base_position=centre)
        if q is None:
            # Taken before the first joint state: where the arm was is unknown. Its points stay, as obstacles.
            return dataclasses.replace(scene, counts={**scene.counts, "arm_not_removed": scene.n_points})
        return remove_arm(scene, partial(surface.distance, q=q, within_m=padding_m + _SLACK_M), padding_m)

    return remove
