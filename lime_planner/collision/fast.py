"""The fast collision model: an arm's bodies against a scene's fields and points, compiled and without the GIL.

Every answer comes in up to three steps: coarse spheres against the distance field clear most bodies; fine spheres clear most of the
rest; what is still open is decided by the cloud's own points in the body's signed distance grid, which follows the undecimated
mesh to about half a millimetre. So the model is not a set of spheres but a fast way to the meshes' own answer.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.collision.distance_fields import Fields, lower_bound, sample
from lime_planner.collision.leaves.sweep import Sweep, make_sweep, set_twists, sphere_speed, turning_speed
from lime_planner.collision.link_shapes import Shapes
from lime_planner.collision.point_contact import leaf_near, place, points_near, touched_patches
from lime_planner.collision.self_contact import SELF_CLEARANCE_M, self_clearance
from lime_planner.collision.world import CAP_M, World, hard_distance, required_clearance
from lime_planner.core.jit import inline_kernel
from lime_planner.core.types import Array, Int32, Int64
from lime_planner.planning.prices import GRADED, body_price, is_settled, with_body
from lime_planner.robot.kinematics import Chain, forward_kinematics

REFINE_M = 0.002  # clearances are exact up to this much above the required one, lower bounds beyond
DESCEND_M = 0.006  # coarse spheres clearer than this are not looked into: what they overstate would shorten the steps along edges
FAR_M = 0.025  # a body whose bounding sphere has this much to spare is not looked at more closely

SELF, LEAF, ZONE, NEED = 0, 1, 2, 3  # places in State.misc


class Scratch(NamedTuple):
    """Memory of one thread.

    Attributes:
        poses: (n + 1, 3, 4) of the joints; centres: (B, 3) of the bodies' bounding spheres.
        masks: (B,) int64, a bit for each coarse sphere that a leaf may touch.
        q, force: (n,) the configuration to check and the force found, where functions called by address look for them.
        open: (2,) int64 bodies, and pairs of bodies, that a check is to look at, a bit each (number modulo 64); -1 for all of them.
        marks: one for each leaf point, last_mark: (1,) the last one used, so that no point counts twice.
        sweep: memory for one edge, which a check without leaves is taken to belong to.
    """

    poses: Array
    centres: Array
    masks: Int64
    q: Array
    force: Array
    open: Int64
    marks: Int32
    last_mark: Int32
    sweep: Sweep


class State(NamedTuple):
    """What one check found: arrays so that a kernel can fill them.

    Attributes:
        clear: (B,) clearance of each body to everything hard but the arm itself, exact near the requirement, else a lower bound [m].
        leaf_clear: (B,) the same for leaves, 0 in contact.
        speed: (B,) bound on the speed of any place of a body along an edge, by the share of the edge; of a check without leaves [m].
        own: (P,) clearance of each pair of bodies that can touch, in the order of `Shapes.pairs` [m].
        misc: (4,) smallest clearance between the arm's own bodies [m], leaf intensity, distance of the tool to the border of the approach
            zone (positive inside) [m], clearance required here [m].
    """

    clear: Array
    leaf_clear: Array
    speed: Array
    own: Array
    misc: Array


def make_scratch(shapes: Shapes, fields: Fields) -> Scratch:
    """Allocate one thread's memory."""
    bodies = len(shapes.spacing)
    return Scratch(
        np.zeros((bodies, 3, 4)),
        np.zeros((bodies, 3)),
        np.zeros(bodies, np.int64),
        np.zeros(max(bodies - 1, 0)),
        np.zeros(max(bodies - 1, 0)),
        np.full(2, -1, np.int64),
        np.zeros(len(fields.leaves.points), np.int32),
        np.zeros(1, np.int32),
        make_sweep(max(bodies - 1, 0)),
    )


def make_state(shapes: Shapes) -> State:
    """Allocate one result."""
    bodies = len(shapes.spacing)
    return State(np.zeros(bodies), np.zeros(bodies), np.zeros(bodies), np.zeros(len(shapes.pairs)), np.zeros(4))


