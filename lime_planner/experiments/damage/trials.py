"""The trials of the damage experiment: one grasp, planned by every method from the same start, each motion judged by what it sweeps."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.parameters import Settings, settings_from
from lime_planner.experiments.grasps import Grasp, grasps_of, plant_spec, rng_of
from lime_planner.experiments.problems import SceneSpec, pipeline_of, scene_of
from lime_planner.experiments.runs.methods import check_options, split_method
from lime_planner.experiments.runs.results_file import Plan
from lime_planner.experiments.swept_leaves import CloudTruth, LeafTruth
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.targets import Target, candidates_target, fruit_target, pose_target
from lime_planner.robot.model import home
from lime_planner.scene.plants.generator import USUAL_DENSITIES
from lime_planner.scene.plants.grasp_targets import approach_directions, grasp_pose

SCAN_FRUIT_RADIUS_M = 0.02  #: in a scan, the place of a drawn grasp counts as a fruit of this radius

#: What is compared: settings of the pipeline that differ from its defaults.
METHODS: dict[str, dict[str, Any]] = {
    "solid": {"leaf_policy": "solid"},
    "ignored": {"leaf_policy": "ignored"},
    "apf_rrt_star": {"planner": "apf_rrt_star", "paper": True},
    "binary": {"leaf_cost": "binary"},
    "graded": {"leaf_cost": "graded"},
    "free": {},
    "candidates": {},
}

#: Grasps drawn for the method `candidates`, as a detector would propose them.
CANDIDATES = 20

#: About what a method gets done in 0.5 s on one free core of a 2024 machine, the median over plants: for results that repeat.
REPEATABLE = {
    "solid": 14_000,
    "ignored": 21_000,
    "apf_rrt_star": 21_000,
    "binary": 11_000,
    "graded": 7000,
    "free": 11_000,
    "candidates": 11_000,
}

#: Their names in tables.
LABELS = {
    "solid": "leaves solid",
    "ignored": "leaves ignored",
    "apf_rrt_star": "APF-RRT* (paper)",
    "binary": "default, binary cost",
    "graded": "default, graded cost",
    "free": "free approach",
    "candidates": f"candidates ({CANDIDATES} random)",
}


@dataclass(frozen=True)
class DamageOptions:
    """What a damage experiment runs.

    Attributes:
        plants: of each density.
        limes: of each plant.
        densities: of foliage.
        scans: files of labelled scans; scan_targets: places in each.
        seed: of the experiment: of plants and planners.
        time_s: search budget of every method; iterations: the budget instead, where it is not 0.
        repeatable: search by each method's own number of iterations (`REPEATABLE`), so that a run can be repeated on any machine.
        methods: keys of `METHODS`, with parameters changed after a colon, for example `binary:leaf_weight=100,max_goals=8`.
        robot: name of the arm.
    """

    plants: int = 17
    limes: int = 4
    densities: tuple[str, ...] = USUAL_DENSITIES
    scans: tuple[str, ...] = ()
    scan_targets: int = 8
    seed: int = 0
    time_s: float = 0.5
    iterations: int = 0
    repeatable: bool = False
    methods: tuple[str, ...] = tuple(METHODS)
    robot: str = "kinova_j2s6s200"

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ParameterError: names the field, its value and what is allowed.
        """
        check_options(self, {"plants": 0, "limes": 1, "scan_targets": 1, "seed": 0})

    def settings(self, method: str) -> Settings:
        """The pipeline's settings for a method.

        Raises:
            ParameterError: an unknown method, or parameter after its colon.
        """
        name, changes = split_method(method, METHODS)
        iterations = REPEATABLE[name] if self.repeatable else self.iterations
        # One thread: trials go side by side themselves.
        values = {"time_budget_s": self.time_s, "iterations": iterations, "threads": 1, "robot": self.robot, **METHODS[name]}
        return settings_from({**values, **changes})

    def scenes(self) -> list[SceneSpec]:
        """All plants, then all scans."""
        first = 1000 * self.seed
        plants = [plant_spec(density, first + number) for number in range(self.plants) for density in self.densities]
        return plants + [SceneSpec.scan(Path(path)) for path in self.scans]

    def description(self) -> dict[str, Any]:
        """What two runs must have in common for the trials of one to continue the other, JSON-ready."""
        return {
            "seed": self.seed,
            "limes": self.limes,
            "scan_targets": self.scan_targets,
            "time_s": self.time_s,
            "iterations": self.iterations,
            "repeatable": REPEATABLE if self.repeatable else None,
            "robot": self.robot,
            "methods": {method: METHODS[method.partition(":")[0]] for method in self.methods},
            "densities": list(self.densities),
        }


@dataclass(frozen=True)
class Task:
    """One grasp, in a form that can go to another process."""

    options: DamageOptions
    scene: SceneSpec
    number: int


