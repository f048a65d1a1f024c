"""The pipeline: validate, inverse kinematics, search, certify, time, check."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.collision.exact import ExactChecker
from lime_planner.collision.link_shapes import Shapes, build_shapes
from lime_planner.core.errors import Refusal
from lime_planner.core.parameters import Settings, obstacle_settings, settings_from
from lime_planner.core.planners import PLANNERS
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline import recheck
from lime_planner.pipeline.certify import CERTIFIED_STEP_RAD, hit_of, timed_motion
from lime_planner.pipeline.context import Clock, ask, checked_deadline, checked_start, checked_target, never
from lime_planner.pipeline.figures import path_figures, sample_path
from lime_planner.pipeline.goals import Goals, examine_start, find_goals
from lime_planner.pipeline.obstacles import Obstacles, prepare, stem_checker
from lime_planner.pipeline.plausibility import doubts_about
from lime_planner.pipeline.result import PlanResult, set_parameters
from lime_planner.pipeline.search import search
from lime_planner.planning.planner import Outcome, load_planner
from lime_planner.robot.model import Robot, home
from lime_planner.scene import voxels
from lime_planner.scene.scene import Scene

_FINISH_S = 0.25  # of a deadline, left for certificate and timing
_RETRY_MARGIN_M = 0.003  # added to the margin when the exact check refuses a path
_ATTEMPTS = 2


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
        voxels.warm_up()
        q = home(self.robot)
        T = self.robot.forward(q + 0.2)
        apart = T[:3, 3] + np.array([0.0, 0.0, 0.4])
        points = apart + np.random.default_rng(0).uniform(-0.05, 0.05, (64, 3))
        scene = Scene.from_points(points, np.arange(64) % 2, frame_id=self.robot.planning_frame)
        easy = {"ik_starts": 10, "leaf_speed_scale": 0.9, "floor_z_m": -5.0}
        for planner in map(load_planner, PLANNERS):
            settings = settings_from({"planner": planner.name, "iterations": planner.warm_iterations, **easy})
            self.plan(scene, T, q, settings, seed=1)
            # What plans that are less easy than these ask besides.
            planner.warm_up(self.obstacles(scene, T[:3, 3], settings).space(q - 1.0, q + 1.0))
        obstacles = self.obstacles(scene, T[:3, 3], settings)
        checker = obstacles.exact_checker()
        checker.stem_distance(q)
        checker.leaf_contact(q)
        self._kept = None

    def obstacles(self, scene: Scene, target: Array | None, settings: Settings, should_stop: Callable[[], bool] = never) -> Obstacles:
        """Obstacles of a scene, those of the last call if nothing that they are made of has changed.

        Args:
            scene: in the planning frame.
            target: (3,) position of the tool at the target [m], or None for a check without one.
            settings: radii, margins, keep-outs, leaf policy.
            should_stop: cancels.

        Raises:
            Refusal: CANCELLED.
        """
        place = None if target is None else tuple(np.asarray(target, dtype=np.float64))
        key = (place, obstacle_settings(settings))
        kept = self._kept  # read and written whole: another thread may ask at the same time
        if kept is None or kept[0] is not scene or kept[1] != key:
            kept = self._kept = (scene, key, prepare(self.robot, self.shapes, scene, target, settings, should_stop))
        return dataclasses.replace(kept[2], settings=settings)

    def plan(
        self,
        scene: Scene,
        T_base_tool: npt.ArrayLike,
        q_start: npt.ArrayLike,
        settings: Settings,
        *,
        should_stop: Callable[[], bool] = never,
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
            deadline_s: wall time from now for everything, or TIMED_OUT; the search gets what certificate and timing leave, at most its
                budget.
            seed: of the random generator; 0 draws one, which the result names.

        Raises:
            ProblemError: `T_base_tool` is no pose, `q_start` is not n finite numbers, or `deadline_s` is no time.
        """
        clock = Clock()
        T, q, deadline_s = checked_target(T_base_tool), checked_start(self.robot, q_start), checked_deadline(deadline_s)
        seed = int(seed) or int(settings.seed) or int(np.random.default_rng().integers(1, 2**31 - 1))
        counts: dict[str, int] = {}
        iterations = [0]
        figures: dict[str, Any] = {}

        def outcome(status: Status, sentence: str) -> PlanResult:
            return PlanResult(
                status,
                status.message(sentence),
                settings.planner,
                seed,
                iterations=iterations[0],
                planning_time_s=clock.elapsed(),
                phases_s=clock.phases,
                counts=counts,
                T_base_tool=T,
                q_start=q,
                parameters=set_parameters(settings, self.robot),
                warnings=doubts_about(scene, self.robot, T, q),
                **figures,
            )

        def ended() -> bool:
            return should_stop() or (deadline_s is not None and clock.elapsed() >= deadline_s)

        try:
            obstacles, checker, goals = self._goals(scene, T, q, settings, seed, clock, counts, ended)
            found = self._path(obstacles, checker, q, goals, settings, seed, clock, counts, ended, deadline_s, iterations)
            assert found.path is not None
            figures = path_figures(obstacles, checker, found.path, T)
            clock.lap("figures")
            limit = settings.max_leaf_contact_rad
            if limit >= 0.0 and figures["leaf_contact_rad"] > limit:
                sentence = f"the least leaf contact found is {figures['leaf_contact_rad']:.3f} rad, allowed are {limit:.3f} rad"
                raise Refusal(Status.LEAF_BUDGET_EXCEEDED, sentence)
            figures["trajectory"] = timed_motion(obstacles, checker, found.path, q, settings, clock, ended)
        except Refusal as refusal:
            if refusal.status is Status.CANCELLED and not should_stop():
                sentence = f"the deadline, {deadline_s:.2f} s after planning began, passed before a motion was certified"
                return outcome(Status.TIMED_OUT, sentence)
            return outcome(refusal.status, str(refusal))
        sentence = (
            f"{len(found.path)} waypoints over {figures['path_length_rad']:.2f} rad, {figures['leaf_contact_rad']:.3f} rad of it among "
            f"leaves, stems at least {1e3 * figures['min_stem_clearance_m']:.1f} mm away, "
            f"{figures['trajectory'].duration_s:.1f} s of motion, planned in {clock.elapsed():.2f} s"
        )
        return outcome(Status.SUCCEEDED, sentence)

    def _goals(
        self,
        scene: Scene,
        T: Array,
        q: Array,
        settings: Settings,
        seed: int,
        clock: Clock,
        counts: dict[str, int],
        should_stop: Callable[[], bool],
    ) -> tuple[Obstacles, ExactChecker, Goals]:
        obstacles = self.obstacles(scene, T[:3, 3], settings, should_stop)
        checker = obstacles.exact_checker()
        counts |= obstacles.counts
        clock.lap("fields")
        ask(should_stop)
        reason = examine_start(obstacles, checker, q)
        if reason is not None:
            raise Refusal(*reason)
        goals = find_goals(obstacles, checker, T, q, np.random.default_rng(seed))
        counts |= {"ik_solutions": goals.found, "goals": len(goals.configurations)}
        clock.lap("inverse_kinematics")
        if goals.status is not None:
            raise Refusal(goals.status, goals.sentence)
        ask(should_stop)
        return obstacles.with_anchors(goals.anchors, goals.needs), checker, goals

    def _path(
        self,
        obstacles: Obstacles,
        checker: ExactChecker,
        q: Array,
        goals: Goals,
        settings: Settings,
        seed: int,
        clock: Clock,
        counts: dict[str, int],
        should_stop: Callable[[], bool],
        deadline_s: float | None,
        iterations: list[int],
    ) -> Outcome:
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
                    raise Refusal(Status.CANCELLED, "the request was stopped while searching")
                if found.status is Status.START_INVALID:
                    raise Refusal(found.status, "where the arm stands, it is closer to itself or to something hard than can be certified")
                amount = f"{found.iterations} iterations" if budget is None else f"{budget:.2f} s ({found.iterations} iterations)"
                raise Refusal(found.status, f"no path to any of {len(goals.configurations)} goal configurations within {amount}")
            hit = hit_of(checker, sample_path(found.path, CERTIFIED_STEP_RAD)[0], should_stop)
            clock.lap("certificate")
            if hit is None:
                return found
        raise Refusal(Status.PATH_INVALID, f"the exact check refuses the path: {hit}")

    def follow(
        self,
        waypoints: npt.ArrayLike,
        scene: Scene,
        T_base_tool: npt.ArrayLike | None,
        settings: Settings,
        *,
        should_stop: Callable[[], bool] = never,
    ) -> PlanResult:
        """Make a motion along given waypoints: exact check, timing, contract; no search.

        Args:
            waypoints: (M, n) [rad], the first one where the arm is, M at least 2.
            scene: to check against.
            T_base_tool: the target whose exclusion sphere holds, or None.
            settings: limits and radii.
            should_stop: cancels.

        Raises:
            ProblemError: `waypoints` is no such array, or `T_base_tool` no pose.
        """
        T = None if T_base_tool is None else checked_target(T_base_tool)
        result = recheck.follow(lambda: self._obstacles_of(scene, T, settings, should_stop), waypoints, T, settings, should_stop)
        return dataclasses.replace(result, parameters=set_parameters(settings, self.robot))

    def recheck(
        self,
        result: PlanResult,
        scene: Scene,
        q_measured: npt.ArrayLike,
        settings: Settings,
        *,
        should_stop: Callable[[], bool] = never,
    ) -> tuple[Status, str]:
        """Check a plan again before it is carried out, against the newest scene and arm state.

        Args:
            result: the plan.
            scene: the newest.
            q_measured: (n,) where the arm is [rad].
            settings: radii and limits.
            should_stop: cancels.

        Returns:
            SUCCEEDED, or why not: PATH_INVALID with the contact or the broken rule, NOTHING_TO_EXECUTE for a plan without a motion,
            CANCELLED.

        Raises:
            ProblemError: `q_measured` is not n finite numbers.
        """
        q = checked_start(self.robot, q_measured)

        def world() -> Obstacles:
            return self._obstacles_of(scene, result.T_base_tool, settings, should_stop)

        return recheck.recheck(world, result.trajectory, q, settings, should_stop)

    def obstruction(
        self,
        result: PlanResult,
        scene: Scene,
        settings: Settings,
        *,
        from_time_s: float = 0.0,
        should_stop: Callable[[], bool] = never,
    ) -> str | None:
        """Look for something hard on the rest of a running motion; leaves never count. May run beside a plan.

        Args:
            result: the plan being carried out.
            scene: the newest; settings: radii and keep-outs.
            from_time_s: how long the motion has run [s].
            should_stop: ends the look early.

        Returns:
            The contact in words; None if there is none, or if the look was ended before it found one.
        """
        target = None if result.T_base_tool is None else result.T_base_tool[:3, 3]
        return recheck.obstruction(lambda: stem_checker(self.robot, scene, target, settings), result.trajectory, from_time_s, should_stop)

    def _obstacles_of(self, scene: Scene, T_base_tool: Array | None, settings: Settings, should_stop: Callable[[], bool]) -> Obstacles:
        return self.obstacles(scene, None if T_base_tool is None else T_base_tool[:3, 3], settings, should_stop)
