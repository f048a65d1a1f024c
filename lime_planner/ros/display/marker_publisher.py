"""Draws plans for RViz and Foxglove in a thread of its own, and only while there is a subscriber: no answer waits for a picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np
from builtin_interfaces.msg import Time
from visualization_msgs.msg import MarkerArray

from lime_planner.core.types import Float32
from lime_planner.ros.display.markers import Extras, markers
from lime_planner.ros.model_loader import Loaded, ModelLoader
from lime_planner.ros.requests.parts import PlannedRequest
from lime_planner.ros.requests.worker import Worker
from lime_planner.ros.runtime import BackgroundThread

_SAMPLES = 60  #: configurations along the path at which touched leaves are looked for


class Publisher(Protocol):
    """What is used of a ROS publisher."""

    def publish(self, msg: MarkerArray) -> None:
        """Send."""
        ...

    def get_subscription_count(self) -> int:
        """Count the subscribers."""
        ...


class MarkerPublisher(BackgroundThread):
    """Remembers the newest plan, and publishes its markers once there is a subscriber."""

    def __init__(
        self, publisher: Publisher, loader: ModelLoader, worker: Worker, now: Callable[[], Time], warn: Callable[[str], None]
    ) -> None:
        """Start the thread.

        Args:
            publisher: of the markers.
            loader: of the arm and its pipeline.
            worker: while it plans the search tree, which takes a search to draw, is left out.
            now: the ROS time.
            warn: is told about a picture that could not be drawn.
        """
        super().__init__("markers")
        self._publisher = publisher
        self._loader = loader
        self._worker = worker
        self._now = now
        self._warn = warn
        self._newest: tuple[PlannedRequest, Loaded | None] | None = None
        self._drawn: PlannedRequest | None = None
        self._start()

    def show(self, planned: PlannedRequest) -> None:
        """Take in a plan; it is drawn at once if there is a subscriber."""
        with self._condition:
            self._newest = (planned, self._loader.loaded)
        self.check()

    def check(self) -> None:
        """Draw the newest plan for subscribers that have come since it was made; to be called now and then."""
        with self._condition:
            if self._wanted() is not None:
                self._condition.notify_all()

    def _wanted(self) -> tuple[PlannedRequest, Loaded | None] | None:
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
                planned, loaded = wanted
                self._drawn = planned
            try:
                self._draw(planned, loaded)
            except Exception as error:  # a picture is no reason to end the planner
                self._warn(f"the markers could not be drawn: {type(error).__name__}: {error}")

    def _draw(self, planned: PlannedRequest, loaded: Loaded | None) -> None:
        record = planned.record
        if loaded is None or not loaded.robot.links or not record.found:
            unseen = np.empty((0, 3)) if loaded is None else loaded.pipeline.seen_map(record.scene).unseen
            self._publisher.publish(markers(record, self._now(), Extras(unseen=unseen)))
            return
        extras = _extras(planned, loaded)
        self._publisher.publish(markers(record, self._now(), extras))
        if planned.target is None or record.target is None or self._stale(planned):
            return  # a retreat was not searched for
        tree = self._tree(planned, loaded)
        if len(tree) and not self._stale(planned):
            self._publisher.publish(markers(record, self._now(), dataclasses.replace(extras, tree=tree)))

    def _stale(self, planned: PlannedRequest) -> bool:
        return self._closed or self._worker.current is not None or self._newest is None or self._newest[0] is not planned

    def _tree(self, planned: PlannedRequest, loaded: Loaded) -> Float32:
        """Return tool positions of the pieces of the search tree's edges, (S, 2, 3): the search runs once more, with its own seed."""
        from lime_planner.output.search_tree import search_tree_of

        return search_tree_of(loaded.pipeline, planned.record, should_stop=lambda: self._stale(planned)).segments.reshape(-1, 2, 3)


def _extras(planned: PlannedRequest, loaded: Loaded) -> Extras:
    """Draw the arm at the path's end, and find the leaf points that it touches on its way and the space that no camera has seen."""
    from lime_planner.collision.touched_points import touched_points
    from lime_planner.pipeline.figures import sample_path
    from lime_planner.robot.convex_hulls import arm_hull

    waypoints, points = planned.record.result.waypoints, planned.record.scene.leaf_points
    rows, _ = sample_path(waypoints, 0.03)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLES)).round().astype(int))]
    marks = touched_points(loaded.robot, loaded.pipeline.shapes, rows, points, planned.record.settings.leaf_point_radius_m)
    unseen = loaded.pipeline.seen_map(planned.record.scene).unseen
    return Extras(arm_hull(loaded.robot, waypoints[-1]), points[marks.any(axis=0)], unseen=unseen)
