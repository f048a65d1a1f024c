"""The fast collision model: an arm's bodies against a scene's fields and points, compiled and without the GIL.

Every answer comes in up to three steps: coarse spheres against the distance field clear most bodies; fine spheres clear most of the
rest; what is still open is decided by the cloud's own points in the body's signed distance grid, which follows the undecimated
mesh to about half a millimetre. So the model is not a set of spheres but a fast way to the meshes' own answer.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lime_planner.jit import hot_kernel, inline_kernel
from lime_planner.robot.kinematics import Chain, forward_kinematics
from lime_planner.robot.shapes import GRID_PADDING_M, Shapes
from lime_planner.scene.fields import Fields, box_distance, lower_bound, sample

Array = npt.NDArray[np.float64]

REFINE_M = 0.002  # clearances are exact up to this much above the required one, lower bounds beyond
FAR_M = 0.1  # a body whose bounding sphere is this clear is not looked at more closely
CAP_M = 0.5  # larger clearances are reported as this
SELF_CLEARANCE_M = 0.002  # between two bodies of the arm
GRADED_CELL_M = 0.01  # graded leaf cost: one point stands for a leaf patch of this edge ...
GRADED_UNIT = 20.0  # ... and this many touched patches, about one leaf, cost as much as a binary contact

BINARY, GRADED = 0, 1


class World(NamedTuple):
    """What the arm must not or should not touch, in the planning frame [m].

    Attributes:
        fields: distance fields and points of stems and leaves.
        stem_radius, leaf_radius: radii of the points.
        margin: clearance kept to stems, beyond their radius.
        boxes: (K, 2, 3) keep-out boxes.
        floor_z: height of the floor, -inf for none.
        workspace: (2, 3) box that the arm stays in, infinite for none.
        exclusion: (4,) centre and radius of the sphere in which stem points do not block the gripper, radius 0 for none.
        zone: distance of the tool from the sphere's centre within which that holds.
        anchors: (A, n) configurations (start, goals) that have less clearance than the margin, anchor_need: (A,) what is required at
            them; the requirement grows by `slope` [m/rad] with the distance from them until it is the margin again.
        leaf_mode: BINARY or GRADED.
    """

    fields: Fields
    stem_radius: float
    leaf_radius: float
    margin: float
    boxes: Array
    floor_z: float
    workspace: Array
    exclusion: Array
    zone: float
    anchors: Array
    anchor_need: Array
    slope: float
    leaf_mode: int


class Scratch(NamedTuple):
    """Memory of one thread.

    Attributes:
        poses: (n + 1, 3, 4) of the joints; centres: (B, 3) of the bodies' bounding spheres.
        masks: (B,) int64, a bit for each coarse sphere that a leaf may touch.
        marks: one for each leaf point, last_mark: (1,) the last one used, so that no point counts twice.
    """

    poses: Array
    centres: Array
    masks: npt.NDArray[np.int64]
    marks: npt.NDArray[np.int32]
    last_mark: npt.NDArray[np.int32]


class State(NamedTuple):
    """What one check found: arrays so that a kernel can fill them.

    Attributes:
        clear: (B,) clearance of each body to everything hard but the arm itself, exact near the requirement, else a lower bound [m].
        leaf_clear: (B,) the same for leaves, 0 in contact.
        misc: (4,) clearance between the arm's own bodies [m], leaf intensity, distance of the tool to the border of the approach
            zone (positive inside) [m], clearance required here [m].
    """

    clear: Array
    leaf_clear: Array
    misc: Array


SELF, LEAF, ZONE, NEED = 0, 1, 2, 3


def make_scratch(shapes: Shapes, fields: Fields) -> Scratch:
    """Allocate one thread's memory."""
    bodies = len(shapes.spacing)
    return Scratch(
        np.zeros((bodies, 3, 4)),
        np.zeros((bodies, 3)),
        np.zeros(bodies, np.int64),
        np.zeros(len(fields.leaves.points), np.int32),
        np.zeros(1, np.int32),
    )


def make_state(bodies: int) -> State:
    """Allocate one result."""
    return State(np.zeros(bodies), np.zeros(bodies), np.zeros(4))


