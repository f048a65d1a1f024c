"""One configuration or one edge of a space, for callers outside compiled code."""

from __future__ import annotations

from typing import Any

from lime_planner.core.jit import kernel
from lime_planner.planning.space import edge, evaluate


@kernel
def one(space: Any, q: Any) -> Any:
    """Evaluate one configuration (`space.evaluate`)."""
    return evaluate(space, q)


@kernel
def line(space: Any, a: Any, b: Any, weight: float, bound: float) -> Any:
    """Evaluate one edge (`space.edge`)."""
    return edge(space, a, b, weight, bound)
