"""What is drawn on demand only: the search tree, the collision spheres, a slice of the distance fields."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from lime_planner.collision.distance_fields import Fields
from lime_planner.core.types import Float32, UInt8
from lime_planner.output.picture import FREE_PATH, LEAFY_PATH
from lime_planner.output.search_tree import SearchTree, search_tree_of
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline.result import PlanRecord
from lime_planner.viewer.backend import Moment
from lime_planner.viewer.controls import FIELDS, Controls
from lime_planner.viewer.layers import Arm, rgb

_FAR_M = 0.25  # distances are coloured up to this


class Extras:
    """The layers that cost something to make; each is made when its box is ticked."""

    def __init__(self, api: Any, controls: Controls, note: Callable[[Callable[[], None]], None]) -> None:
        """Nothing is drawn yet.

        Args:
            api: viser's scene.
            controls: say what is wanted.
            note: runs a call in the page's thread.
        """
        self._api = api
        self._controls = controls
        self._note = note
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="tree")
        self._tree: Any = None
        self._tree_of: PlanRecord | None = None
        self._spheres: list[Any] = []
        self._spheres_of: Arm | None = None
        self._slice: Any = None
        self._slice_of: tuple[Any, ...] | None = None
        self.notes: list[str] = []
        self._tree_note = self._field_note = ""

    def close(self) -> None:
        """Do not begin anything more."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def draw(self, moment: Moment, shown: PlanRecord | None, ghost: Arm | None) -> None:
        """Make, show and hide what is wanted."""
        pipeline = moment.pipeline
        self._draw_tree(pipeline, shown if self._controls.shows("tree") else None)
        self._draw_spheres(pipeline, ghost if self._controls.shows("spheres") else None)
        self._draw_slice(moment)
        self.notes = [note for note in (self._tree_note, self._field_note) if note]

    def _draw_tree(self, pipeline: Pipeline | None, shown: PlanRecord | None) -> None:
        if shown is self._tree_of:
            return
        if self._tree is not None:
            self._tree.remove()
            self._tree = None
        self._tree_of, self._tree_note = shown, ""
        if shown is None or pipeline is None or not shown.found:
            return
        self._tree_note = "the search is run again for its tree"
        future = self._pool.submit(search_tree_of, pipeline, shown, should_stop=lambda: self._tree_of is not shown)
        future.add_done_callback(lambda done: None if done.cancelled() else self._note(lambda: self._put_tree(shown, done.result())))

    def _put_tree(self, shown: PlanRecord, tree: SearchTree) -> None:
        if shown is not self._tree_of:
            return
        thin = "" if len(tree.segments) == tree.total else f"{len(tree.segments):,} of "
        self._tree_note = f"search tree: {thin}{tree.total:,} edges" if tree.total else "search tree: empty, first paths took all time"
        if tree.total:
            colours = np.where(tree.leafy[:, None, None, None], rgb(LEAFY_PATH), rgb(FREE_PATH)).astype(np.uint8)
            colours = np.broadcast_to(colours, tree.segments.shape).reshape(-1, 2, 3)
            self._tree = self._api.add_line_segments(
                "/tree", tree.segments.reshape(-1, 2, 3), colours, thickness=1.0, thickness_units="screen"
            )

    def _draw_spheres(self, pipeline: Pipeline | None, ghost: Arm | None) -> None:
        if ghost is self._spheres_of or pipeline is None:
            return
        for handle in self._spheres:
            handle.remove()
        self._spheres, self._spheres_of = [], ghost
        if ghost is None:
            return
        import trimesh

        shapes, ball = pipeline.shapes, trimesh.creation.icosphere(subdivisions=1)
        for body in range(len(shapes.spacing)):
            first, last = (int(shapes.fine_start[shapes.coarse_start[end]]) for end in (body, body + 1))
            spheres = shapes.fine[first:last]
            if not len(spheres):
                continue
            self._spheres.append(
                self._api.add_batched_meshes_simple(
                    f"{ghost.joint_name(body)}/spheres",
                    ball.vertices,
                    ball.faces,
                    batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(spheres), 1)),
                    batched_positions=spheres[:, :3],
                    batched_scales=spheres[:, 3],
                    batched_colors=(230, 159, 0),
                    opacity=0.35,
                    cast_shadow=False,
                    receive_shadow=False,
                )
            )

    def _draw_slice(self, moment: Moment) -> None:
        channel, height_m = FIELDS[self._controls.field.value], float(self._controls.height.value)
        wanted = channel >= 0 and moment.pipeline is not None and moment.scene is not None
        if self._controls.height.visible != wanted:
            self._controls.height.visible = wanted
        key = (moment.scene, channel, round(height_m, 3)) if wanted else None
        if key == self._slice_of:
            return
        self._slice_of, self._field_note = key, ""
        if self._slice is not None:
            self._slice.remove()
            self._slice = None
        if key is None or moment.pipeline is None or moment.scene is None:
            return
        target = None if moment.target is None else moment.target[:3]
        fields = moment.pipeline.obstacles(moment.scene, target, moment.settings).world.fields
        if not fields.present[channel]:
            self._field_note = f"there are no {self._controls.field.value}"
            return
        points, colours = slice_of(fields, channel, height_m)
        self._slice = self._api.add_point_cloud(
            "/slice", points, colours, point_size=1.05 * fields.spacing_m, point_shape="square", precision="float32", point_shading="flat"
        )
        self._field_note = f"distance to {self._controls.field.value}: dark 0 m, yellow {_FAR_M:g} m and more"


def slice_of(fields: Fields, channel: int, height_m: float) -> tuple[Float32, UInt8]:
    """Return the nodes (N, 3) of a distance field nearest to a height, and their colours (N, 3)."""
    from matplotlib import colormaps

    size = fields.values.shape
    level = int(np.clip(round((height_m - fields.origin[2]) / fields.spacing_m), 0, size[2] - 1))
    distance = fields.values[:, :, level, channel]
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]), indexing="ij")
    points = fields.origin + fields.spacing_m * np.stack([x, y, np.full_like(x, level)], axis=-1)
    colours = colormaps["cividis"](np.clip(distance / _FAR_M, 0.0, 1.0))[..., :3]
    return points.reshape(-1, 3).astype(np.float32), (255 * colours).astype(np.uint8).reshape(-1, 3)
