"""What leaves cost along a straight edge: where contact begins and ends, by bisection with certificates instead of samples.

An interval of the edge is free when no body can reach a leaf point between its ends, and in contact when some point cannot get out of
a body; everything else is halved. How far a body moves in half an interval follows from its velocity in the middle and a bound on its
acceleration: the velocity is that of the place that could touch (the joints' motions added as vectors), so that the bound is close to
the truth. Far from leaves whole bodies are cleared by their spheres in the distance field. Closer, the points that could be touched are
collected once, and from there on only these are looked at: a step costs the arm's kinematics and a few look-ups.

What is left when an interval is so short that it hardly matters is settled by its middle, and its possible error is added up.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.collision.distance_fields import lower_bound, sample
from lime_planner.collision.point_contact import cells_near, mesh_distance, place
from lime_planner.core.jit import inline_kernel
from lime_planner.core.types import Array, Int32, Int64
from lime_planner.planning.prices import GRADED, body_price, is_settled
from lime_planner.robot.kinematics import forward_kinematics

FINEST_RAD = 2e-4  #: an interval that could cost no more than so much contact with a leaf of price 1 is settled by its middle
GATHER_M = 0.01  #: points are collected as soon as no open body moves further than this in half an interval
_SLACK, _SLACK_M = 1.05, 2e-5  #: distances interpolated in a grid change a little faster than the place moves
_CANDIDATES = 1 << 16
_TOUCHES = 64  # added to the number of a body in a list: the point touches it in the middle of the interval
_DEPTH = 64
_GRADED = 8.0
_SPANS = 1 << 13


class Sweep(NamedTuple):
    """Memory of one thread for one edge a + t · along, t from 0 to 1.

    Attributes:
        start, along: (n,) where the edge begins, and its difference; moves: (B,) whether a body moves at all.
        bend: (B,) bound on the second derivative of any of a body's places by t [m].
        twist: (B, 6) angular velocity and velocity at the planning frame's origin of each body in the middle of an interval, by t.
        body, point: (K,) the points that may be touched, with the body concerned; lists of the intervals one after another.
        left, right: (D,) open intervals; first, listed: (D,) int64 their lists, listed -1 before points are collected.
        open: (D,) int64 bodies to look at, one bit each, until then; sure: (D,) price that the interval costs at least.
        doubt: (1,) sum of what charges may be wrong by, by t.
        spans: (S, 3) where contact begins and ends, and its price, for figures; used: (1,) int64 how many there are, -1 to keep none.
    """

    start: Array
    along: Array
    bend: Array
    twist: Array
    body: Int32
    point: Int32
    left: Array
    right: Array
    first: Int64
    listed: Int64
    open: Int64
    sure: Array
    doubt: Array
    spans: Array
    used: Int64


def make_sweep(n: int) -> Sweep:
    """Allocate one thread's memory for an arm of n joints."""
    bodies = n + 1
    return Sweep(
        np.zeros(n),
        np.zeros(n),
        np.zeros(bodies),
        np.zeros((bodies, 6)),
        np.zeros(_CANDIDATES, np.int32),
        np.zeros(_CANDIDATES, np.int32),
        np.zeros(_DEPTH),
        np.zeros(_DEPTH),
        np.zeros(_DEPTH, np.int64),
        np.zeros(_DEPTH, np.int64),
        np.zeros(_DEPTH, np.int64),
        np.zeros(_DEPTH),
        np.zeros(1),
        np.zeros((_SPANS, 3)),
        np.full(1, -1, np.int64),
    )


@inline_kernel
def set_bends(lever: Any, sweep: Any) -> Any:
    """Bound the acceleration of each body along the edge in `sweep.along`, with `lever` of `Shapes`.

    The second derivative of a place by joints i and j is a product of their axes with the place's distance from the outer one.
    """
    n = sweep.along.shape[0]
    for b in range(n + 1):
        total = 0.0
        inner = 0.0
        for j in range(b):
            rate = abs(sweep.along[j])
            total += lever[j, b] * rate * (rate + 2.0 * inner)
            inner += rate
        sweep.bend[b] = total


