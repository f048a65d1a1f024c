"""Plants and grasps of the damage experiment: chosen by inverse kinematics and stems alone, before any planner sees them."""

from __future__ import annotations

import functools
import zlib
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import settings_from
from lime_planner.core.types import Array
from lime_planner.experiments.problems import SceneSpec, pipeline_of, scene_of
from lime_planner.robot.ik import solve_ik
from lime_planner.robot.model import Robot, home
from lime_planner.scene.plants.grasp_targets import HIDDEN_REACH_M, canopy_targets, lime_targets
from lime_planner.scene.scene import Scene

SPARE_M = 0.001  #: a grasp counts as possible with this much room to the nearest stem ball, by the exact meshes
DRAWS = 6  #: grasps tried for each lime
_SCAN_DRAWS = 16  # places tried in a scan for each wanted target


@dataclass(frozen=True)
class Grasp:
    """A grasp that the arm can take without touching a stem.

    Attributes:
        number: of the lime, or of the place drawn in a scan.
        pose: (7,) of the tool [m, quaternion].
        configurations: how many solutions of inverse kinematics touch no stem.
        leaves_at_best: leaves that the arm cuts at the solution that cuts fewest: no motion can touch fewer. None on scans, and
            where it was not asked for.
    """

    number: int
    pose: tuple[float, ...]
    configurations: int
    leaves_at_best: int | None


def plant_spec(density: str, seed: int) -> SceneSpec:
    """The generated plant of a density and a seed."""
    return SceneSpec(f"{density}-{seed}", density=density, seed=seed)


def rng_of(name: str, what: str, seed: int = 0) -> np.random.Generator:
    """A generator of its own for each scene and purpose."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(name.encode()), zlib.crc32(what.encode())]))


def free_solutions(robot: Robot, scene: Scene, pose: npt.ArrayLike, rng: np.random.Generator) -> Array:
    """Return the configurations (K, n) that hold the tool at a pose (7,) and touch neither stems nor the arm itself, nearest first."""
    settings = settings_from()
    T = pose_to_matrix(np.asarray(pose))
    solutions = solve_ik(robot, T, home(robot), rng, starts=settings.ik_starts).solutions
    if len(solutions) == 0:
        return np.zeros((0, robot.n))
    checker = ExactChecker(
        robot,
        scene.impermeable_points(T[:3, 3], settings.target_exclusion_radius_m),
        point_radius_m=settings.stem_point_radius_m + SPARE_M,
        exclusion_centre=T[:3, 3],
        exclusion_radius_m=settings.target_exclusion_radius_m,
        approach_zone_m=settings.approach_zone_m,
    )
    return np.asarray(solutions[[checker.stem_hit(q) is None for q in solutions]])


@functools.lru_cache(maxsize=4)
def grasps_of(spec: SceneSpec, wanted: int, robot: str, count_leaves: bool = True) -> tuple[Grasp, ...]:
    """Choose up to `wanted` grasps in a scene.

    On a plant: of the limes within 0.85 m, in the order in which they grew, the first ones for which one of `DRAWS` drawn grasps has
    a solution free of stems. In a scan: places in the canopy, likewise. Leaves are counted only where that is asked for: it takes longer
    than everything else.
    """
    scene, arm = scene_of(spec), pipeline_of(robot).robot
    rng = rng_of(spec.name, "grasps")
    truth = None
    if count_leaves and scene.leaf_triangles is not None:
        from lime_planner.experiments.swept_leaves import LeafTruth

        truth = LeafTruth(arm, scene)
    if scene.fruit_centres is None:
        numbers = list(range(_SCAN_DRAWS * wanted))
        draws = [canopy_targets(scene, rng, len(numbers))]
    else:
        numbers = [int(i) for i in np.flatnonzero(np.linalg.norm(scene.fruit_centres, axis=1) <= HIDDEN_REACH_M)]
        draws = [lime_targets(scene, rng) for _ in range(DRAWS)]
    chosen: list[Grasp] = []
    for number in numbers:
        if len(chosen) == wanted:
            break
        for draw in draws:
            free = free_solutions(arm, scene, draw[number], rng)
            if len(free):
                least = None if truth is None else min(len(truth.touched_at(q)) for q in free)
                chosen.append(Grasp(number, tuple(float(v) for v in draw[number]), len(free), least))
                break
    return tuple(chosen)
