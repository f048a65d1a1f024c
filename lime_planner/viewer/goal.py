"""What is to be reached: a lime that is chosen by click or by list, or a pose that is dragged or typed.

Viser's threads run its calls at the same time and in any order, while the next number is being typed. So they only leave a note, the page's
thread looks at what has become of the fields, and what was typed is never written back: it would take the place of what came after it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.core.types import Array
from lime_planner.pipeline.grasps.approaches import frames_along
from lime_planner.pipeline.targets import fruit_target
from lime_planner.scene.scene import Scene
from lime_planner.viewer.layers import set_visible

_ARROW_M = 0.09
GIVEN, POSED = "the first target", "this pose"


class Goal:
    """The gizmo at the target and the fields that say the same; what they were changed to is wished for by the next plan.

    All its methods are for the page's thread.
    """

    def __init__(self, api: Any, gui: Any, note: Callable[[Callable[[], None]], None]) -> None:
        """Add the marker, hidden until there is a target, and the fields.

        Args:
            api: viser's scene.
            gui: viser's, in the container that the fields belong to.
            note: lets the page's thread call something.
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
        self._written = [tuple(field.value) for field in (self._place, self._towards)]  # by us, or taken already

        def by_hand(call: Callable[[], None]) -> Callable[[Any], None]:
            return lambda event: note(call) if event.client is not None else None

        self._gizmo.on_update(lambda _: note(self._take_dragged))
        self._reach.on_update(by_hand(self._take_chosen))
        self._place.on_update(by_hand(self.take_typed))
        self._towards.on_update(by_hand(self.take_typed))
        back.on_click(lambda _: note(self.reset))

    def take(self, scene: Scene | None, *, forget: bool) -> None:
        """Offer a scene's limes.

        Args:
            scene: what there is now.
            forget: whether it is another plant, not a newer look at the same: then what was chosen before does not count.
        """
        self._centres = np.zeros((0, 3)) if scene is None or scene.fruit_centres is None else np.asarray(scene.fruit_centres, np.float64)
        options = (GIVEN, *(f"lime {number}" for number in range(len(self._centres))), POSED)
        kept = GIVEN if forget or self._reach.value not in options else self._reach.value
        if tuple(self._reach.options) != options:
            self._reach.options = options
        if self._reach.value != kept:
            self._reach.value = kept
        if forget:
            self._given = None

    def follow(self, target: Array | None) -> None:
        """Stand at the target (7,), unless another was chosen; one that is told again, or moves, leaves that as it is."""
        before, self._given = self._given, target
        if target is before or (target is not None and before is not None and np.array_equal(target, before)):
            return
        if before is None or target is None or not self.changed:
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
        self._stand(pose)
        self._write(pose)

    def _stand(self, pose: Array) -> None:
        self._pose = np.asarray(pose, dtype=np.float64)
        self._gizmo.position = pose[:3]
        self._gizmo.wxyz = pose[[6, 3, 4, 5]]

    def _write(self, pose: Array) -> None:
        for number, (field, values, decimals) in enumerate(((self._place, pose[:3], 3), (self._towards, angles_of(pose), 0))):
            shown = self._written[number] = tuple(round(float(value), decimals) + 0.0 for value in values)
            if tuple(field.value) != shown:
                field.value = shown

    def _take_chosen(self) -> None:
        number = self._lime()
        if number is not None:
            self.choose(number)
        elif self._reach.value == GIVEN:
            self.reset()

    def _take_dragged(self) -> None:
        position, wxyz = np.asarray(self._gizmo.position, dtype=np.float64), np.asarray(self._gizmo.wxyz, dtype=np.float64)
        pose = np.concatenate([position, wxyz[[1, 2, 3, 0]]])
        pose_to_matrix(pose)  # raises on what is no pose
        if self._pose is None or np.array_equal(pose, self._pose):
            return  # put there by us meanwhile
        self._pose, self._reach.value = pose, POSED
        self._write(pose)

    def take_typed(self) -> None:
        """Take what the fields say; of their calls some may be yet to come."""
        # Only what was typed is taken: the other field is rounded.
        place, towards = said = [tuple(field.value) for field in (self._place, self._towards)]
        placed, turned = (now != written for now, written in zip(said, self._written, strict=True))
        if not (placed or turned) or self._given is None or self._pose is None:
            return
        self._written = said
        T = pose_to_matrix(self._pose)
        if placed:
            T[:3, 3] = place
        if turned:
            T[:3, :3] = frame_of(towards)
        self._reach.value = POSED
        self._stand(matrix_to_pose(T))


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
