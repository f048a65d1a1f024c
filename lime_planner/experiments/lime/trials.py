"""The trials of the lime experiment (section V): scene, spaces for both checkers, options, seeds."""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from lime_planner.collision.joint_space import ArmSpace
from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import Settings, settings_from
from lime_planner.core.types import Array
from lime_planner.experiments.lime.scenes import LimeScene, find_scenes
from lime_planner.experiments.problems import pipeline_of, scene_of
from lime_planner.experiments.runs.results_file import Plan
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.planning.rrt_star.planner import PaperOptions, Snapshot, plan_paper
from lime_planner.planning.space import repulsion
from lime_planner.planning.spaces.function_space import FunctionSpace, function_space
from lime_planner.robot.model import home

ALGORITHMS = ("rrt_star", "apf_rrt_star", "p_rrt_star")
LABELS = {"rrt_star": "RRT*", "apf_rrt_star": "APF-RRT*", "p_rrt_star": "P-RRT*"}

#: Table II of the paper: mean and standard error of 100 trials.
PAPER = {"rrt_star": (822.75, 50.06), "apf_rrt_star": (422.62, 36.98), "p_rrt_star": (886.77, 47.90)}

CHECKERS = ("fast", "fcl")
_EDGE_STEP_RAD = 0.02  # where FCL looks at the edges of a finished path, for J


@dataclass(frozen=True)
class Choices:
    """What the paper leaves open (docs/paper-lime-choices.md); the defaults were fixed before the first trial.

    Attributes:
        slack_rad: how far the sampling box reaches beyond start and goal.
        goal_bias: share of samples that are the goal.
        goal_radius: nodes this close to the goal may become its parent, in steps δ.
        nearest_only: the nearest stem-free solution is the goal, or all of them are.
        inside_leaves: `explore` (λ = 1) or `attract`.
        patience: factor on the iterations.
    """

    slack_rad: float = math.pi / 2.0
    goal_bias: float = 0.05
    goal_radius: float = 5.0 / 3.0
    nearest_only: bool = True
    inside_leaves: str = "explore"
    patience: int = 1


#: The sensitivity's variants: one choice changed at a time.
VARIANTS: dict[str, Choices] = {
    "as fixed": Choices(),
    "box ±π/4": Choices(slack_rad=math.pi / 4.0),
    "box ±π": Choices(slack_rad=math.pi),
    "no goal bias": Choices(goal_bias=0.0),
    "goal bias 20 %": Choices(goal_bias=0.2),
    "goal radius δ": Choices(goal_radius=1.0),
    "goal radius 3 δ": Choices(goal_radius=3.0),
    "all solutions as goals": Choices(nearest_only=False),
    "attraction inside leaves": Choices(inside_leaves="attract"),
    "ten times the iterations": Choices(patience=10),  # not part of the plan: added when 1,500 proved few
}
FIXED = "as fixed"
_PATIENT_TRIALS = 2  # at most, for each planner and plant: ten times the iterations take a hundred times as long


@dataclass(frozen=True)
class LimeOptions:
    """What a lime experiment runs.

    Attributes:
        trials: for each planner on each plant, with the choices as fixed.
        plants: further plants beside the default one.
        sensitivity_trials: for each planner, further plant and variant.
        seed: of the trials; the plants are always the same ones.
        iterations: of one run, rejected ones included.
        checker: `fast`, or `fcl`: undecimated meshes through FCL, as Python callables.
        robot: name of the arm.
    """

    trials: int = 100
    plants: int = 10
    sensitivity_trials: int = 30
    seed: int = 0
    iterations: int = 1500
    checker: str = "fast"
    robot: str = "kinova_j2s6s200"

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ParameterError: names the field, its value and what is allowed.
        """
        for name, least in (("trials", 1), ("plants", 0), ("sensitivity_trials", 0), ("seed", 0), ("iterations", 1)):
            if getattr(self, name) < least:
                raise ParameterError(f"{name} must be at least {least}, got {getattr(self, name)}")
        if self.checker not in CHECKERS:
            raise ParameterError(f"checker {self.checker!r} is none of {', '.join(CHECKERS)}")

    def settings(self) -> Settings:
        """The pipeline's settings for the obstacles: nothing but contact counts as collision."""
        return settings_from({"stem_margin_m": 0.0, "robot": self.robot})

    def planner_options(self, algorithm: str, choices: Choices) -> PaperOptions:
        """Options of one planner."""
        arm = PaperOptions.arm(algorithm)
        changes = {"goal_radius": choices.goal_radius * arm.delta, "goal_bias": choices.goal_bias, "inside_leaves": choices.inside_leaves}
        return PaperOptions.arm(algorithm, **changes)

    def description(self) -> dict[str, Any]:
        """What two runs must have in common for the trials of one to continue the other, JSON-ready."""
        return {
            "seed": self.seed,
            "iterations": self.iterations,
            "checker": self.checker,
            "robot": self.robot,
            "planners": {algorithm: asdict(self.planner_options(algorithm, Choices())) for algorithm in ALGORITHMS},
        }


