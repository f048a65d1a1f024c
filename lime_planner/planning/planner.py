"""What a planner is to the rest of the package: an entry of the table `lime_planner.core.planners.PLANNERS` with this protocol."""

from __future__ import annotations

import importlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ParameterError, ProblemError
from lime_planner.core.parameters import Settings
from lime_planner.core.planners import PLANNERS
from lime_planner.core.status import Status
from lime_planner.core.types import Array, Bool, Int64

OptionsT = TypeVar("OptionsT")

Metric = Literal["integral", "node"]


class Limit(Protocol):
    """Tells whether a search is over, by its iterations, and by whether it has a path where that counts (`Query.patience`)."""

    def __call__(self, iterations: int, found: bool = True) -> Status | None:
        """Return what the end would mean without a path: CANCELLED, NO_PATH, TIMED_OUT; None while the search may go on."""


@dataclass(frozen=True, eq=False)
class Query:
    """What a planner is asked.

    Attributes:
        space: a space of `lime_planner.planning.space` with memory of its own; its counters are written.
        start: (n,) configuration, not yet checked [unit of the space: rad for an arm].
        goals: (G, n) configurations, at least one, most promising first; invalid ones are to be left out.
        seed: of the random generator.
        terminal_costs: (G,) what ending at each goal adds to the cost; None: nothing.
        iterations: budget of sampled configurations of each thread; None for none.
        deadline_s: search time from the call on [s]; None for none.
        patience: share of these budgets after which a search that has found no path may end.
        should_stop: True ends the search; to be asked every few milliseconds, in the calling thread. None: never.
        threads: searches side by side at most.
        another_space: makes another space like `space` with memory of its own, for a further thread; None: one thread alone.
    """

    space: Any
    start: Array
    goals: Array
    seed: int
    terminal_costs: Array | None = None
    iterations: int | None = None
    deadline_s: float | None = None
    patience: float = 1.0
    should_stop: Callable[[], bool] | None = None
    threads: int = 1
    another_space: Callable[[], Any] | None = None

    def limit(self) -> Limit:
        """Start the clock of this query, and return what tells whether the search is over."""
        began_s = time.monotonic()

        def ended(iterations: int, found: bool = True) -> Status | None:
            if self.should_stop is not None and self.should_stop():
                return Status.CANCELLED
            return budget_spent(self.iterations, self.deadline_s, 1.0 if found else self.patience, iterations, time.monotonic() - began_s)

        return ended


def budget_spent(budget: int | None, deadline_s: float | None, share: float, iterations: int, elapsed_s: float) -> Status | None:
    """Return NO_PATH or TIMED_OUT once a share of the iterations or of the time is over, whichever there is; else None."""
    if budget is not None and iterations >= share * budget:
        return Status.NO_PATH
    return Status.TIMED_OUT if deadline_s is not None and elapsed_s >= share * deadline_s else None


@dataclass(frozen=True, eq=False)
class SearchTree:
    """What a search grew, tree or graph.

    Attributes:
        configurations: (V, n); edges: (E, 2) rows of `configurations`.
        leafy: (E,) whether the edge costs more than its length.
    """

    configurations: Array
    edges: Int64
    leafy: Bool


def no_tree() -> SearchTree:
    """The search tree of a planner that keeps none."""
    return SearchTree(np.zeros((0, 0)), np.zeros((0, 2), np.int64), np.zeros(0, np.bool_))


@dataclass(frozen=True, eq=False)
class Outcome:
    """A path from a search, or why there is none.

    Attributes:
        path: (M, n) start to goal, or None.
        status: SUCCEEDED, or NO_PATH, TIMED_OUT, CANCELLED (also with a path), START_INVALID, GOAL_IN_STEM.
        iterations: configurations sampled; the most of any thread, so that it is the budget that repeats the search.
        checks: configurations checked, inside edges included.
        first_path_s: search time until the first path [s], NaN if unknown.
        history: (K, 3) time [s], iterations and J at each improvement; empty where the planner keeps none.
        tree: makes the search tree, for those who want to see it.
    """

    path: Array | None
    status: Status
    iterations: int
    checks: int
    first_path_s: float = float("nan")
    history: Array = field(default_factory=lambda: np.zeros((0, 3)))
    tree: Callable[[], SearchTree] = no_tree


