"""From a labelled scene, a target and the settings to what the searches and the exact check ask."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.collision.distance_fields import build_fields
from lime_planner.collision.exact import ExactChecker
from lime_planner.collision.joint_space import ArmSpace, make_arm_space
from lime_planner.collision.link_shapes import Shapes
from lime_planner.collision.world import World, empty_world, unseen_world
from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array, Float32
from lime_planner.pipeline.context import ask, never
from lime_planner.pipeline.spots import Spot, ball, exclusion, hard_points, spared
from lime_planner.planning.prices import BINARY, GRADED, price_of_points
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.seen_map import SeenMap, make_seen_map
from lime_planner.scene.voxels import thin

LEAF_VOXEL_M = 0.004  # leaves are thinned to this: about the leaf points' own radius
UNSEEN_VOXEL_M = 0.01  # unseen space is priced by voxels of this edge
_BEYOND_REACH_M = 0.1
_MEASURED_CLEARANCE_M = 0.05  # clearances are looked for up to this when a path is measured
_MARGIN_SLOPE = 0.02  # m per rad: how fast the margin is regained on leaving a start or goal that has less


@dataclass(frozen=True, eq=False)
class Obstacles:
    """One scene as obstacles for one arm and one target.

    Attributes:
        robot, shapes: the arm.
        world: for searches.
        hard: (P, 3) impermeable points; leaves: (L, 3) leaf points, thinned.
        settings: as used.
        spot: place of the target, None without one.
        counts: what was used and hidden.
        unseen: the space that no camera has seen, None where everything counts as seen.
        views: how many views the scene was seen from, 0 where that is not known.
    """

    robot: Robot
    shapes: Shapes
    world: World
    hard: Float32
    leaves: Float32
    settings: Settings
    spot: Spot | None
    counts: dict[str, int]
    unseen: World | None = None
    views: int = 0

    def space(self, lower: Array, upper: Array, *, leaves: bool | None = None) -> ArmSpace:
        """A joint space with memory of its own; leaves matter unless they are ignored by the settings or by the argument."""
        matter = self.settings.leaf_policy != "ignored" if leaves is None else leaves
        price = self.settings.unseen_price
        return make_arm_space(
            lower, upper, self.robot.chain, self.shapes, self.world, leaves=matter, unseen=self.unseen, unseen_price=price
        )

    def measuring_space(self, *, stems_alone: bool = False) -> ArmSpace:
        """A space that takes every configuration and measures clearances farther out.

        Args:
            stems_alone: leave keep-out boxes, floor and workspace out of account.
        """
        unlimited = np.full(self.robot.n, 1e9)
        measuring = self.world._replace(margin=_MEASURED_CLEARANCE_M, anchors=np.zeros((0, self.robot.n)), anchor_need=np.zeros(0))
        if stems_alone:
            nothing = empty_world(measuring.fields, self.robot.n)
            measuring = measuring._replace(boxes=nothing.boxes, floor_z=nothing.floor_z, workspace=nothing.workspace)
        return make_arm_space(-unlimited, unlimited, self.robot.chain, self.shapes, measuring)

    def unseen_space(self) -> ArmSpace | None:
        """A space in which unseen space is all there is, as leaves of price 1; None where everything counts as seen."""
        unlimited = np.full(self.robot.n, 1e9)
        return None if self.unseen is None else make_arm_space(-unlimited, unlimited, self.robot.chain, self.shapes, self.unseen)

    def with_anchors(self, anchors: Array, needs: Array) -> Obstacles:
        """The same with less clearance required at some configurations.

        Args:
            anchors: (A, n) configurations; needs: (A,) clearance required there [m].
        """
        world = self.world._replace(
            anchors=np.ascontiguousarray(anchors, dtype=np.float64), anchor_need=np.ascontiguousarray(needs, dtype=np.float64)
        )
        return dataclasses.replace(self, world=world)

    def with_margin(self, margin_m: float) -> Obstacles:
        """The same with another margin."""
        return dataclasses.replace(self, world=self.world._replace(margin=margin_m))

    def with_nothing_let_go(self, settings: Settings) -> Obstacles:
        """The same for a motion that is not to the target: nothing is let go for the hand, and its fruit is hard, for the search a box.

        Args:
            settings: of that motion; their obstacles must be those of these.
        """
        hard, boxes = self.hard, self.world.boxes
        if self.spot is not None and self.spot.fruit_radius_m is None and settings.fruit_radius_m > 0.0:  # the fruit itself is let go
            centre, radius_m = np.array(self.spot.centre), settings.fruit_radius_m
            hard = np.concatenate([hard, ball(centre, radius_m)])
            boxes = np.concatenate([boxes, [[centre - radius_m, centre + radius_m]]])
        world = self.world._replace(exclusion=np.zeros(6), boxes=boxes)
        return dataclasses.replace(self, hard=hard, world=world, settings=settings, spot=None)

    def exact_checker(self, should_stop: Callable[[], bool] = never) -> ExactChecker:
        """An exact checker of the same obstacles; may raise `Refusal` with CANCELLED."""
        world = self.world
        return _exact_checker(
            self.robot, self.hard, self.leaves, world.exclusion, world.zone, self.settings, world.stem_radius, should_stop
        )


def stem_checker(
    robot: Robot, scene: Scene, spot: Spot | None, settings: Settings, should_stop: Callable[[], bool] = never
) -> ExactChecker:
    """An exact checker of everything hard in a scene, without leaves and without the fields that a search needs: made in no time.

    Args:
        robot, scene, spot, settings, should_stop: see `prepare`; the leaf policy does not count.
    """
    hard, none = _hard_points(robot, scene, spot, settings), np.zeros((0, 3), np.float32)
    return _exact_checker(robot, hard, none, *exclusion(spot, settings), settings, _stem_radius_m(scene, settings), should_stop)


def _stem_radius_m(scene: Scene, settings: Settings) -> float:
    """Radius of stem points such that those which thinning dropped lie inside those which stand for them."""
    return settings.stem_point_radius_m + scene.stem_displacement_m


def _hard_points(robot: Robot, scene: Scene, spot: Spot | None, settings: Settings) -> Float32:
    hard = hard_points(scene, spot, settings)
    reach = robot.reach_m + _BEYOND_REACH_M
    return np.asarray(hard[np.einsum("ij,ij->i", hard, hard) <= reach * reach], dtype=np.float32)


def _exact_checker(
    robot: Robot,
    hard: Float32,
    leaves: Float32,
    hidden: Array,
    zone_m: float,
    s: Settings,
    stem_radius_m: float,
    should_stop: Callable[[], bool],
) -> ExactChecker:
    boxes = np.array(s.keep_out_boxes, dtype=np.float64).reshape(-1, 6)
    return ExactChecker(
        robot,
        hard,
        point_radius_m=stem_radius_m,
        leaf_points=leaves,
        leaf_point_radius_m=s.leaf_point_radius_m,
        keep_out_boxes=boxes,
        floor_z_m=s.floor_height_m,
        workspace_box=np.array(s.workspace_box) if s.workspace_box else None,
        exclusion_centre=hidden[:3] if hidden[3] > 0.0 else None,
        exclusion_radius_m=float(hidden[3]),
        exclusion_heights_m=(float(hidden[4]), float(hidden[5])),
        approach_zone_m=zone_m,
        should_stop=should_stop,
    )


def seen_map_of(robot: Robot, scene: Scene) -> SeenMap:
    """Map what the views of a scene show of the space in an arm's reach."""
    return make_seen_map(scene, UNSEEN_VOXEL_M, reach_m=robot.reach_m + _BEYOND_REACH_M)


