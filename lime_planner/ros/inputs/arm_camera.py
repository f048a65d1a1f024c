"""The camera that the arm carries: where it was when it took a cloud, told by the joints measured then, whatever `/tf` knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.core.errors import Refusal
from lime_planner.core.geometry import clean_name
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.robot.link_frames import Carried, carried_links
from lime_planner.robot.model import Robot
from lime_planner.ros.inputs.frames import Frames


@dataclass(frozen=True, eq=False)
class ArmCamera:
    """A camera on an arm.

    Attributes:
        robot: the arm.
        frame: the camera's.
        frames: where frames are.
    """

    robot: Robot
    frame: str
    frames: Frames

    def mount(self) -> Carried | None:
        """Return what the camera is bolted to, the tool before other links; None where nothing tells."""
        links = carried_links(self.robot)
        if clean_name(self.frame) in links:
            return links[clean_name(self.frame)]
        for link, carried in links.items():
            T_link_camera = self.frames.bolted(link, self.frame)
            if T_link_camera is not None and carried.joint:
                return carried.beyond(T_link_camera)
        return None

    def carries(self, frame: str) -> Callable[[Array], Array] | None:
        """Return what tells T_base_frame (4, 4) of a configuration (n,) for the camera's frame or one bolted to it; None for others."""
        name = clean_name(frame)
        T_camera_frame = np.eye(4) if name == clean_name(self.frame) else self.frames.bolted(self.frame, name)
        if T_camera_frame is None or name == clean_name(self.robot.planning_frame):
            return None
        carried = self.mount()
        if carried is None:
            return None
        own = carried.beyond(T_camera_frame)
        return lambda q: own.at(self.robot, q)

    def T_tool_camera(self) -> Array:
        """Return where the tool carries the camera, (4, 4).

        Raises:
            Refusal: TF_ERROR, nothing tells where it is, or it moves against the tool.
        """
        carried = self.mount()
        if carried is None:
            place = f"static_transforms: '{self.robot.tool_frame} {self.frame} x y z qx qy qz qw' says it"
            raise Refusal(Status.TF_ERROR, f"no link of the arm is known to carry camera_frame {self.frame!r}; {place}")
        if carried.joint != self.robot.n:
            last = self.robot.joint_names[-1]
            sentence = f"camera_frame {self.frame!r} is on {carried.link}, against which {last} moves the tool"
            raise Refusal(Status.TF_ERROR, f"{sentence}; views are chosen for cameras beyond the last joint")
        zero = np.zeros(self.robot.n)
        return np.asarray(np.linalg.inv(self.robot.forward(zero)) @ carried.at(self.robot, zero))
