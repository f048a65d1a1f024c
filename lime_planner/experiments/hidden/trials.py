"""The trials of the hidden-stems experiment: one lime, planned with what cameras see, each motion judged by the whole plant."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from lime_planner.core.parameters import Settings, settings_from
from lime_planner.core.types import Array, Float32
from lime_planner.experiments.grasps import Grasp, grasps_of, plant_spec, rng_of
from lime_planner.experiments.problems import SceneSpec, pipeline_of, scene_of
from lime_planner.experiments.runs.methods import check_options, split_method
from lime_planner.experiments.runs.results_file import Plan
from lime_planner.experiments.swept_leaves import FINE_RAD, LeafTruth, motion_samples
from lime_planner.experiments.swept_stems import StemTruth
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline.looks import T_TOOL_CAMERA, plan_look
from lime_planner.pipeline.obstacles import stem_checker
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.targets import Target, fruit_target, pose_target
from lime_planner.robot.kinematics import forward_kinematics
from lime_planner.robot.model import home
from lime_planner.scene.camera import Camera, Picture, View, look_at, scene_in_pictures, take_picture
from lime_planner.scene.plants.generator import USUAL_DENSITIES
from lime_planner.scene.scene import Scene

#: Where the fixed cameras stand, behind the arm and on either side of the plant [m]; all look at its middle and have it in the picture.
CAMERAS = ((-0.4, 0.2, 0.8), (0.3, -1.0, 0.7), (0.3, 1.0, 0.7))
LENS = Camera(edge_drop_out=0.3, noise_m=0.001)
ENOUGH_RAD = 0.02  #: no more looks once less of the path than this is unseen

#: What is known when a motion is planned, and settings that differ from the defaults.
KNOWLEDGE: dict[str, dict[str, Any]] = {
    "full": {},
    "one": {"unseen_price": 0.0},
    "priced": {},
    "three": {},
    "looks": {},
}

#: Their names in tables.
LABELS = {
    "full": "the whole plant",
    "one": "one view, as seen",
    "priced": "one view, unseen priced",
    "three": "three fixed views",
    "looks": "one view and planned looks",
}

METHODS = tuple(f"{knowledge}-{approach}" for knowledge in KNOWLEDGE for approach in ("fixed", "free"))


@dataclass(frozen=True)
class HiddenOptions:
    """What a hidden-stems experiment runs.

    Attributes:
        plants: of each density; limes: of each plant; densities: of foliage.
        first_plant: seed of the first plant.
        seed: of planners and of the cameras' noise.
        time_s: search budget of every plan; iterations: the budget instead, where it is not 0.
        max_looks: planned looks at most.
        methods: of `METHODS`, with parameters changed after a colon, for example `priced-free:unseen_price=1`.
        robot: name of the arm.
    """

    plants: int = 17
    limes: int = 3
    densities: tuple[str, ...] = USUAL_DENSITIES
    first_plant: int = 0
    seed: int = 0
    time_s: float = 0.5
    iterations: int = 0
    max_looks: int = 3
    methods: tuple[str, ...] = METHODS
    robot: str = "kinova_j2s6s200"

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ParameterError: names the field, its value and what is allowed.
        """
        check_options(self, {"plants": 1, "limes": 1, "first_plant": 0, "seed": 0, "iterations": 0, "max_looks": 0})

    def settings(self, method: str) -> Settings:
        """The pipeline's settings for a method.

        Raises:
            ParameterError: an unknown method, or parameter after its colon.
        """
        name, changes = split_method(method, METHODS)
        # One thread: trials go side by side themselves.
        budget = {"time_budget_s": self.time_s, "iterations": self.iterations, "threads": 1}
        values = {**budget, "robot": self.robot, **KNOWLEDGE[name.partition("-")[0]]}
        return settings_from({**values, **changes})

    def description(self) -> dict[str, Any]:
        """What two runs must have in common for the trials of one to continue the other, JSON-ready."""
        return {
            "seed": self.seed,
            "limes": self.limes,
            "first_plant": self.first_plant,
            "time_s": self.time_s,
            "iterations": self.iterations,
            "max_looks": self.max_looks,
            "robot": self.robot,
            "methods": {method: self.settings(method).unseen_price for method in self.methods},
            "densities": list(self.densities),
        }


@dataclass(frozen=True)
class Task:
    """One lime, in a form that can go to another process."""

    options: HiddenOptions
    scene: SceneSpec
    number: int


@functools.lru_cache(maxsize=2)
def _warm(robot: str) -> Pipeline:
    pipeline = pipeline_of(robot)
    pipeline.warm_up(())
    return pipeline


@functools.lru_cache(maxsize=1)
def _truth(spec: SceneSpec, robot: str) -> tuple[StemTruth, LeafTruth]:
    scene, arm = scene_of(spec), pipeline_of(robot).robot
    return StemTruth(arm, scene), LeafTruth(arm, scene)


