"""The pipeline: validate, inverse kinematics, search, certify, time, check."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.collision.distance_fields import hash_points
from lime_planner.collision.exact import ExactChecker
from lime_planner.collision.link_shapes import Shapes, build_shapes
from lime_planner.collision.touched_points import touched_anywhere, touched_points
from lime_planner.core.errors import Refusal
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.parameters import Settings, obstacle_settings, settings_from
from lime_planner.core.planners import PLANNERS
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline import recheck
from lime_planner.pipeline.certify import CERTIFIED_STEP_RAD, hit_of, timed_motion
from lime_planner.pipeline.context import Clock, ask, checked_deadline, checked_start, never
from lime_planner.pipeline.figures import path_figures, sample_path
from lime_planner.pipeline.goals import Goals, examine_start, tight_anchors
from lime_planner.pipeline.grasps.goals import goals_of
from lime_planner.pipeline.grasps.slide import SHARE, slide, trials_for, worth_sliding
from lime_planner.pipeline.obstacles import Obstacles, prepare, seen_map_of, stem_checker
from lime_planner.pipeline.plausibility import doubts_about
from lime_planner.pipeline.result import PlanResult, set_parameters
from lime_planner.pipeline.search import search
from lime_planner.pipeline.spots import Spot, spot_at
from lime_planner.pipeline.targets import Target, candidates_target, fruit_target, target_of
from lime_planner.pipeline.way_out import way_out
from lime_planner.planning.planner import load_planner
from lime_planner.planning.practice import practise
from lime_planner.planning.space import line, one
from lime_planner.robot.model import Robot, home
from lime_planner.scene import voxels
from lime_planner.scene.scene import Scene
from lime_planner.scene.views import fused, several, sight
from lime_planner.scene.views.seen_map import SeenMap

_FINISH_S = 0.4  # of a deadline, left for certificate, figures and timing
_RETRY_MARGIN_M = 0.003  # added to the margin when the exact check refuses a path
_ATTEMPTS = 2
_AROUND_ARM_M = 0.02  # so close to where the arm stood nothing is unseen: it came there, and begins to move there again
_DROPPED = 4  # goals at most whose straight stretch the exact check refuses


class Pipeline:
    """Plans for one robot. One plan at a time; a scene is taken whole and never changed."""

    def __init__(self, robot: Robot) -> None:
        """Keep the robot; its shapes are made when first needed, or by `warm_up`."""
        self.robot = robot
        self._shapes: Shapes | None = None
        self._kept: tuple[Scene, tuple[Any, ...], Obstacles] | None = None
        self._seen: tuple[Scene, SeenMap] | None = None

    @property
    def shapes(self) -> Shapes:
        """The robot's bodies for the fast model."""
        if self._shapes is None:
            self._shapes = build_shapes(self.robot)
        return self._shapes

    def warm_up(self, planners: Iterable[str] = PLANNERS) -> None:
        """Build the shapes, and run every kernel once so that no plan pays for compilation.

        Args:
            planners: those that will be asked; all of them by default.
        """
        q = home(self.robot)
        T = self.robot.forward(q + 0.2)
        apart = T[:3, 3] + np.array([0.0, 0.0, 0.4])
        points = apart + np.random.default_rng(0).uniform(-0.05, 0.05, (64, 3))
        scene = Scene.from_points(points, np.arange(64) % 2, frame_id=self.robot.planning_frame, viewpoints=apart[None] + 0.2)
        settings = settings_from({"ik_starts": 10, "max_grasps": 10, "leaf_speed_scale": 0.9, "floor_z_m": -5.0})
        for aim in (fruit_target(T[:3, 3], 0.02), candidates_target(T[None])):
            with contextlib.suppress(Refusal):  # what becomes of them does not matter here
                self._goals(scene, aim, q, settings, 1, Clock(), {}, {}, never)
        obstacles, checker, goals = self._goals(scene, target_of(T), q, settings, 1, Clock(), {}, {}, never)
        space = obstacles.space(q - 4.0, q + 4.0).handle()
        one(space, q)
        line(space, q, goals.configurations[0], 1.0, np.inf)
        self.follow(np.array([q, q + 0.05]), scene, T, settings)
        for module in (voxels, sight, fused, several):
            module.warm_up()
        touched_anywhere(self.robot, self.shapes, q, hash_points(points), 0.01)
        checker.stem_distance(q)
        checker.leaf_contact(q)
        for name in planners:
            practise(load_planner(name))
        self._kept = None

    def obstacles(
        self, scene: Scene, place: Spot | npt.ArrayLike | None, settings: Settings, should_stop: Callable[[], bool] = never
    ) -> Obstacles:
        """Obstacles of a scene, those of the last call if nothing that they are made of has changed.

        Args:
            scene: in the planning frame.
            place: of the target; a position (3,) is an exact pose's, None for a check without a target.
            settings: radii, margins, keep-outs, leaf policy.
            should_stop: cancels.

        Raises:
            Refusal: CANCELLED.
        """
        spot = spot_at(place)
        key = (spot, obstacle_settings(settings))
        kept = self._kept  # read and written whole: another thread may ask at the same time
        if kept is None or kept[0] is not scene or kept[1] != key:
            seen = self.seen_map(scene)
            kept = self._kept = (scene, key, prepare(self.robot, self.shapes, scene, spot, settings, should_stop, seen))
        return dataclasses.replace(kept[2], settings=settings)

    def seen_map(self, scene: Scene) -> SeenMap:
        """Map what a scene's views show in the arm's reach; that of the last call if it was for the same scene.

        Where the arm stood when it was seen is no unseen space, although it hid it itself.
        """
        kept = self._seen  # read and written whole, as in `obstacles`
        if kept is None or kept[0] is not scene:
            seen = seen_map_of(self.robot, scene)
            if scene.stood is not None and len(seen.unseen) and scene.stood.shape[1] == self.robot.n:
                filled = touched_points(self.robot, self.shapes, scene.stood, seen.unseen, _AROUND_ARM_M).any(axis=0)
                seen = dataclasses.replace(seen, unseen=seen.unseen[~filled])
            kept = self._seen = (scene, seen)
        return kept[1]

    def plan(
        self,
        scene: Scene,
        target: Target | npt.ArrayLike,
        q_start: npt.ArrayLike,
        settings: Settings,
        *,
        should_stop: Callable[[], bool] = never,
        deadline_s: float | None = None,
        seed: int = 0,
        obstacles: Obstacles | None = None,
    ) -> PlanResult:
        """Plan a motion of the tool to a target.

        Args:
            scene: in the planning frame.
            target: what the tool is to reach, in the planning frame. An array (4, 4) is T_base_tool of one pose, with the freedom that
                the settings name; one of three numbers the centre of a fruit.
            q_start: (n,) measured configuration [rad], turns kept.
            settings: everything else.
            should_stop: True cancels; asked every few milliseconds.
            deadline_s: wall time from now for everything, or TIMED_OUT; the search gets what certificate and timing leave, at most its
                budget.
            seed: of the random generator; 0 draws one, which the result names.
            obstacles: of the scene, where they are made already and hold for this target too.

        Raises:
            ProblemError: `target` is none, `q_start` is not n finite numbers, or `deadline_s` is no time.
        """
        clock = Clock()
        aim = target_of(target, settings.grasp_freedom)
        q, deadline_s = checked_start(self.robot, q_start), checked_deadline(deadline_s)
        seed = int(seed) or int(settings.seed) or int(np.random.default_rng().integers(1, 2**31 - 1))
        counts: dict[str, int] = {}
        iterations = [0]
        figures: dict[str, Any] = {}
        asked: dict[str, Any] = {"T_base_tool": aim.poses[0] if aim.kind == "pose" else None}

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
                target=aim,
                q_start=q,
                parameters=set_parameters(settings, self.robot),
                warnings=(*filter(None, [aim.doubt]), *doubts_about(scene, self.robot, aim.centre, q)),
                **(asked | figures),
            )

        def ended() -> bool:
            return should_stop() or (deadline_s is not None and clock.elapsed() >= deadline_s)

        try:
            obstacles, checker, goals = self._goals(scene, aim, q, settings, seed, clock, counts, figures, ended, obstacles)
            begin = np.clip(q, self.robot.lower, self.robot.upper)
            first_moves = [] if self.robot.within_limits(q) else [q]  # led back inside first
            off = way_out(obstacles, checker, begin, np.random.default_rng(seed), ended)
            if off is not None:
                first_moves, begin = [*first_moves, begin], off
                obstacles = obstacles.with_anchors(*tight_anchors(obstacles, goals.configurations, begin))
            path, straight_from, T = self._path(
                obstacles, checker, aim, begin, goals, settings, seed, clock, counts, ended, deadline_s, iterations
            )
            path, straight_from = np.vstack([*first_moves, path]), straight_from + len(first_moves)
            figures |= {"T_base_tool": T, "straight_from": straight_from}
            figures |= path_figures(obstacles, path, T, straight_from)
            clock.lap("figures")
            limit = settings.max_leaf_contact_rad
            if limit >= 0.0 and figures["leaf_contact_rad"] > limit:
                sentence = f"the least leaf contact found is {figures['leaf_contact_rad']:.3f} rad, allowed are {limit:.3f} rad"
                raise Refusal(Status.LEAF_BUDGET_EXCEEDED, sentence)
            limit = settings.max_unseen_contact_rad
            if limit >= 0.0 and figures["unseen_contact_rad"] > limit:
                views = "1 view" if obstacles.views == 1 else f"{obstacles.views} views"
                sentence = f"{figures['unseen_contact_rad']:.3f} rad of the best path lie in space that {views} did not show"
                raise Refusal(Status.UNSEEN, f"{sentence}, allowed are {limit:.3f} rad")
            straight = slice(straight_from, len(path))
            figures["trajectory"] = timed_motion(obstacles, checker, path, q, settings, clock, ended, figures["leaf_contact_rad"], straight)
        except Refusal as refusal:
            if refusal.status is Status.CANCELLED and not should_stop():
                sentence = f"the deadline, {deadline_s:.2f} s after planning began, passed before a motion was certified"
                return outcome(Status.TIMED_OUT, sentence)
            return outcome(refusal.status, str(refusal))
        sentence = (
            f"{len(path)} waypoints over {figures['path_length_rad']:.2f} rad, {figures['leaf_contact_rad']:.3f} rad of it among "
            f"leaves, stems at least {1e3 * figures['min_stem_clearance_m']:.1f} mm away, "
            f"{figures['trajectory'].duration_s:.1f} s of motion, planned in {clock.elapsed():.2f} s"
            f"{_approach(figures, settings)}{_unseen_part(figures)}"
        )
        return outcome(Status.SUCCEEDED, sentence)

    def _goals(
        self,
        scene: Scene,
        aim: Target,
        q: Array,
        settings: Settings,
        seed: int,
        clock: Clock,
        counts: dict[str, int],
        figures: dict[str, Any],
        should_stop: Callable[[], bool],
        given: Obstacles | None = None,
    ) -> tuple[Obstacles, ExactChecker, Goals]:
        obstacles = given or self.obstacles(scene, aim.spot(scene, settings), settings, should_stop)
        checker = obstacles.exact_checker(should_stop)
        counts |= obstacles.counts
        clock.lap("fields")
        ask(should_stop)
        reason = examine_start(obstacles, checker, q)
        if reason is not None:
            raise Refusal(*reason)
        inside = np.clip(q, self.robot.lower, self.robot.upper)
        goals = goals_of(obstacles, checker, aim, inside, np.random.default_rng(seed), should_stop)
        counts |= {"ik_solutions": goals.found, "goals": len(goals.configurations)}
        figures |= {"grasps_tried": goals.tried, "grasps_free": goals.free, "views": obstacles.views}
        if goals.approaches is not None:
            figures |= {"approaches": matrix_to_pose(goals.approaches.poses), "approach_outcomes": goals.approaches.outcomes}
        clock.lap("inverse_kinematics")
        if goals.status is not None:
            raise Refusal(goals.status, goals.sentence)
        ask(should_stop)
        return obstacles.with_anchors(goals.anchors, goals.needs), checker, goals

    def _path(
        self,
        obstacles: Obstacles,
        checker: ExactChecker,
        aim: Target,
        q: Array,
        goals: Goals,
        settings: Settings,
        seed: int,
        clock: Clock,
        counts: dict[str, int],
        should_stop: Callable[[], bool],
        deadline_s: float | None,
        iterations: list[int],
    ) -> tuple[Array, int, Array]:
        """Search until the exact check accepts the path; a refused one is searched again with more margin.

        A goal whose straight stretch the exact check refuses is left out, and costs no attempt.

        Returns:
            The path (M, n) to the grasp, the waypoint from which it leads straight there, and the grasp (4, 4).
        """
        hit: str | None = None
        attempt = dropped = 0
        while attempt < _ATTEMPTS:
            budget = None if settings.iterations else settings.time_budget_s
            if deadline_s is not None:
                left = max(deadline_s - clock.elapsed() - _FINISH_S, 0.02)
                budget = left if budget is None else min(budget, left)
            wider = obstacles.with_margin(obstacles.world.margin + attempt * _RETRY_MARGIN_M)
            sliding = worth_sliding(goals, aim, settings)
            slide_s = None if budget is None else SHARE * budget if sliding else 0.0
            search_s = None if budget is None or slide_s is None else budget - slide_s
            found, goals, wider = search(wider, q, goals, settings, seed=seed + attempt, budget_s=search_s, should_stop=should_stop)
            iterations[0] += found.iterations
            counts["configurations_checked"] = counts.get("configurations_checked", 0) + found.checks
            if np.isfinite(found.first_path_s):
                clock.phases.setdefault("first_path", found.first_path_s)
            clock.lap("search")
            if found.path is None:
                if found.status is Status.CANCELLED:
                    raise Refusal(Status.CANCELLED, "the request was stopped while searching")
                if found.status is Status.START_INVALID:
                    raise Refusal(
                        found.status, "where the arm stands, it is too close to itself or to something hard to be certified (within 1 mm)"
                    )
                amount = f"{found.iterations} iterations" if budget is None else f"{budget:.2f} s ({found.iterations} iterations)"
                raise Refusal(found.status, f"no path to any of {len(goals.configurations)} goal configurations within {amount}")
            which, stretch = goals.behind(found.path[-1])
            if sliding:
                trials = trials_for(settings.iterations) if settings.iterations else None
                slid = slide(
                    wider, aim, goals, found.path, q, seed=seed + attempt, trials=trials, budget_s=slide_s, should_stop=should_stop
                )
                clock.lap("search")
                way = np.concatenate([slid.path, slid.stretch[1:]])
                if hit_of(checker, sample_path(way, CERTIFIED_STEP_RAD)[0], should_stop) is None:
                    clock.lap("certificate")
                    return way, len(slid.path) - 1, slid.pose
            hit = hit_of(checker, sample_path(stretch, CERTIFIED_STEP_RAD)[0], should_stop) if len(stretch) > 1 else None
            if hit is not None and dropped < _DROPPED and len(goals.configurations) > 1:
                clock.lap("certificate")
                goals, dropped = goals.without(which), dropped + 1
                continue
            hit = hit or hit_of(checker, sample_path(found.path, CERTIFIED_STEP_RAD)[0], should_stop)
            clock.lap("certificate")
            if hit is None:
                return np.concatenate([found.path, stretch[1:]]), len(found.path) - 1, goals.poses[which]
            attempt += 1
        raise Refusal(Status.PATH_INVALID, f"the exact check refuses the path: {hit}")

    def follow(
        self,
        waypoints: npt.ArrayLike,
        scene: Scene,
        target: Target | npt.ArrayLike | None,
        settings: Settings,
        *,
        straight: slice | None = None,
        should_stop: Callable[[], bool] = never,
    ) -> PlanResult:
        """Make a motion along given waypoints: exact check, timing, contract; no search.

        Args:
            waypoints: (M, n) [rad], the first one where the arm is, M at least 2.
            scene: to check against.
            target: what was reached where the path ends or begins, or None: its fruit is in the hand and let go, and so is what is let
                go around an exact pose.
            settings: limits and radii.
            straight: the waypoints along which the tool keeps to a straight line.
            should_stop: cancels.

        Raises:
            ProblemError: `waypoints` is no such array, or `target` none.
        """
        aim = None if target is None else target_of(target)

        def world() -> Obstacles:
            spot = None if aim is None else dataclasses.replace(aim.spot(scene, settings), picked=True)
            return self.obstacles(scene, spot, settings, should_stop)

        result = recheck.follow(world, waypoints, settings, should_stop, straight)
        T = aim.poses[0] if aim is not None and aim.kind == "pose" else None
        return dataclasses.replace(result, parameters=set_parameters(settings, self.robot), target=aim, T_base_tool=T)

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
            return self.obstacles(scene, self._spot_of(result, scene, settings), settings, should_stop)

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
        spot = self._spot_of(result, scene, settings)

        def checker() -> ExactChecker:
            return stem_checker(self.robot, scene, spot, settings, should_stop)

        return recheck.obstruction(checker, result.trajectory, from_time_s, should_stop)

    def _spot_of(self, result: PlanResult, scene: Scene, settings: Settings) -> Spot | None:
        """The place of a result's target in a scene; the hand that goes back holds its fruit."""
        if result.target is None:
            return None
        spot = result.target.spot(scene, settings)
        return dataclasses.replace(spot, picked=True) if result.back else spot


def _unseen_part(figures: dict[str, Any]) -> str:
    """Say how much of the path no camera has seen, where the views are known."""
    if not figures["views"]:
        return ""
    return f"; {figures['unseen_contact_rad']:.2f} rad of it in space that no view shows ({figures['views']} known)"


def _approach(figures: dict[str, Any], settings: Settings) -> str:
    """Say how much of the last stretch is straight, where that is less than wanted."""
    straight_m = figures["straight_approach_m"]
    if straight_m >= min(settings.approach_distance_m, figures["tool_path_length_m"]) - 1e-3:
        return ""
    return f"; only the last {100.0 * straight_m:.0f} cm of {100.0 * settings.approach_distance_m:.0f} are straight"
