"""Options and outcome of the default planner."""

from __future__ import annotations

from dataclasses import dataclass, field

from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.planning.lime_star.roadmap import Roadmap


@dataclass(frozen=True)
class LimeOptions:
    """Settings of the default planner.

    Attributes:
        weight: cost of one unit of length at leaf intensity 1 [1/rad].
        tracks: paths that are polished side by side.
        batch: roadmap samples between two searches of it.
        polish: polishing trials for each roadmap sample and dimension.
        connect_samples: random configurations for one attempt to reach one goal.
        least_step, most_step: range of the random moves, as shares of the sampling box's diagonal.
    """

    weight: float = 1000.0
    tracks: int = 6
    batch: int = 50
    polish: float = 0.5
    connect_samples: int = 150
    least_step: float = 0.003
    most_step: float = 0.1


@dataclass(frozen=True)
class LimeOutcome:
    """What a run gave.

    Attributes:
        path: (M, n) start to goal, None if none was found; cost: its J, the goal's terminal cost included.
        status: SUCCEEDED, or NO_PATH, TIMED_OUT, CANCELLED (also with a path), START_INVALID, GOAL_IN_STEM.
        iterations: configurations sampled, by whatever part; the most of any thread.
        states_checked, edges_checked: work done.
        first_path_s: time from the call until the first path [s], NaN without.
        history: (K, 3) time [s], iterations and cost at each improvement.
        road: the roadmap, None where no search began.
    """

    path: Array | None = field(repr=False)
    cost: float
    status: Status
    iterations: int
    states_checked: int
    edges_checked: int
    first_path_s: float
    history: Array = field(repr=False)
    road: Roadmap | None = field(default=None, repr=False)
