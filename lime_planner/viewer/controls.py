"""The page's controls: status in words, the three buttons, what to plan with, and what to show."""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lime_planner.core.parameters import Settings
from lime_planner.core.planners import PLANNERS
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.output.console import cell
from lime_planner.pipeline.plan_record import PlanRecord
from lime_planner.planning.planner import load_planner
from lime_planner.viewer.backend import Activity, Moment

#: Colour and sign of the status light; told apart by the sign as well.
_LIGHTS = {
    Activity.LOADING: ("#8a8a8a", "…"),
    Activity.IDLE: ("#0072b2", "●"),
    Activity.PLANNING: ("#cc79a7", "◔"),
    Activity.MOVING: ("#d55e00", "▶"),
    Activity.STOPPING: ("#d55e00", "■"),
}
_LAYERS = (
    ("leaves", "Leaves", True, "The soft points: touching them costs, and is allowed"),
    ("stems", "Stems", True, "The hard points: stems, branches, stakes. The arm never touches them"),
    ("limes", "Limes", True, "The fruit"),
    ("unseen", "Unseen space", False, "What no camera has looked into, where it is known where the clouds were seen from; it has a price"),
    ("arm", "Arm, as measured", True, "Where the arm is, by its joint angles"),
    ("ghost", "Ghost arm, as planned", True, "Where the plan has the arm at the slider's moment"),
    ("path", "Path of the tool", True, "Blue: the arm is free. Orange: some part of it touches leaves"),
    ("touched", "Touched leaves", True, "Orange: touched at the slider's moment. Pale: touched before it"),
    ("target", "Target marker", True, "Drag its arrows and rings to move the target"),
    ("tree", "Search tree", False, "Where the search looked, as the tool saw it: the search is run once more for it. Orange: costs leaves"),
    ("spheres", "Collision spheres", False, "The spheres that stand for the arm in quick collision checks, on the ghost arm"),
)
FIELDS = {"none": -1, "stems": 0, "leaves": 1}


@dataclass(frozen=True)
class Commands:
    """What the buttons do; each gets viser's event."""

    plan: Callable[[Any], None]
    execute: Callable[[Any], None]
    stop: Callable[[Any], None]
    reset_target: Callable[[Any], None]
    changed: Callable[[Any], None]


class Controls:
    """The main panel, but for the player."""

    def __init__(self, gui: Any, settings: Settings, commands: Commands, *, player: Callable[[], Any]) -> None:
        """Add everything.

        Args:
            gui: viser's.
            settings: defaults of what can be set.
            commands: what the buttons do.
            player: adds the player's controls in their place.
        """
        self._gui = gui
        self._status = gui.add_html("")
        self._said = ""
        self.plan = gui.add_button("Plan", icon="route", color="green", hint="Search a path from where the arm stands. Nothing moves")
        self.execute = gui.add_button("Execute", icon="player-track-next", color="orange", disabled=True, hint="Move the arm; asks first")
        self.stop = gui.add_button("Stop", icon="hand-stop", color="red", hint="Stop the search, and the arm")
        self.plan.on_click(commands.plan)
        self.execute.on_click(commands.execute)
        self.stop.on_click(commands.stop)
        with gui.add_folder("Plan, moment by moment"):
            self.player = player()
        with gui.add_folder("For the next plan"):
            hint = "\n".join(f"{name}: {load_planner(name).summary}" for name in PLANNERS)
            self._planner = gui.add_dropdown("Planner", tuple(PLANNERS), initial_value=settings.planner, hint=hint)
            self._budget = gui.add_number(
                "Search time [s]", settings.time_budget_s, min=0.02, max=60.0, step=0.1, hint="The longer, the cheaper the path"
            )
            self._weight = gui.add_number(
                "Weight of leaves",
                round(settings.weight, 3),
                min=0.0,
                max=1e6,
                step=10.0,
                hint="What one radian of motion among leaves costs; in free air it costs 1. 0: leaves do not matter",
            )
            self.target = gui.add_vector3(
                "Target [m]", (0.0, 0.0, 0.0), step=0.005, hint="Where the tool is to go, from the arm's base; z is up"
            )
            self._reset = gui.add_button("Back to the first target", icon="arrow-back-up", hint="Undo the dragging")
            self._reset.on_click(commands.reset_target)
        with gui.add_folder("Show", expand_by_default=False):
            self._layers = {name: gui.add_checkbox(label, value, hint=hint) for name, label, value, hint in _LAYERS}
            self.field = gui.add_dropdown(
                "Distance to",
                tuple(FIELDS),
                initial_value="none",
                hint="A coloured slice through the map of distances that the planner uses",
            )
            self.height = gui.add_slider("Height of the slice [m]", -0.2, 1.5, 0.01, 0.5, hint="Where the slice lies", visible=False)
        for handle in (*self._layers.values(), self.field, self.height):
            handle.on_update(commands.changed)

    def wishes(self, settings: Settings) -> dict[str, Any]:
        """Return the parameters that differ from the settings."""
        changed: dict[str, Any] = {}
        if self._planner.value != settings.planner:
            changed["planner"] = self._planner.value
        if abs(self._budget.value - settings.time_budget_s) > 1e-9:
            changed |= {"time_budget_s": float(self._budget.value), "iterations": 0}
        if abs(self._weight.value - settings.weight) > 1e-3:
            weight = float(self._weight.value)
            # The paper's planners count nodes: C_perm is their weight of one step.
            changed |= {"leaf_weight": weight, "c_perm": min(weight * settings.step_rad, 1e6)}
        return changed

    def shows(self, layer: str) -> bool:
        """Tell whether a layer is wanted."""
        return bool(self._layers[layer].value)

    def tell(self, moment: Moment, touched: str, notes: Sequence[str]) -> None:
        """Put the moment into words, and grey out what cannot be done.

        Args:
            moment: what there is to see.
            touched: which leaves are touched, in HTML.
            notes: what is drawn otherwise than one would think.
        """
        colour, sign = _LIGHTS[moment.activity]
        said = (
            '<div style="padding:2px 14px 6px 14px;line-height:1.35">'
            f'<div style="font-weight:600;color:{colour}"><span aria-hidden="true">{sign}</span> {moment.activity.value}</div>'
            f'<div style="font-size:0.86em">{html.escape(in_words(moment))}</div>{figures(moment.shown, touched)}'
            + "".join(f'<div style="font-size:0.8em;color:#666;margin-top:3px">{html.escape(note)}</div>' for note in notes)
            + "</div>"
        )
        if said != self._said:
            self._said = self._status.content = said
        for button, blocked in ((self.plan, moment.blocked_plan), (self.execute, moment.blocked_motion)):
            if button.disabled != bool(blocked):
                button.disabled = bool(blocked)

    def put_target(self, position: Array) -> None:
        """Show a target's position, unless it is shown already."""
        shown = tuple(round(float(value), 4) for value in position)
        if tuple(self.target.value) != shown:
            self.target.value = shown


