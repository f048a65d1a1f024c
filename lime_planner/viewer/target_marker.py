"""The target's marker: shows where the tool is to go, and can be dragged somewhere else."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.types import Array
from lime_planner.viewer.controls import Controls
from lime_planner.viewer.layers import set_visible

_ARROW_M = 0.09


class TargetMarker:
    """A gizmo at the target; what it was dragged to is wished for by the next plan."""

    def __init__(self, api: Any, controls: Controls) -> None:
        """Add the marker, hidden until there is a target.

        Args:
            api: viser's scene.
            controls: shows the position, and takes another one.
        """
        self._controls = controls
        self._given: Array | None = None
        self._wished: Array | None = None
        self._gizmo = api.add_transform_controls("/target", scale=0.11, line_width=3.0, depth_test=False, opacity=0.9, visible=False)
        # The palm comes along the marker's +z, from behind it.
        shaft = np.array([[[0.0, 0.0, -_ARROW_M], [0.0, 0.0, 0.0]]])
        api.add_arrows("/target/approach", shaft, (204, 26, 128), shaft_radius=0.004, head_radius=0.009, head_length=0.025)
        self._label = api.add_label("/target/label", "target: drag me", anchor="bottom-center", font_screen_scale=0.9)
        self._gizmo.on_update(self._on_drag)
        controls.target.on_update(self._on_typed)

    def follow(self, target: Array | None) -> None:
        """Stand at the target (7,), unless it was dragged away from it."""
        if target is self._given:
            return
        self._given, self._wished = target, None
        if target is not None:
            self._put(target)

    def wish(self) -> Array | None:
        """Return the pose (7,) that the marker was dragged to, or None."""
        return self._wished

    def reset(self) -> None:
        """Go back to the target that was given."""
        self._wished = None
        if self._given is not None:
            self._put(self._given)

    def show(self, visible: bool) -> None:
        """Show or hide the marker; without a target there is nothing to show."""
        set_visible(self._gizmo, visible and self._given is not None)

    def _put(self, pose: Array) -> None:
        self._gizmo.position = pose[:3]
        self._gizmo.wxyz = pose[[6, 3, 4, 5]]
        self._controls.put_target(pose[:3])
        self._label.text = "target: drag me"

    def _on_drag(self, _event: Any) -> None:
        position, wxyz = np.asarray(self._gizmo.position, dtype=np.float64), np.asarray(self._gizmo.wxyz, dtype=np.float64)
        self._wish(np.concatenate([position, wxyz[[1, 2, 3, 0]]]))
        self._controls.put_target(position)

    def _on_typed(self, event: Any) -> None:
        pose = self._wished if self._wished is not None else self._given
        if event.client is None or pose is None:
            return
        position = np.asarray(self._controls.target.value, dtype=np.float64)
        self._gizmo.position = position
        self._wish(np.concatenate([position, pose[3:]]))

    def _wish(self, pose: Array) -> None:
        pose_to_matrix(pose)  # raises on what is no pose
        self._wished = pose
        self._label.text = "moved: press Plan"
