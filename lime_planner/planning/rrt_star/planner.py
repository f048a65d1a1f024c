"""The three planners of the paper: RRT*, APF-RRT* and P-RRT*, cost-based (section III, algorithm 1; section IV-B).

One loop serves all three (`lime_planner.planning.rrt_star.kernels`); every choice that the paper leaves open is an option. They run on
any space of `lime_planner.planning.space`: the plane, the arm, or functions of the caller's own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.status import Status
from lime_planner.core.types import Array, Int64
from lime_planner.planning.rrt_star import kernels
from lime_planner.planning.rrt_star.growth import Growth
from lime_planner.planning.rrt_star.options import PaperOptions
from lime_planner.planning.rrt_star.tree import Tree, trace
from lime_planner.planning.space import one

__all__ = ["PaperOptions", "PaperOutcome", "Snapshot", "plan_paper"]


_SLICE_S = 0.004  # aim of one slice of compiled iterations; cancel and deadline are looked at in between
_FIRST_SLICE = 8
_LARGEST_SLICE = 4096


@dataclass(frozen=True)
class Snapshot:
    """The best path after a number of iterations of one run.

    Attributes:
        iterations: iterations done, rejected ones included.
        elapsed_s: planning time until then.
        nodes: nodes in the tree.
        path: start to goal, (M, n), or None.
        goal_index: which goal it ends at, -1 without a path.
        stored_cost: the planner's own cost of it (stale where costs are not propagated), inf without a path.
        node_cost: the paper's metric, length + C_perm × Σ intensity of its nodes (section IV), from the traced path itself.
        integral_cost: J = length + weight × length inside leaves, inf where an edge goes through an impermeable obstacle.
        length: its length.
        nodes_inside: its nodes in leaves.
    """

    iterations: int
    elapsed_s: float
    nodes: int
    path: Array | None = field(repr=False)
    goal_index: int
    stored_cost: float
    node_cost: float
    integral_cost: float
    length: float
    nodes_inside: int


@dataclass(frozen=True)
class PaperOutcome:
    """What a run of a paper planner gave.

    Attributes:
        status: SUCCEEDED; NO_PATH or TIMED_OUT without a path; CANCELLED; START_INVALID; GOAL_IN_STEM: no goal is valid.
        final: the state at the end.
        snapshots: the states at the iteration marks that were reached, in order.
        tree: the arrays of the tree, cut to its size.
        seed: the seed, or None where a generator was passed in.
        counters: what the space counted during the run (`lime_planner.planning.space`).
    """

    status: Status
    final: Snapshot
    snapshots: tuple[Snapshot, ...]
    tree: Tree = field(repr=False)
    seed: int | None
    counters: Int64 = field(repr=False)

    @property
    def path(self) -> Array | None:
        """Start to goal, (M, n), or None."""
        return self.final.path


def _configurations(values: npt.ArrayLike, name: str, n: int) -> Array:
    array = np.array(values, dtype=np.float64, ndmin=2)
    if array.ndim != 2 or array.shape[1] != n or not len(array):
        raise ProblemError(f"{name} must have {n} numbers for each configuration, got shape {np.shape(values)}")
    if not np.isfinite(array).all():
        raise ProblemError(f"{name} has a number that is not finite: {array.tolist()}")
    return array


class _Run(Growth):
    """One search: the tree, the sample stream and the clock."""

    def __init__(
        self, space: Any, start: Array, goals: Array, terminal: Array, options: PaperOptions, rng: np.random.Generator, capacity: int
    ) -> None:
        super().__init__(space, start, goals, options, capacity)
        self.rng, self.terminal = rng, terminal
        self.lower, self.width = np.asarray(space.lower), np.asarray(space.upper) - np.asarray(space.lower)
        self.iterations = 0
        # Compile (or load) everything before the clock starts.
        self.grow(0)
        kernels.best_goal(self.space, self.rules, goals[:0], terminal[:0], self.tree)
        kernels.measure(self.space, np.empty((0, len(start))), 1.0)
        self.began_s = time.monotonic()

    def elapsed_s(self) -> float:
        return time.monotonic() - self.began_s

    def grow(self, count: int) -> None:
        n = len(self.lower)
        # One row of the stream for each iteration, so that the size of a slice does not matter.
        biased = self.options.goal_bias > 0.0
        uniform = self.rng.random((count, n + 2 if biased else n))
        samples = self.lower + self.width * uniform[:, :n]
        if biased:
            towards = uniform[:, n] < self.options.goal_bias
            samples[towards] = self.goals[(uniform[towards, n + 1] * len(self.goals)).astype(int)]
        self.extend(samples)
        self.iterations += count

    def snapshot(self) -> Snapshot:
        node, goal, stored = kernels.best_goal(self.space, self.rules, self.goals, self.terminal, self.tree)
        common = (self.iterations, self.elapsed_s(), int(self.tree.size[0]))
        if node < 0:
            return Snapshot(*common, None, -1, math.inf, math.inf, math.inf, math.inf, 0)
        path = np.concatenate([trace(self.tree, node), self.goals[goal : goal + 1]])
        length, intensities, inside, integral = kernels.measure(self.space, path, self.rules.weight)
        node_cost = length + self.options.c_perm * intensities
        return Snapshot(*common, path, int(goal), float(stored), float(node_cost), float(integral), float(length), int(inside))


def plan_paper(
    space: Any,
    start: npt.ArrayLike,
    goals: npt.ArrayLike,
    options: PaperOptions,
    seed: int | np.random.Generator,
    *,
    terminal_costs: npt.ArrayLike | None = None,
    iterations: int | None = None,
    should_stop: Callable[[], bool] | None = None,
    deadline_s: float | None = None,
    marks: Sequence[int] = (),
) -> PaperOutcome:
    """Plan with one of the paper's algorithms.

    Equal arguments with an equal seed and an iteration budget give equal results. `should_stop` and the deadline are looked at
    every few milliseconds; the time of compilation on a first call is outside the deadline.

    Args:
        space: a space of `lime_planner.planning.space`; its `counters` are written.
        start: configuration, (n,) [unit of the space: rad for an arm].
        goals: one configuration (n,) or several (G, n); invalid ones are left out.
        options: algorithm, gains and readings.
        seed: a seed, or a generator to draw from.
        terminal_costs: (G,) finite and not negative, what ending at each goal adds to the cost; zeros by default.
        iterations: budget; rejected iterations count. None: until the deadline or `should_stop`.
        should_stop: returns True to cancel.
        deadline_s: planning time from this call on [s].
        marks: iteration numbers of one and the same run at which a snapshot is kept.

    Raises:
        ProblemError: malformed start, goals, terminal costs, budget or marks.
    """
    n = len(space.lower)
    starts, goal_array = _configurations(start, "start", n), _configurations(goals, "goals", n)
    if len(starts) != 1:
        raise ProblemError(f"start must be one configuration, got {len(starts)}")
    terminal = np.zeros(len(goal_array)) if terminal_costs is None else np.ascontiguousarray(terminal_costs, dtype=np.float64)
    if terminal.shape != (len(goal_array),) or not (np.isfinite(terminal).all() and (terminal >= 0.0).all()):
        raise ProblemError(f"{len(goal_array)} goals need as many terminal costs, finite and not negative, got {terminal.tolist()}")
    if iterations is None and deadline_s is None and should_stop is None:
        raise ProblemError("give iterations, deadline_s or should_stop: the search has no end of its own")
    if iterations is not None and iterations < 0:
        raise ProblemError(f"iterations must not be negative, got {iterations}")
    wanted = sorted({int(m) for m in marks})
    if wanted and wanted[0] < 1:
        raise ProblemError(f"marks must be positive iteration numbers, got {wanted[0]}")
    generator = seed if isinstance(seed, np.random.Generator) else np.random.default_rng(seed)

    counters_before = np.array(space.counters)
    capacity = min(iterations if iterations is not None else 2000, 20_000) + 1
    handle = space.handle()
    valid = np.array([one(handle, g) >= 0.0 for g in goal_array])
    used = valid if valid.any() else np.ones(len(goal_array), dtype=bool)
    run = _Run(space, starts[0], goal_array[used], terminal[used], options, generator, capacity)
    if one(handle, starts[0]) < 0.0:
        return _outcome(run, Status.START_INVALID, (), seed, counters_before)
    if not valid.any():
        return _outcome(run, Status.GOAL_IN_STEM, (), seed, counters_before)

    status, snapshots = _search(run, iterations, should_stop, deadline_s, wanted)
    return _outcome(run, status, tuple(snapshots), seed, counters_before)


def _search(
    run: _Run, iterations: int | None, should_stop: Callable[[], bool] | None, deadline_s: float | None, marks: list[int]
) -> tuple[Status, list[Snapshot]]:
    """Grow in slices until a limit is reached; the status is what the end would mean without a path."""
    snapshots: list[Snapshot] = []
    size = float(_FIRST_SLICE)
    ends = [m for m in marks if iterations is None or m <= iterations]
    while iterations is None or run.iterations < iterations:
        if should_stop is not None and should_stop():
            return Status.CANCELLED, snapshots
        remaining_s = math.inf if deadline_s is None else deadline_s - run.elapsed_s()
        if remaining_s <= 0.0:
            return Status.TIMED_OUT, snapshots
        stop = ends[0] if ends else iterations
        count = max(int(size), 1) if stop is None else min(max(int(size), 1), stop - run.iterations)
        before_s = run.elapsed_s()
        run.grow(count)
        spent_s = max(run.elapsed_s() - before_s, 1e-6)
        size = min(count * min(_SLICE_S, remaining_s) / spent_s, 2.0 * max(size, count), _LARGEST_SLICE)
        if ends and run.iterations == ends[0]:
            snapshots.append(run.snapshot())
            ends.pop(0)
    return Status.NO_PATH, snapshots


def _outcome(
    run: _Run, status: Status, snapshots: tuple[Snapshot, ...], seed: int | np.random.Generator, counters_before: Int64
) -> PaperOutcome:
    ended_at_mark = bool(snapshots) and snapshots[-1].iterations == run.iterations
    final = snapshots[-1] if ended_at_mark else run.snapshot()
    if final.path is not None and status in (Status.NO_PATH, Status.TIMED_OUT):
        status = Status.SUCCEEDED
    size = int(run.tree.size[0])
    cut = {name: getattr(run.tree, name)[:size] for name in run.tree._fields if name not in ("size", "columns", "squared")}
    tree = run.tree._replace(**cut, columns=run.tree.columns[:, :size])
    return PaperOutcome(
        status=status,
        final=final,
        snapshots=snapshots,
        tree=tree,
        seed=None if isinstance(seed, np.random.Generator) else seed,
        counters=np.asarray(run.space.counters - counters_before),
    )
