"""Every place where a finished plan is shown: the topics `~/tool_path` and `~/markers`, and the page."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from lime_planner.ros.convert import to_path, to_pose_stamped
from lime_planner.ros.display.marker_publisher import MarkerPublisher
from lime_planner.ros.requests.parts import PlanDisplay, PlannedRequest


class PathPublisher(Protocol):
    """What is used of a ROS publisher."""

    def publish(self, msg: Path) -> None:
        """Send."""
        ...


class PosePublisher(Protocol):
    """Sends poses; a publisher of rclpy."""

    def publish(self, msg: PoseStamped) -> None:
        """Send."""
        ...


class Displays:
    """See `PlanDisplay`.

    Attributes:
        page: the 3-D page's side; None where no page is served.
    """

    def __init__(self, tool_path: PathPublisher, target: PosePublisher, markers: MarkerPublisher, now: Callable[[], Time]) -> None:
        """Show plans on these topics.

        Args:
            tool_path: publisher of the tool's poses along the plan.
            target: publisher of the grasp; a pose that was asked for is there when it comes in, others when they are chosen.
            markers: draws the markers.
            now: the ROS time.
        """
        self._tool_path, self._target = tool_path, target
        self._markers = markers
        self._now = now
        self.page: PlanDisplay | None = None

    def show(self, planned: PlannedRequest) -> None:
        """Show a plan."""
        if self.page is not None:
            self.page.show(planned)
        self._tool_path.publish(to_path(planned.record.result.tool_path, planned.record.scene.frame_id, self._now()))
        result = planned.record.result
        if result.T_base_tool is not None and result.target is not None and not result.target.exact and planned.target is not None:
            self._target.publish(to_pose_stamped(result.T_base_tool, planned.record.scene.frame_id, self._now()))
        self._markers.show(planned)