def _unseen(robot: Robot, seen: SeenMap, spot: Spot | None, settings: Settings, pause: Callable[[], None]) -> World | None:
    """The unseen space in reach, without the inside of the fruit at a spot, which is known to be fruit."""
    places = seen.unseen
    reach = robot.reach_m + _BEYOND_REACH_M
    places = places[np.einsum("ij,ij->i", places, places) <= reach * reach]
    if spot is not None:
        radius_m = settings.fruit_radius_m if spot.fruit_radius_m is None else spot.fruit_radius_m
        offset = places - np.array(spot.centre, dtype=np.float32)
        places = places[np.einsum("ij,ij->i", offset, offset) > radius_m * radius_m]
    return unseen_world(places, seen.voxel_m, robot.n, pause) if len(places) else None


def prepare(
    robot: Robot,
    shapes: Shapes,
    scene: Scene,
    spot: Spot | None,
    settings: Settings,
    should_stop: Callable[[], bool] = never,
    seen: SeenMap | None = None,
) -> Obstacles:
    """Build fields and obstacles.

    Args:
        robot, shapes: the arm.
        scene: in the planning frame.
        spot: place of the target, or None for a check without one.
        settings: radii, margins, keep-outs, leaf policy.
        should_stop: cancels.
        seen: what the scene's views show (`seen_map_of`); None where everything counts as seen.

    Raises:
        Refusal: CANCELLED.
    """
    hard = _hard_points(robot, scene, spot, settings)
    leaf, costs = scene.leaf_points, scene.leaf_costs
    reach = robot.reach_m + _BEYOND_REACH_M
    near = np.einsum("ij,ij->i", leaf, leaf) <= reach * reach
    leaf, costs = leaf[near], costs[near]
    if settings.leaf_policy == "solid":
        hard = np.concatenate([hard, leaf])
    kept, stands_for = thin(leaf, LEAF_VOXEL_M) if len(leaf) else (np.zeros(0, np.int32), np.zeros(0, np.int32))
    thinned_costs = costs[kept].copy()
    if (costs != 1.0).any():
        np.maximum.at(thinned_costs, stands_for, costs)
    thinned = np.ascontiguousarray(leaf[kept])
    touched = thinned_costs > 0.0  # a leaf that costs nothing is free space
    thinned, thinned_costs = thinned[touched], thinned_costs[touched]
    ask(should_stop)
    weights, prices = price_of_points(thinned, thinned_costs, GRADED if settings.leaf_cost == "graded" else BINARY)
    fields = build_fields(hard, thinned, weights, spacing_m=settings.voxel_m, pause=lambda: ask(should_stop))
    counts = dict(scene.counts) | {"stem_points_used": len(hard), "leaf_points_used": len(thinned)}
    hidden, zone_m = exclusion(spot, settings)
    if hidden[3] > 0.0:
        counts["stem_points_hidden"] = int(spared(hard, hidden).sum())
    infinite = np.array([[-np.inf] * 3, [np.inf] * 3])
    world = empty_world(
        fields,
        robot.n,
        stem_radius=_stem_radius_m(scene, settings),
        leaf_radius=settings.leaf_point_radius_m,
        margin=settings.stem_margin_m,
        boxes=np.array(settings.keep_out_boxes, dtype=np.float64).reshape(-1, 2, 3),
        floor_z=settings.floor_height_m,
        workspace=np.array(settings.workspace_box, dtype=np.float64).reshape(2, 3) if settings.workspace_box else infinite,
        exclusion=hidden,
        zone=zone_m,
        slope=_MARGIN_SLOPE,
        prices=prices,
    )
    unseen = None if seen is None or not len(seen.unseen) else _unseen(robot, seen, spot, settings, lambda: ask(should_stop))
    return Obstacles(robot, shapes, world, hard, thinned, settings, spot, counts, unseen, 0 if seen is None else len(seen.views))
