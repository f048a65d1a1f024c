"""Draws plans for RViz and Foxglove in a thread of its own, and only while somebody subscribes: no answer waits for a picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from builtin_interfaces.msg import Time
from visualization_msgs.msg import MarkerArray

from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.types import Array, Float32
from lime_planner.ros.attendant import Attendant
from lime_planner.ros.display.markers import Extras, markers
from lime_planner.ros.model_loader import Loaded
from lime_planner.ros.requests.jobs import Shown

_SAMPLES = 60  #: configurations along the path at which touched leaves are looked for


class Publisher(Protocol):
    """What is used of a ROS publisher."""

    def publish(self, msg: MarkerArray) -> None:
        """Send."""
        ...

    def get_subscription_count(self) -> int:
        """Count the subscribers."""
        ...


class MarkerDesk(Attendant):
    """Keeps the newest plan, and publishes its markers once somebody wants to see them."""

    def __init__(
        self,
        publisher: Publisher,
        model: Callable[[], Loaded | None],
        busy: Callable[[], bool],
        now: Callable[[], Time],
        warn: Callable[[str], None],
    ) -> None:
        """Start the thread.

        Args:
            publisher: of the markers.
            model: the arm and its pipeline.
            busy: whether a plan is being made; the search tree, which takes a search to draw, is left out then.
            now: the ROS time.
            warn: is told about a picture that could not be drawn.
        """
        super().__init__("markers")
        self._publisher = publisher
        self._model = model
        self._busy = busy
        self._now = now
        self._warn = warn
        self._newest: tuple[Shown, Loaded | None] | None = None
        self._drawn: Shown | None = None
        self._start()

    def show(self, shown: Shown) -> None:
        """Take in a plan; it is drawn at once if somebody subscribes."""
        with self._condition:
            self._newest = (shown, self._model())
        self.check()

    def check(self) -> None:
        """Draw the newest plan if somebody has come who has not seen it; to be called now and then."""
        with self._condition:
            if self._wanted() is not None:
                self._condition.notify_all()

    def _wanted(self) -> tuple[Shown, Loaded | None] | None:
        """Return the newest plan if it is to be drawn."""
        if self._newest is None or self._newest[0] is self._drawn or self._publisher.get_subscription_count() == 0:
            return None
        return self._newest

    def _run(self) -> None:
        while True:
            with self._condition:
                # What came while the last plan was drawn, the end among it, was not waited for when it was announced.
                self._condition.wait_for(lambda: self._closed or self._wanted() is not None)
                if self._closed:
                    return
                wanted = self._wanted()
                if wanted is None:  # the subscriber has left meanwhile
                    continue
                shown, loaded = wanted
                self._drawn = shown
            try:
                self._draw(shown, loaded)
            except Exception as error:  # a picture is no reason to end the planner
                self._warn(f"the markers could not be drawn: {type(error).__name__}: {error}")

    def _draw(self, shown: Shown, loaded: Loaded | None) -> None:
        extras = Extras()
        bodies = loaded is not None and bool(loaded.robot.links) and len(shown.result.waypoints) > 1
        if loaded is not None and bodies:
            extras = _extras(shown, loaded)
        self._publish(shown, extras)
        if loaded is None or not bodies or shown.target is None or shown.T_base_tool is None:
            return  # a retreat was not searched for
        if not self._stale(shown):
            tree = self._tree(shown, matrix_to_pose(shown.T_base_tool), loaded)
            if len(tree) and not self._stale(shown):
                self._publish(shown, Extras(extras.goal_arm, extras.touched, tree))

    def _publish(self, shown: Shown, extras: Extras) -> None:
        self._publisher.publish(markers(shown.scene, shown.T_base_tool, shown.result, shown.snapshot.plan, self._now(), extras))

    def _stale(self, shown: Shown) -> bool:
        return self._closed or self._busy() or self._newest is None or self._newest[0] is not shown

    def _tree(self, shown: Shown, target: Array, loaded: Loaded) -> Float32:
        """Return tool positions of the pieces of the search tree's edges, (S, 2, 3): the search runs once more, with its own seed."""
        from lime_planner.output.search_tree import grow_again
        from lime_planner.pipeline.plan_record import PlanRecord

        plan = PlanRecord(0, shown.scene, shown.snapshot.plan, target, shown.result)
        return grow_again(loaded.pipeline, plan, should_stop=lambda: self._stale(shown)).segments.reshape(-1, 2, 3)


def _extras(shown: Shown, loaded: Loaded) -> Extras:
    """Draw the arm at the path's end, and find the leaf points that it touches on its way."""
    from lime_planner.collision.touched_points import touched_points
    from lime_planner.pipeline.finish import sample_path
    from lime_planner.robot.convex_hulls import arm_hull

    waypoints, points = shown.result.waypoints, shown.scene.leaf_points
    rows, _ = sample_path(waypoints, 0.03)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLES)).round().astype(int))]
    marks = touched_points(loaded.robot, loaded.pipeline.shapes, rows, points, shown.snapshot.plan.leaf_point_radius_m)
    return Extras(arm_hull(loaded.robot, waypoints[-1]), points[marks.any(axis=0)])
