"""A scene file's planner behind the page: plans in a thread of its own, through the same pipeline as the node, and a simulated arm."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable

import numpy as np

from lime_planner.core.errors import LimePlannerError, SceneError
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.parameters import Settings
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.motion import stop as stopping
from lime_planner.motion.trajectory import Trajectory
from lime_planner.motion.way_back import straight_back, way_back
from lime_planner.output.console import compile_first
from lime_planner.pipeline import Pipeline, PlanResult
from lime_planner.pipeline.plausibility import doubts_about
from lime_planner.pipeline.result import PlanRecord
from lime_planner.pipeline.scene_targets import own_target
from lime_planner.pipeline.targets import Target, fruit_target, pose_target, target_of
from lime_planner.robot.model import Robot, home
from lime_planner.scene.plants.grasp_targets import canopy_targets, grasp_pose
from lime_planner.scene.scene import Scene
from lime_planner.viewer.backend import Activity, Moment, Wishes, with_wishes

Job = Callable[[threading.Event], None]

_ADVICE = (
    "Nothing to show yet. Open a scene of yours with the button below (.npz with points and labels), "
    "or grow a lime plant to try the planner on."
)

_NO_TARGET = "the scene has no target: drag the marker to where the tool is to go, or type it, and press Plan"


@dataclasses.dataclass(frozen=True, eq=False)
class _Motion:
    """A motion of the simulated arm: which plan's, what it follows, since when, and whether it is a stop."""

    trajectory: Trajectory
    began_s: float
    of_plan_s: float | None

    def elapsed_s(self) -> float:
        return time.monotonic() - self.began_s