@inline_kernel
def scan_body(world: Any, shapes: Any, scratch: Any, b: Any, inside: Any, need: Any, enough: Any, leaves: Any, state: Any) -> Any:
    """Clearance of one body to everything hard into state.clear; lower bound for leaves into state.leaf_clear.

    Stops when the clearance is under `enough`. The coarse spheres that a leaf may touch are left in scratch.masks.
    """
    pose = scratch.poses[b]
    fields = world.fields
    h = fields.spacing_m
    extra = world.boxes.shape[0] > 0 or world.floor_z > -np.inf or world.workspace[1, 0] < np.inf
    scratch.masks[b] = 0
    if not extra:
        stem, leaf = sample(fields, scratch.centres[b, 0], scratch.centres[b, 1], scratch.centres[b, 2])
        stem = lower_bound(stem, h) - shapes.bound[b, 3] - world.stem_radius
        leaf = lower_bound(leaf, h) - shapes.bound[b, 3] - world.leaf_radius
        if stem > need + FAR_M and (leaf > FAR_M or not leaves):
            state.clear[b] = stem
            state.leaf_clear[b] = leaf
            return
    skip_radius = world.exclusion[3] if inside and b == shapes.gripper else 0.0
    refine = need + REFINE_M
    best = CAP_M
    leaf_best = CAP_M
    mask = 0
    for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
        sphere = shapes.coarse[c]
        x, y, z = place(pose, sphere)
        stem, leaf = sample(fields, x, y, z)
        if leaves:
            bound = lower_bound(leaf, h) - sphere[3] - world.leaf_radius
            if bound > REFINE_M:
                leaf_best = min(leaf_best, bound)
            else:
                mask |= 1 << (c - shapes.coarse_start[b])
        bound = lower_bound(stem, h) - sphere[3] - world.stem_radius
        hard = hard_distance(world, x, y, z) - sphere[3] if extra else CAP_M
        if bound > need + DESCEND_M and hard > need + DESCEND_M:
            best = min(best, bound, hard)
            continue
        for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
            sphere = shapes.fine[f]
            x, y, z = place(pose, sphere)
            if extra:
                best = min(best, hard_distance(world, x, y, z) - sphere[3])
            stem, _ = sample(fields, x, y, z)
            bound = lower_bound(stem, h) - sphere[3] - world.stem_radius
            if bound > refine:
                best = min(best, bound)
            elif bound < best:
                reach = sphere[3] + world.stem_radius + refine
                d = points_near(shapes, b, pose, fields.stems, x, y, z, reach, world.stem_radius + enough, world.exclusion, skip_radius)
                best = min(best, d - world.stem_radius, refine)
            if best < enough:
                state.clear[b] = best
                return
    scratch.masks[b] = mask
    state.clear[b] = best
    state.leaf_clear[b] = leaf_best


@inline_kernel
def _leaf_of_body(world: Any, shapes: Any, scratch: Any, b: Any, state: Any) -> Any:
    """Price of what one body touches, looking only at the coarse spheres left open; completes state.leaf_clear."""
    pose = scratch.poses[b]
    fields = world.fields
    prices = world.prices
    graded = prices.mode == GRADED
    radius = world.leaf_radius
    mask = scratch.masks[b]
    best = state.leaf_clear[b]
    touched = 0.0
    for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
        if not (mask >> (c - shapes.coarse_start[b])) & 1:
            continue
        for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
            sphere = shapes.fine[f]
            x, y, z = place(pose, sphere)
            _, leaf = sample(fields, x, y, z)
            bound = lower_bound(leaf, fields.spacing_m) - sphere[3] - radius
            if bound > 0.001:
                best = min(best, bound)
                continue
            reach = sphere[3] + radius
            if graded:
                touched += touched_patches(shapes, b, pose, fields.leaves, x, y, z, reach, radius, scratch.marks, scratch.last_mark[0])
                best = 0.0 if touched > 0.0 else min(best, 0.001)
            else:
                d, weight = leaf_near(shapes, b, pose, fields.leaves, x, y, z, reach + 0.001, radius, prices.top)
                touched = max(touched, weight)
                best = 0.0 if touched > 0.0 else min(best, d - radius, 0.001)
                if is_settled(prices, touched):
                    state.leaf_clear[b] = 0.0
                    return body_price(prices, touched)
    state.leaf_clear[b] = best
    return body_price(prices, touched)