def tasks_of(options: DamageOptions) -> list[Task]:
    """All trials: every grasp of every scene."""
    return [
        Task(options, scene, number)
        for scene in options.scenes()
        for number in range(options.scan_targets if scene.path else options.limes)
    ]


@functools.lru_cache(maxsize=2)
def _warm(robot: str) -> Pipeline:
    pipeline = pipeline_of(robot)
    pipeline.warm_up()
    return pipeline


@functools.lru_cache(maxsize=2)
def _truth(spec: SceneSpec, robot: str) -> LeafTruth | CloudTruth:
    scene, arm = scene_of(spec), pipeline_of(robot).robot
    return CloudTruth(arm, scene) if scene.leaf_triangles is None else LeafTruth(arm, scene)


def _number(value: float, digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None  # JSON has no NaN


def _record(result: PlanResult, cpu_s: float, truth: LeafTruth | CloudTruth) -> dict[str, Any]:
    """What became of one plan, and what its motion sweeps."""
    record: dict[str, Any] = {
        "status": result.status.name,
        "planning_time_s": round(result.planning_time_s, 4),
        "planning_cpu_s": round(cpu_s, 4),
        "iterations": result.iterations,
    }
    if result.trajectory is None or result.status.name != "SUCCEEDED":
        return record | {"sentence": result.message}
    record |= {
        "duration_s": round(result.trajectory.duration_s, 3),
        "path_length_rad": _number(result.path_length_rad, 4),
        "leaf_contact_rad": _number(result.leaf_contact_rad, 4),
        "tool_leaf_contact_m": _number(result.tool_leaf_contact_m, 4),
        "min_stem_clearance_m": _number(result.min_stem_clearance_m, 5),
    }
    if isinstance(truth, CloudTruth):
        record["area_cm2"] = round(1e4 * truth.swept_area_m2(result.trajectory), 2)
    else:
        swept = truth.swept(result.trajectory)
        record |= {
            "leaves": [int(i) for i in swept.leaves],
            "area_cm2": round(1e4 * swept.area_m2, 2),
            "leaves_at_goal": len(truth.touched_at(result.waypoints[-1])),
        }
    return record


def _targets_of(grasp: Grasp, scene: SceneSpec, options: DamageOptions) -> dict[str, Target]:
    """What the methods are asked for: the grasp that was drawn, its fruit with the approach free, or one of some grasps drawn like it."""
    rng = rng_of(f"{scene.name}/{grasp.number}", "candidates", options.seed)
    centre = np.array(grasp.pose[:3])
    ways = approach_directions(rng, centre, CANDIDATES)
    poses = [grasp_pose(centre, way, float(rng.uniform(0.0, 2.0 * np.pi))) for way in ways]
    radius_m = SCAN_FRUIT_RADIUS_M if scene.path else None
    return {"fixed": pose_target(grasp.pose), "free": fruit_target(centre, radius_m), "candidates": candidates_target(poses)}


def run_trial(task: Task) -> dict[str, Any]:
    """Plan one grasp by every method and return the record for the results file."""
    options, scene = task.options, task.scene
    pipeline = _warm(options.robot)
    wanted = options.scan_targets if scene.path else options.limes
    grasps = grasps_of(scene, wanted, options.robot)
    grasp: Grasp | None = grasps[task.number] if task.number < len(grasps) else None
    record: dict[str, Any] = {
        "scene": scene.name,
        "density": "scan" if scene.path else scene.density,
        "number": task.number,
        "target": None if grasp is None else grasp.number,
        "methods": {},
    }
    if grasp is None:
        return record
    record |= {"pose": [round(v, 6) for v in grasp.pose], "goals": grasp.configurations, "leaves_at_best_goal": grasp.leaves_at_best}
    seed = int(rng_of(f"{scene.name}/{task.number}", "plan", options.seed).integers(1, 2**31 - 1))
    start, truth = home(pipeline.robot), _truth(scene, options.robot)
    targets = _targets_of(grasp, scene, options)
    for method in options.methods:
        began_s = time.process_time()
        target = targets.get(method.partition(":")[0], targets["fixed"])
        result = pipeline.plan(scene_of(scene), target, start, options.settings(method), seed=seed)
        record["methods"][method] = _record(result, time.process_time() - began_s, truth)
    return record


def plan_of(options: DamageOptions) -> Plan[Task]:
    """The experiment as trials for `lime_planner.experiments.runs.results_file`."""
    return Plan(
        "damage",
        options.description(),
        tasks_of(options),
        run_trial,
        lambda task: (task.scene.name, task.number),
        lambda record: (record["scene"], record["number"]),
        {"plants": options.plants, "densities": list(options.densities), "scans": len(options.scans)},
    )