def in_words(moment: Moment) -> str:
    """Return what to tell about a moment, in a sentence or two."""
    shown, message = moment.shown, re.sub(r" \[plan_id [^]]*\]$", "", moment.message)
    if shown is not None and shown.result.status is Status.SUCCEEDED and message == shown.result.message:
        then = f"Execute is not possible: {moment.blocked_motion}." if moment.blocked_motion else "Play shows it, Execute moves the arm."
        return f"A path is found; nothing has moved. {then}"
    return message


def figures(shown: PlanRecord | None, touched: str) -> str:
    """Return a plan's figures as a small table of HTML; empty without a path."""
    if shown is None or not shown.found:
        return ""
    values = shown.result.figures()
    rows = [
        ("plan", f"<b>{shown.number}</b>, by {html.escape(shown.result.planner)} in {cell(values, 'planning_time_s')} s"),
        ("among leaves", f"{cell(values, 'leaf_contact_rad')} of {cell(values, 'path_length_rad')} rad"),
        ("nearest stem", f"{cell(values, 'min_stem_clearance_m', 1000.0, 1)} mm"),
        ("tool's way", f"{cell(values, 'tool_path_length_m', 1.0, 2)} m"),
    ]
    if shown.result.trajectory is not None:
        rows.append(("motion", f"{shown.result.trajectory.duration_s:.1f} s"))
    rows.append(("touched", touched))
    cells = "".join(f'<tr><td style="color:#666;padding-right:10px">{name}</td><td>{text}</td></tr>' for name, text in rows if text)
    return f'<table style="font-size:0.86em;margin-top:4px;border-spacing:0">{cells}</table>'


def ask_before_moving(client: Any, shown: PlanRecord, *, real: bool, go: Callable[[], None]) -> None:
    """Ask one browser's user whether the arm is to move.

    Args:
        client: viser's handle of the browser.
        shown: the plan that would be carried out.
        real: whether something outside this program moves.
        go: is called on yes.
    """
    duration_s = shown.result.trajectory.duration_s if shown.result.trajectory is not None else 0.0
    which = "The arm" if real else "The simulated arm"
    modal = client.gui.add_modal("Move the arm?")
    with modal:
        client.gui.add_markdown(
            f"{which} will carry out **plan {shown.number}**: {duration_s:.1f} s of motion."
            + ("\n\nIs everyone out of its reach?" if real else "")
        )
        yes = client.gui.add_button("Move the arm", color="orange", icon="player-track-next")
        no = client.gui.add_button("Cancel", icon="x")

    @yes.on_click
    def _(_event: Any) -> None:
        modal.close()
        go()

    @no.on_click
    def _(_event: Any) -> None:
        modal.close()
