"""The plans made so far: one is shown, another may stand beside it, and both can be saved."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lime_planner.output.timeline import Timeline
from lime_planner.pipeline.in_the_way import InTheWay
from lime_planner.pipeline.result import PlanRecord
from lime_planner.robot.model import Robot
from lime_planner.viewer import words

MOST = 20
_NEWEST, _NONE = "the newest", "none"


@dataclass(eq=False)
class Entry:
    """A plan, its motion in samples where it has a path, and what is in its way where it was refused."""

    record: PlanRecord
    timeline: Timeline | None = None
    in_the_way: InTheWay | None = None

    @property
    def name(self) -> str:
        """What the lists call it."""
        result = self.record.result
        return f"plan {self.record.number}: {result.planner if result.succeeded else result.status.name}"


class History:
    """The folder with the two lists, the table, and the two buttons that save."""

    def __init__(self, gui: Any, robot: Callable[[], Robot | None], pool: ThreadPoolExecutor) -> None:
        """Add the controls.

        Args:
            gui: viser's, in the container that the controls belong to.
            robot: returns the arm.
            pool: draws pictures.
        """
        self._entries: list[Entry] = []
        self._robot = robot
        self._pool = pool
        self._shown = gui.add_dropdown("Shown", (_NEWEST,), hint="The plan that is drawn; only the newest one can be executed")
        self._beside = gui.add_dropdown("Beside it", (_NONE,), hint="Another plan: its figures and curves beside those of the one shown")
        self._table = gui.add_html("", visible=False)
        self._json = gui.add_button(
            "Save the plan", icon="download", color="gray", disabled=True, hint="A file for `lime-planner view` and `lime-planner animate`"
        )
        self._picture = gui.add_button(
            "Save a picture", icon="photo", color="gray", disabled=True, hint="Side and top view of the plan, PNG"
        )
        self._json.on_click(self._save_plan)
        self._picture.on_click(self._save_picture)
        self._said = ""

    def add(self, entry: Entry) -> None:
        """Take in a new plan, and show it."""
        self._entries = [*self._entries[1 - MOST :], entry]
        self._shown.value = _NEWEST
        self._offer()

    def clear(self) -> None:
        """Forget all: another scene."""
        self._entries = []
        self._offer()

    @property
    def shown(self) -> Entry | None:
        """The plan to draw."""
        return next((entry for entry in self._entries if entry.name == self._shown.value), self._entries[-1] if self._entries else None)

    @property
    def beside(self) -> Entry | None:
        """The plan to stand beside it."""
        other = next((entry for entry in self._entries if entry.name == self._beside.value), None)
        return None if other is self.shown else other

    def draw(self) -> None:
        """Write the table."""
        shown, beside = self.shown, self.beside
        said = "" if shown is None or beside is None else words.comparison((shown.record, shown.timeline), (beside.record, beside.timeline))
        if said != self._said:
            self._said = self._table.content = said
            self._table.visible = bool(said)
        for button in (self._json, self._picture):
            if button.disabled != (shown is None):
                button.disabled = shown is None

    def _offer(self) -> None:
        names = [entry.name for entry in reversed(self._entries)]
        for field, first in ((self._shown, _NEWEST), (self._beside, _NONE)):
            if tuple(field.options) != (first, *names):
                field.options = (first, *names)

    def _save_plan(self, event: Any) -> None:
        entry = self.shown
        if entry is not None and event.client is not None:
            result = entry.record.result
            text = json.dumps({**result.figures(), **result.origin()}, indent=1, allow_nan=False)
            event.client.send_file_download(f"plan-{entry.record.number}.json", text.encode(), save_immediately=True)

    def _save_picture(self, event: Any) -> None:
        entry, robot = self.shown, self._robot()
        if entry is not None and robot is not None and event.client is not None:
            notice = event.client.add_notification("The picture is being drawn", "A few seconds.", loading=True, with_close_button=False)
            self._pool.submit(_send_picture, event.client, entry.record, robot, notice)


def _send_picture(client: Any, record: PlanRecord, robot: Robot, notice: Any) -> None:
    from lime_planner.output.picture import draw_plan

    try:
        with tempfile.TemporaryDirectory() as folder:
            picture = draw_plan(record.result, record.scene, robot, Path(folder) / "plan.png").read_bytes()
        client.send_file_download(f"plan-{record.number}.png", picture, save_immediately=True)
    finally:
        notice.remove()
