"""What `lime-planner bench kernels` times, each case by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from benchmarks.planner_runs import CLOCKS, options_of, run_anytime, warm_up
from benchmarks.problem_sets import choose_problems
from benchmarks.timing import Timing, repeat
from lime_planner.collision.distance_fields import build_fields
from lime_planner.collision.edge_cost import arm_check, arm_edge
from lime_planner.collision.fast import SELF
from lime_planner.collision.self_contact import SELF_CLEARANCE_M
from lime_planner.core.jit import kernel
from lime_planner.core.planners import DEFAULT_PLANNER
from lime_planner.core.types import Array
from lime_planner.experiments.problems import Problem, ProblemSpec, SceneSpec, build_problem, pipeline_of, scene_of
from lime_planner.pipeline.obstacles import prepare
from lime_planner.pipeline.spots import spot_at
from lime_planner.planning.rrt_star.planner import plan_paper
from lime_planner.robot.kinematics import forward_kinematics
from lime_planner.scene.scene import Scene

PLANT = SceneSpec("medium-1", density="medium", seed=1)  # 59,000 leaf points, 6,600 on wood
CONFIGURATIONS = 400
NEAR_CANOPY_M = 0.15  # configurations are near the canopy when some body is this close to a leaf
EDGE_RAD = 0.3
CHECK_TARGET_S, FIELDS_TARGET_S, PAPER_TARGET_S, FIRST_PATH_TARGET_S = 2e-6, 0.12, 25e-3, 50e-3
PAPER_ITERATIONS = 1500
_FIRST_PATH_BUDGET_S = 0.5


@kernel
def _check_all(space: Any, rows: Any, valid: Any) -> int:
    count = 0
    for i in range(rows.shape[0]):
        ok = arm_check(space, rows[i], True)
        valid[i] = ok
        count += 1 if ok else 0
    return count


@kernel
def _check_again(space: Any, q: Any, times: int) -> int:
    count = 0
    for _ in range(times):
        count += 1 if arm_check(space, q, True) else 0
    return count


@kernel
def _forward_all(chain: Any, rows: Any, poses: Any) -> float:
    total = 0.0
    for i in range(rows.shape[0]):
        forward_kinematics(chain, rows[i], poses)
        total += poses[poses.shape[0] - 1, 0, 3]
    return total


@kernel
def _edge_again(space: Any, a: Any, b: Any, weight: float, times: int) -> float:
    total = 0.0
    for _ in range(times):
        total += arm_edge(space, a, b, weight, np.inf)
    return total


def _median_of(function: Callable[[], Any], calls: int, samples: int = 3) -> float:
    return repeat("", "", function, samples=samples, calls=calls).quantile(0.5)


@dataclass(eq=False)
class Bench:
    """A plant with configurations near its canopy.

    Attributes:
        problem: a target on the plant; rows: (400, n) valid configurations near the canopy; mixed: (400, n) as a search meets them.
        repeats: samples of each timing.
    """

    repeats: int
    problem: Problem = field(init=False)
    rows: Array = field(init=False)
    mixed: Array = field(init=False)

    def __post_init__(self) -> None:
        """Draw the configurations: around goal configurations of every lime, and keep those near leaves."""
        rng = np.random.default_rng(0)
        specs = choose_problems([PLANT], 8)[0]
        self.problem = build_problem(specs[0])
        space = self.problem.space()._replace(lower=np.full(6, -1e9), upper=np.full(6, 1e9))
        centres = np.concatenate([build_problem(s).goals.configurations for s in specs])
        kept: list[Array] = []
        drawn: list[Array] = []
        valid = np.zeros(1, np.bool_)
        while len(kept) < CONFIGURATIONS or len(drawn) < CONFIGURATIONS:
            q = centres[rng.integers(len(centres))] + rng.normal(0.0, 0.3, centres.shape[1])
            drawn.append(q)
            if _check_all(space, q[None], valid) and space.state.leaf_clear.min() < NEAR_CANOPY_M:
                assert space.state.misc[SELF] >= SELF_CLEARANCE_M
                kept.append(q)
        self.rows = np.ascontiguousarray(kept[:CONFIGURATIONS])
        self.mixed = np.ascontiguousarray(drawn[:CONFIGURATIONS])

    def checks(self) -> list[Timing]:
        """One full check near the canopy: valid ones, as searches meet them, and the spread over configurations; FK alone."""
        space, chain = self.problem.space(), self.problem.obstacles.robot.chain
        valid, poses = np.zeros(CONFIGURATIONS, np.bool_), np.zeros((len(self.rows[0]) + 1, 3, 4))
        passed = _check_all(space, self.mixed, valid) / CONFIGURATIONS
        single = []
        for q in self.rows:
            single.append(_median_of(partial(_check_again, space, q, 200), 200))
        return [
            repeat(
                "forward_kinematics", "forward kinematics", lambda: _forward_all(chain, self.rows, poses), samples=self.repeats, calls=400
            ),
            repeat(
                "check",
                "full check near the canopy",
                lambda: _check_all(space, self.rows, valid),
                samples=self.repeats,
                calls=CONFIGURATIONS,
                target_s=CHECK_TARGET_S,
                note="forward kinematics, self, stems and leaves; 400 valid configurations in turn",
            ),
            Timing("check_by_configuration", "the same, spread over them", np.array(single), 200, note="one sample: one configuration"),
            repeat(
                "check_mixed",
                "check as searches meet it",
                lambda: _check_all(space, self.mixed, valid),
                samples=self.repeats,
                calls=CONFIGURATIONS,
                note=f"{100 * passed:.0f} % of the configurations are valid; checks stop at the first contact",
            ),
        ]

    def edges(self) -> Timing:
        """The cost of edges of 0.3 rad near the canopy, one sample an edge."""
        space, rng = self.problem.space(), np.random.default_rng(1)
        weight = self.problem.settings.weight
        samples, states = [], 0
        for q in self.rows[:200]:
            step = rng.normal(size=len(q))
            end = np.ascontiguousarray(q + EDGE_RAD * step / np.linalg.norm(step))
            before = int(space.counters[2])
            if not np.isfinite(_edge_again(space, q, end, weight, 1)):
                continue
            states += int(space.counters[2]) - before
            samples.append(_median_of(partial(_edge_again, space, q, end, weight, 5), 5))
        note = f"{states / max(len(samples), 1):.0f} configurations checked in each, on average; blocked ones left out"
        return Timing("edge", "edge of 0.3 rad, integrated", np.array(samples), 5, note=note)

    def fields(self) -> list[Timing]:
        """Both distance fields of the plant, and everything that a new scene needs."""
        pipeline, scene = pipeline_of(self.problem.spec.robot), scene_of(PLANT)
        obstacles, settings = self.problem.obstacles, self.problem.settings
        target = np.array(self.problem.spec.pose[:3])
        points = Scene.impermeable_points(scene, target, settings.target_exclusion_radius_m)
        leaves = scene.leaf_points
        size = f"{len(leaves)} leaf points, {len(points)} impermeable ones"
        return [
            repeat(
                "fields",
                "both distance fields",
                lambda: build_fields(points, leaves, spacing_m=settings.voxel_m),
                samples=max(3, self.repeats // 5),
                target_s=FIELDS_TARGET_S,
                note=size,
            ),
            repeat(
                "obstacles",
                "a new scene, all in all",
                lambda: prepare(obstacles.robot, pipeline.shapes, scene, spot_at(target), settings),
                samples=max(3, self.repeats // 5),
                note="selected, thinned, fields and hashes",
            ),
        ]


def paper_mode(problems: Sequence[ProblemSpec], seeds: int) -> Timing:
    """1,500 iterations of APF-RRT* in paper mode, one sample a problem and seed."""
    samples = []
    for spec in problems:
        problem = build_problem(spec)
        options = options_of(problem, "apf_rrt_star_paper").gains
        for seed in range(seeds):
            plan = partial(plan_paper, problem.space(), problem.start, problem.goals.configurations, options, seed)
            samples.append(_median_of(partial(plan, iterations=PAPER_ITERATIONS), 1, samples=1))
    return Timing(
        "paper_mode", "paper mode, 1,500 iterations", np.array(samples), 1, PAPER_TARGET_S, f"{len(problems)} problems × {seeds} seeds"
    )


def first_path(problems: Sequence[ProblemSpec], seeds: int, clock: str) -> Timing:
    """Time until the default planner's first path, one sample a problem and seed; inf where none came in 0.5 s."""
    samples = []
    assert clock in CLOCKS
    for spec in problems:
        problem = build_problem(spec)
        warm_up(problem, DEFAULT_PLANNER)
        for seed in range(1, seeds + 1):
            curve = run_anytime(problem, DEFAULT_PLANNER, seed, _FIRST_PATH_BUDGET_S, clock)["curve"]
            samples.append(curve[0][0] if curve else np.inf)
    note = f"{len(problems)} problems × {seeds} seeds"
    return Timing("first_path", "first path, default planner", np.array(samples), 1, FIRST_PATH_TARGET_S, note)