@dataclass(frozen=True)
class Task:
    """One trial, in a form that can go to another process."""

    options: LimeOptions
    scene: LimeScene = field(repr=False)
    variant: str
    algorithm: str
    trial: int

    @property
    def key(self) -> tuple[int, str, str, int]:
        """What identifies the trial."""
        return self.scene.seed, self.variant, self.algorithm, self.trial

    @property
    def seed(self) -> int:
        """Seed of the planner: different for every planner, so that rows are independent samples."""
        parts = [self.options.seed, self.scene.seed, list(VARIANTS).index(self.variant), ALGORITHMS.index(self.algorithm), self.trial]
        return int(np.random.SeedSequence(parts).generate_state(1)[0])


@functools.lru_cache(maxsize=2)
def obstacles_of(scene: LimeScene, options: LimeOptions) -> Obstacles:
    """The scene as obstacles; the last ones are kept."""
    return pipeline_of(options.robot).obstacles(scene_of(scene.spec), np.array(scene.pose[:3]), options.settings())


def goals_of(scene: LimeScene, choices: Choices) -> Array:
    """Goal configurations (G, n)."""
    return np.array(scene.goals[:1] if choices.nearest_only else scene.goals)


def box_of(robot_name: str, goals: Array, choices: Choices) -> tuple[Array, Array]:
    """Bounds of the samples (n,), (n,): around start and goals, within the joint limits."""
    robot = pipeline_of(robot_name).robot
    ends = np.vstack([home(robot)[None], goals])
    low, high = ends.min(axis=0) - choices.slack_rad, ends.max(axis=0) + choices.slack_rad
    return np.maximum(low, robot.lower), np.minimum(high, robot.upper)


def fcl_space(obstacles: Obstacles, lower: Array, upper: Array) -> FunctionSpace:
    """The arm's joint space with collisions by FCL, as the paper has them: Python functions, undecimated meshes.

    The field's force is the fast model's, since FCL gives no gradient; whether the arm touches leaves is FCL's answer there too.
    """
    checker = obstacles.exact_checker()
    fast = obstacles.space(lower, upper).handle()

    def field(q: Array, force: Array, d_star: float, k_leaf: float, k_stem: float) -> float:
        nearest = float(repulsion(fast, np.array(q), d_star, k_leaf, k_stem, force))
        return 0.0 if checker.leaf_contact(q) else max(nearest, 1e-4)

    return function_space(
        lower,
        upper,
        valid=lambda q: checker.stem_hit(q) is None,
        cost=lambda q: float(checker.leaf_contact(q)),
        field=field,
        edge_step=_EDGE_STEP_RAD,
    )


def space_of(task: Task) -> tuple[ArmSpace | FunctionSpace, Array]:
    """The space of a trial, and its goals."""
    choices = VARIANTS[task.variant]
    goals = goals_of(task.scene, choices)
    lower, upper = box_of(task.options.robot, goals, choices)
    obstacles = obstacles_of(task.scene, task.options)
    if task.options.checker == "fcl":
        return fcl_space(obstacles, lower, upper), goals
    return obstacles.space(lower, upper), goals


def _number(value: float, digits: int = 4) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None  # JSON has no infinity


def plan_trial(task: Task, space: ArmSpace | FunctionSpace, goals: Array) -> Snapshot:
    """Plan; what there is at the end."""
    choices = VARIANTS[task.variant]
    options = task.options.planner_options(task.algorithm, choices)
    start = home(pipeline_of(task.options.robot).robot)
    return plan_paper(space, start, goals, options, task.seed, iterations=choices.patience * task.options.iterations).final


def run_trial(task: Task) -> dict[str, Any]:
    """Run one trial and return its record for the results file."""
    space, goals = space_of(task)
    final = plan_trial(task, space, goals)
    record: dict[str, Any] = {"plant": task.scene.seed, "variant": task.variant, "algorithm": task.algorithm, "trial": task.trial}
    record |= {"seed": task.seed, "tree_nodes": final.nodes, "time_s": round(final.elapsed_s, 4), "cost": None}
    if final.path is None:
        return record
    record |= {"cost": _number(final.node_cost), "J": _number(final.integral_cost), "stored_cost": _number(final.stored_cost)}
    return record | {"length": _number(final.length), "nodes_inside": final.nodes_inside, "nodes": len(final.path)}


def plan_of(options: LimeOptions) -> Plan[Task]:
    """The experiment as trials for `lime_planner.experiments.runs.results_file`."""
    scenes = find_scenes(1 + options.plants, options.robot)
    tasks = [Task(options, scene, FIXED, a, trial) for scene in scenes for trial in range(options.trials) for a in ALGORITHMS]
    for variant in VARIANTS:
        if variant != FIXED:
            trials = options.sensitivity_trials if VARIANTS[variant].patience == 1 else min(options.sensitivity_trials, _PATIENT_TRIALS)
            tasks += [Task(options, scene, variant, a, trial) for scene in scenes[1:] for trial in range(trials) for a in ALGORITHMS]
    described = [{"seed": s.seed, "pose": list(s.pose), "goals": len(s.goals), "leaves": list(s.leaves)} for s in scenes]
    wanted = {"trials": options.trials, "plants": options.plants, "sensitivity_trials": options.sensitivity_trials}
    return Plan(
        "lime",
        options.description(),
        tasks,
        run_trial,
        lambda task: task.key,
        lambda r: (r["plant"], r["variant"], r["algorithm"], r["trial"]),
        {"wanted": wanted, "scenes": described},
    )
