"""Exceptions for callers' mistakes. Outcomes of planning are not exceptions: they are `lime_planner.core.status.Status`."""

from __future__ import annotations


class LimePlannerError(Exception):
    """Base of everything this package raises on purpose; its text is one sentence for a user."""


class SceneError(LimePlannerError, ValueError):
    """A scene file or a cloud that cannot be used; the text names the file, the field and what was expected."""


class RobotError(LimePlannerError, ValueError):
    """A robot description that cannot be used; the text names the joint, link or frame and the valid alternatives."""


class ParameterError(LimePlannerError, ValueError):
    """A parameter outside its range; the text names the parameter, the value and the limit."""


class UsageError(ParameterError):
    """Options of a command that are missing or do not go together; the exit status is 2, as for every wrong usage."""

    exit_status = 2


class ProblemError(LimePlannerError, ValueError):
    """A malformed planning call: wrong shape, not finite; the text names the argument."""
