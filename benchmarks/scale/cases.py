"""How cost grows: with the points of a cloud, the leaves of a plant, the joints of an arm, and the budget of a search."""

from __future__ import annotations

import functools
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.isolated import run_isolated
from benchmarks.planner_runs import run_anytime, warm_up
from benchmarks.problem_sets import scene_problems
from lime_planner.collision.joint_space import ArmSpace
from lime_planner.core.errors import ProblemError
from lime_planner.core.jit import kernel
from lime_planner.core.parameters import settings_from
from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.core.types import Array, Float32, UInt8
from lime_planner.experiments.problems import ProblemSpec, SceneSpec, build_problem, pipeline_of, scene_of
from lime_planner.pipeline.obstacles import prepare
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.planning.lime_star.planner import LimeOptions, plan_lime
from lime_planner.planning.space import evaluate
from lime_planner.robot.model import Robot, home, robot_from_urdf
from lime_planner.scene import voxels
from lime_planner.scene.clean import clean_scene
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import Scene

AXES = ("points", "leaves", "joints", "budget")
ARM = "kinova_j2s6s200"
POINTS_TARGETS_S = {100_000: 0.15, 5_000_000: 3.0}  # from arrays to a clean scene
MEMORY_TARGET_BYTES = 4e9
SEARCH_S = 0.5  # of every search but those on the axis `budget`
LIMES = 3  # problems on each plant
_TIMEOUT_S = 600.0
_REACH_M, _TUBE_M = 0.95, 0.03  # of the arms with other numbers of joints
_CANOPY_M = 0.22


@dataclass(frozen=True)
class ScaleTask:
    """One measurement.

    Attributes:
        axis: of `AXES`; value: points, leaves, joints, or seconds.
        number: repetition: seed of the plant, of the goal or of the search.
        problem: of the axis `budget`.
    """

    axis: str
    value: float
    number: int
    problem: ProblemSpec | None = None

    @property
    def key(self) -> tuple[str, float, int, str]:
        """What identifies it."""
        return self.axis, self.value, self.number, "" if self.problem is None else self.problem.key


@kernel
def _check_rows(space: Any, rows: Any, times: int) -> int:
    count = 0
    for _ in range(times):
        for i in range(rows.shape[0]):
            count += 1 if evaluate(space, rows[i]) >= 0.0 else 0
    return count


def labelled_cloud(points: int) -> tuple[Float32, UInt8]:
    """A cloud of a dense plant as a camera might give it: `points` points with labels, noise, and one in a thousand not finite."""
    rng = np.random.default_rng(0)
    plant = generate_plant(rng, PlantOptions(density="dense"))
    parts = (plant.leaf_points, plant.stem_points, plant.fruit_points)
    source = np.concatenate(parts)
    labels = np.repeat(np.arange(3, dtype=np.uint8), [len(p) for p in parts])
    pick = rng.integers(len(source), size=points)
    cloud = source[pick] + rng.normal(0.0, 0.001, (points, 3)).astype(np.float32)
    cloud[::1000] = np.nan
    return np.asarray(cloud, dtype=np.float32), labels[pick]


