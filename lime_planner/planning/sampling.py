"""Random numbers and random configurations inside compiled code.

One generator whose state is an array, so that a search can stop and go on: SplitMix64 (Steele, Lea and Flood 2014), a counter and a
mixing function; passes BigCrush, and any seed is good.

Configurations are drawn uniformly in the sampling box, or in the ellipsoid of the paths between two configurations that are shorter
than a bound. Every such path lies inside it, and where it is smaller than the sampling box nothing else need be sampled (Informed
RRT*, Gammell, Srinivasa and Barfoot 2014). The bound is a cost: no cost is below the length.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.jit import hot_kernel, kernel
from lime_planner.planning.space import distance

State = npt.NDArray[np.uint64]


def random_state(seed: int) -> State:
    """Return the state (1,) of a generator, well spread even for neighbouring seeds."""
    return np.asarray(np.random.SeedSequence(seed).generate_state(1, np.uint64), dtype=np.uint64)


@hot_kernel
def uniform(state: State) -> float:
    """Draw from [0, 1)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16


@hot_kernel
def normal(state: State) -> float:
    """Draw from the standard normal distribution (Box and Muller)."""
    return math.sqrt(-2.0 * math.log(1.0 - uniform(state))) * math.cos(2.0 * math.pi * uniform(state))


@hot_kernel
def below(state: State, n: int) -> int:
    """Draw an integer from 0 to n - 1."""
    return min(int(uniform(state) * n), n - 1)


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