def arm_points(pipeline: Pipeline, q: Array) -> Float32:
    """Points on the arm's surface at a configuration (n,), (P, 3) [m]."""
    shapes, poses = pipeline.shapes, np.empty((pipeline.robot.n + 1, 3, 4))
    forward_kinematics(pipeline.robot.chain, np.ascontiguousarray(q), poses)
    coarse = np.searchsorted(shapes.coarse_start, np.arange(len(shapes.coarse)), side="right") - 1
    fine = np.searchsorted(shapes.fine_start, np.arange(len(shapes.fine)), side="right") - 1
    of_point = np.searchsorted(shapes.surface_start, np.arange(len(shapes.surface)), side="right") - 1
    own = poses[coarse[fine[of_point]]]
    return np.asarray(np.einsum("pij,pj->pi", own[:, :, :3], shapes.surface) + own[:, :, 3], dtype=np.float32)


@functools.lru_cache(maxsize=2)
def fixed_views(spec: SceneSpec, seed: int) -> tuple[View, ...]:
    """What the fixed cameras take of a plant, the arm out of the picture."""
    plant = scene_of(spec)
    middle = np.concatenate([plant.leaf_points, plant.stem_points]).mean(axis=0)
    first = int(rng_of(spec.name, "cameras", seed).integers(1, 2**31 - 1 - len(CAMERAS)))
    return tuple(View(look_at(place, middle), seed=first + k) for k, place in enumerate(CAMERAS))


class Pictures:
    """What is known of a plant from pictures of it, each of which is taken once."""

    def __init__(self, plant: Scene) -> None:
        """Take the whole plant."""
        self._plant = plant
        self._taken: dict[View, Picture] = {}
        self._known: dict[tuple[View, ...], Scene] = {}

    def known(self, views: tuple[View, ...]) -> Scene:
        """What is known of the plant from some views; its own truth is left out."""
        if views not in self._known:
            for view in views:
                if view not in self._taken:
                    self._taken[view] = take_picture(self._plant, view, camera=LENS)
            seen = scene_in_pictures(self._plant, views, [self._taken[view] for view in views])
            points, labels, costs = seen.labelled_points()
            ids = [seen.leaf_view_ids, seen.stem_view_ids, seen.fruit_view_ids]
            self._known[views] = Scene.from_points(
                points,
                labels,
                frame_id=seen.frame_id,
                permeability_cost=costs,
                viewpoints=seen.viewpoints,
                view_ids=np.concatenate([part for part in ids if part is not None]),
                blocking_points=seen.blocking_points,
                blocking_view_ids=seen.blocking_view_ids,
            )
        return self._known[views]


@functools.lru_cache(maxsize=1)
def _pictures(spec: SceneSpec) -> Pictures:
    return Pictures(scene_of(spec))


