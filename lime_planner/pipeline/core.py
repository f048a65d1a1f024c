"""The pipeline: validate, inverse kinematics, search, certify, time, check."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.errors import ProblemError
from lime_planner.parameters import Settings
from lime_planner.pipeline.finish import (
    CERTIFIED_STEP_RAD,
    contract_violations,
    hit_of,
    make_trajectory,
    path_figures,
    sample_path,
)
from lime_planner.pipeline.goals import Goals, examine_start, find_goals
from lime_planner.pipeline.obstacles import Obstacles, prepare
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.search import Found, search
from lime_planner.robot.exact import ExactChecker
from lime_planner.robot.model import Robot, home
from lime_planner.robot.shapes import Shapes, build_shapes
from lime_planner.scene import voxels
from lime_planner.scene.scene import Scene
from lime_planner.status import Status

Array = npt.NDArray[np.float64]

_FINISH_S = 0.25  # of a deadline, left for certificate and timing
_RETRY_MARGIN_M = 0.003  # added to the margin when the exact check refuses a path
_ATTEMPTS = 2


def _never() -> bool:
    return False


class _Stopped(Exception):
    """Carries an early outcome out of the steps."""

    def __init__(self, status: Status, sentence: str) -> None:
        self.status, self.sentence = status, sentence


class _Clock:
    """Wall time of the phases of one plan."""

    def __init__(self) -> None:
        self.began = self.last = time.monotonic()
        self.phases: dict[str, float] = {}

    def lap(self, phase: str) -> None:
        now = time.monotonic()
        self.phases[phase] = self.phases.get(phase, 0.0) + now - self.last
        self.last = now

    def elapsed(self) -> float:
        return time.monotonic() - self.began


class Pipeline:
    """Plans for one robot. One plan at a time; a scene is taken whole and never changed."""

    def __init__(self, robot: Robot) -> None:
        """Keep the robot; its shapes are made when first needed, or by `warm_up`."""
        self.robot = robot
        self._shapes: Shapes | None = None
        self._kept: tuple[Scene, tuple[Any, ...], Obstacles] | None = None

    @property
    def shapes(self) -> Shapes:
        """The robot's bodies for the fast model."""
        if self._shapes is None:
            self._shapes = build_shapes(self.robot)
        return self._shapes

    def warm_up(self) -> None:
        """Build the shapes, and run every kernel once so that no plan pays for compilation."""
        from lime_planner.parameters import PLANNERS, settings_from

        voxels.warm_up()
        q = home(self.robot)
        T = self.robot.forward(q + 0.2)
        apart = T[:3, 3] + np.array([0.0, 0.0, 0.4])
        points = apart + np.random.default_rng(0).uniform(-0.05, 0.05, (64, 3))
        scene = Scene.from_points(points, np.arange(64) % 2, frame_id=self.robot.planning_frame)
        for planner in PLANNERS:
            # Enough iterations to pass through every part of a search.
            iterations = 600 if planner == "lime_star" else 50
            settings = settings_from({"planner": planner, "iterations": iterations, "ik_starts": 10, "leaf_speed_scale": 0.9})
            self.plan(scene, T, q, settings, seed=1)
        self._kept = None

    def obstacles(self, scene: Scene, target: Array | None, settings: Settings) -> Obstacles:
        """Obstacles of a scene, those of the last call if nothing has changed."""
        key = (
            None if target is None else tuple(np.asarray(target, dtype=np.float64)),
            tuple(
                getattr(settings, name)
                for name in (
                    "leaf_policy",
                    "leaf_cost",
                    "stem_margin_m",
                    "stem_point_radius_m",
                    "leaf_point_radius_m",
                    "target_exclusion_radius_m",
                    "approach_zone_m",
                    "voxel_m",
                    "keep_out_boxes",
                    "floor_z_m",
                    "workspace_box",
                    "planner",
                    "c_perm",
                    "step_rad",
                    "leaf_weight",
                    "ik_starts",
                    "max_goals",
                )
            ),
        )
        if self._kept is None or self._kept[0] is not scene or self._kept[1] != key:
            self._kept = (scene, key, prepare(self.robot, self.shapes, scene, target, settings))
        return self._kept[2]

    def plan(
        self,
        scene: Scene,
        T_base_tool: npt.ArrayLike,
        q_start: npt.ArrayLike,
        settings: Settings,
        *,
        should_stop: Callable[[], bool] = _never,
        deadline_s: float | None = None,
        seed: int = 0,
    ) -> PlanResult:
        """Plan a motion of the tool to a target.

        Args:
            scene: in the planning frame.
            T_base_tool: (4, 4) pose that the tool frame must reach, in the planning frame.
            q_start: (n,) measured configuration [rad], turns kept.
            settings: everything else.
            should_stop: True cancels; asked every few milliseconds.
            deadline_s: wall time from now for everything; the search gets what certificate and timing leave, at most its budget.
            seed: of the random generator; 0 draws one, which the result names.

        Raises:
            ProblemError: `T_base_tool` is no pose, or `q_start` is not n finite numbers.
        """
        clock = _Clock()
        T, q = _checked_target(T_base_tool), self._checked_start(q_start)
        seed = int(seed) or int(settings.seed) or int(np.random.default_rng().integers(1, 2**31 - 1))
        counts: dict[str, int] = {}
        iterations = [0]

        def refused(stop: _Stopped, **figures: Any) -> PlanResult:
            return PlanResult(
                stop.status,
                stop.status.message(stop.sentence),
                settings.planner,
                seed,
                iterations=iterations[0],
                planning_time_s=clock.elapsed(),
                phases_s=clock.phases,
                counts=counts,
                T_base_tool=T,
                **figures,
            )

        figures: dict[str, Any] = {}
        try:
            obstacles, checker, goals = self._goals(scene, T, q, settings, seed, clock, counts, should_stop)
            found = self._path(obstacles, checker, q, goals, settings, seed, clock, counts, should_stop, deadline_s, iterations)
            assert found.path is not None
            figures = path_figures(obstacles, checker, found.path, T)
            clock.lap("figures")
            limit = settings.max_leaf_contact_rad
            if limit >= 0.0 and figures["leaf_contact_rad"] > limit:
                sentence = f"the least leaf contact found is {figures['leaf_contact_rad']:.3f} rad, allowed are {limit:.3f} rad"
                raise _Stopped(Status.LEAF_BUDGET_EXCEEDED, sentence)
            figures["trajectory"] = self._motion(obstacles, checker, found.path, q, settings, clock, should_stop)
        except _Stopped as stop:
            return refused(stop, **figures)
        sentence = (
            f"{len(found.path)} waypoints over {figures['path_length_rad']:.2f} rad, {figures['leaf_contact_rad']:.3f} rad of it among "
            f"leaves, stems at least {1e3 * figures['min_stem_clearance_m']:.1f} mm away, "
            f"{figures['trajectory'].duration_s:.1f} s of motion, planned in {clock.elapsed():.2f} s"
        )
        return refused(_Stopped(Status.SUCCEEDED, sentence), **figures)

    def _goals(
        self,
        scene: Scene,
        T: Array,
        q: Array,
        settings: Settings,
        seed: int,
        clock: _Clock,
        counts: dict[str, int],
        should_stop: Callable[[], bool],
    ) -> tuple[Obstacles, ExactChecker, Goals]:
        obstacles = self.obstacles(scene, T[:3, 3], settings)
        checker = obstacles.exact_checker()
        counts |= obstacles.counts
        clock.lap("fields")
        _ask(should_stop)
        reason = examine_start(obstacles, checker, q)
        if reason is not None:
            raise _Stopped(*reason)
        goals = find_goals(obstacles, checker, T, q, np.random.default_rng(seed))
        counts |= {"ik_solutions": goals.found, "goals": len(goals.configurations)}
        clock.lap("inverse_kinematics")
        if goals.status is not None:
            raise _Stopped(goals.status, goals.sentence)
        _ask(should_stop)
        return obstacles.with_anchors(goals.anchors, goals.needs), checker, goals

    def _path(
        self,
        obstacles: Obstacles,
        checker: ExactChecker,
        q: Array,
        goals: Goals,
        settings: Settings,
        seed: int,
        clock: _Clock,
        counts: dict[str, int],
        should_stop: Callable[[], bool],
        deadline_s: float | None,
        iterations: list[int],
    ) -> Found:
        """Search until the exact check accepts the path; a refused one is searched again with more margin."""
        hit: str | None = None
        for attempt in range(_ATTEMPTS):
            budget = None if settings.iterations else settings.time_budget_s
            if deadline_s is not None:
                left = max(deadline_s - clock.elapsed() - _FINISH_S, 0.02)
                budget = left if budget is None else min(budget, left)
            wider = obstacles.with_margin(obstacles.world.margin + attempt * _RETRY_MARGIN_M)
            found = search(wider, q, goals, settings, seed=seed + attempt, budget_s=budget, should_stop=should_stop)
            iterations[0] += found.iterations
            counts["configurations_checked"] = counts.get("configurations_checked", 0) + found.checks
            if np.isfinite(found.first_path_s):
                clock.phases.setdefault("first_path", found.first_path_s)
            clock.lap("search")
            if found.path is None:
                if found.status is Status.CANCELLED:
                    raise _Stopped(Status.CANCELLED, "the request was stopped while searching")
                amount = f"{found.iterations} iterations" if budget is None else f"{budget:.2f} s ({found.iterations} iterations)"
                raise _Stopped(found.status, f"no path to any of {len(goals.configurations)} goal configurations within {amount}")
            hit = hit_of(checker, sample_path(found.path, CERTIFIED_STEP_RAD)[0], should_stop)
            clock.lap("certificate")
            _ask(should_stop)
            if hit is None:
                return found
        raise _Stopped(Status.PATH_INVALID, f"the exact check refuses the path: {hit}")

    def _motion(
        self,
        obstacles: Obstacles,
        checker: ExactChecker,
        waypoints: Array,
        q_measured: Array,
        settings: Settings,
        clock: _Clock,
        should_stop: Callable[[], bool],
    ) -> Any:
        trajectory = make_trajectory(self.robot, waypoints, obstacles, settings)
        clock.lap("timing")
        _ask(should_stop)
        broken = contract_violations(self.robot, trajectory, q_measured, settings)
        if broken:
            raise _Stopped(Status.PATH_INVALID, "; ".join(broken))
        hit = hit_of(checker, trajectory.configurations(CERTIFIED_STEP_RAD), should_stop)
        clock.lap("certificate")
        _ask(should_stop)
        if hit is not None:
            raise _Stopped(Status.PATH_INVALID, f"the exact check refuses the timed motion: {hit}")
        return trajectory

    def follow(
        self,
        waypoints: npt.ArrayLike,
        scene: Scene,
        T_base_tool: npt.ArrayLike | None,
        settings: Settings,
        *,
        should_stop: Callable[[], bool] = _never,
    ) -> PlanResult:
        """Make a motion along given waypoints: exact check, timing, contract; no search.

        Args:
            waypoints: (M, n) [rad], the first one where the arm is.
            scene: to check against; T_base_tool: the target whose exclusion sphere holds, or None.
            settings: limits and radii; should_stop: cancels.
        """
        clock = _Clock()
        path = np.ascontiguousarray(waypoints, dtype=np.float64)
        T = None if T_base_tool is None else _checked_target(T_base_tool)
        figures: dict[str, Any] = {}
        try:
            obstacles = self.obstacles(scene, None if T is None else T[:3, 3], settings)
            checker = obstacles.exact_checker()
            clock.lap("fields")
            hit = hit_of(checker, sample_path(path, CERTIFIED_STEP_RAD)[0], should_stop)
            clock.lap("certificate")
            _ask(should_stop)
            if hit is not None:
                raise _Stopped(Status.PATH_INVALID, f"the exact check refuses the path: {hit}")
            figures = path_figures(obstacles, checker, path, None)
            figures["trajectory"] = self._motion(obstacles, checker, path, path[0], settings, clock, should_stop)
            outcome = _Stopped(
                Status.SUCCEEDED, f"{figures['path_length_rad']:.2f} rad, {figures['trajectory'].duration_s:.1f} s of motion"
            )
        except _Stopped as stop:
            outcome = stop
        message = outcome.status.message(outcome.sentence)
        return PlanResult(
            outcome.status,
            message,
            settings.planner,
            0,
            planning_time_s=clock.elapsed(),
            phases_s=clock.phases,
            T_base_tool=T,
            **figures,
        )

    def recheck(self, result: PlanResult, scene: Scene, q_measured: npt.ArrayLike, settings: Settings) -> tuple[Status, str]:
        """Check a plan again before it is carried out, against the newest scene and arm state.

        Returns:
            SUCCEEDED, or why not: PATH_INVALID with the contact or the broken rule.
        """
        if result.trajectory is None:
            return Status.NOTHING_TO_EXECUTE, "the plan has no motion"
        broken = contract_violations(self.robot, result.trajectory, self._checked_start(q_measured), settings)
        if broken:
            return Status.PATH_INVALID, "; ".join(broken)
        target = None if result.T_base_tool is None else result.T_base_tool[:3, 3]
        hit = hit_of(self.obstacles(scene, target, settings).exact_checker(), result.trajectory.positions, _never)
        if hit is not None:
            return Status.PATH_INVALID, f"the exact check refuses the motion in the newest scene: {hit}"
        return Status.SUCCEEDED, f"the motion of {result.trajectory.duration_s:.1f} s is still clear"

    def obstruction(
        self,
        result: PlanResult,
        scene: Scene,
        settings: Settings,
        *,
        from_time_s: float = 0.0,
        should_stop: Callable[[], bool] = _never,
    ) -> str | None:
        """Look for something hard on the rest of a running motion; leaves never count.

        Args:
            result: the plan being carried out.
            scene: the newest; settings: radii and keep-outs.
            from_time_s: how long the motion has run [s].
            should_stop: ends the look early.

        Returns:
            The contact in words, or None.
        """
        if result.trajectory is None:
            return None
        target = None if result.T_base_tool is None else result.T_base_tool[:3, 3]
        rest = result.trajectory.positions[result.trajectory.times() >= from_time_s]
        if len(rest) == 0:
            return None
        return hit_of(self.obstacles(scene, target, settings).exact_checker(), rest, should_stop)

    def _checked_start(self, q: npt.ArrayLike) -> Array:
        values = np.ascontiguousarray(q, dtype=np.float64)
        if values.shape != (self.robot.n,) or not np.isfinite(values).all():
            raise ProblemError(f"the start needs {self.robot.n} finite joint angles, got {values.tolist()}")
        return values


def _ask(should_stop: Callable[[], bool]) -> None:
    if should_stop():
        raise _Stopped(Status.CANCELLED, "the request was stopped")


def _checked_target(T_base_tool: npt.ArrayLike) -> Array:
    T = np.array(T_base_tool, dtype=np.float64)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise ProblemError(f"the target needs a finite 4 x 4 pose, got {T.tolist()}")
    if abs(np.linalg.det(T[:3, :3]) - 1.0) > 1e-3 or not np.allclose(T[3], [0, 0, 0, 1]):
        raise ProblemError("the target's upper left 3 x 3 block is not a rotation")
    return T
