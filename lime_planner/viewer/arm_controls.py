"""Where the arm starts, its way home, and its way back out of the plant."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.robot.model import Robot
from lime_planner.viewer.backend import Moment

_TURN_RAD = 2.0 * np.pi


class ArmControls:
    """The folder with a slider for each joint, Home and Retreat."""

    def __init__(
        self, gui: Any, *, places: bool, place: Callable[[Array], None], home: Callable[[Any], None], retreat: Callable[[Any], None]
    ) -> None:
        """Add the controls.

        Args:
            gui: viser's, in the container that the controls belong to.
            places: whether the arm can be put somewhere without moving there: a simulated one.
            place: puts it into a configuration (n,) [rad].
            home: is called with the event of its button.
            retreat: likewise.
        """
        self._gui = gui
        self._places = places
        self._place = place
        self._home = gui.add_button("Home", icon="home", color="gray", hint="Plan a way to where the arm is at home; Execute goes it")
        self._retreat = gui.add_button("Retreat", icon="arrow-back", color="gray", hint="Back along the last motion; asks first")
        self._home.on_click(home)
        self._retreat.on_click(retreat)
        self._container = gui.add_folder("Start [rad]", expand_by_default=True, visible=False)
        self._sliders: list[Any] = []
        self._robot: Robot | None = None
        self._written: Array | None = None

    def follow(self, moment: Moment) -> None:
        """Show where the arm is, and what it can do."""
        if moment.robot is not self._robot:
            self._build(moment.robot)
        for button, blocked in ((self._home, moment.blocked_plan), (self._retreat, moment.blocked_retreat)):
            if button.disabled != bool(blocked):
                button.disabled = bool(blocked)
        if moment.q is None or not self._sliders:
            return
        moving = bool(moment.blocked_plan)
        if self._written is None or np.abs(moment.q - self._written).max() > 2e-3:
            self._written = np.array(moment.q)
            for slider, angle in zip(self._sliders, moment.q, strict=True):
                slider.value = float(np.clip(round(float(angle), 3), slider.min, slider.max))
        for slider in self._sliders:
            if slider.disabled != moving:
                slider.disabled = moving

    def _build(self, robot: Robot | None) -> None:
        for slider in self._sliders:
            slider.remove()
        self._sliders, self._robot, self._written = [], robot, None
        if robot is None or not self._places:
            return
        with self._container:
            # "joint_1", not "j2s6s200_joint_1": what all names begin with tells nothing, and would be cut off.
            common = re.sub(r"(joint_?|[^_/]*)$", "", os.path.commonprefix(robot.joint_names))  # noqa: RUF071 - letter by letter
            for name, low, high in zip(robot.joint_names, robot.lower, robot.upper, strict=True):
                low, high = max(float(low), -_TURN_RAD), min(float(high), _TURN_RAD)
                slider = self._gui.add_slider(name.removeprefix(common), low, high, 0.01, float(np.clip(0.0, low, high)))
                slider.on_update(self._on_update)
                self._sliders.append(slider)
        self._container.visible = True

    def _on_update(self, event: Any) -> None:
        if event.client is None:
            return
        q = np.array([float(slider.value) for slider in self._sliders])
        self._written = q
        self._place(q)
