"""Targets that a scene itself offers: its fruit, or the pose that came with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError, SceneError
from lime_planner.core.types import Array
from lime_planner.core.validation import floats, shown
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.targets import Target, candidates_target, fruit_target, pose_target
from lime_planner.scene.scene import Scene

_AT_POSE_M = 0.03  # a fruit this close to the scene's target pose is the pose's


def fruit_targets(scene: Scene, which: int | str | npt.ArrayLike, tool: Array) -> list[Target]:
    """Return the fruit that is meant, as targets, in the order in which they are to be tried.

    Args:
        scene: with `fruit_centres` where fruit is named by number or word.
        which: the number of a fruit, `nearest`, `any` (whichever can be reached, nearest first), or a centre (3,) [m].
        tool: (3,) where the tool is, from which distances count [m].

    Raises:
        SceneError: the scene does not say where its fruit is.
        ProblemError: there is no such fruit; the text says which there are.
    """
    if not isinstance(which, (str, int, np.integer)):
        values = floats("fruit", which)
        if values.shape == (3,):
            return [fruit_target(values)]
        raise ProblemError(f"fruit is {shown(which)}; it must be a number of the scene's fruit, `nearest`, `any`, or a centre x y z")
    centres = scene.fruit_centres
    if centres is None or not len(centres):
        raise SceneError("the scene does not know its fruit (fruit_centres); give the centre of one, x y z")
    if isinstance(which, str):
        if which not in ("nearest", "any"):
            raise ProblemError(f"fruit is {which!r}; it must be a number from 0 to {len(centres) - 1}, `nearest`, `any`, or a centre x y z")
        order = np.argsort(np.linalg.norm(centres - tool, axis=1), kind="stable")
        return [_fruit(scene, int(i)) for i in (order if which == "any" else order[:1])]
    if not 0 <= int(which) < len(centres):
        raise ProblemError(f"fruit {which} is not there; the scene has {len(centres)}, numbered from 0 to {len(centres) - 1}")
    return [_fruit(scene, int(which))]


def own_target(scene: Scene, freedom: str, tool: Array) -> Target | None:
    """Return what a scene is about: its target's fruit with the approach free, else its target pose, its candidates.

    Args:
        scene: any.
        freedom: of a pose without a fruit.
        tool: (3,) where the tool is [m].

    Returns:
        The target; None where the scene names none.
    """
    pose, centres = scene.target_pose, scene.fruit_centres
    if centres is not None and len(centres):
        if pose is None:
            return fruit_targets(scene, "nearest", tool)[0]
        apart = np.linalg.norm(centres - pose[:3], axis=1)
        if apart.min() < _AT_POSE_M:
            return _fruit(scene, int(apart.argmin()))
    if pose is not None:
        return pose_target(pose, freedom)
    candidates = scene.grasp_candidates
    return None if candidates is None else candidates_target(candidates)


def plan_first(targets: Sequence[Target], plan: Callable[[Target], PlanResult]) -> PlanResult:
    """Plan to the first of several targets that can be reached; the first one's refusal where none can."""
    first: PlanResult | None = None
    for target in targets:
        result = plan(target)
        if result.succeeded:
            return result
        first = first or result
    if first is None:
        raise ProblemError("there is no target to plan to")
    return first


def _fruit(scene: Scene, number: int) -> Target:
    assert scene.fruit_centres is not None
    radius_m = None if scene.fruit_radii is None else float(scene.fruit_radii[number])
    return fruit_target(scene.fruit_centres[number], radius_m)
