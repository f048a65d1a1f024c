"""The 3-D page: looks at its backend's moments, and draws what has changed.

Everything is drawn by one thread, the page's own. Viser calls back from threads of its own; those calls only leave a note.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.output.timeline import Timeline, timeline_of
from lime_planner.pipeline.plan_record import PlanRecord
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene
from lime_planner.viewer.access import Access
from lime_planner.viewer.backend import Activity, Backend, Moment, Wishes
from lime_planner.viewer.controls import Commands, Controls, ask_before_moving
from lime_planner.viewer.debug_layers import Extras
from lime_planner.viewer.empty_page import EmptyPage
from lime_planner.viewer.layers import ApproachLines, Arm, Plant, ToolPath, Touched, ghost_arm, measured_arm
from lime_planner.viewer.player import Player
from lime_planner.viewer.plots import Plots
from lime_planner.viewer.serving import start_server, stop_server
from lime_planner.viewer.target_marker import TargetMarker

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
        self._shown: PlanRecord | None = None
        self._timeline: Timeline | None = None
        self._arm: Arm | None = None
        self._ghost: Arm | None = None
        self._plant: Plant | None = None
        self._path: ToolPath | None = None
        self._touched: Touched | None = None
        self._approaches: ApproachLines | None = None
        self._marked_s = -1.0
        self.failure = ""
        moment = backend.moment()
        self._server = start_server(access, port, label="Lime planner")
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
        stop_server(self._server)

    # -- building -------------------------------------------------------------------------------------------------------------

    def _build(self, moment: Moment) -> None:
        server, gui = self._server, self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium", brand_color=(0, 114, 178))
        gui.main_panel.dock_right()
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(True, cast_shadow=False)
        server.scene.add_grid(
            "/floor", 3.0, 3.0, cell_size=0.1, section_size=0.5, cell_color=(225, 225, 225), section_color=(195, 195, 195)
        )
        server.initial_camera.position = (0.95, -1.15, 0.95)
        server.initial_camera.look_at = (0.38, 0.0, 0.46)
        self._starting = EmptyPage(gui, self._backend, self._note)
        commands = Commands(self._on_plan, self._on_execute, self._on_stop, self._on_reset_target, lambda _: None)
        self._controls = Controls(gui, moment.settings, commands, player=lambda: Player(gui))
        self._player: Player = self._controls.player
        panel = gui.add_panel()
        with panel.add_tab("Along the path"):
            self._empty_plots = gui.add_markdown("Clearance and cost along the path appear here once there is a plan.")
            self._plots = Plots(gui)
        panel.dock_left()
        panel.set_width(330)
        self._marker = TargetMarker(server.scene, self._controls)
        self._extras = Extras(server.scene, self._controls, self._note)

    # -- notes from viser's threads -------------------------------------------------------------------------------------------

    def _note(self, call: Callable[[], None]) -> None:
        self._notes.put(call)

    def _on_plan(self, _event: Any) -> None:
        self._note(lambda: self._backend.plan(Wishes(self._controls.wishes(self._backend.moment().settings), self._marker.wish())))

    def _on_lime(self, centre: Array) -> None:
        self._note(lambda: self._backend.plan(Wishes(self._controls.wishes(self._backend.moment().settings), fruit=centre)))

    def _on_execute(self, event: Any) -> None:
        shown = self._backend.moment().shown
        if event.client is not None and shown is not None:
            ask_before_moving(event.client, shown, real=self._backend.real, go=lambda: self._backend.execute(shown.number))

    def _on_stop(self, _event: Any) -> None:
        self._backend.stop()  # at once, whatever the page is drawing

    def _on_reset_target(self, _event: Any) -> None:
        self._note(self._marker.reset)

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
            if moment.shown is not self._shown and moment.activity is not Activity.PLANNING:
                self._draw_plan(moment)
            touched = self._draw_moving(moment)
        self._starting.show(moment)
        notes = [*(self._plant.notes if self._plant is not None else []), *self._extras.notes]
        self._controls.tell(moment, touched, notes)

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
            self._plant = None
            if moment.scene is not None:
                reach_m = (1.2 if moment.robot is None else moment.robot.reach_m) + _BEYOND_REACH_M
                self._plant = Plant(api, moment.scene, centre=np.zeros(3), reach_m=reach_m, on_lime=self._on_lime)
            self._scene = moment.scene
        self._marker.follow(moment.target)
        if self._arm is not None and moment.q is not None:
            self._arm.place(moment.q)

    def _draw_plan(self, moment: Moment) -> None:
        for layer in (self._path, self._touched, self._approaches):
            if layer is not None:
                layer.remove()
        self._path = self._touched = self._approaches = self._timeline = None
        shown = self._shown = moment.shown
        if shown is not None:
            self._approaches = ApproachLines(self._server.scene, shown.result.approaches, shown.result.approach_outcomes)
        if shown is not None and shown.found and moment.pipeline is not None:
            self._timeline = timeline_of(moment.pipeline, shown)
            self._path = ToolPath(self._server.scene, self._timeline)
            self._touched = Touched(self._server.scene, shown.scene, self._timeline)
        timed = self._timeline is not None and self._timeline.timed
        self._player.load(self._timeline.duration_s if self._timeline else 0.0, unit="s" if timed else "rad", play=moment.moving_s is None)
        self._plots.load(self._timeline)
        self._empty_plots.visible = self._timeline is None
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
        if self._path is not None:
            self._path.show(controls.shows("path"))
        if self._touched is not None:
            self._touched.show(controls.shows("touched"))
        if self._approaches is not None:
            self._approaches.show(controls.shows("target"))
        self._marker.show(controls.shows("target"))
        return words
