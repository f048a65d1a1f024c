"""The page before there is a scene: what to do, and buttons that open a scene where the backend takes one."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.errors import LimePlannerError
from lime_planner.viewer.backend import Backend, Moment

_SUFFIXES = (".npz", ".ply", ".pcd")


class EmptyPage:
    """What stands at the top of the panel as long as there is nothing to see."""

    def __init__(self, gui: Any, backend: Backend, note: Callable[[Callable[[], None]], None]) -> None:
        """Add the advice, and the ways to a scene where the backend takes one.

        Args:
            gui: viser's.
            backend: see `lime_planner.viewer.backend`.
            note: runs a call in the page's thread.
        """
        self._backend = backend
        self._said = ""
        self._place = gui.add_folder(None, visible=False)
        with self._place:
            self._advice = gui.add_markdown("")
            if not backend.opens:
                return
            grow = gui.add_button(
                "Grow a lime plant", icon="plant-2", color="green", hint="A plant made from a random seed, to try the planner on"
            )
            upload = gui.add_upload_button(
                "Open a scene file",
                icon="folder-open",
                color="gray",
                mime_type=",".join(_SUFFIXES),
                hint="Points with labels: leaf, stem, fruit",
            )

        @upload.on_upload
        def _(_event: Any) -> None:
            file = upload.value
            note(lambda: self._open(file.name, file.content))

        @grow.on_click
        def _(_event: Any) -> None:
            note(self._grow)

    def show(self, moment: Moment) -> None:
        """Show the advice while there is one."""
        if moment.advice != self._said:
            self._said = self._advice.content = moment.advice
        if self._place.visible != bool(moment.advice):
            self._place.visible = bool(moment.advice)

    def _grow(self) -> None:
        from lime_planner.scene.plants.generator import generate_plant

        seed = int(np.random.default_rng().integers(1, 1000))
        self._backend.open(generate_plant(np.random.default_rng(seed)), f"lime plant {seed}")

    def _open(self, name: str, content: bytes) -> None:
        from lime_planner.scene.scene import Scene

        suffix = Path(name).suffix.lower()
        try:
            with tempfile.NamedTemporaryFile(suffix=suffix if suffix in _SUFFIXES else ".npz") as file:
                file.write(content)
                file.flush()
                scene = Scene.load(file.name)
        except LimePlannerError as error:
            self._advice.content = f"**{Path(name).name} cannot be opened.** {str(error).replace(file.name, Path(name).name)}"
            return
        self._backend.open(scene, Path(name).name)
