"""Uniform samples: in the sampling box, or in the ellipsoid of the paths between two configurations that are shorter than a bound.

Every such path lies inside it, and where it is smaller than the sampling box nothing else need be sampled (Informed RRT*, Gammell,
Srinivasa and Barfoot 2014). The bound is a cost: no cost is below the length.
"""

from __future__ import annotations

import math
from typing import Any

from lime_planner.core.jit import kernel
from lime_planner.planning.sampling import normal, uniform
from lime_planner.planning.space import distance


@kernel
def draw_in_box(space: Any, random: Any, q: Any) -> None:
    """Draw uniformly in the sampling box into q, (n,)."""
    for k in range(q.shape[0]):
        q[k] = space.lower[k] + uniform(random) * (space.upper[k] - space.lower[k])


@kernel
def draw_between(space: Any, a: Any, b: Any, bound: float, random: Any, q: Any) -> float:
    """Draw uniformly in the ellipsoid with foci a and b, (n,), into q, (n,), which may lie outside the box.

    Returns:
        The ellipsoid's volume over the sampling box's; 0, and nothing is drawn, where it is empty or larger than that.
    """
    n = q.shape[0]
    apart = distance(space, a, b)
    if not apart < bound or bound == math.inf:
        return 0.0
    along = 0.5 * bound
    across = 0.5 * math.sqrt((bound - apart) * (bound + apart))
    # Volumes, by their logarithms: that of the unit ball is pi^(n/2) / gamma(n/2 + 1).
    volume = 0.5 * n * math.log(math.pi) - math.lgamma(0.5 * n + 1.0) + math.log(along) + (n - 1) * math.log(across)
    for k in range(n):
        volume -= math.log(space.upper[k] - space.lower[k])
    if volume > 0.0:
        return 0.0
    total = 0.0
    for k in range(n):
        q[k] = normal(random)
        total += q[k] * q[k]
    radius = uniform(random) ** (1.0 / n) / math.sqrt(total)
    q[0] *= radius * along
    for k in range(1, n):
        q[k] *= radius * across
    # The first axis is turned into b - a by a reflection, which the ellipsoid does not notice: about u - e, for the unit vector u of
    # b - a and the first axis e, or about u + e where that is longer (no division by next to nothing).
    if apart > 0.0:
        sign = 1.0 if b[0] >= a[0] else -1.0
        dot = q[0] * ((b[0] - a[0]) / apart + sign)
        for k in range(1, n):
            dot += q[k] * (b[k] - a[k]) / apart
        scale = dot / (1.0 + sign * (b[0] - a[0]) / apart)
        q[0] -= scale * ((b[0] - a[0]) / apart + sign)
        for k in range(1, n):
            q[k] -= scale * (b[k] - a[k]) / apart
    for k in range(n):
        q[k] += 0.5 * (a[k] + b[k])
    return math.exp(volume)
