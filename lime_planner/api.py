"""The front door for Python: one call from a scene and an arm to a motion, through the very pipeline of node and command line."""

from __future__ import annotations

import inspect
import os
import threading
import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy.typing as npt

from lime_planner.core.errors import ParameterError, PlausibilityWarning, ProblemError, SceneError
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS, no_parameter, settings_from
from lime_planner.core.types import Array
from lime_planner.core.validation import floats, shown
from lime_planner.output.console import compile_first
from lime_planner.pipeline import Pipeline, PlanResult
from lime_planner.pipeline.context import checked_deadline, checked_start, never
from lime_planner.pipeline.scene_targets import fruit_targets, own_target, plan_first
from lime_planner.pipeline.targets import Target, candidates_target, target_of
from lime_planner.robot.builtin import BUILTIN_ARMS
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

#: Parameters of the robot, and what `Robot.load` calls them.
_OF_THE_ROBOT = {
    "robot": "name_or_path",
    "arm_joints": "joint_names",
    "planning_frame": "planning_frame",
    "tool_frame": "tool_frame",
    "finger_positions": "locked",
}
_ROBOTS_KEPT = 4


@lru_cache(maxsize=_ROBOTS_KEPT)
def _robot_named(name: str) -> Robot:
    return Robot.load(name)


def _robot_of(given: object) -> Robot:
    """Return the robot that was given, loaded once where it is a name; a description in a file is read again, for it may change."""
    if isinstance(given, Robot):
        return given
    if not isinstance(given, str | os.PathLike):
        raise ParameterError(f"robot must be a Robot, the name of a built-in arm or a URDF file, got {shown(given)}")
    name = os.fspath(given)
    return _robot_named(name) if name in BUILTIN_ARMS else Robot.load(name)


def _scene_of(given: object) -> Scene:
    if isinstance(given, Scene):
        return given
    if not isinstance(given, str | os.PathLike):
        raise ParameterError(f"scene must be a Scene or the path of a scene file, got {shown(given)}")
    return Scene.load(given)


@lru_cache(maxsize=_ROBOTS_KEPT)
def _warm_pipeline(robot: Robot) -> tuple[Pipeline, threading.Lock]:
    compile_first()
    pipeline = Pipeline(robot)
    pipeline.warm_up()  # compiling must not eat a plan's time budget
    return pipeline, threading.Lock()


def plan(
    scene: Scene | str | os.PathLike[str],
    robot: Robot | str | os.PathLike[str],
    *,
    target: Target | npt.ArrayLike | None = None,
    fruit: int | str | npt.ArrayLike | None = None,
    candidates: npt.ArrayLike | None = None,
    start: npt.ArrayLike | None = None,
    should_stop: Callable[[], bool] = never,
    deadline_s: float | None = None,
    seed: int | None = None,
    time_budget_s: float | None = None,
    iterations: int | None = None,
    planner: str | None = None,
    leaf_policy: str | None = None,
    grasp_freedom: str | None = None,
    **parameters: Any,
) -> PlanResult:
    """Plan a motion of the arm to a target: around stems, and through as few leaves as it must.

    The first plan with a robot loads the compiled kernels, which takes seconds (a minute or two after an update). Threads may
    call it; plans of one robot wait for each other.

    Args:
        scene: what stands in front of the arm, in the arm's planning frame; or its file.
        robot: the arm, the name of a built-in one, or its URDF file.
        target: pose of the tool at the fruit in the planning frame, as (7,) x y z qx qy qz qw or as a (4, 4) matrix, with the freedom
            that `grasp_freedom` names; three numbers are the centre of a fruit, whose grasp the planner chooses. By default what
            the scene is about: its target's fruit, else its target pose.
        fruit: instead of a target: the number of one of the scene's fruits, `nearest`, `any` (the first that can be reached,
            nearest first), or a centre (3,) [m]. The planner chooses how to grasp it.
        candidates: instead of a target: (P, 7) or (P, 4, 4) poses of the tool, any of which will do; at most 2,000.
        start: (n,) joint angles [rad], turns kept; the arm's ready configuration by default.
        should_stop: True cancels; asked every few milliseconds.
        deadline_s: wall time from now for the whole plan; by default the search has `time_budget_s` and the rest what it needs.
        seed: of the search; by default a random one, which the result names.
        time_budget_s: of the search [s].
        iterations: of the search, in place of a time: with a seed they give the same path everywhere.
        planner: `lime_star`, or one of the paper's.
        leaf_policy: `permeable`, `solid` or `ignored`.
        grasp_freedom: what a target pose leaves open: `exact`, `roll` or `cone`.
        **parameters: any other one by its name, such as `c_perm`, `stem_margin_m`, `keep_out_boxes`; `lime-planner parameters` lists
            them.

    Returns:
        The result, whatever became of it: `result.status` says what, and `result.succeeded` whether there is a motion.

    Warns:
        PlausibilityWarning: about what is hardly meant, such as a scene in millimetres; `result.warnings` has the sentences too.

    Raises:
        SceneError: the scene is in another frame than the arm's, or no target is known.
        ParameterError: an unknown parameter, or a value out of range.
        ProblemError: a target that is none, or more than one, a start of the wrong size, or a deadline that is no time.
    """
    _check_names(parameters)
    robot, scene = _robot_of(robot), _scene_of(scene)
    common = {
        "seed": seed,
        "time_budget_s": time_budget_s,
        "iterations": iterations,
        "planner": planner,
        "leaf_policy": leaf_policy,
        "grasp_freedom": grasp_freedom,
    }
    parameters |= {name: value for name, value in common.items() if value is not None}
    settings = settings_from(parameters)
    if scene.frame_id not in ("", robot.planning_frame):
        raise SceneError(
            f"the scene is in the frame {scene.frame_id!r} and the arm plans in {robot.planning_frame!r}; "
            "if they are the same, set it with dataclasses.replace(scene, frame_id=...)"
        )
    if sum(given is not None for given in (target, fruit, candidates)) > 1:
        raise ProblemError("target, fruit and candidates say what is to be reached; give one of them")
    q_start = robot.home if start is None else checked_start(robot, start)
    checked_deadline(deadline_s)  # all before the kernels are loaded, which takes seconds
    targets = _targets(scene, target, fruit, candidates, settings.grasp_freedom, robot.forward(q_start)[:3, 3])
    pipeline, lock = _warm_pipeline(robot)
    with lock:
        result = plan_first(
            targets,
            lambda one: pipeline.plan(scene, one, q_start, settings, should_stop=should_stop, deadline_s=deadline_s, seed=settings.seed),
        )
    for sentence in (*scene.notes, *result.warnings):
        warnings.warn(sentence, PlausibilityWarning, stacklevel=2)
    return result


