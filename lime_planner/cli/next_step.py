"""After a refusal: the command to type next, made of the one that was refused, and tried before it is printed."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.parameters import PARAMETERS
from lime_planner.core.status import Status
from lime_planner.pipeline.plausibility import as_large_as_a_plant

if TYPE_CHECKING:
    from lime_planner.collision.exact import ExactChecker
    from lime_planner.core.types import Array
    from lime_planner.pipeline.result import PlanResult
    from lime_planner.robot.model import Robot
    from lime_planner.scene.scene import Scene

_SLOWER = 4.0  # so much longer the next search is
_TRIALS = 10  # commands that are tried at most
_FAR = 10.0  # times the arm's reach: beyond it a length is hardly in metres
_UNITS = (0.001, 0.01)  # metres in a millimetre, in a centimetre
_TURNS_RAD = (0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0)  # of the first joint, to other places to start from
_STARTS = 3  # of them that are tried
_STEPS_M = (0.05, 0.1, 0.15, 0.2)  # by which a plant is moved away from the arm
_COMFORTABLE = 0.6  # of the reach: where fruit is well reached
_OF_VIEW = ("--set", "--params", "--namespace", "--start", "--scale", "--offset")


@dataclass(frozen=True)
class Refused:
    """A plan that was refused, and what it was asked for with.

    Attributes:
        words: the arguments of the command, `plan` first.
        file: the scene's file, empty for a recording.
        scale, offset: how the scene was placed; offset (3,) [m].
        scene: in the planning frame.
        robot: the arm.
        result: what became of it.
        checker: the exact check of what the plan was made in, without anything let go at the target.
    """

    words: tuple[str, ...]
    file: str
    scale: float
    offset: Array
    scene: Scene
    robot: Robot
    result: PlanResult
    checker: Callable[[], ExactChecker]


def next_command(refused: Refused, works: Callable[[Sequence[str]], bool]) -> str:
    """Return a command that is worth a try after a refused plan, empty where nothing is known to help.

    Args:
        refused: the plan.
        works: tells whether a plan's arguments lead to a motion. What asks for more of the same, time or another seed, is not tried first.
    """
    status, words = refused.result.status, list(refused.words)
    if status in (Status.NO_PATH, Status.TIMED_OUT, Status.LEAF_BUDGET_EXCEEDED):
        iterations, seconds = _values(words, "--iterations"), _values(words, "--time")
        if iterations:
            return _command(_replaced(words, "--iterations", [float(iterations[0]) * _SLOWER]))
        budget = float(seconds[0]) if seconds else float(str(PARAMETERS["time_budget_s"].default))
        return _command(_replaced(words, "--time", [budget * _SLOWER]))
    if status is Status.PATH_INVALID:
        return _command(_replaced(words, "--seed", [refused.result.seed % 1000 + 1]))
    if status in (Status.START_INVALID, Status.START_IN_STEM):
        proposed, last = _after_start(refused), _seen(refused)
    elif status in (Status.NO_IK_SOLUTION, Status.GOAL_IN_STEM):
        proposed, last = _after_target(refused), ["scene", "info", refused.file]
    else:
        return ""
    found = next((command for command in itertools.islice(_distinct(proposed, words), _TRIALS) if works(command)), None)
    return _command(found) if found is not None else _command(last) if refused.file else ""


def _after_start(refused: Refused) -> Iterator[list[str]]:
    """Yield commands for an arm that cannot begin where it stands: from home, from elsewhere, with the plant moved, to another target."""
    words = list(refused.words)
    if "--start" in words:
        yield _without(words, "--start")
    for q in itertools.islice(_free_starts(refused), _STARTS):
        yield _replaced(words, "--start", q)
    if refused.file and not {"--target", "--candidates"} & set(words):
        middle = _points(refused.scene).sum(axis=0) * [1.0, 1.0, 0.0]
        away = middle / max(float(np.linalg.norm(middle)), 1e-9)
        for step_m in _STEPS_M:
            yield _replaced(words, "--offset", np.round(refused.offset + step_m * away, 3))
    if "--target" in words:
        yield from _own_targets(refused, words)


def _free_starts(refused: Refused) -> Iterator[Array]:
    """Yield configurations (n,) around the arm's home that touch nothing hard, to two decimals, the nearest first [rad]."""
    robot, checker = refused.robot, refused.checker()
    for turn in _TURNS_RAD:
        q = robot.home.copy()
        q[0] += turn
        q = np.round(q, 2)
        if robot.within_limits(q) and checker.stem_hit(q) is None:
            yield q


