"""Exceptions. Callers' mistakes have a class of their own each; `Refusal` carries a status to where a request is answered."""

from __future__ import annotations

from lime_planner.core.status import Status


class LimePlannerError(Exception):
    """Base of everything this package raises on purpose; its text is one sentence for a user."""


class Refusal(LimePlannerError):
    """A request cannot be served, or a plan ends early: `status` is the code of the answer, the text its sentence.

    Raised where that is found out and caught where the request is answered; success is never raised.
    """

    def __init__(self, status: Status, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


class PlausibilityWarning(UserWarning):
    """What a plan in Python was asked for with is hardly meant: lengths in another unit, another axis, labels without a meaning."""


class SceneError(LimePlannerError, ValueError):
    """A scene file or a cloud that cannot be used; the text names the file, the field and what was expected."""


class RobotError(LimePlannerError, ValueError):
    """A robot description that cannot be used; the text names the joint, link or frame and the valid alternatives."""


class ParameterError(LimePlannerError, ValueError):
    """A parameter outside its range; the text names the parameter, the value and the limit."""


class UsageError(ParameterError):
    """Options of a command that are missing or do not go together: the command line answers with the exit status of wrong usage."""


class ProblemError(LimePlannerError, ValueError):
    """A malformed planning call: wrong shape, not finite; the text names the argument."""
