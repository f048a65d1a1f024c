"""The time slider: where in the plan the ghost arm is, and how that moment moves on by itself."""

from __future__ import annotations

import time
from typing import Any

SPEEDS = {"¼ ×": 0.25, "½ ×": 0.5, "1 ×": 1.0, "2 ×": 2.0}


class Player:
    """Slider, play button and speed, and the moment that they stand for."""

    def __init__(self, gui: Any) -> None:
        """Add the controls, disabled until there is a plan.

        Args:
            gui: viser's, in the container that the controls belong to.
        """
        self._slider = gui.add_slider(
            "Time [s]", 0.0, 1.0, 0.01, 0.0, disabled=True, hint="The moment of the plan at which the blue ghost arm is drawn"
        )
        self._button = gui.add_button("Play", icon="player-play", color="gray", disabled=True, hint="Let the ghost arm go through the plan")
        self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1 ×", hint="Of the ghost arm, against the real time")
        self._end_s = 0.0
        self._last = time.monotonic()
        self._written = 0.0  # where the slider stands, by us or by hand: what a hand has just done must not be undone
        self.playing = False
        self.t_s = 0.0

        @self._slider.on_update
        async def _(event: Any) -> None:
            if event.client is not None:  # a hand, not ourselves
                self.playing = False
                self.t_s = self._written = float(self._slider.value)

        @self._button.on_click
        def _(_event: Any) -> None:
            if self._end_s > 0.0:
                if not self.playing and self.t_s >= self._end_s - 1e-3:
                    self.t_s = 0.0
                self._last = time.monotonic()
                self.playing = not self.playing

    def load(self, end_s: float, *, unit: str, play: bool) -> None:
        """Take a plan of a new length.

        Args:
            end_s: its last moment; 0 for none.
            unit: of the slider.
            play: whether to start at once.
        """
        self._end_s, self.t_s, self.playing = end_s, 0.0, play
        self._last = time.monotonic()
        self._slider.label = f"Time [{unit}]" if unit == "s" else f"Along the path [{unit}]"
        self._slider.max = max(end_s, 0.01)
        self._slider.disabled = self._button.disabled = end_s <= 0.0
        self._slider.value = self._written = 0.0

    def follow(self, t_s: float) -> None:
        """Be at the moment at which a motion is."""
        self.playing = False
        self.t_s = min(max(t_s, 0.0), self._end_s)

    def step(self) -> float:
        """Move on by the time since the last call; return the moment [s]."""
        now = time.monotonic()
        if self.playing:
            self.t_s += (now - self._last) * SPEEDS[self._speed.value]
            if self.t_s >= self._end_s:
                self.t_s, self.playing = self._end_s, False
        self._last = now
        shown = round(self.t_s, 2)
        if abs(self._written - shown) > 0.005:
            self._slider.value = self._written = shown
        label, icon = ("Pause", "player-pause") if self.playing else ("Play", "player-play")
        if self._button.label != label:
            self._button.label, self._button.icon = label, icon
        return self.t_s
