"""After a refusal: the command to type next, made of the one that was refused."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from lime_planner.core.parameters import PARAMETERS
from lime_planner.core.status import Status

_SLOWER = 4.0  # so much longer the next search is


def next_command(words: Sequence[str], scene: str, status: Status, figures: Mapping[str, Any]) -> str:
    """Return a command that is worth a try after a refused plan, empty where nothing is known to help.

    Args:
        words: the arguments of the refused command, `plan` first.
        scene: the scene's file, empty for a recording.
        status: its outcome.
        figures: its figures, as `--json` has them.
    """
    kind = figures.get("target_kind")
    told = _values(words, "--target")
    if status in (Status.START_INVALID, Status.START_IN_STEM):
        return _command(_without(words, "--start")) if "--start" in words else ""
    if status in (Status.NO_IK_SOLUTION, Status.GOAL_IN_STEM):
        if kind == "pose" and len(told) == 7 and "--freedom" not in words:
            return _command(_without(words, "--target"), "--target", *told[:3])
        if kind == "pose" and not told and "--bag" not in words:
            return _command(words, "--freedom", "cone")
        if kind == "fruit" and "--fruit" not in words and not told:
            return _command(words, "--fruit", "any")
        return _command(["scene", "info", scene]) if scene else ""
    if status in (Status.NO_PATH, Status.TIMED_OUT, Status.LEAF_BUDGET_EXCEEDED):
        iterations, seconds = _values(words, "--iterations"), _values(words, "--time")
        if iterations:
            return _command(_without(words, "--iterations"), "--iterations", f"{float(iterations[0]) * _SLOWER:.0f}")
        budget = float(seconds[0]) if seconds else float(str(PARAMETERS["time_budget_s"].default))
        return _command(_without(words, "--time"), "--time", f"{budget * _SLOWER:g}")
    if status is Status.PATH_INVALID:
        return _command(_without(words, "--seed"), "--seed", str(int(figures.get("seed", 0)) % 1000 + 1))
    return ""


def _command(words: Sequence[str], *more: str) -> str:
    return shlex.join(["lime-planner", *words, *more])


def _values(words: Sequence[str], option: str) -> list[str]:
    """Return the numbers that follow an option."""
    if option not in words:
        return []
    found = []
    for word in words[list(words).index(option) + 1 :]:
        try:
            float(word)
        except ValueError:
            break
        found.append(word)
    return found


def _without(words: Sequence[str], option: str) -> list[str]:
    """Return the words without an option and its values."""
    if option not in words:
        return list(words)
    at = list(words).index(option)
    return [*words[:at], *words[at + 1 + len(_values(words, option)) :]]