@inline_kernel
def set_twists(chain: Any, poses: Any, sweep: Any) -> Any:
    """Velocities of all bodies at the poses given, by t."""
    twist = sweep.twist
    wx = wy = wz = vx = vy = vz = 0.0
    for j in range(sweep.along.shape[0]):
        pose = poses[j + 1]
        rate = sweep.along[j]
        ax = pose[0, 2] * rate
        ay = pose[1, 2] * rate
        az = pose[2, 2] * rate
        if chain.prismatic[j] == 0:
            wx += ax
            wy += ay
            wz += az
            vx += pose[1, 3] * az - pose[2, 3] * ay
            vy += pose[2, 3] * ax - pose[0, 3] * az
            vz += pose[0, 3] * ay - pose[1, 3] * ax
        else:
            vx += ax
            vy += ay
            vz += az
        twist[j + 1, 0] = wx
        twist[j + 1, 1] = wy
        twist[j + 1, 2] = wz
        twist[j + 1, 3] = vx
        twist[j + 1, 4] = vy
        twist[j + 1, 5] = vz


@inline_kernel
def _speed(twist: Any, b: Any, x: Any, y: Any, z: Any) -> Any:
    """Speed of the place (x, y, z) as it moves with body b."""
    ux = twist[b, 3] + twist[b, 1] * z - twist[b, 2] * y
    uy = twist[b, 4] + twist[b, 2] * x - twist[b, 0] * z
    uz = twist[b, 5] + twist[b, 0] * y - twist[b, 1] * x
    return math.sqrt(ux * ux + uy * uy + uz * uz)


@inline_kernel
def turning_speed(twist: Any, b: Any) -> Any:
    """Angular speed of body b."""
    return math.sqrt(twist[b, 0] * twist[b, 0] + twist[b, 1] * twist[b, 1] + twist[b, 2] * twist[b, 2])


@inline_kernel
def sphere_speed(twist: Any, b: Any, turning: Any, x: Any, y: Any, z: Any, radius: Any) -> Any:
    """Bound on the speed of any place of a sphere of body b, whose `turning_speed` is given."""
    return _speed(twist, b, x, y, z) + turning * radius


@inline_kernel
def _reach_of_sphere(sweep: Any, b: Any, turning: Any, half: Any, x: Any, y: Any, z: Any, radius: Any) -> Any:
    """How far any place of a sphere of body b gets within half an interval."""
    return _SLACK * half * sphere_speed(sweep.twist, b, turning, x, y, z, radius) + 0.5 * half * half * sweep.bend[b] + _SLACK_M


@inline_kernel
def _is_clear(world: Any, shapes: Any, scratch: Any, sweep: Any, b: Any, half: Any) -> Any:
    """Whether the spheres of body b stay clear of all leaves within half an interval, and how far the farthest of them gets."""
    pose = scratch.poses[b]
    fields = world.fields
    h = fields.spacing_m
    turning = turning_speed(sweep.twist, b)
    x, y, z = place(pose, shapes.bound[b])
    widest = _reach_of_sphere(sweep, b, turning, half, x, y, z, shapes.bound[b, 3])
    _, leaf = sample(fields, x, y, z)
    if lower_bound(leaf, h) - shapes.bound[b, 3] - world.leaf_radius > widest:
        return True, widest
    for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
        sphere = shapes.coarse[c]
        x, y, z = place(pose, sphere)
        _, leaf = sample(fields, x, y, z)
        reach = _reach_of_sphere(sweep, b, turning, half, x, y, z, sphere[3])
        if lower_bound(leaf, h) - sphere[3] - world.leaf_radius > reach:
            continue
        for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
            sphere = shapes.fine[f]
            x, y, z = place(pose, sphere)
            _, leaf = sample(fields, x, y, z)
            reach = _reach_of_sphere(sweep, b, turning, half, x, y, z, sphere[3])
            if lower_bound(leaf, h) - sphere[3] - world.leaf_radius <= reach:
                return False, widest
    return True, widest


