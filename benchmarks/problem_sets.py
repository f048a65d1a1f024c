"""Sets of problems: targets among the leaves of scans and generated plants, plain ones and hard ones.

The choice looks at inverse kinematics and at clearances, never at what a planner makes of a problem.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lime_planner.collision.self_contact import SELF_CLEARANCE_M
from lime_planner.core.errors import ParameterError
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem, ProblemSpec, SceneSpec, find_problem, pipeline_of, scene_of
from lime_planner.pipeline.goals import measure
from lime_planner.robot.model import home
from lime_planner.scene.plants.grasp_targets import canopy_targets, lime_targets

CASES = ("plain", "narrow", "leaf_start", "far")
DRAWN_TARGETS = 64  # targets drawn in each scan, whatever number is used
NARROW_M = 0.010  # a goal is narrow when no goal configuration is clearer of stems than this
_FAR_STARTS = 6  # random starts of which the one farthest from its goals is taken
_CLEAR_START_M = 0.03


@dataclass(frozen=True)
class Refused:
    """A target that makes no problem, and why."""

    key: str
    reason: str


def scan_specs(folder: Path) -> list[SceneSpec]:
    """The scans (.npz) in a folder, by name.

    Raises:
        ParameterError: there is none.
    """
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise ParameterError(f"{folder} holds no scan (.npz); `lime-planner scene tomatowur` obtains some")
    return [SceneSpec.scan(path) for path in paths]


def plant_specs(names: Sequence[str]) -> list[SceneSpec]:
    """Generated plants from their names, DENSITY:SEED."""
    return [SceneSpec.plant(name) for name in names]


def _seed(name: str, what: str) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence([zlib.crc32(name.encode()), zlib.crc32(what.encode())]))


def scene_targets(spec: SceneSpec) -> list[Array]:
    """The fixed draw of targets (7,) of a scene: limes of a generated plant, places in the canopy of a scan."""
    scene = scene_of(spec)
    rng = _seed(spec.name, "targets")
    if scene.fruit_centres is not None:
        return lime_targets(scene, rng)
    return canopy_targets(scene, rng, DRAWN_TARGETS)


def _valid_start(problem: Problem, q: Array, *, leaf: bool) -> bool:
    obstacles = problem.obstacles
    if obstacles.robot.limit_violation(q) is not None:
        return False
    clear, own, intensity = measure(obstacles.measuring_space(), q)
    least = obstacles.world.margin if leaf else _CLEAR_START_M
    return clear > least and own > SELF_CLEARANCE_M + 0.005 and (intensity > 0.0) == leaf


def _leaf_start(problem: Problem, others: Sequence[Array]) -> ProblemSpec | None:
    """The same target from a start that is a goal of another target and touches leaves."""
    spec = problem.spec
    for pose in others:
        from_there, _ = find_problem(replace(spec, pose=tuple(pose)))
        if from_there is None:
            continue
        for q in from_there.goals.configurations:
            if _valid_start(problem, q, leaf=True):
                return replace(spec, case="leaf_start", start=tuple(q.tolist()))
    return None


def _far_start(problem: Problem) -> ProblemSpec | None:
    """The same target from the random free start whose nearest goal is farthest."""
    spec, robot = problem.spec, problem.obstacles.robot
    rng = _seed(spec.key, "far")
    best: tuple[float, ProblemSpec] | None = None
    for _ in range(_FAR_STARTS):
        for _ in range(200):
            q = rng.uniform(np.where(robot.continuous, -np.pi, robot.lower), np.where(robot.continuous, np.pi, robot.upper))
            if _valid_start(problem, q, leaf=False):
                break
        else:
            continue
        candidate = replace(spec, case="far", start=tuple(q.tolist()))
        built, _ = find_problem(candidate)
        if built is None:
            continue
        distance = float(np.linalg.norm(built.goals.configurations - q, axis=1).min())
        if best is None or distance > best[0]:
            best = (distance, candidate)
    return None if best is None else best[1]


def _is_narrow(problem: Problem) -> bool:
    space = problem.obstacles.measuring_space()
    return max(measure(space, q)[0] for q in problem.goals.configurations) < NARROW_M


def scene_problems(scene: SceneSpec, cases: Sequence[str], robot: str, refused: list[Refused]) -> Iterator[ProblemSpec]:
    """Go through a scene's targets and yield the problems of the wanted cases; targets without goals are appended to `refused`."""
    start = tuple(home(pipeline_of(robot).robot).tolist())
    poses = scene_targets(scene)
    for number, pose in enumerate(poses):
        spec = ProblemSpec(scene, number, "plain", tuple(np.asarray(pose).tolist()), start, robot)
        problem, reason = find_problem(spec)
        if problem is None:
            refused.append(Refused(spec.key, reason))
            continue
        for case in cases:
            found: ProblemSpec | None = None
            if case == "plain":
                found = spec
            elif case == "narrow" and _is_narrow(problem):
                found = replace(spec, case="narrow")
            elif case == "leaf_start":
                found = _leaf_start(problem, poses[number + 1 :] + poses[:number])
            elif case == "far":
                found = _far_start(problem)
            if found is not None:
                yield found


def choose_problems(
    scenes: Sequence[SceneSpec], count: int, cases: Sequence[str] = ("plain",), robot: str = "kinova_j2s6s200"
) -> tuple[list[ProblemSpec], list[Refused]]:
    """Choose `count` problems, in turn from each scene and case.

    Args:
        scenes: at least one.
        count: how many in all; fewer where the scenes have no more.
        cases: of `CASES`.
        robot: name of the arm.

    Returns:
        The problems, and the targets that were passed over with the reasons.

    Raises:
        ParameterError: no scene, or an unknown case.
    """
    if not scenes:
        raise ParameterError("no scene is given: name scans or generated plants")
    for case in cases:
        if case not in CASES:
            raise ParameterError(f"case {case!r} is none of {', '.join(CASES)}")
    refused: list[Refused] = []
    sources = [iter(scene_problems(scene, (case,), robot, refused)) for case in cases for scene in scenes]
    chosen: list[ProblemSpec] = []
    while sources and len(chosen) < count:
        for source in list(sources):
            found = next(source, None)
            if found is None:
                sources.remove(source)
            elif len(chosen) < count:
                chosen.append(found)
    return chosen, list(dict.fromkeys(refused))