@inline_kernel
def check(chain: Chain, shapes: Shapes, world: World, scratch: Scratch, q: Array, leaves: bool, floor: float, state: State) -> bool:
    """Check one configuration against everything; body 0, which stands still, against the other bodies only.

    Merged into the two functions that are called by address: hundreds of array fields would be copied at a call.

    Args:
        chain, shapes, world, scratch: the arm, its bodies, the obstacles, this thread's memory.
        q: configuration (n,) [rad], within the joint limits.
        leaves: whether leaves matter; without, the intensity is 0, and the bodies' speeds along the edge of `scratch.sweep` are found.
        floor: evaluate clearances fully down to this value [m] instead of stopping below the requirement (for figures); +inf to stop early.
        state: receives the clearances and the leaf intensity; complete only where the result is True or `floor` is finite.

    Returns:
        Whether nothing hard is nearer than required.
    """
    poses = scratch.poses
    forward_kinematics(chain, q, poses)
    bodies = shapes.spacing.shape[0]
    for b in range(bodies):
        x, y, z = place(poses[b], shapes.bound[b])
        scratch.centres[b, 0] = x
        scratch.centres[b, 1] = y
        scratch.centres[b, 2] = z
    if not leaves:
        set_twists(chain, poses, scratch.sweep)
        for b in range(bodies):
            turning = turning_speed(scratch.sweep.twist, b)
            centre = scratch.centres[b]
            state.speed[b] = sphere_speed(scratch.sweep.twist, b, turning, centre[0], centre[1], centre[2], shapes.bound[b, 3])
    need = required_clearance(world, q)
    state.misc[NEED] = need
    inside = False
    state.misc[ZONE] = -CAP_M
    if world.exclusion[3] > 0.0:
        total = 0.0
        last = poses[bodies - 1]
        for k in range(3):
            tool = last[k, 0] * chain.tool[0, 3] + last[k, 1] * chain.tool[1, 3] + last[k, 2] * chain.tool[2, 3] + last[k, 3]
            total += (tool - world.exclusion[k]) ** 2
        state.misc[ZONE] = world.zone - math.sqrt(total)
        inside = state.misc[ZONE] >= 0.0
    fields = world.fields
    enough = min(need, floor)
    valid = True
    leaves = leaves and fields.present[1] > 0
    for step in range(bodies):
        b = bodies - 1 - step
        # What stands still comes no closer to anything whatever the path: the exact check of the start has judged it.
        if b == 0 or shapes.bound[b, 3] == 0.0 or not (scratch.open[0] >> (b & 63)) & 1:
            state.clear[b] = CAP_M
            state.leaf_clear[b] = CAP_M
            scratch.masks[b] = 0
            continue
        scan_body(world, shapes, scratch, b, inside, need, enough, leaves, state)
        if state.clear[b] < need:
            if floor > need:
                return False
            valid = False
    state.misc[SELF] = self_clearance(shapes, scratch, state.own)
    if state.misc[SELF] < SELF_CLEARANCE_M:
        if floor > need:
            return False
        valid = False
    intensity = 0.0
    if leaves:
        if world.prices.mode == GRADED:
            scratch.last_mark[0] += 1
        for step in range(bodies):
            b = bodies - 1 - step
            if scratch.masks[b] != 0:
                intensity = with_body(world.prices, intensity, _leaf_of_body(world, shapes, scratch, b, state))
                if is_settled(world.prices, intensity):
                    break
    state.misc[LEAF] = intensity
    return valid