class Trial:
    """One lime of one plant: what is asked for, what cameras see, and what became of a motion."""

    def __init__(self, task: Task, grasp: Grasp) -> None:
        """Prepare."""
        self.task, self.grasp, self.options = task, grasp, task.options
        self.plant, self.pipeline = scene_of(task.scene), _warm(task.options.robot)
        self.pictures = _pictures(task.scene)
        centres, radii = self.plant.fruit_centres, self.plant.fruit_radii
        assert centres is not None and radii is not None
        self.targets: dict[str, Target] = {
            "fixed": pose_target(grasp.pose),
            "free": fruit_target(centres[grasp.number].astype(np.float64), float(radii[grasp.number])),
        }
        self.seed = int(rng_of(f"{task.scene.name}/{task.number}", "hidden", self.options.seed).integers(1, 2**31 - 1))
        self._first: dict[tuple[Any, ...], tuple[PlanResult, float]] = {}

    def first_plan(self, views: tuple[View, ...], approach: str, settings: Settings) -> tuple[PlanResult, float]:
        """The plan from where the arm stands in the beginning, and its processor time [s]; methods that ask for the same one share it.

        Args:
            views: what is known; none for the whole plant.
            approach: which of the targets.
            settings: of the plan.
        """
        key = (views, approach, settings)
        if key not in self._first:
            scene = self.pictures.known(views) if views else self.plant
            began_s = time.process_time()
            result = self.pipeline.plan(scene, self.targets[approach], home(self.pipeline.robot), settings, seed=self.seed)
            self._first[key] = result, time.process_time() - began_s
        return self._first[key]

    def run(self, method: str) -> dict[str, Any]:
        """Plan by one method and judge every motion, looks included."""
        name = method.partition(":")[0]
        knowledge, _, approach = name.partition("-")
        settings, target, q = self.options.settings(method), self.targets[approach], home(self.pipeline.robot)
        fixed = fixed_views(self.task.scene, self.options.seed)
        views: tuple[View, ...] = {"full": (), "three": fixed}.get(knowledge, fixed[:1])
        result, cpu_s = self.first_plan(views, approach, settings)
        look_cpu_s: list[float] = []
        motions: list[Trajectory] = []
        while knowledge == "looks" and len(motions) < self.options.max_looks:
            if result.succeeded and result.unseen_contact_rad <= ENOUGH_RAD:
                break
            scene = self.pictures.known(views)
            began_s = time.process_time()
            look = plan_look(self.pipeline, scene, target, result, q, settings, seed=self.seed + len(motions))
            look_cpu_s.append(time.process_time() - began_s)
            if look is None or look.plan.trajectory is None:
                break
            motions.append(look.plan.trajectory)
            q = look.plan.trajectory.positions[-1]
            T_base_camera = self.pipeline.robot.forward(q) @ T_TOOL_CAMERA
            views = (*views, View(T_base_camera, arm_points(self.pipeline, q), self.seed + 10 + len(motions)))
            scene = self.pictures.known(views)
            began_s = time.process_time()
            result = self.pipeline.plan(scene, target, q, settings, seed=self.seed)
            cpu_s += time.process_time() - began_s
        known = len(self.pictures.known(views).stem_points) if views else len(self.plant.stem_points)
        return self._record(result, motions, target, settings) | {
            "planning_cpu_s": round(cpu_s + sum(look_cpu_s), 3),
            "look_cpu_s": [round(v, 3) for v in look_cpu_s],
            "looks": len(motions),
            "stems_known": round(known / len(self.plant.stem_points), 4),
        }

    def _record(self, result: PlanResult, looks: list[Trajectory], target: Target, settings: Settings) -> dict[str, Any]:
        stems, leaves = _truth(self.task.scene, self.options.robot)
        robot = self.pipeline.robot
        swept = [motion_samples(robot, motion.configurations(FINE_RAD)) for motion in looks]
        touched = {int(p) for motion in swept for p in stems.touched(motion, None, settings)}
        record: dict[str, Any] = {"status": result.status.name, "stems_on_looks": len(touched)}
        if not result.succeeded or result.trajectory is None:
            return record | {"sentence": result.message, "stems": len(touched)}
        last = motion_samples(robot, result.trajectory.configurations(FINE_RAD))
        cut = {int(leaf) for motion in (*swept, last) for leaf in leaves.cut_along(motion)}
        touched |= {int(p) for p in stems.touched(last, target.spot(self.plant, settings), settings)}
        return record | {
            "stems": len(touched),
            "leaves": len(cut),
            "duration_s": round(result.trajectory.duration_s + sum(motion.duration_s for motion in looks), 3),
            "path_length_rad": round(result.path_length_rad, 4),
            "leaf_contact_rad": round(result.leaf_contact_rad, 4),
            "unseen_contact_rad": round(result.unseen_contact_rad, 4),
        }


def approach_of(method: str) -> str:
    """The kind of target of a method: `fixed` or `free`."""
    return method.partition(":")[0].partition("-")[2]


@functools.lru_cache(maxsize=2)
def _starts_free(spec: SceneSpec, robot: str) -> bool:
    """Whether the arm at home touches no stem of the whole plant: otherwise every motion from there would, whatever was seen."""
    pipeline = pipeline_of(robot)
    return stem_checker(pipeline.robot, scene_of(spec), None, settings_from()).stem_hit(home(pipeline.robot)) is None


def run_trial(task: Task) -> dict[str, Any]:
    """Plan one lime by every method and return the record for the results file."""
    grasps = grasps_of(task.scene, task.options.limes, task.options.robot, count_leaves=False)
    grasp = grasps[task.number] if task.number < len(grasps) and _starts_free(task.scene, task.options.robot) else None
    record: dict[str, Any] = {
        "scene": task.scene.name,
        "density": task.scene.density,
        "number": task.number,
        "target": None if grasp is None else grasp.number,
        "methods": {},
    }
    if grasp is not None:
        trial = Trial(task, grasp)
        # Methods of the same target one after another: they share what is made for it.
        done = {method: trial.run(method) for method in sorted(task.options.methods, key=approach_of)}
        record["methods"] = {method: done[method] for method in task.options.methods}
    return record


def tasks_of(options: HiddenOptions) -> list[Task]:
    """All trials: every lime of every plant."""
    seeds = range(options.first_plant, options.first_plant + options.plants)
    specs = [plant_spec(density, seed) for seed in seeds for density in options.densities]
    return [Task(options, spec, number) for spec in specs for number in range(options.limes)]


def plan_of(options: HiddenOptions) -> Plan[Task]:
    """The experiment as trials for `lime_planner.experiments.runs.results_file`."""
    return Plan(
        "hidden",
        options.description(),
        tasks_of(options),
        run_trial,
        lambda task: (task.scene.name, task.number),
        lambda record: (record["scene"], record["number"]),
        {"plants": options.plants},
    )