@inline_kernel
def grid_distance(shapes: Shapes, b: int, x: float, y: float, z: float) -> float:
    """Signed distance of body b's mesh from a place in its joint's frame; outside the grid, the grid's padding [m]."""
    inverse = 1.0 / shapes.spacing[b]
    gx = (x - shapes.origin[b, 0]) * inverse
    gy = (y - shapes.origin[b, 1]) * inverse
    gz = (z - shapes.origin[b, 2]) * inverse
    ny = shapes.size[b, 1]
    nz = shapes.size[b, 2]
    if gx < 0.0 or gy < 0.0 or gz < 0.0 or gx >= shapes.size[b, 0] - 1 or gy >= ny - 1 or gz >= nz - 1:
        return GRID_PADDING_M
    i = int(gx)
    j = int(gy)
    k = int(gz)
    fx = gx - i
    fy = gy - j
    fz = gz - k
    grid = shapes.grid
    at = shapes.offset[b] + (i * ny + j) * nz + k
    step = ny * nz
    c00 = grid[at] * (1.0 - fz) + grid[at + 1] * fz
    c01 = grid[at + nz] * (1.0 - fz) + grid[at + nz + 1] * fz
    c10 = grid[at + step] * (1.0 - fz) + grid[at + step + 1] * fz
    c11 = grid[at + step + nz] * (1.0 - fz) + grid[at + step + nz + 1] * fz
    return (c00 * (1.0 - fy) + c01 * fy) * (1.0 - fx) + (c10 * (1.0 - fy) + c11 * fy) * fx


