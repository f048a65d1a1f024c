"""The 3-D page: looks at its backend's moments, and draws what has changed.

Everything is drawn by one thread, the page's own. Viser calls back from threads of its own; those calls only leave a note.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from lime_planner.core.geometry import matrix_to_pose
from lime_planner.output.timeline import Timeline, timeline_of
from lime_planner.pipeline.in_the_way import in_the_way
from lime_planner.pipeline.result import PlanRecord
from lime_planner.robot.model import Robot, home
from lime_planner.scene.scene import Scene
from lime_planner.viewer import words
from lime_planner.viewer.access import Access
from lime_planner.viewer.arm_controls import ArmControls
from lime_planner.viewer.backend import Activity, Backend, Moment, Wishes
from lime_planner.viewer.blocked import BlockedLayer
from lime_planner.viewer.cameras import START, Cameras
from lime_planner.viewer.controls import Commands, Controls, ask_before_moving
from lime_planner.viewer.debug_layers import Extras
from lime_planner.viewer.empty_page import EmptyPage
from lime_planner.viewer.goal import Goal
from lime_planner.viewer.history import Entry, History
from lime_planner.viewer.layers import BESIDE, ApproachLines, Arm, Plant, ToolPath, Touched, ghost_arm, measured_arm
from lime_planner.viewer.player import Player
from lime_planner.viewer.plots import Plots
from lime_planner.viewer.pointing import Named, Pointing, Ray
from lime_planner.viewer.serving import start_server, stop_server

_PERIOD_S = 0.05
_UNWATCHED_PERIOD_S = 0.5  # when no browser is open
_PLANNING_PERIOD_S = 0.25  # the search may have the interpreter then
_BEYOND_REACH_M = 0.35  # of the arm: a wall of the greenhouse would only hide the plant


class Page:
    """A page that is being served."""

    def __init__(self, backend: Backend, access: Access, port: int) -> None:
        """Serve; the page follows the backend until `close`.

        Args:
            backend: plans and moves.
            access: who may do what.
            port: where to listen.

        Raises:
            ParameterError: see `lime_planner.viewer.serving.start_server`.
        """
        self._backend = backend
        self._access = access
        self._notes: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._closed = threading.Event()
        self._robot: Robot | None = None
        self._scene: Scene | None = None
        self._newest: PlanRecord | None = None  # taken into the history
        self._shown: PlanRecord | None = None  # drawn
        self._beside: Entry | None = None
        self._timeline: Timeline | None = None
        self._arm: Arm | None = None
        self._ghost: Arm | None = None
        self._plant: Plant | None = None
        self._pointing: Pointing | None = None
        self._blocked: BlockedLayer | None = None
        self._path: ToolPath | None = None
        self._other_path: ToolPath | None = None
        self._touched: Touched | None = None
        self._approaches: ApproachLines | None = None
        self._marked_s = -1.0
        self.failure = ""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="picture")
        moment = backend.moment()
        self._server = start_server(access, port, label="Lime planner", answers={"/under": self._on_hover})
        self._build(moment)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.get_port())

    @property
    def url(self) -> str:
        """Its address, token included."""
        return self._access.url(self.port)

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        self._thread.join(2.0)
        self._extras.close()
        self._pool.shutdown(wait=False, cancel_futures=True)
        stop_server(self._server)

    # -- building -------------------------------------------------------------------------------------------------------------

    def _build(self, moment: Moment) -> None:
        server, gui = self._server, self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium", brand_color=(0, 114, 178))
        gui.main_panel.dock_right()
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(True, cast_shadow=False)
        grey = {"cell_color": (172, 174, 178), "section_color": (140, 142, 146)}  # faint on white and on black
        server.scene.add_grid("/floor", 3.0, 3.0, cell_size=0.1, section_size=0.5, cell_thickness=0.6, **grey)
        server.initial_camera.position, server.initial_camera.look_at = (tuple(point) for point in START)
        self._starting = EmptyPage(gui, self._backend, self._note)
        commands = Commands(self._on_plan, self._on_execute, self._on_stop)
        self._controls = Controls(gui, moment.settings, commands, between=self._build_between)
        with gui.add_folder("Legend", expand_by_default=False):
            gui.add_html(words.legend())
        self._extras = Extras(server.scene, self._controls, self._note)
        server.scene.on_click()(self._on_scene_click)

    def _build_between(self) -> None:
        """What stands between the buttons and how to search: the plan, its goal, the arm, and other plans."""
        server, gui = self._server, self._server.gui
        self._along = gui.add_folder("Along the path", visible=False)
        with self._along:
            self._player = Player(gui)
            self._plots = Plots(gui)
        # Before there is a scene, the way to one is all that there is.
        self._of_scene = [gui.add_folder("Goal", visible=False)]
        with self._of_scene[0]:
            self._goal = Goal(server.scene, gui, self._note)
            Cameras(gui, lambda: None if self._shown is None else self._shown.target)
        self._of_scene.append(gui.add_folder("Arm", expand_by_default=False, visible=False))
        with self._of_scene[1]:
            place = self._backend.place
            self._arm_controls = ArmControls(
                gui, places=self._backend.places, place=lambda q: self._note(lambda: place(q)), home=self._on_home, retreat=self._on_retreat
            )
        self._of_scene.append(gui.add_folder("Plans", expand_by_default=False, visible=False))
        with self._of_scene[2]:
            self._history = History(gui, lambda: self._robot, self._pool)

    # -- notes from viser's threads -------------------------------------------------------------------------------------------

    def _note(self, call: Callable[[], None]) -> None:
        self._notes.put(call)

    def _on_plan(self, _event: Any) -> None:
        self._note(self._plan)

    def _plan(self) -> None:
        self._goal.take_typed()  # the call of the last number may come after the button's
        pose, fruit = self._goal.wish()
        self._backend.plan(Wishes(self._controls.wishes(self._backend.moment().settings), pose, fruit))

    def _on_lime(self, number: int) -> None:
        self._note(lambda: self._goal.choose(number))

    def _on_scene_click(self, event: Any) -> None:
        found = self._under(Ray.through(event.ray_origin, event.ray_direction))
        if found is not None and found.kind in ("leaf", "stem"):
            event.client.add_notification(found.title, found.sentence, auto_close_seconds=6.0)

    def _on_hover(self, query: str) -> str | None:
        """Answer the browser's question for what its pointer rests on."""
        ray = Ray.read(query)
        found = None if ray is None else self._under(ray)
        return None if found is None else found.json()

    def _under(self, ray: Ray) -> Named | None:
        pointing, robot, arm = self._pointing, self._robot, self._arm
        if pointing is None:
            return None
        placed = None if robot is None or arm is None or arm.q is None else (robot, arm.q)
        return pointing.under(ray, timeline=self._timeline, arm=placed, shows=self._controls.shows)

    def _on_execute(self, event: Any) -> None:
        shown = self._backend.moment().shown
        if event.client is not None and shown is not None:
            duration_s = shown.result.trajectory.duration_s if shown.result.trajectory is not None else 0.0
            what = f"will carry out **plan {shown.number}**: {duration_s:.1f} s of motion."
            ask_before_moving(event.client, what, real=self._backend.real, go=lambda: self._backend.execute(shown.number))

    def _on_retreat(self, event: Any) -> None:
        if event.client is not None:
            what = "will go **back along the last motion**, as far as it came."
            ask_before_moving(event.client, what, real=self._backend.real, go=self._backend.retreat)

    def _on_home(self, _event: Any) -> None:
        def plan() -> None:
            if self._robot is not None:
                pose = matrix_to_pose(self._robot.forward(home(self._robot)))
                self._backend.plan(Wishes(self._controls.wishes(self._backend.moment().settings), pose))

        self._note(plan)

    def _on_stop(self, _event: Any) -> None:
        self._backend.stop()  # at once, whatever the page is drawing

    # -- the page's thread ----------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._closed.is_set():
            began_s, planning = time.monotonic(), False
            try:
                while not self._notes.empty():
                    self._notes.get()()
                moment = self._backend.moment()
                planning = moment.activity is Activity.PLANNING
                self._draw(moment)
            except Exception as error:  # a page that cannot draw must not end a planner that moves an arm
                self.failure = f"{type(error).__name__}: {error}"
            watched = self._backend.watched = bool(self._server.get_clients())
            period_s = _UNWATCHED_PERIOD_S if not watched else _PLANNING_PERIOD_S if planning else _PERIOD_S
            self._closed.wait(max(0.005, period_s - (time.monotonic() - began_s)))

    def _draw(self, moment: Moment) -> None:
        with self._server.atomic():
            self._draw_standing(moment)
            if moment.activity is not Activity.PLANNING:
                self._take_in(moment)
            entry, beside = self._history.shown, self._history.beside
            if (None if entry is None else entry.record) is not self._shown or beside is not self._beside:
                self._draw_plan(entry, beside, play=moment.moving_s is None)
            touched = self._draw_moving(moment)
        self._starting.show(moment)
        self._history.draw()
        self._arm_controls.follow(moment)
        warnings = tuple(dict.fromkeys((*moment.doubts, *(() if self._shown is None else self._shown.result.warnings))))
        notes = [*(self._plant.notes if self._plant is not None else []), *self._extras.notes]
        self._controls.tell(moment, self._shown, self._timeline, touched, self._changed(), warnings, notes)

    def _changed(self) -> str:
        """What the next plan is to reach, where the newest one was not made for it."""
        pose, fruit = self._goal.wish()
        if pose is None and fruit is None:
            return ""
        aim = None if self._newest is None else self._newest.result.target
        if aim is not None and fruit is not None and aim.kind == "fruit" and np.allclose(aim.centre, fruit):
            return ""
        if (
            aim is not None
            and pose is not None
            and aim.kind == "pose"
            and np.allclose(matrix_to_pose(aim.poses[0])[:3], pose[:3], atol=1e-9)
        ):
            return ""
        return self._goal.changed

    def _take_in(self, moment: Moment) -> None:
        """Add the newest plan to the history."""
        if moment.shown is self._newest:
            return
        self._newest = moment.shown
        if moment.shown is None:
            self._history.clear()
            return
        record, pipeline = moment.shown, moment.pipeline
        if pipeline is None:
            self._history.add(Entry(record))
        else:
            self._history.add(Entry(record, timeline_of(pipeline, record) if record.found else None, in_the_way(pipeline, record)))

    def _draw_standing(self, moment: Moment) -> None:
        """Arm, plant and target, where they have changed."""
        api = self._server.scene
        if moment.robot is not self._robot:
            for arm in (self._arm, self._ghost):
                if arm is not None:
                    arm.remove()
            self._arm = self._ghost = None
            if moment.robot is not None:
                self._arm, self._ghost = measured_arm(api, moment.robot), ghost_arm(api, moment.robot)
                self._ghost.show(False)
            self._robot = moment.robot
        if moment.scene is not self._scene:
            if self._plant is not None:
                self._plant.remove()
            self._plant = self._pointing = None
            if moment.scene is not None:
                reach_m = (1.2 if moment.robot is None else moment.robot.reach_m) + _BEYOND_REACH_M
                self._plant = Plant(api, moment.scene, centre=np.zeros(3), reach_m=reach_m, on_lime=self._on_lime)
                self._pointing = Pointing(moment.scene, reach_m=reach_m)
            self._scene = moment.scene
            self._goal.take(moment.scene, forget=self._backend.opens)
            for folder in self._of_scene:
                folder.visible = moment.scene is not None
        self._goal.follow(moment.target)
        if self._arm is not None and moment.q is not None:
            self._arm.place(moment.q)

    def _draw_plan(self, entry: Entry | None, beside: Entry | None, *, play: bool) -> None:
        for layer in (self._path, self._other_path, self._touched, self._approaches, self._blocked):
            if layer is not None:
                layer.remove()
        self._path = self._other_path = self._touched = self._approaches = self._blocked = self._timeline = None
        again = entry is not None and entry.record is self._shown
        shown = self._shown = None if entry is None else entry.record
        self._beside, api = beside, self._server.scene
        other = None if beside is None else beside.timeline
        if shown is not None and entry is not None:
            self._approaches = ApproachLines(api, shown.result.approaches, shown.result.approach_outcomes)
            self._timeline = entry.timeline
            if entry.in_the_way is not None and self._robot is not None:
                self._blocked = BlockedLayer(api, self._robot, shown.scene, entry.in_the_way)
        if shown is not None and self._timeline is not None:
            self._path = ToolPath(api, self._timeline)
            self._touched = Touched(api, shown.scene, self._timeline)
        if other is not None:
            self._other_path = ToolPath(api, other, name="/path_beside", colour=BESIDE)
        timed = self._timeline is not None and self._timeline.timed
        if not again:
            self._player.load(self._timeline.duration_s if self._timeline else 0.0, unit="s" if timed else "rad", play=play)
        self._plots.load(self._timeline, other)
        self._along.visible = self._timeline is not None
        self._marked_s = -1.0

    def _draw_moving(self, moment: Moment) -> str:
        """What the slider's moment moves; return what is touched then, in words."""
        controls, timeline = self._controls, self._timeline
        if moment.moving_s is not None:
            self._player.follow(moment.moving_s)
        t_s = self._player.step()
        words = ""
        if timeline is not None and self._ghost is not None and self._touched is not None:
            self._ghost.place(timeline.configuration(t_s))
            count = self._touched.light(timeline.at(t_s))
            ever = self._touched.count(np.ones(len(timeline.leaf_points), dtype=bool))
            words = f"{self._touched.unit}: <b>{count}</b> now, {ever} on the whole way"
            if abs(t_s - self._marked_s) > 0.01:
                self._marked_s = t_s
                self._plots.mark(t_s)
        self._extras.draw(moment, self._shown, self._ghost)
        for part in ("leaves", "stems", "limes", "unseen"):
            if self._plant is not None:
                self._plant.show(part, controls.shows(part))
        if self._arm is not None:
            self._arm.show(controls.shows("arm"))
        if self._ghost is not None:
            self._ghost.show(controls.shows("ghost") and timeline is not None and moment.moving_s is None)
        for path in (self._path, self._other_path):
            if path is not None:
                path.show(controls.shows("path"))
        if self._touched is not None:
            self._touched.show(controls.shows("touched"))
        if self._blocked is not None:
            self._blocked.show(controls.shows("blocked"))
        if self._approaches is not None:
            self._approaches.show(controls.shows("approaches"))
        self._goal.show(controls.shows("target"))
        return words
