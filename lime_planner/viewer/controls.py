"""The page's controls: status in words, the three buttons, how to search, and what to show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lime_planner.core.parameters import Settings
from lime_planner.core.planners import PLANNERS
from lime_planner.output.timeline import Timeline
from lime_planner.pipeline.result import PlanRecord
from lime_planner.planning.planner import load_planner
from lime_planner.viewer import words
from lime_planner.viewer.backend import Activity, Moment

_LAYERS = (
    ("leaves", "Leaves", True, "The soft points: touching them costs, and is allowed"),
    ("stems", "Stems", True, "The hard points: stems, branches, stakes. The arm never touches them"),
    ("limes", "Limes", True, "The fruit"),
    ("unseen", "Unseen space", False, "What no camera has looked into, where it is known where the clouds were seen from; it has a price"),
    ("arm", "Arm, as measured", True, "Where the arm is, by its joint angles"),
    ("ghost", "Ghost arm, as planned", True, "Where the plan has the arm at the slider's moment"),
    ("path", "Path of the tool", True, "Blue: the arm is free. Orange: some part of it touches leaves"),
    ("touched", "Touched leaves", True, "Orange: touched at the slider's moment. Pale: touched before it"),
    ("target", "Target marker", True, "Drag its arrows and rings to move and turn the target"),
    ("blocked", "What is in the way", True, "After a refusal: where the arm would have to be, and what it meets there"),
    ("approaches", "Approaches tried", True, "Lines towards the lime, coloured by what became of them"),
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


class Controls:
    """The panel's own part: status, the three buttons, how to search, and what to show; the others add theirs in between."""

    def __init__(self, gui: Any, settings: Settings, commands: Commands, *, between: Callable[[], None]) -> None:
        """Add everything.

        Args:
            gui: viser's.
            settings: defaults of what can be set.
            commands: what the buttons do.
            between: adds the controls that stand between the buttons and the search's.
        """
        self._status = gui.add_html("")
        self._said = ("", "")
        # They never change places: a click that comes late must not meet another button.
        self.plan = gui.add_button("Plan", icon="route", color="gray", hint="Search a path from where the arm stands. Nothing moves")
        self.execute = gui.add_button("Execute", icon="player-track-next", color="gray", disabled=True, hint="Move the arm; asks first")
        self.stop = gui.add_button(
            "Stop", icon="hand-stop", color="gray", hint="Stop the search, and the arm; the Escape key does the same"
        )
        self.plan.on_click(commands.plan)
        self.execute.on_click(commands.execute)
        self.stop.on_click(commands.stop)
        self._figures = gui.add_html("", visible=False)
        between()
        with gui.add_folder("How to search", expand_by_default=False):
            hint = "\n".join(f"{name}: {load_planner(name).summary}" for name in PLANNERS)
            self._planner = gui.add_dropdown("Planner", tuple(PLANNERS), initial_value=settings.planner, hint=hint)
            self._budget = gui.add_number(
                "Search time [s]", settings.time_budget_s, min=0.02, max=60.0, step=0.1, hint="The longer, the cheaper the path"
            )
            self._weight = gui.add_number(
                "Leaf weight",
                round(settings.weight, 3),
                min=0.0,
                max=1e6,
                step=10.0,
                hint="What one radian of motion among leaves costs; in free air it costs 1. 0: leaves do not matter",
            )
        with gui.add_folder("Show", expand_by_default=False):
            self._layers = {name: gui.add_checkbox(label, value, hint=hint) for name, label, value, hint in _LAYERS}
            self.field = gui.add_dropdown(
                "Distance to",
                tuple(FIELDS),
                initial_value="none",
                hint="A coloured slice through the map of distances that the planner uses",
            )
            self.height = gui.add_slider("Height of the slice [m]", -0.2, 1.5, 0.01, 0.5, hint="Where the slice lies", visible=False)

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

    def tell(
        self,
        moment: Moment,
        shown: PlanRecord | None,
        timeline: Timeline | None,
        touched: str,
        changed: str,
        warnings: Sequence[str],
        notes: Sequence[str],
    ) -> None:
        """Put the moment into words, and show which button is the next one to press.

        Args:
            moment: what there is to see.
            shown: the plan that is drawn.
            timeline: its.
            touched: which leaves are touched, in HTML.
            changed: what the next plan is to reach, where that is not what it was asked for before.
            warnings: what is hardly meant about scene, target and start.
            notes: what is drawn otherwise than one would think.
        """
        idle = moment.activity is Activity.IDLE and not moment.blocked_plan
        advice = f"{changed} is chosen: press Plan." if changed and idle else ""
        said = (words.status(moment, advice, warnings, notes), words.figures(shown, timeline, touched))
        if said[0] != self._said[0]:
            self._status.content = said[0]
        if said[1] != self._said[1]:
            self._figures.content = said[1]
            self._figures.visible = bool(said[1])
        self._said = said
        active = moment.activity in (Activity.PLANNING, Activity.MOVING, Activity.STOPPING)
        newest = shown is moment.shown and not changed
        primary = self.stop if active else self.execute if not moment.blocked_motion and newest else self.plan
        no_motion = moment.blocked_motion or ("" if shown is moment.shown else "an older plan is shown")
        for button, colour, blocked in (
            (self.plan, "green", moment.blocked_plan),
            (self.execute, "orange", no_motion),
            (self.stop, "red", ""),
        ):
            wanted = colour if button is primary and not blocked else "gray"
            if button.color != wanted:
                button.color = wanted
            if button.disabled != bool(blocked):
                button.disabled = bool(blocked)


def ask_before_moving(client: Any, what: str, *, real: bool, go: Callable[[], None]) -> None:
    """Ask one browser's user whether the arm is to move.

    Args:
        client: viser's handle of the browser.
        what: goes on after "The arm", in Markdown.
        real: whether something outside this program moves.
        go: is called on yes.
    """
    modal = client.gui.add_modal("Move the arm?")
    with modal:
        client.gui.add_markdown(
            f"{'The arm' if real else 'The simulated arm'} {what}" + ("\n\nIs everyone out of its reach?" if real else "")
        )
        yes = client.gui.add_button("Move the arm", color="orange", icon="player-track-next")
        no = client.gui.add_button("Cancel", icon="x", color="gray")

    @yes.on_click
    def _(_event: Any) -> None:
        modal.close()
        go()

    @no.on_click
    def _(_event: Any) -> None:
        modal.close()