class Planner(ABC, Generic[OptionsT]):
    """One planner.

    Attributes:
        name: in the table and in the parameter `planner`.
        summary: one sentence.
        anytime: whether its best path's J never rises, and `Outcome.history` says when it fell.
        warm_iterations: budget that passes through every part of an easy search, so that everything is compiled.
    """

    name: str
    summary: str
    anytime: bool = False
    warm_iterations: int = 50

    @abstractmethod
    def options(self, settings: Settings) -> OptionsT:
        """Return its options as the parameters have them."""

    @abstractmethod
    def run(self, query: Query, options: OptionsT) -> Outcome:
        """Search.

        Raises:
            ProblemError: malformed start or goals, or no limit.
        """

    def metric(self, settings: Settings) -> Metric:
        """What its cost is: `integral` (J = length + weight · ∫ leaf ds) or `node` (length + C_perm × nodes in leaves)."""
        return "integral"

    def warm_up(self, space: Any) -> None:
        """Compile what an easy search (see `warm_iterations`) passes by."""


@dataclass(frozen=True, eq=False)
class Ends:
    """Start and goals of a query as arrays of a search.

    Attributes:
        start: (n,); goals: (G, n); terminal: (G,) what ending at each adds to the cost.
    """

    start: Array
    goals: Array
    terminal: Array


def checked_ends(space: Any, start: npt.ArrayLike, goals: npt.ArrayLike, terminal_costs: npt.ArrayLike | None) -> Ends:
    """Return start and goals as arrays.

    Raises:
        ProblemError: malformed start, goals or terminal costs.
    """
    n = len(space.lower)
    q_start = np.ascontiguousarray(start, dtype=np.float64)
    q_goals = np.ascontiguousarray(np.atleast_2d(np.asarray(goals, dtype=np.float64)))
    if q_start.shape != (n,) or q_goals.ndim != 2 or q_goals.shape[1] != n or len(q_goals) == 0:
        raise ProblemError(f"start needs {n} numbers and goals {n} each, got shapes {q_start.shape} and {q_goals.shape}")
    if not (np.isfinite(q_start).all() and np.isfinite(q_goals).all()):
        raise ProblemError("start or goals have numbers that are not finite")
    terminal = np.zeros(len(q_goals)) if terminal_costs is None else np.ascontiguousarray(terminal_costs, dtype=np.float64)
    if terminal.shape != (len(q_goals),) or not (np.isfinite(terminal).all() and (terminal >= 0.0).all()):
        raise ProblemError(f"{len(q_goals)} goals need as many terminal costs, finite and not negative, got {terminal.tolist()}")
    return Ends(q_start, q_goals, terminal)


def checked_limits(iterations: int | None, deadline_s: float | None, should_stop: Callable[[], bool] | None) -> None:
    """Refuse a search without an end.

    Raises:
        ProblemError: no limit is given.
    """
    if iterations is None and deadline_s is None and should_stop is None:
        raise ProblemError("give iterations, deadline_s or should_stop: the search has no end of its own")


def load_planner(name: str) -> Planner[Any]:
    """Return the planner of a name, imported when it is first asked for.

    Raises:
        ParameterError: there is none of this name.
    """
    if name not in PLANNERS:
        raise ParameterError(f"planner is {name!r}; allowed: one of {', '.join(PLANNERS)}")
    module, _, attribute = PLANNERS[name].partition(":")
    planner: Planner[Any] = getattr(importlib.import_module(module), attribute)
    return planner
