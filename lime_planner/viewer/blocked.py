"""What a refused plan was refused for, in red: the arm where it would have to be, the link that is blocked, and what blocks it."""

from __future__ import annotations

from typing import Any

from lime_planner.output.refusal_marks import BLOCKED
from lime_planner.pipeline.in_the_way import InTheWay
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene
from lime_planner.viewer.layers import Arm, rgb, set_visible, thinned

_MOST_POINTS = 400
_PALE = 0.25


class BlockedLayer:
    """The refused configuration."""

    def __init__(self, api: Any, robot: Robot, scene: Scene, found: InTheWay) -> None:
        """Draw it.

        Args:
            api: viser's scene.
            robot: the arm.
            scene: whose hard points are drawn around the contact.
            found: see `lime_planner.pipeline.in_the_way`.
        """
        self._arm = Arm(api, "/blocked", robot, BLOCKED, _PALE, solid=found.links)
        self._arm.place(found.q)
        self._handles: list[Any] = []
        place = found.place(robot)
        if place is None:
            return
        near = found.obstacle(scene)
        near = near[thinned(near, _MOST_POINTS)] if len(near) else near
        if len(near):
            self._handles.append(
                api.add_point_cloud("/blocked_by", near, rgb(BLOCKED), point_size=0.009, point_shape="circle", precision="float32")
            )
        ball = api.add_icosphere("/blocked_at", 0.022, color=rgb(BLOCKED), subdivisions=2, position=place, opacity=0.4, cast_shadow=False)
        self._handles.append(ball)

    def show(self, visible: bool) -> None:
        """Show or hide it."""
        self._arm.show(visible)
        for handle in self._handles:
            set_visible(handle, visible)

    def remove(self) -> None:
        """Take it out of the scene."""
        self._arm.remove()
        for handle in self._handles:
            handle.remove()
