"""Random numbers inside compiled code: one generator whose state is an array, so that a search can stop and go on.

SplitMix64 (Steele, Lea and Flood 2014): a counter and a mixing function; passes BigCrush, and any seed is good.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from lime_planner.core.jit import hot_kernel

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