class SceneBackend:
    """The backend for scene files and saved plans (see `lime_planner.viewer.backend.Backend`)."""

    real = False
    watched = False

    def __init__(
        self,
        load_robot: Callable[[], Robot],
        settings: Settings,
        *,
        scene: Scene | None = None,
        target: Target | Array | None = None,
        q_start: Array | None = None,
        saved: Callable[[Robot], PlanResult] | None = None,
        title: str = "no scene",
    ) -> None:
        """Start loading; the page may be opened at once.

        Args:
            load_robot: loads the arm, in the background.
            settings: parameters of the plans.
            scene: what stands in front of the arm; its frame may be empty, then it is the arm's.
            target: (7,) pose of the tool at the fruit, or what is to be reached otherwise; what the scene is about by default.
            q_start: (n,) where the arm stands [rad]; its home by default.
            saved: makes a plan that was made before, to be shown first.
            title: names the scene.
        """
        self.title = title
        self._settings = settings
        self._lock = threading.Condition()
        self._jobs: list[tuple[Job, threading.Event]] = []
        self._running: threading.Event | None = None
        self._closed = False
        self._scene = scene
        self._aim = self._own(scene) if target is None else target_of(target, settings.grasp_freedom)
        self._target = None if self._aim is None else self._aim.shown_pose()
        self._robot: Robot | None = None
        self._pipeline: Pipeline | None = None
        self._ready = False
        self._q = q_start
        self._motion: _Motion | None = None
        self._way_out: PlanResult | None = None  # the plan that was carried out last
        self._shown: PlanRecord | None = None
        self._count = 0
        self._made_up = False  # the target stands where the page put it: the scene has none
        self._doubts: tuple[str, ...] = ()
        self._message = "loading the arm's model"
        with self._lock:
            self._submit(lambda _: self._load(load_robot, saved))
        self._thread = threading.Thread(target=self._run, name="backend", daemon=True)
        self._thread.start()

    @property
    def places(self) -> bool:
        """Whether the arm can be put somewhere."""
        return True

    @property
    def opens(self) -> bool:
        """Whether a scene can be opened from the page."""
        return True

    def moment(self) -> Moment:
        """Return what there is to see now."""
        with self._lock:
            self._settle()
            motion = self._motion
            if motion is not None:
                activity = Activity.MOVING if motion.of_plan_s is not None else Activity.STOPPING
            elif self._running is not None or self._jobs:
                activity = Activity.PLANNING if self._ready else Activity.LOADING
            else:
                activity = Activity.IDLE
            return Moment(
                activity,
                self._message,
                self._settings,
                self._robot,
                self._pipeline,
                self._scene,
                self._target,
                self._measured(),
                self._shown,
                None if motion is None or motion.of_plan_s is None else motion.elapsed_s(),
                self._why_no_plan(),
                self._why_no_motion(),
                self._why_no_retreat(),
                _ADVICE if self._scene is None else "",
                self._doubts,
            )

    def plan(self, wishes: Wishes) -> None:
        """Plan from where the arm stands."""
        with self._lock:
            if self._why_no_plan():
                self._message = Status.NOT_READY.message(self._why_no_plan())
                return
            try:
                settings, aim = with_wishes(self._settings, wishes), self._aim
                if wishes.target is not None:
                    aim = pose_target(wishes.target, settings.grasp_freedom)
                elif wishes.fruit is not None:
                    aim = fruit_target(wishes.fruit)
            except LimePlannerError as error:
                self._message = Status.BAD_INPUT.message(str(error))
                return
            assert self._pipeline is not None and self._scene is not None and aim is not None
            pipeline, scene, goal = self._pipeline, self._scene, aim
            self._message = f"searching for a path ({settings.planner})"
            self._submit(lambda stop: self._make_plan(pipeline, scene, goal, settings, stop))

    def execute(self, number: int) -> None:
        """Let the simulated arm carry the plan out."""
        with self._lock:
            reason = self._why_no_motion() or ("a newer plan has taken its place" if self._shown and self._shown.number != number else "")
            if reason:
                self._message = Status.NOTHING_TO_EXECUTE.message(reason)
                return
            assert self._shown is not None and self._shown.result.trajectory is not None
            self._motion = _Motion(self._shown.result.trajectory, time.monotonic(), 0.0)
            if not self._shown.result.back:
                self._way_out = self._shown.result
            self._message = f"the simulated arm moves for {self._motion.trajectory.duration_s:.1f} s"

    def retreat(self) -> None:
        """Let the simulated arm go back along the motion that it made last."""
        with self._lock:
            reason = self._why_no_retreat()
            if reason:
                self._message = Status.NOTHING_TO_EXECUTE.message(reason)
                return
            assert self._pipeline is not None and self._scene is not None and self._way_out is not None
            pipeline, scene, way, settings = self._pipeline, self._scene, self._way_out, self._settings
            self._submit(lambda stop: self._go_back(pipeline, scene, way, settings, stop))

    def place(self, q: Array) -> None:
        """Put the simulated arm into a configuration; plans begin there."""
        with self._lock:
            if self._motion is None and self._robot is not None and np.shape(q) == (self._robot.n,) and np.isfinite(q).all():
                self._q = np.asarray(q, dtype=np.float64)
                self._way_out = None

    def stop(self) -> None:
        """Cancel a plan; brake the simulated arm along its path."""
        with self._lock:
            if self._running is not None and self._ready:
                self._running.set()
            self._settle()
            motion, robot = self._motion, self._robot
            if motion is None or motion.of_plan_s is None or robot is None:
                return
            brake = stopping.braking(motion.trajectory, motion.elapsed_s(), robot.acceleration_limits, lead_s=0.0)
            self._motion = _Motion(brake, time.monotonic(), None)
            self._message = Status.CANCELLED.message("stopped from the page")

    def open(self, scene: Scene, title: str) -> None:
        """Take another scene; its plan and target go with the old one."""
        with self._lock:
            self._scene, self._shown, self._way_out, self.title = scene, None, None, title
            self._aim = self._own(scene)
            self._target = None if self._aim is None else self._aim.shown_pose()
            self._made_up, self._doubts = False, scene.notes
            self._message = f"{title}: {scene.n_points} points; {'press Plan' if self._target is not None else _NO_TARGET}"
            if self._robot is not None:
                self._fit(self._robot)

    def close(self) -> None:
        """End the thread; a plan in work is cancelled."""
        with self._lock:
            self._closed = True
            if self._running is not None:
                self._running.set()
            self._lock.notify_all()
        self._thread.join(5.0)

    # -- with the lock held ---------------------------------------------------------------------------------------------------

    def _why_no_plan(self) -> str:
        if self._scene is None:
            return "there is no scene"
        if not self._ready:
            return "the planner is still getting ready"
        if self._motion is not None:
            return "the arm moves; press Stop first"
        if self._robot is not None and self._scene.frame_id != self._robot.planning_frame:
            return f"the scene is in the frame {self._scene.frame_id!r}, the arm plans in {self._robot.planning_frame!r}"
        return "" if self._target is not None else "there is no target"

    def _why_no_motion(self) -> str:
        shown = self._shown
        if self._motion is not None:
            return "the arm moves already"
        if shown is None or shown.result.trajectory is None or shown.result.status is not Status.SUCCEEDED:
            return "there is no plan to carry out; press Plan first"
        q = self._measured()
        if q is None or np.abs(q - shown.result.trajectory.positions[0]).max() > 0.01:
            return "the arm no longer stands where the plan begins; press Plan again"
        return ""

    def _why_no_retreat(self) -> str:
        if self._motion is not None:
            return "the arm moves already"
        return "" if self._way_out is not None and self._ready else "nothing has been executed yet"

    def _measured(self) -> Array | None:
        if self._motion is None:
            return self._q
        return self._motion.trajectory.sample(self._motion.elapsed_s())

    def _settle(self) -> None:
        """Notice a motion's end."""
        motion = self._motion
        if motion is None or motion.elapsed_s() < motion.trajectory.duration_s:
            return
        self._q, self._motion = motion.trajectory.positions[-1].copy(), None
        if motion.of_plan_s is not None:
            back = self._shown is not None and self._shown.result.back
            reached = "is back where the motion began" if back else "has reached the end of the plan"
            self._message = Status.SUCCEEDED.message(f"the simulated arm {reached}")

    def _fit(self, robot: Robot) -> None:
        """Put a scene without a frame into the arm's, and give one without a target a place to drag it from."""
        assert self._scene is not None
        if not self._scene.frame_id:
            self._scene = dataclasses.replace(self._scene, frame_id=robot.planning_frame)
        if self._aim is None:
            self._made_up = True
            self._set_aim(pose_target(_place_to_begin(self._scene, robot), self._settings.grasp_freedom))
        assert self._aim is not None
        start = home(robot) if self._q is None else self._q
        self._doubts = (*self._scene.notes, *doubts_about(self._scene, robot, self._aim.centre, start))

    def _own(self, scene: Scene | None) -> Target | None:
        """What a scene is about: its target's fruit, with the approach free, where it knows its fruit."""
        return None if scene is None else own_target(scene, self._settings.grasp_freedom, np.zeros(3))

    def _set_aim(self, aim: Target) -> None:
        self._aim, self._target = aim, aim.shown_pose()

    def _submit(self, job: Job) -> None:
        """Hand a job to the thread; it takes the place of older ones."""
        self._jobs = [(job, threading.Event())]
        if self._running is not None and self._ready:
            self._running.set()
        self._lock.notify_all()

    # -- in the backend's thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            with self._lock:
                self._running = None
                self._lock.wait_for(lambda: bool(self._jobs) or self._closed)
                if self._closed:
                    return
                job, stop = self._jobs.pop()
                self._running = stop
            try:
                job(stop)
            except LimePlannerError as error:
                self._say(getattr(error, "status", Status.BAD_INPUT).message(str(error)))
            except Exception as error:
                self._say(Status.INTERNAL_ERROR.message(f"{type(error).__name__}: {error}"))

    def _say(self, message: str) -> None:
        with self._lock:
            self._message = message

    def _load(self, load_robot: Callable[[], Robot], saved: Callable[[Robot], PlanResult] | None) -> None:
        robot = load_robot()
        pipeline = Pipeline(robot)
        with self._lock:
            self._robot, self._pipeline = robot, pipeline
            self._q = home(robot) if self._q is None else self._q
            if self._scene is not None:
                self._fit(robot)
            self._message = "compiling the planner (a minute the first time, seconds later)"
        result = None if saved is None else saved(robot)
        if result is not None:
            grasp = self._target if result.T_base_tool is None else matrix_to_pose(result.T_base_tool)
            self._show(self._scene, grasp, self._settings, result)
        compile_first()
        stopping.warm_up()
        pipeline.warm_up()
        with self._lock:
            self._ready = True
            next_step = _NO_TARGET if self._made_up else "press Plan" if self._scene is not None else "waiting for a scene"
            self._message = next_step if result is None else result.message

    def _make_plan(self, pipeline: Pipeline, scene: Scene, aim: Target, settings: Settings, stop: threading.Event) -> None:
        with self._lock:
            q = self._measured()
        assert q is not None
        result = pipeline.plan(scene, aim, q, settings, should_stop=stop.is_set)
        self._say(result.message)
        if result.status is not Status.CANCELLED:
            grasp = aim.shown_pose() if result.T_base_tool is None else matrix_to_pose(result.T_base_tool)
            self._show(scene, grasp, settings, result)

    def _go_back(self, pipeline: Pipeline, scene: Scene, way: PlanResult, settings: Settings, stop: threading.Event) -> None:
        with self._lock:
            q = self._measured()
            self._message = "the way back is checked"
        assert q is not None
        waypoints = way_back(way.waypoints, q)
        straight_from = way.waypoints[way.straight_from] if way.straight_from < len(way.waypoints) - 1 else None
        straight = straight_back(straight_from, waypoints)
        result = pipeline.follow(waypoints, scene, way.target, settings, straight=straight, should_stop=stop.is_set)
        self._say(result.message)
        if result.status is Status.CANCELLED:
            return
        self._show(scene, None, settings, result)
        if result.status is Status.SUCCEEDED and result.trajectory is not None:
            with self._lock:
                if stop.is_set():
                    return
                self._motion = _Motion(result.trajectory, time.monotonic(), 0.0)
                self._message = f"the simulated arm goes back for {result.trajectory.duration_s:.1f} s"

    def _show(self, scene: Scene | None, target: Array | None, settings: Settings, result: PlanResult) -> None:
        assert scene is not None
        with self._lock:
            if scene is not self._scene:
                return  # another one was opened meanwhile
            self._count += 1
            self._shown = PlanRecord(self._count, scene, settings, target, result)


def _place_to_begin(scene: Scene, robot: Robot) -> Array:
    """Return a pose (7,) among the leaves within reach, or in front of the arm where there are none."""
    try:
        poses = [pose for pose in canopy_targets(scene, np.random.default_rng(0), 20) if np.linalg.norm(pose[:3]) < robot.reach_m]
    except SceneError:
        poses = []
    poses = poses or [grasp_pose((0.5 * robot.reach_m, 0.0, 0.5 * robot.reach_m), (1.0, 0.0, 0.0), 0.0)]
    return min(poses, key=lambda pose: float(np.linalg.norm(pose[:3])))
