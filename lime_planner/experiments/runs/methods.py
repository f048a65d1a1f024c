"""What experiments on plants with several methods check and read alike."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Protocol

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import Settings, parse_assignment
from lime_planner.scene.plants.generator import DENSITIES


class MethodOptions(Protocol):
    """Options of such an experiment."""

    @property
    def densities(self) -> tuple[str, ...]:
        """Foliage of the plants."""

    @property
    def methods(self) -> tuple[str, ...]:
        """Names, each with changed parameters after a colon."""

    def settings(self, method: str) -> Settings:
        """Return a method's settings."""


def check_options(options: MethodOptions, least: Mapping[str, int]) -> None:
    """Check numbers, densities and methods.

    Args:
        options: what to check.
        least: smallest value of each number, by its name.

    Raises:
        ParameterError: names the field, its value and what is allowed.
    """
    for name, smallest in least.items():
        if getattr(options, name) < smallest:
            raise ParameterError(f"{name} must be at least {smallest}, got {getattr(options, name)}")
    if unknown := [v for v in options.densities if v not in DENSITIES]:
        raise ParameterError(f"densities: {unknown[0]!r} is none of {', '.join(DENSITIES)}")
    for method in options.methods:
        options.settings(method)


def split_method(method: str, known: Collection[str]) -> tuple[str, dict[str, Any]]:
    """Return the name of a method `NAME:PARAMETER=VALUE,...` and the parameters that it changes.

    Raises:
        ParameterError: an unknown method, or parameter after its colon.
    """
    name, _, changes = method.partition(":")
    if name not in known:
        raise ParameterError(f"method {name!r} is none of {', '.join(known)}")
    return name, dict(parse_assignment(text) for text in changes.split(",") if text)
