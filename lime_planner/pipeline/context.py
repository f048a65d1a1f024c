"""What the steps of a plan share: how one ends early, the clock, and the check of a caller's arguments."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError, Refusal
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.core.validation import floats, shown
from lime_planner.robot.model import Robot


class Clock:
    """Wall time of the phases of one plan."""

    def __init__(self) -> None:
        """Start now."""
        self.began = self.last = time.monotonic()
        self.phases: dict[str, float] = {}

    def lap(self, phase: str) -> None:
        """Count the time since the last lap to a phase [s]."""
        now = time.monotonic()
        self.phases[phase] = self.phases.get(phase, 0.0) + now - self.last
        self.last = now

    def elapsed(self) -> float:
        """Time since the start [s]."""
        return time.monotonic() - self.began


def never() -> bool:
    """The `should_stop` of a caller who never cancels."""
    return False


def ask(should_stop: Callable[[], bool]) -> None:
    """Raise `Refusal` with CANCELLED if the caller wants to stop."""
    if should_stop():
        raise Refusal(Status.CANCELLED, "the request was stopped")


def checked_start(robot: Robot, q: npt.ArrayLike) -> Array:
    """Return a configuration as an array (n,) [rad].

    Raises:
        ProblemError: not n finite numbers.
    """
    values = floats("the start", q)
    if values.shape != (robot.n,) or not np.isfinite(values).all():
        raise ProblemError(f"the start needs {robot.n} finite joint angles, got {values.tolist()}")
    return values


def checked_target(T_base_tool: npt.ArrayLike) -> Array:
    """Return a pose as an array (4, 4).

    Raises:
        ProblemError: not finite, of another shape, or no pose.
    """
    T = floats("the target", T_base_tool)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise ProblemError(f"the target needs a finite 4 x 4 pose, got {T.tolist()}")
    if abs(np.linalg.det(T[:3, :3]) - 1.0) > 1e-3 or not np.allclose(T[3], [0, 0, 0, 1]):
        raise ProblemError("the target's upper left 3 x 3 block is not a rotation")
    return T


def checked_deadline(deadline_s: Any) -> float | None:
    """Return a time from now [s], which may be over, or None where there is no end.

    Raises:
        ProblemError: neither a number nor None; nan is no time either.
    """
    if deadline_s is None:
        return None
    if isinstance(deadline_s, bool) or not isinstance(deadline_s, Real) or math.isnan(deadline_s):
        raise ProblemError(f"deadline_s must be a time in seconds or None, got {shown(deadline_s)}")
    return None if deadline_s == math.inf else float(deadline_s)
