"""The plants of the lime experiment: those on which the hidden lime can be grasped, and only through leaves.

See docs/paper-lime-choices.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lime_planner.core.errors import SceneError
from lime_planner.experiments.grasps import free_solutions, plant_spec, rng_of
from lime_planner.experiments.problems import SceneSpec, pipeline_of, scene_of
from lime_planner.experiments.swept_leaves import LeafTruth

DENSITY = "dense"
_MOST_SEEDS = 1000


@dataclass(frozen=True)
class LimeScene:
    """A plant that qualifies.

    Attributes:
        seed: of the plant.
        pose: (7,) grasp of the hidden lime [m, quaternion].
        goals: configurations (n,) that hold it and touch no stem, nearest to the start first [rad].
        leaves: how many leaves the arm cuts at each of them.
    """

    seed: int
    pose: tuple[float, ...]
    goals: tuple[tuple[float, ...], ...]
    leaves: tuple[int, ...]

    @property
    def spec(self) -> SceneSpec:
        """Where the plant comes from."""
        return plant_spec(DENSITY, self.seed)


def examine(seed: int, robot: str) -> LimeScene | None:
    """Return the plant of a seed if it qualifies."""
    spec = plant_spec(DENSITY, seed)
    scene, arm = scene_of(spec), pipeline_of(robot).robot
    if scene.target_pose is None:
        return None
    free = free_solutions(arm, scene, scene.target_pose, rng_of(spec.name, "lime"))
    if not len(free):
        return None
    truth = LeafTruth(arm, scene)
    leaves = tuple(len(truth.touched_at(q)) for q in free)
    if min(leaves) == 0:
        return None
    goals = tuple(tuple(float(v) for v in q) for q in free)
    return LimeScene(seed, tuple(float(v) for v in np.asarray(scene.target_pose)), goals, leaves)


def find_scenes(count: int, robot: str, first_seed: int = 0) -> list[LimeScene]:
    """Return the first `count` plants that qualify, seeds tried upwards.

    Raises:
        SceneError: there are not as many among a thousand seeds.
    """
    found: list[LimeScene] = []
    for seed in range(first_seed, first_seed + _MOST_SEEDS):
        if len(found) == count:
            return found
        scene = examine(seed, robot)
        if scene is not None:
            found.append(scene)
    raise SceneError(f"only {len(found)} of {count} plants from seed {first_seed} on have a lime that can be grasped through leaves alone")