@inline_kernel
def _points_near(shapes, b, pose, table, x, y, z, reach, enough, skip, skip_radius):  # type: ignore[no-untyped-def]
    """Smallest distance from body b's mesh to the points of `table` within `reach` of a place.

    Stops at the first one under `enough`. Points within skip_radius of `skip` do not count.
    """
    best = reach
    shape = table.shape
    inverse = 1.0 / table.cell_m
    low0 = max(0, int(math.floor((x - reach - table.origin[0]) * inverse)))
    low1 = max(0, int(math.floor((y - reach - table.origin[1]) * inverse)))
    low2 = max(0, int(math.floor((z - reach - table.origin[2]) * inverse)))
    high0 = min(shape[0] - 1, int(math.floor((x + reach - table.origin[0]) * inverse)))
    high1 = min(shape[1] - 1, int(math.floor((y + reach - table.origin[1]) * inverse)))
    high2 = min(shape[2] - 1, int(math.floor((z + reach - table.origin[2]) * inverse)))
    for i in range(low0, high0 + 1):
        for j in range(low1, high1 + 1):
            row = (i * shape[1] + j) * shape[2]
            for at in range(table.start[row + low2] if high2 >= low2 else 0, table.start[row + high2 + 1] if high2 >= low2 else 0):
                px = float(table.points[at, 0])
                py = float(table.points[at, 1])
                pz = float(table.points[at, 2])
                if (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2 > reach * reach:
                    continue
                if skip_radius > 0.0 and (px - skip[0]) ** 2 + (py - skip[1]) ** 2 + (pz - skip[2]) ** 2 < skip_radius * skip_radius:
                    continue
                dx = px - pose[0, 3]
                dy = py - pose[1, 3]
                dz = pz - pose[2, 3]
                d = grid_distance(
                    shapes,
                    b,
                    pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz,
                    pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz,
                    pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz,
                )
                if d < best:
                    best = d
                    if best < enough:
                        return best
    return best


@inline_kernel
def _touched_patches(shapes, b, pose, table, x, y, z, reach, radius, marks, mark):  # type: ignore[no-untyped-def]
    """Sum of the weights of the points near a place that touch body b and carry no mark yet; they are marked."""
    total = 0.0
    shape = table.shape
    inverse = 1.0 / table.cell_m
    low0 = max(0, int(math.floor((x - reach - table.origin[0]) * inverse)))
    low1 = max(0, int(math.floor((y - reach - table.origin[1]) * inverse)))
    low2 = max(0, int(math.floor((z - reach - table.origin[2]) * inverse)))
    high0 = min(shape[0] - 1, int(math.floor((x + reach - table.origin[0]) * inverse)))
    high1 = min(shape[1] - 1, int(math.floor((y + reach - table.origin[1]) * inverse)))
    high2 = min(shape[2] - 1, int(math.floor((z + reach - table.origin[2]) * inverse)))
    for i in range(low0, high0 + 1):
        for j in range(low1, high1 + 1):
            row = (i * shape[1] + j) * shape[2]
            for at in range(table.start[row + low2] if high2 >= low2 else 0, table.start[row + high2 + 1] if high2 >= low2 else 0):
                if marks[at] == mark:
                    continue
                dx = table.points[at, 0] - pose[0, 3]
                dy = table.points[at, 1] - pose[1, 3]
                dz = table.points[at, 2] - pose[2, 3]
                d = grid_distance(
                    shapes,
                    b,
                    pose[0, 0] * dx + pose[1, 0] * dy + pose[2, 0] * dz,
                    pose[0, 1] * dx + pose[1, 1] * dy + pose[2, 1] * dz,
                    pose[0, 2] * dx + pose[1, 2] * dy + pose[2, 2] * dz,
                )
                if d < radius:
                    marks[at] = mark
                    total += table.weights[at]
    return total


@inline_kernel
def _hard_distance(world, b, x, y, z):  # type: ignore[no-untyped-def]
    """Distance from a place to the keep-out boxes, the floor (but for body 0) and out of the workspace box [m]."""
    best = CAP_M
    for k in range(world.boxes.shape[0]):
        best = min(best, box_distance(world.boxes[k], x, y, z))
    if b > 0:
        best = min(best, z - world.floor_z)
        best = min(best, x - world.workspace[0, 0], world.workspace[1, 0] - x)
        best = min(best, y - world.workspace[0, 1], world.workspace[1, 1] - y)
        best = min(best, z - world.workspace[0, 2], world.workspace[1, 2] - z)
    return best


@inline_kernel
def required_clearance(world: World, q: Array) -> float:
    """Clearance to stems required at q: the margin, less near a start or goal that has less itself [m]."""
    need = world.margin
    for a in range(world.anchors.shape[0]):
        total = 0.0
        for i in range(q.shape[0]):
            total += (q[i] - world.anchors[a, i]) ** 2
        need = min(need, world.anchor_need[a] + world.slope * math.sqrt(total))
    return need


@inline_kernel
def place(pose: Array, sphere: Array) -> tuple[float, float, float]:
    """Carry a sphere's centre from its joint's frame into the planning frame."""
    x = pose[0, 0] * sphere[0] + pose[0, 1] * sphere[1] + pose[0, 2] * sphere[2] + pose[0, 3]
    y = pose[1, 0] * sphere[0] + pose[1, 1] * sphere[1] + pose[1, 2] * sphere[2] + pose[1, 3]
    z = pose[2, 0] * sphere[0] + pose[2, 1] * sphere[1] + pose[2, 2] * sphere[2] + pose[2, 3]
    return x, y, z


@inline_kernel
def _scan_body(world, shapes, scratch, b, inside, need, enough, leaves, state):  # type: ignore[no-untyped-def]
    """Clearance of one body to everything hard into state.clear; lower bound for leaves into state.leaf_clear.

    Stops when the clearance is under `enough`. The coarse spheres that a leaf may touch are left in scratch.masks.
    """
    pose = scratch.poses[b]
    fields = world.fields
    h = fields.spacing_m
    extra = world.boxes.shape[0] > 0 or world.floor_z > -1e9 or world.workspace[1, 0] < 1e9
    scratch.masks[b] = 0
    if not extra:
        stem, leaf = sample(fields, scratch.centres[b, 0], scratch.centres[b, 1], scratch.centres[b, 2])
        stem = lower_bound(stem, h) - shapes.bound[b, 3] - world.stem_radius
        leaf = lower_bound(leaf, h) - shapes.bound[b, 3] - world.leaf_radius
        if stem > FAR_M and leaf > FAR_M:
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
        hard = _hard_distance(world, b, x, y, z) - sphere[3] if extra else CAP_M
        if bound > refine and hard > refine:
            best = min(best, bound, hard)
            continue
        for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
            sphere = shapes.fine[f]
            x, y, z = place(pose, sphere)
            if extra:
                best = min(best, _hard_distance(world, b, x, y, z) - sphere[3])
            stem, _ = sample(fields, x, y, z)
            bound = lower_bound(stem, h) - sphere[3] - world.stem_radius
            if bound > refine:
                best = min(best, bound)
            elif bound < best:
                reach = sphere[3] + world.stem_radius + refine
                d = _points_near(shapes, b, pose, fields.stems, x, y, z, reach, world.stem_radius + enough, world.exclusion, skip_radius)
                best = min(best, d - world.stem_radius, refine)
            if best < enough:
                state.clear[b] = best
                return
    scratch.masks[b] = mask
    state.clear[b] = best
    state.leaf_clear[b] = leaf_best


@inline_kernel
def _leaf_of_body(world, shapes, scratch, b, state):  # type: ignore[no-untyped-def]
    """Leaf intensity of one body, looking only at the coarse spheres left open; completes state.leaf_clear."""
    pose = scratch.poses[b]
    fields = world.fields
    graded = world.leaf_mode == GRADED
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
                touched += _touched_patches(
                    shapes, b, pose, fields.leaves, x, y, z, reach, radius, scratch.marks, scratch.last_mark[0]
                )
                best = 0.0 if touched > 0.0 else min(best, 0.001)
            else:
                reach += 0.001
                d = _points_near(shapes, b, pose, fields.leaves, x, y, z, reach, radius, pose[:, 3], 0.0) - radius
                if d < 0.0:
                    state.leaf_clear[b] = 0.0
                    return 1.0
                best = min(best, d, 0.001)
    state.leaf_clear[b] = best
    return touched / GRADED_UNIT


@inline_kernel
def _self_clearance(shapes, scratch):  # type: ignore[no-untyped-def]
    """Smallest clearance between bodies that can touch: spheres of one in the other's grid, surface points where that is close."""
    best = CAP_M
    for p in range(shapes.pairs.shape[0]):
        a = shapes.pairs[p, 0]
        b = shapes.pairs[p, 1]
        dx = scratch.centres[a, 0] - scratch.centres[b, 0]
        dy = scratch.centres[a, 1] - scratch.centres[b, 1]
        dz = scratch.centres[a, 2] - scratch.centres[b, 2]
        apart = math.sqrt(dx * dx + dy * dy + dz * dz) - shapes.bound[a, 3] - shapes.bound[b, 3]
        if apart > GRID_PADDING_M:
            best = min(best, apart)
            continue
        # The outer body's spheres go into the inner body's grid: the gripper's are the finest.
        inner = scratch.poses[a]
        outer = scratch.poses[b]
        for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
            d = _sphere_in_grid(shapes, a, inner, outer, shapes.coarse[c])
            if d > SELF_CLEARANCE_M + REFINE_M:
                best = min(best, d)
                continue
            for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
                d = _sphere_in_grid(shapes, a, inner, outer, shapes.fine[f])
                if d > SELF_CLEARANCE_M:
                    best = min(best, d)
                    continue
                for s in range(shapes.surface_start[f], shapes.surface_start[f + 1]):
                    point = shapes.surface[s]
                    x = outer[0, 0] * point[0] + outer[0, 1] * point[1] + outer[0, 2] * point[2] + outer[0, 3] - inner[0, 3]
                    y = outer[1, 0] * point[0] + outer[1, 1] * point[1] + outer[1, 2] * point[2] + outer[1, 3] - inner[1, 3]
                    z = outer[2, 0] * point[0] + outer[2, 1] * point[1] + outer[2, 2] * point[2] + outer[2, 3] - inner[2, 3]
                    d = grid_distance(
                        shapes,
                        a,
                        inner[0, 0] * x + inner[1, 0] * y + inner[2, 0] * z,
                        inner[0, 1] * x + inner[1, 1] * y + inner[2, 1] * z,
                        inner[0, 2] * x + inner[1, 2] * y + inner[2, 2] * z,
                    )
                    best = min(best, d)
                    if best < SELF_CLEARANCE_M:
                        return best
    return best


@inline_kernel
def _sphere_in_grid(shapes, a, inner, outer, sphere):  # type: ignore[no-untyped-def]
    """Lower bound of the distance between body a and a sphere of another body."""
    x = outer[0, 0] * sphere[0] + outer[0, 1] * sphere[1] + outer[0, 2] * sphere[2] + outer[0, 3] - inner[0, 3]
    y = outer[1, 0] * sphere[0] + outer[1, 1] * sphere[1] + outer[1, 2] * sphere[2] + outer[1, 3] - inner[1, 3]
    z = outer[2, 0] * sphere[0] + outer[2, 1] * sphere[1] + outer[2, 2] * sphere[2] + outer[2, 3] - inner[2, 3]
    px = inner[0, 0] * x + inner[1, 0] * y + inner[2, 0] * z
    py = inner[0, 1] * x + inner[1, 1] * y + inner[2, 1] * z
    pz = inner[0, 2] * x + inner[1, 2] * y + inner[2, 2] * z
    h = shapes.spacing[a]
    gap = 0.0
    low = shapes.origin[a]
    gx = max(low[0] - px, 0.0, px - low[0] - h * (shapes.size[a, 0] - 1))
    gy = max(low[1] - py, 0.0, py - low[1] - h * (shapes.size[a, 1] - 1))
    gz = max(low[2] - pz, 0.0, pz - low[2] - h * (shapes.size[a, 2] - 1))
    gap = math.sqrt(gx * gx + gy * gy + gz * gz)
    if gap > 0.0:
        return gap + GRID_PADDING_M - sphere[3]
    return grid_distance(shapes, a, px, py, pz) - sphere[3]


@hot_kernel
def check(chain: Chain, shapes: Shapes, world: World, scratch: Scratch, q: Array, leaves: bool, floor: float, state: State) -> bool:
    """Check one configuration against everything.

    Args:
        chain, shapes, world, scratch: the arm, its bodies, the obstacles, this thread's memory.
        q: configuration (n,) [rad], within the joint limits.
        leaves: whether leaves matter; without, the intensity is 0.
        floor: evaluate clearances fully down to this value [m] instead of stopping below the requirement (for figures); +inf to stop early.
        state: receives the clearances and the leaf intensity; complete only where the result is True or `floor` is finite.

    Returns:
        Whether nothing hard is nearer than required.
    """
    poses = scratch.poses
    forward_kinematics(chain, q, poses)
    bodies = shapes.spacing.shape[0]
    for b in range(bodies):
        for k in range(3):
            scratch.centres[b, k] = (
                poses[b, k, 0] * shapes.bound[b, 0] + poses[b, k, 1] * shapes.bound[b, 1] + poses[b, k, 2] * shapes.bound[b, 2] + poses[b, k, 3]
            )
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
        if shapes.bound[b, 3] == 0.0:
            state.clear[b] = CAP_M
            state.leaf_clear[b] = CAP_M
            scratch.masks[b] = 0
            continue
        _scan_body(world, shapes, scratch, b, inside, need, enough, leaves, state)
        if state.clear[b] < need:
            if floor > need:
                return False
            valid = False
    state.misc[SELF] = _self_clearance(shapes, scratch)
    if state.misc[SELF] < SELF_CLEARANCE_M:
        if floor > need:
            return False
        valid = False
    intensity = 0.0
    if leaves:
        if world.leaf_mode == GRADED:
            scratch.last_mark[0] += 1
        for step in range(bodies):
            b = bodies - 1 - step
            if scratch.masks[b] != 0:
                intensity += _leaf_of_body(world, shapes, scratch, b, state)
                if intensity > 0.0 and world.leaf_mode == BINARY:
                    break
    state.misc[LEAF] = intensity
    return valid


def empty_world(fields: Fields, n: int, **values: Any) -> World:
    """A world with the given parts and nothing else."""
    infinite = np.array([[-1e10] * 3, [1e10] * 3])
    parts: dict[str, Any] = {
        "fields": fields,
        "stem_radius": 0.004,
        "leaf_radius": 0.004,
        "margin": 0.005,
        "boxes": np.zeros((0, 2, 3)),
        "floor_z": -1e10,
        "workspace": infinite,
        "exclusion": np.zeros(4),
        "zone": 0.0,
        "anchors": np.zeros((0, n)),
        "anchor_need": np.zeros(0),
        "slope": 0.02,
        "leaf_mode": BINARY,
    }
    return World(**(parts | values))
