"""What is to be reached: a lime that is chosen by click or by list, or a pose that is dragged or typed."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.core.types import Array
from lime_planner.pipeline.grasps.approaches import frames_along
from lime_planner.pipeline.targets import fruit_target
from lime_planner.scene.scene import Scene
from lime_planner.viewer.layers import set_visible

_ARROW_M = 0.09
GIVEN, POSED = "as given", "this pose"


class Goal:
    """The gizmo at the target and the fields that say the same; what they were changed to is wished for by the next plan."""

    def __init__(self, api: Any, gui: Any) -> None:
        """Add the marker, hidden until there is a target, and the fields.

        Args:
            api: viser's scene.
            gui: viser's, in the container that the fields belong to.
        """
        self._given: Array | None = None
        self._pose: Array | None = None
        self._centres = np.zeros((0, 3))
        self._reach = gui.add_dropdown(
            "Reach", (GIVEN, POSED), initial_value=GIVEN, hint="A lime, from whichever side is best (or click it), or one very pose"
        )
        self._place = gui.add_vector3("At [m]", (0.0, 0.0, 0.0), step=0.005, hint="Where the tool is to go, from the arm's base; z is up")
        self._towards = gui.add_vector3(
            "Along [°]",
            (0.0, 0.0, 0.0),
            step=5.0,
            min=(-180.0, -90.0, -180.0),
            max=(180.0, 90.0, 180.0),
            hint="Direction in which the palm moves at the end: heading from the x axis, slope (90 is up), and the hand's turn about it",
        )
        back = gui.add_button("Back to the first target", icon="arrow-back-up", color="gray", hint="Undo what was chosen, dragged or typed")
        self._gizmo = api.add_transform_controls("/target", scale=0.11, line_width=3.0, depth_test=False, opacity=0.9, visible=False)
        # The palm comes along the marker's +z, from behind it.
        shaft = np.array([[[0.0, 0.0, -_ARROW_M], [0.0, 0.0, 0.0]]])
        api.add_arrows("/target/approach", shaft, (204, 26, 128), shaft_radius=0.004, head_radius=0.009, head_length=0.025)
        self._gizmo.on_update(self._on_drag)
        self._reach.on_update(self._on_chosen)
        self._place.on_update(self._on_typed)
        self._towards.on_update(self._on_typed)
        back.on_click(lambda _: self.reset())

    def take(self, scene: Scene | None) -> None:
        """Offer a scene's limes."""
        self._centres = np.zeros((0, 3)) if scene is None or scene.fruit_centres is None else np.asarray(scene.fruit_centres, np.float64)
        self._reach.options = (GIVEN, *(f"lime {number}" for number in range(len(self._centres))), POSED)
        if self._reach.value != GIVEN:
            self._reach.value = GIVEN

    def follow(self, target: Array | None) -> None:
        """Stand at the target (7,), unless another was chosen."""
        if target is self._given:
            return
        self._given = target
        self.reset()

    def wish(self) -> tuple[Array | None, Array | None]:
        """Return the pose (7,) or the lime's centre (3,) that the next plan is to reach; None twice for the target as it is."""
        number = self._lime()
        if number is not None:
            return None, self._centres[number]
        return (self._pose if self._reach.value == POSED else None), None

    def choose(self, number: int) -> None:
        """Choose a lime."""
        self._reach.value = f"lime {number}"
        self._put(fruit_target(self._centres[number]).shown_pose())

    def reset(self) -> None:
        """Go back to the target that was given."""
        if self._reach.value != GIVEN:
            self._reach.value = GIVEN
        if self._given is not None:
            self._put(self._given)

    def show(self, visible: bool) -> None:
        """Show or hide the marker; without a target there is nothing to show."""
        set_visible(self._gizmo, visible and self._given is not None)

    @property
    def changed(self) -> str:
        """What the next plan is to reach, in words; empty where it is the target that was given."""
        return "" if self._reach.value == GIVEN else str(self._reach.value)

    def _lime(self) -> int | None:
        name = str(self._reach.value)
        return int(name.removeprefix("lime ")) if name.startswith("lime ") else None

    def _put(self, pose: Array) -> None:
        self._pose = np.asarray(pose, dtype=np.float64)
        self._gizmo.position = pose[:3]
        self._gizmo.wxyz = pose[[6, 3, 4, 5]]
        self._write(pose)

    def _write(self, pose: Array) -> None:
        for field, values, decimals in ((self._place, pose[:3], 3), (self._towards, angles_of(pose), 0)):
            shown = tuple(round(float(value), decimals) + 0.0 for value in values)
            if tuple(field.value) != shown:
                field.value = shown

    def _on_chosen(self, event: Any) -> None:
        if event.client is None:
            return
        number = self._lime()
        if number is not None:
            self.choose(number)
        elif self._reach.value == GIVEN:
            self.reset()

    def _on_drag(self, _event: Any) -> None:
        position, wxyz = np.asarray(self._gizmo.position, dtype=np.float64), np.asarray(self._gizmo.wxyz, dtype=np.float64)
        pose = np.concatenate([position, wxyz[[1, 2, 3, 0]]])
        pose_to_matrix(pose)  # raises on what is no pose
        self._pose, self._reach.value = pose, POSED
        self._write(pose)

    def _on_typed(self, event: Any) -> None:
        if event.client is None or self._given is None or self._pose is None:
            return
        # Only what was typed is taken: the other field is rounded.
        T = pose_to_matrix(self._pose)
        if event.target is self._place:
            T[:3, 3] = self._place.value
        else:
            T[:3, :3] = frame_of(self._towards.value)
        self._reach.value = POSED
        self._put(matrix_to_pose(T))


def frame_of(angles_deg: Any) -> Array:
    """Return the tool's rotation (3, 3) for heading, slope and roll of its approach [degrees]; see `angles_of`."""
    heading, slope, roll = np.radians(np.asarray(angles_deg, dtype=np.float64))
    direction = np.array([np.cos(slope) * np.cos(heading), np.cos(slope) * np.sin(heading), np.sin(slope)])
    return np.asarray(frames_along(direction[None], np.array([roll]))[0])


def angles_of(pose: Array) -> Array:
    """Return the direction of approach of a pose (7,): heading in the plane from +x, slope above it, and roll about it [degrees]."""
    R = pose_to_matrix(pose)[:3, :3]
    z = R[:, 2]
    zero = frames_along(z[None] / np.linalg.norm(z), np.zeros(1))[0]
    roll = np.arctan2(zero[:, 1] @ R[:, 0], zero[:, 0] @ R[:, 0])
    return np.asarray(np.degrees([np.arctan2(z[1], z[0]), np.arcsin(np.clip(z[2], -1.0, 1.0)), roll]))