def _check_names(parameters: Mapping[str, Any]) -> None:
    """Refuse keywords that `plan` has no use for.

    Raises:
        ParameterError: the text says what may have been meant.
    """
    own = [name for name, given in inspect.signature(plan).parameters.items() if given.kind is not inspect.Parameter.VAR_KEYWORD]
    for name in parameters:
        if name in NODE_PARAMETERS:
            raise ParameterError(f"{name}: only the node has a use for this parameter")
        if name in _OF_THE_ROBOT:
            raise ParameterError(f"{name}: the robot is loaded already; give this to Robot.load as {_OF_THE_ROBOT[name]}")
        if name not in PARAMETERS:
            raise no_parameter(name, [*own, *PARAMETERS])


def _targets(
    scene: Scene,
    target: Target | npt.ArrayLike | None,
    fruit: int | str | npt.ArrayLike | None,
    candidates: npt.ArrayLike | None,
    freedom: str,
    tool: Array,
) -> list[Target]:
    if fruit is not None:
        return fruit_targets(scene, fruit, tool)
    if candidates is not None:
        return [candidates_target(candidates)]
    if target is not None:
        given = target if isinstance(target, Target) else floats("target", target)
        try:
            return [target_of(given, freedom)]
        except ProblemError as error:
            raise ProblemError(f"target: {error}") from None
    own = own_target(scene, freedom, tool)
    if own is None:
        raise SceneError("the scene has no target_pose; give one: target=(x, y, z, qx, qy, qz, qw), or a fruit: fruit=(x, y, z)")
    return [own]


def draw(
    result: PlanResult, scene: Scene | str | os.PathLike[str], robot: Robot | str | os.PathLike[str], path: str | os.PathLike[str]
) -> Path:
    """Draw plant, arm and the tool's path, coloured by leaf contact, from the side and from above.

    Args:
        result: a plan, found or refused.
        scene: the scene it was made in, or its file.
        robot: the arm, as for `plan`.
        path: the picture; `.png`, `.svg` or `.pdf`.

    Returns:
        The picture's path.

    Raises:
        ParameterError: a suffix that is not supported, or a file that cannot be written.
    """
    from lime_planner.output.picture import draw_plan

    if not isinstance(result, PlanResult):
        raise ParameterError(f"result must be what plan returned, got {shown(result)}")
    return draw_plan(result, _scene_of(scene), _robot_of(robot), path)