def _after_target(refused: Refused) -> Iterator[list[str]]:
    """Yield commands for a target that is not reached: in another unit, with more freedom, at other fruit, with the scene moved."""
    words, target, reach_m = list(refused.words), refused.result.target, refused.robot.reach_m
    if target is None:
        return
    told, far = _values(words, "--target"), float(np.linalg.norm(target.centre)) > _FAR * reach_m
    points = _points(refused.scene)
    nearest_m = float(np.linalg.norm(points, axis=1).min()) if len(points) else 0.0
    in_reach = [f for f in _UNITS if far and float(np.linalg.norm(target.centre)) * f <= reach_m]
    rest = [float(text) for text in told[3:]]
    if target.kind == "pose" and not told and "--bag" not in words:  # the file's own
        rest = matrix_to_pose(target.poses[0])[3:].tolist()
    nearer = [_replaced(words, "--target", [*(f * target.centre), *rest]) for f in in_reach if told or rest]
    nearer += [_replaced(words, "--target", f * target.centre) for f in in_reach if rest and "--freedom" not in words]
    if nearest_m <= reach_m:  # else the scene is in the same unit
        yield from nearer
    if refused.file and nearest_m > reach_m:
        yield from _in_other_units(refused, [words, *nearer, *_own_targets(refused, words)], nearest_m)
        yield from nearer if told else ()
    if target.kind == "pose" and len(told) == 7 and "--freedom" not in words:
        yield _replaced(words, "--target", map(float, told[:3]))
    if target.kind == "pose" and not told and not {"--bag", "--freedom"} & set(words):
        yield [*words, "--freedom", "cone"]
    yield from _own_targets(refused, words)
    if refused.file and not told and "--candidates" not in words:
        for offset in _nearer_offsets(refused, points, target.centre, nearest_m):
            moved = _replaced(words, "--offset", offset)
            yield moved
            if target.kind == "pose" and "--freedom" not in words:
                yield [*moved, "--freedom", "cone"]
            yield from _own_targets(refused, moved)


def _in_other_units(refused: Refused, ways: Sequence[list[str]], nearest_m: float) -> Iterator[list[str]]:
    """Yield commands with the scene, or what it was moved by, in millimetres or centimetres."""
    metres = as_large_as_a_plant(_points(refused.scene), refused.robot)  # then only what it was moved by can be in another unit
    for factor in _UNITS:
        if nearest_m * factor <= refused.robot.reach_m < nearest_m:
            if float(np.linalg.norm(refused.offset)) > _FAR * refused.robot.reach_m:
                yield _replaced(list(refused.words), "--offset", factor * refused.offset)
            for words in () if metres else ways:
                yield _replaced(words, "--scale", [refused.scale * factor])


def _nearer_offsets(refused: Refused, points: Array, centre: Array, nearest_m: float) -> Iterator[Array]:
    """Yield offsets (3,) with which the target comes to where it is well reached [m]."""
    reach_m = refused.robot.reach_m
    flat = centre * [1.0, 1.0, 0.0]
    distance_m = float(np.linalg.norm(flat))
    ahead = flat / distance_m if distance_m > 1e-9 else np.array([1.0, 0.0, 0.0])
    if float(np.linalg.norm(centre)) > _COMFORTABLE * reach_m:
        yield np.round(refused.offset - (distance_m - _COMFORTABLE * reach_m) * ahead, 2)
    if len(points) and nearest_m > reach_m:  # the whole scene: before the arm, its lowest point at the height of the base
        low, high = points.min(axis=0), points.max(axis=0)
        place = np.array([_COMFORTABLE * reach_m, 0.0, 0.0])
        yield np.round(refused.offset + place - [*(0.5 * (low + high))[:2], low[2]], 2)


def _own_targets(refused: Refused, words: list[str]) -> list[list[str]]:
    """Return commands that reach for what the scene itself offers instead."""
    if "--bag" in words:
        return []
    bare = _without(_without(words, "--target"), "--candidates")
    if refused.scene.fruit_centres is not None and len(refused.scene.fruit_centres):
        fruit = _without(_without(bare, "--freedom"), "--fruit")
        return [] if _values(words, "--fruit", "any") else [[*fruit, "--fruit", "any"]]
    return [bare] if refused.scene.target_pose is not None and bare != words else []


def _seen(refused: Refused) -> list[str]:
    """Return the command that shows where the arm stands and what it touches there."""
    kept: list[str] = []
    words = list(refused.words)
    for option in _OF_VIEW:
        for at in [k for k, word in enumerate(words) if word == option]:
            values = _values(words[at:], option) or words[at + 1 : at + 2]
            kept += [option, *values]
    return ["view", refused.file, *kept]


def _points(scene: Scene) -> Array:
    parts = [np.asarray(part, dtype=np.float64) for part in (scene.leaf_points, scene.stem_points, scene.fruit_points)]
    return np.concatenate(parts)


def _distinct(proposed: Iterator[list[str]], refused: list[str]) -> Iterator[list[str]]:
    before = [refused]
    for command in proposed:
        if command not in before:
            before.append(command)
            yield command


def _command(words: Sequence[str]) -> str:
    return shlex.join(["lime-planner", *words])


def _values(words: Sequence[str], option: str, *among: str) -> list[str]:
    """Return the numbers, or of some words those, that follow an option."""
    if option not in words:
        return []
    found = []
    for word in words[list(words).index(option) + 1 :]:
        try:
            float(word)
        except ValueError:
            if word not in among:
                break
        found.append(word)
    return found if not among else [word for word in found if word in among]


def _replaced(words: Sequence[str], option: str, values: Sequence[float] | Array | Iterator[float]) -> list[str]:
    """Return the words with an option's numbers at the end."""
    return [*_without(words, option), option, *(f"{value + 0.0:.6g}" for value in values)]


def _without(words: Sequence[str], option: str) -> list[str]:
    """Return the words without an option and its values: numbers, or one word."""
    if option not in words:
        return list(words)
    at = list(words).index(option)
    count = len(_values(words, option)) or int(at + 1 < len(words) and not words[at + 1].startswith("--"))
    return [*words[:at], *words[at + 1 + count :]]