def _timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time of the whole process [s], and the result: what the call takes on one core."""
    began_s = time.process_time()
    result = function()
    return time.process_time() - began_s, result


def measure_points(points: int, repeats: int = 5) -> dict[str, Any]:
    """From arrays to a clean scene, and from there to obstacles: median times, and the process's peak memory."""
    pipeline, settings = pipeline_of(ARM), settings_from()
    cloud, labels = labelled_cloud(points)
    voxels.warm_up()
    clean_s, obstacle_s, scene = [], [], Scene.from_points(cloud[:1000], labels[:1000])
    prepare(pipeline.robot, pipeline.shapes, scene, None, settings)
    for _ in range(repeats):
        spent_s, scene = _timed(lambda: clean_scene(Scene.from_points(cloud, labels), reach_m=pipeline.robot.reach_m))
        clean_s.append(spent_s)
        obstacle_s.append(_timed(functools.partial(prepare, pipeline.robot, pipeline.shapes, scene, None, settings))[0])
    return {
        "scene_s": round(float(np.median(clean_s)), 5),
        "obstacles_s": round(float(np.median(obstacle_s)), 5),
        "kept": scene.n_points,
        "peak_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def _around(space: ArmSpace, centres: Array, seed: int, count: int = 200) -> Array:
    """Valid configurations around some others, as a search meets them."""
    rng, rows = np.random.default_rng(seed), []
    for _ in range(100 * count):
        q = centres[rng.integers(len(centres))] + rng.normal(0.0, 0.3, centres.shape[1])
        if _check_rows(space.handle(), q[None], 1):
            rows.append(q)
            if len(rows) == count:
                break
    return np.ascontiguousarray(rows)


def _check_time(space: ArmSpace, centres: Array, seed: int) -> float:
    """Median time of a full check around some configurations [s]."""
    rows = _around(space, centres, seed)
    _check_rows(space.handle(), rows, 1)
    began, spent = time.thread_time, []
    for _ in range(15):
        before_s = began()
        _check_rows(space.handle(), rows, 5)
        spent.append((began() - before_s) / (5 * max(len(rows), 1)))
    return float(np.median(spent))


def measure_leaves(leaves: int, seed: int) -> dict[str, Any]:
    """Obstacles, checks and searches on a plant with a number of leaves."""
    scene = SceneSpec(f"{leaves}-leaves-{seed}", density="medium", seed=seed, leaves=leaves)
    pipeline, settings = pipeline_of(ARM), settings_from()
    fields_s = [_timed(lambda: prepare(pipeline.robot, pipeline.shapes, scene_of(scene), None, settings))[0] for _ in range(4)][1:]
    runs, check_s = [], []
    for number, spec in zip(range(LIMES), scene_problems(scene, ("plain",), ARM, []), strict=False):
        problem = build_problem(spec)
        warm_up(problem, DEFAULT_PLANNER)
        check_s.append(_check_time(problem.space(), problem.goals.configurations, seed))
        runs.append(_search_figures(run_anytime(problem, DEFAULT_PLANNER, 1 + number, SEARCH_S, "cpu")))
    record = {"points": len(scene_of(scene).leaf_points), "obstacles_s": round(float(np.median(fields_s)), 5), "searches": runs}
    return record | {"check_s": float(f"{np.median(check_s):.4g}") if check_s else None}


def _search_figures(run: dict[str, Any]) -> dict[str, Any]:
    curve = run["curve"]
    return {"first_s": curve[0][0] if curve else None, "iterations": run["iterations"], "checks": run["checks"], "cost": run["cost"]}


def chain_urdf(joints: int) -> str:
    """An arm of so many equal tubes, as a URDF: turning joints about z, y, x, y, x ..., 0.95 m long whatever their number."""
    length = _REACH_M / (joints + 1)

    def tube(name: str) -> str:
        cylinder = f'<geometry><cylinder radius="{_TUBE_M}" length="{0.94 * length:.4f}"/></geometry>'
        return f'<link name="{name}"><collision><origin xyz="0 0 {length / 2:.4f}"/>{cylinder}</collision></link>'

    parts = [tube("link_0")]
    for i in range(1, joints + 1):
        axis = "0 0 1" if i == 1 else "0 1 0" if i % 2 == 0 else "1 0 0"
        parts.append(tube(f"link_{i}"))
        parts.append(
            f'<joint name="joint_{i}" type="revolute"><parent link="link_{i - 1}"/><child link="link_{i}"/>'
            f'<origin xyz="0 0 {length:.4f}"/><axis xyz="{axis}"/><limit lower="-2.6" upper="2.6" velocity="1" effort="1"/></joint>'
        )
    parts.append('<link name="tool"/>')
    parts.append(
        f'<joint name="fixed" type="fixed"><parent link="link_{joints}"/><child link="tool"/><origin xyz="0 0 {length:.4f}"/></joint>'
    )
    return f'<robot name="chain_{joints}">' + "".join(parts) + "</robot>"


@functools.lru_cache(maxsize=1)
def _chain(joints: int) -> tuple[Robot, Pipeline]:
    robot = robot_from_urdf(chain_urdf(joints))
    return robot, Pipeline(robot)


def measure_joints(joints: int, seed: int) -> dict[str, Any]:
    """Checks and one search of an arm with a number of joints, from upright to a random place among the leaves of a plant.

    Raises:
        ProblemError: no such place was found.
    """
    robot, pipeline = _chain(joints)
    scene = scene_of(SceneSpec("medium-1", density="medium", seed=1))
    obstacles = pipeline.obstacles(scene, None, settings_from())
    space, start = obstacles.space(robot.lower, robot.upper), home(robot)
    rng, centre = np.random.default_rng([joints, seed]), scene.leaf_points.mean(axis=0)
    for _ in range(200_000):
        goal = rng.uniform(robot.lower, robot.upper)
        if np.linalg.norm(robot.forward(goal)[:3, 3] - centre) < _CANOPY_M and _check_rows(space.handle(), goal[None], 1):
            break
    else:
        raise ProblemError(f"an arm of {joints} joints finds no place in the canopy that is free of stems")
    check_s = _check_time(space, goal[None], seed)
    options = LimeOptions(weight=settings_from().weight)
    plan_lime(space, start, goal, options, 0, iterations=800)
    began_s = time.thread_time()
    wall_s = time.monotonic()
    outcome = plan_lime(space, start, goal, options, 1 + seed, should_stop=lambda: time.thread_time() - began_s >= SEARCH_S)
    share = min(1.0, SEARCH_S / max(time.monotonic() - wall_s, 1e-9))  # of the wall time that was ours
    found = np.isfinite(outcome.first_path_s)
    return {
        "check_s": float(f"{check_s:.4g}"),
        "first_s": round(share * outcome.first_path_s, 5) if found else None,
        "iterations": outcome.iterations,
        "checks": outcome.states_checked,
        "cost": round(outcome.cost, 4) if np.isfinite(outcome.cost) else None,
        "straight": round(float(np.linalg.norm(goal - start)), 4),
    }


def run_task(task: ScaleTask) -> dict[str, Any]:
    """Carry out one measurement and return its record."""
    if task.axis == "points":
        # In a process of its own, whose peak memory is its own.
        figures = run_isolated(measure_points, int(task.value), timeout_s=_TIMEOUT_S)
    elif task.axis == "leaves":
        figures = measure_leaves(int(task.value), task.number)
    elif task.axis == "joints":
        figures = measure_joints(int(task.value), task.number)
    else:
        assert task.problem is not None
        problem = build_problem(task.problem)
        warm_up(problem, DEFAULT_PLANNER)
        figures = {"curve": run_anytime(problem, DEFAULT_PLANNER, 1 + task.number, task.value, "cpu")["curve"]}
    axis, value, number, problem_key = task.key
    return {"axis": axis, "value": value, "number": number, "problem": problem_key, **figures}


def scan_files(folder: Path | None) -> list[SceneSpec]:
    """Scenes of the axis `budget`: scans, or generated plants where none are given."""
    from benchmarks.problem_sets import plant_specs, scan_specs

    return scan_specs(folder) if folder is not None else plant_specs(["medium:1", "dense:2"])
