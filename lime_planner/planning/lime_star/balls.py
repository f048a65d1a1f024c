"""Closed balls in configuration space, for searches that keep away from them."""

from __future__ import annotations

from typing import Any

from lime_planner.core.jit import kernel


@kernel
def passes(a: Any, b: Any, balls: Any) -> bool:
    """Whether a straight line meets one of the balls (B, n + 1): centre and radius."""
    n = a.shape[0]
    for i in range(balls.shape[0]):
        along = 0.0
        length = 0.0
        for k in range(n):
            along += (balls[i, k] - a[k]) * (b[k] - a[k])
            length += (b[k] - a[k]) ** 2
        share = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
        gap = 0.0
        for k in range(n):
            gap += (a[k] + share * (b[k] - a[k]) - balls[i, k]) ** 2
        if gap < balls[i, n] ** 2:
            return True
    return False