@inline_kernel
def _collect(world: Any, shapes: Any, scratch: Any, sweep: Any, b: Any, half: Any, at: Any) -> Any:
    """Append the leaf points that body b may touch within half an interval to the list that ends at `at`.

    Returns:
        The list's new end; -1 where there is no room; -2 where a point is touched throughout and none could cost more (binary).
    """
    pose = scratch.poses[b]
    fields = world.fields
    table = fields.leaves
    h = fields.spacing_m
    radius = world.leaf_radius
    turning = turning_speed(sweep.twist, b)
    bend = 0.5 * half * half * sweep.bend[b] + _SLACK_M
    scratch.last_mark[0] += 1
    mark = scratch.last_mark[0]
    for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
        sphere = shapes.coarse[c]
        x, y, z = place(pose, sphere)
        _, leaf = sample(fields, x, y, z)
        if lower_bound(leaf, h) - sphere[3] - radius > _reach_of_sphere(sweep, b, turning, half, x, y, z, sphere[3]):
            continue
        for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
            sphere = shapes.fine[f]
            x, y, z = place(pose, sphere)
            _, leaf = sample(fields, x, y, z)
            around = _reach_of_sphere(sweep, b, turning, half, x, y, z, sphere[3])
            if lower_bound(leaf, h) - sphere[3] - radius > around:
                continue
            reach = sphere[3] + radius + around
            low0, high0, low1, high1, low2, high2 = cells_near(table, x, y, z, reach)
            for i in range(low0, high0 + 1):
                for j in range(low1, high1 + 1):
                    row = (i * table.shape[1] + j) * table.shape[2]
                    for p in range(table.start[row + low2] if high2 >= low2 else 0, table.start[row + high2 + 1] if high2 >= low2 else 0):
                        if scratch.marks[p] == mark:
                            continue
                        px = float(table.points[p, 0])
                        py = float(table.points[p, 1])
                        pz = float(table.points[p, 2])
                        if (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2 > reach * reach:
                            continue
                        scratch.marks[p] = mark
                        gap = mesh_distance(shapes, b, pose, px, py, pz) - radius
                        reach_p = _SLACK * half * _speed(sweep.twist, b, px, py, pz) + bend
                        if gap > reach_p:
                            continue
                        if gap < -reach_p and is_settled(world.prices, float(table.weights[p])):
                            return -2
                        if at >= sweep.body.shape[0]:
                            return -1
                        sweep.body[at] = b
                        sweep.point[at] = p
                        at += 1
    return at


@inline_kernel
def _charge(sweep: Any, left: Any, right: Any, price: Any) -> Any:
    """What an interval of one price costs, by t; it is kept among the spans where these are wanted, joined to the one before."""
    used = sweep.used[0]
    if used >= 0 and price > 0.0:
        last = used - 1
        if last >= 0 and sweep.spans[last, 1] == left and (sweep.spans[last, 2] == price or used == sweep.spans.shape[0]):
            if sweep.spans[last, 2] != price:  # no room: what is joined costs the mean
                whole = right - sweep.spans[last, 0]
                sweep.spans[last, 2] += (price - sweep.spans[last, 2]) * (right - left) / whole
            sweep.spans[last, 1] = right
        elif used < sweep.spans.shape[0]:
            sweep.spans[used, 0] = left
            sweep.spans[used, 1] = right
            sweep.spans[used, 2] = price
            sweep.used[0] = used + 1
    return (right - left) * price


@inline_kernel
def _what_is_open(
    table: Any, scratch: Any, sweep: Any, graded: Any, begin: Any, end: Any, sure: Any, throughout: Any
) -> tuple[Any, Any, Any]:
    """What the points of a list would add to the price `sure`: those that touch in the middle, and all of them; and the list's end.

    Points that cannot add anything are taken out: cheaper ones (binary), and those marked `throughout`, in contact by another body.
    """
    inside = 0.0
    highest = 0.0
    kept = begin
    for at in range(begin, end):
        p = sweep.point[at]
        price = float(table.weights[p])
        if scratch.marks[p] == throughout if graded else price <= sure:
            continue
        if not graded:
            highest = max(highest, price - sure)
            if sweep.body[at] >= _TOUCHES:
                inside = max(inside, price - sure)
        sweep.body[kept] = sweep.body[at]
        sweep.point[kept] = p
        kept += 1
    if graded:  # a point counts once, whatever number of bodies touches it
        scratch.last_mark[0] += 1
        mark = scratch.last_mark[0]
        for at in range(begin, kept):
            p = sweep.point[at]
            if sweep.body[at] >= _TOUCHES and scratch.marks[p] != mark:
                scratch.marks[p] = mark
                inside += float(table.weights[p])
        highest = inside
        for at in range(begin, kept):
            p = sweep.point[at]
            if scratch.marks[p] != mark:
                scratch.marks[p] = mark
                highest += float(table.weights[p])
    return inside, highest, kept


@inline_kernel
def _push(sweep: Any, top: Any, left: Any, right: Any, first: Any, count: Any, bodies: Any, sure: Any) -> Any:
    sweep.left[top] = left
    sweep.right[top] = right
    sweep.first[top] = first
    sweep.listed[top] = count
    sweep.open[top] = bodies
    sweep.sure[top] = sure
    return top + 1


@inline_kernel
def charged_between(chain: Any, shapes: Any, world: Any, scratch: Any, finest: Any, enough: Any) -> Any:
    """∫ price dt over the edge in `scratch.sweep`, whose `bend` is set.

    Args:
        chain, shapes, world, scratch: the arm, its bodies, the obstacles, this thread's memory.
        finest: a charge may be wrong by this much, by t, for each place where contact begins or ends.
        enough: the charge may stop once it is above this.
    """
    sweep = scratch.sweep
    table = world.fields.leaves
    prices = world.prices
    poses = scratch.poses
    radius = world.leaf_radius
    graded = prices.mode == GRADED
    if graded:
        finest = finest * _GRADED  # many small steps up and down, whose errors cancel
    charged = 0.0
    if world.fields.present[1] == 0:
        return charged
    top = _push(sweep, 0, 0.0, 1.0, 0, -1, -1, 0.0)
    while top > 0 and charged <= enough:
        top -= 1
        t0 = sweep.left[top]
        t1 = sweep.right[top]
        first = sweep.first[top]
        count = sweep.listed[top]
        mask = sweep.open[top]
        sure = sweep.sure[top]
        half = 0.5 * (t1 - t0)
        middle = t0 + half
        for k in range(sweep.along.shape[0]):
            scratch.q[k] = sweep.start[k] + middle * sweep.along[k]
        forward_kinematics(chain, scratch.q, poses)
        set_twists(chain, poses, sweep)
        if count < 0:
            open_ = 0
            widest = 0.0
            for b in range(1, shapes.spacing.shape[0]):
                if (mask >> b) & 1:
                    clear, reach = _is_clear(world, shapes, scratch, sweep, b, half)
                    if not clear:
                        open_ |= 1 << b
                        widest = max(widest, reach)
            if open_ == 0:
                continue
            end = -1
            if widest <= GATHER_M:
                end = 0
                for b in range(shapes.spacing.shape[0] - 1, 0, -1):
                    if (open_ >> b) & 1 and end >= 0:
                        end = _collect(world, shapes, scratch, sweep, b, half, end)
            if end == -2 or (end == -1 and 2.0 * half * prices.top <= finest):
                charged += _charge(sweep, t0, t1, prices.top)
                continue
            if end == -1:
                top = _push(sweep, top, middle, t1, 0, -1, open_, 0.0)
                top = _push(sweep, top, t0, middle, 0, -1, open_, 0.0)
                continue
            first = 0
            count = end
        # Sort the points: those that stay clear are dropped, those that stay in contact are charged, the others go on to both halves.
        begin = first + count
        end = begin
        room = sweep.body.shape[0] - count
        scratch.last_mark[0] += 1
        throughout = scratch.last_mark[0]
        settled = False
        for at in range(first, begin):
            b = sweep.body[at] & (_TOUCHES - 1)
            p = sweep.point[at]
            price = float(table.weights[p])
            if not graded and price <= sure:
                continue
            px = float(table.points[p, 0])
            py = float(table.points[p, 1])
            pz = float(table.points[p, 2])
            reach = _SLACK * half * _speed(sweep.twist, b, px, py, pz) + 0.5 * half * half * sweep.bend[b] + _SLACK_M
            gap = mesh_distance(shapes, b, poses[b], px, py, pz) - radius
            if gap > reach:
                continue
            if gap < -reach:
                if not graded:
                    sure = max(sure, price)
                    settled = is_settled(prices, sure)
                    if settled:
                        break
                elif scratch.marks[p] != throughout:
                    scratch.marks[p] = throughout
                    sure += price
                continue
            if end < room:
                sweep.body[end] = b + (_TOUCHES if gap < 0.0 else 0)
                sweep.point[end] = p
                end += 1
        inside, highest, end = _what_is_open(table, scratch, sweep, graded, begin, end, sure, throughout)
        if settled or end == begin:
            charged += _charge(sweep, t0, t1, body_price(prices, sure))
        elif 2.0 * half * body_price(prices, highest) <= finest or top + 2 > sweep.left.shape[0] or end >= room:
            charged += _charge(sweep, t0, t1, body_price(prices, sure + inside))
            sweep.doubt[0] += 2.0 * half * body_price(prices, max(inside, highest - inside))
        else:
            top = _push(sweep, top, middle, t1, begin, end - begin, 0, sure)
            top = _push(sweep, top, t0, middle, begin, end - begin, 0, sure)
    return charged
