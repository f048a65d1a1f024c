"""Where to look next: the view that shows most of the unseen space that the best way to a target passes, and the motion there.

Candidates stand on spheres around that space and look at its middle. A view's worth is the share of the unseen voxels of the way that it
is expected to show: what was seen hides what is behind it; what was not seen hides some of it (`scene.views.sight`). The best views are
handed to the planner as poses of the tool that carries the camera: it chooses the one that is cheapest to get to, through seen space only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.collision.touched_points import touched_anywhere
from lime_planner.core.geometry import sphere_directions
from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array, Float32
from lime_planner.pipeline.context import never
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.pipeline.result import PlanResult
from lime_planner.pipeline.targets import Target, candidates_target
from lime_planner.scene.camera import Camera, look_at
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.seen_map import SeenMap
from lime_planner.scene.views.sight import make_sight_map

#: Where the camera sits on the tool unless something else is said: beside the wrist, looking along the palm's axis.
T_TOOL_CAMERA = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.07], [0.0, 0.0, 1.0, -0.1], [0.0, 0.0, 0.0, 1.0]])

DISTANCES_M = (0.3, 0.45, 0.6)  #: of candidate views from the middle of what they are to show
DIRECTIONS = 48  #: of candidate views, spread evenly
CLEAR_M = 0.12  #: a camera keeps this far from every point of the plant
MOST_VIEWS = 6  #: handed to the planner in one go, each with `ROLLS` turns about its axis
MOST_GOES = 4  #: such handfuls, each the next best views where none of those before can be reached
ROLLS = 4
LEAST_SHARE = 0.05  #: of the voxels of the way; a view that shows less is not worth a motion
NEXT_BEST = 0.5  #: views that show less than this share of what the best one does are left out
AROUND_WAY_M = 0.01  #: voxels this close to the arm on its way count as passed
AROUND_TARGET_M = 0.12  #: without a way: the unseen space that matters, around the target
ENTERED_RAD = 0.02  #: of a look's path in unseen space at most: the border of a voxel, not a way through
LEAVING_RAD = 0.05  #: and more, where the arm stands in such space as it begins: what it fills holds nothing else

_STEP_RAD = 0.05  # between configurations whose voxels are looked for
_MOST_VOXELS = 300  # of the way, for which rays are cast
_PICTURE = Camera()
_SEARCH_S, _ITERATIONS = 0.08, 600  # of a look's way: it need not be the cheapest


@dataclass(frozen=True, eq=False)
class Look:
    """A motion that carries the camera to a view.

    Attributes:
        plan: the motion, certified; it stays out of unseen space, but for leaving what the arm stands in.
        T_base_camera: (4, 4) of the view.
        share: of the unseen voxels that matter, which it would show.
        matter: (K, 3) these voxels [m].
    """

    plan: PlanResult
    T_base_camera: Array
    share: float
    matter: Float32

    @property
    def voxels(self) -> int:
        """How many unseen voxels matter."""
        return len(self.matter)


def voxels_that_matter(pipeline: Pipeline, scene: Scene, target: Target, plan: PlanResult, settings: Settings) -> Float32:
    """Return the unseen voxels (K, 3) that a plan passes, or those around its target where there is no path [m].

    The inside of the target's fruit is not among them: no camera can show it.
    """
    unseen = pipeline.obstacles(scene, target.spot(scene, settings), settings).unseen
    if unseen is None:
        return np.empty((0, 3), np.float32)
    table = unseen.fields.leaves
    if len(plan.waypoints) < 2:
        offset = table.points - target.centre
        around: Float32 = table.points[np.einsum("ij,ij->i", offset, offset) < AROUND_TARGET_M**2]
        return around
    rows, _ = sample_path(plan.waypoints, _STEP_RAD)
    passed: Float32 = table.points[touched_anywhere(pipeline.robot, pipeline.shapes, rows, table, AROUND_WAY_M)]
    return passed


def candidate_views(scene: Scene, seen: SeenMap, voxels: Float32, reach_m: float) -> tuple[Array, Array]:
    """Return poses T_base_camera (P, 4, 4) that look at the middle of some voxels, and which share of these each shows, (P,); best first.

    Args:
        scene: what is known.
        seen: what its views show.
        voxels: (K, 3) what is to be shown [m].
        reach_m: views farther from the base are left out.
    """
    some = voxels[:: max(1, len(voxels) // _MOST_VOXELS)]
    middle = some.mean(axis=0, dtype=np.float64)
    eyes = np.concatenate([middle + distance_m * sphere_directions(DIRECTIONS) for distance_m in DISTANCES_M])
    away = np.linalg.norm(eyes, axis=1)
    eyes = eyes[(away > 0.2) & (away < reach_m)]
    if not len(eyes):
        return np.empty((0, 4, 4)), np.empty(0)
    around = np.concatenate([eyes, some])
    low, high = around.min(axis=0) - CLEAR_M - seen.voxel_m, around.max(axis=0) + CLEAR_M + seen.voxel_m
    things = np.concatenate([scene.leaf_points, scene.stem_points, scene.fruit_points])
    sight = make_sight_map(things, seen.unseen, low, high, seen.voxel_m)
    eyes = eyes[sight.nearest_m(eyes, CLEAR_M) >= CLEAR_M]
    across = float(np.tan(0.5 * _PICTURE.field_of_view_rad))
    tangents = across, across * _PICTURE.height / _PICTURE.width
    shown = sight.seen_from(eyes, np.tile(middle, (len(eyes), 1)), some, tangents, _PICTURE.nearest_m)
    order = np.argsort(-shown, kind="stable")
    order = order[shown[order] >= LEAST_SHARE][: MOST_GOES * MOST_VIEWS]
    return np.array([look_at(eye, middle) for eye in eyes[order]]).reshape(-1, 4, 4), shown[order]


def plan_look(
    pipeline: Pipeline,
    scene: Scene,
    target: Target,
    plan: PlanResult,
    q_start: Array,
    settings: Settings,
    *,
    T_tool_camera: Array = T_TOOL_CAMERA,
    should_stop: Callable[[], bool] = never,
    seed: int = 0,
) -> Look | None:
    """Plan the motion to the view that shows most of what a plan has to pass through unseen.

    Args:
        pipeline: of the arm.
        scene: what is known; its viewpoints must be known too.
        target: what the tool is to reach in the end.
        plan: the best that was found for it with this knowledge, or a refused one.
        q_start: (n,) where the arm is [rad].
        settings: of the plan; the look's own differ in what a straight approach is for.
        T_tool_camera: (4, 4) of the camera in the tool's frame.
        should_stop: cancels.
        seed: of the random generator.

    Returns:
        The look; None where nothing unseen is in the way, no view shows enough of it, or none can be reached through seen space.
    """
    voxels = voxels_that_matter(pipeline, scene, target, plan, settings)
    if not len(voxels):
        return None
    poses, shown = candidate_views(scene, pipeline.seen_map(scene), voxels, pipeline.robot.reach_m)
    good = int((shown >= NEXT_BEST * shown[0]).sum()) if len(shown) else 0
    bare = pipeline.obstacles(scene, target.spot(scene, settings), settings, should_stop)
    inside = bare.unseen is not None and bool(
        touched_anywhere(pipeline.robot, pipeline.shapes, q_start, bare.unseen.fields.leaves, bare.unseen.leaf_radius).any()
    )
    own = dataclasses.replace(
        settings,
        grasp_freedom="exact",
        approach_distance_m=0.0,
        min_approach_distance_m=0.0,
        max_unseen_contact_rad=ENTERED_RAD + (LEAVING_RAD if inside else 0.0),
        max_leaf_contact_rad=-1.0,
        unseen_price=max(settings.unseen_price, 10.0),
        time_budget_s=min(settings.time_budget_s, _SEARCH_S),
        iterations=min(settings.iterations, _ITERATIONS),
    )
    obstacles = bare.with_nothing_let_go(own)
    T_camera_tool = np.linalg.inv(T_tool_camera)
    for first in range(0, good, MOST_VIEWS):
        if should_stop():
            return None
        chosen = poses[first : min(first + MOST_VIEWS, good)]
        views = np.concatenate([chosen @ _turned(2.0 * np.pi * k / ROLLS) for k in range(ROLLS)])
        found = pipeline.plan(
            scene, candidates_target(views @ T_camera_tool), q_start, own, should_stop=should_stop, seed=seed, obstacles=obstacles
        )
        if found.succeeded and found.T_base_tool is not None:
            T_base_camera = found.T_base_tool @ T_tool_camera
            which = int(np.linalg.norm(chosen[:, :3, 3] - T_base_camera[:3, 3], axis=1).argmin())
            return Look(found, T_base_camera, float(shown[first + which]), voxels)
    return None


def _turned(angle_rad: float) -> Array:
    """A turn about a camera's own axis, (4, 4)."""
    T, c, s = np.eye(4), np.cos(angle_rad), np.sin(angle_rad)
    T[:2, :2] = [[c, -s], [s, c]]
    return T
