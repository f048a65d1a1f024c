"""Where to look from: a row of buttons, each for the browser that presses it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lime_planner.core.types import Array

START = (np.array([0.95, -1.15, 0.95]), np.array([0.38, 0.0, 0.46]))
_CLOSE_M = 0.45


class Cameras:
    """Whole, side, top, and close to the target."""

    def __init__(self, gui: Any, target: Callable[[], Array | None]) -> None:
        """Add the buttons.

        Args:
            gui: viser's, in the container that they belong to.
            target: returns the pose (7,) that is to be reached, None where there is none.
        """
        buttons = gui.add_button_group("Look from", ("Start", "Side", "Top", "Target"), hint="Moves this browser's camera alone")

        @buttons.on_click
        def _(event: Any) -> None:
            if event.client is None:
                return
            position, look_at = placed(str(event.target.value), target())
            with event.client.atomic():
                event.client.camera.up_direction = (0.0, 0.0, 1.0)
                event.client.camera.position = position
                event.client.camera.look_at = look_at


def placed(name: str, target: Array | None) -> tuple[Array, Array]:
    """Return position and point looked at [m] of a preset, around the target where there is one."""
    middle = np.array([0.4, 0.0, 0.45]) if target is None else 0.5 * (target[:3] + np.array([0.0, 0.0, 0.4]))
    across = np.array([0.0, -1.0, 0.0]) if target is None else np.array([target[1], -target[0], 0.0])
    across = across / max(float(np.linalg.norm(across)), 1e-9) if np.linalg.norm(across) > 1e-6 else np.array([0.0, -1.0, 0.0])
    if name == "Side":
        return middle + 1.7 * across, middle
    if name == "Top":
        return middle + np.array([-0.02, 0.0, 1.9]), middle
    if name == "Target" and target is not None:
        away = across + np.array([0.0, 0.0, 0.35])
        return target[:3] + _CLOSE_M * away / np.linalg.norm(away), target[:3]
    return START
