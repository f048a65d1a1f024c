"""What leaves cost along a straight edge: where contact begins and ends, by bisection with certificates instead of samples.

An interval of the edge is free when no body can reach a leaf point between its ends, and in contact when some point cannot get out of
a body; everything else is halved. Far from leaves bodies are cleared by their spheres in the distance field (`spheres`). Closer,
the points that could be touched are collected once, and from there on only these are looked at: a step costs the arm's kinematics and a
few look-ups.

An edge that costs more than is wanted ends early: first a few configurations are looked at, far apart and then closer (a rake), and
where one is in contact it is so for as long as it takes to get out. That alone refuses most edges.

An interval that is so short that it hardly matters costs the most that it can (graded: what its middle costs), and its possible error
is added up.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.collision.leaves.spheres import GATHER_M, certain_contact, collect_points, list_bodies, open_spheres
from lime_planner.collision.leaves.sweep import reach_of_point, set_twists
from lime_planner.collision.point_contact import mesh_distance
from lime_planner.core.jit import inline_kernel
from lime_planner.planning.prices import GRADED, body_price, is_settled
from lime_planner.robot.kinematics import forward_kinematics

_TOUCHES = 64  # added to the number of a body in a list: the point touches it in the middle of the interval
_GRADED = 8.0
_APART_RAD = 0.25  # between the places of the rake, roughly
_ROUNDING = 1e-9  # of sums of what intervals cost at least, by t


@inline_kernel
def _charge(sweep: Any, left: Any, right: Any, price: Any) -> Any:
    """What an interval of one price costs, by t; it is kept among the spans where these are wanted, joined to the one before."""
    used = sweep.used[0]
    if used >= 0 and price > 0.0:
        last = used - 1
        if last >= 0 and sweep.spans[last, 1] == left and sweep.spans[last, 2] == price:
            sweep.spans[last, 1] = right
        elif used < sweep.spans.shape[0]:
            sweep.spans[used, 0] = left
            sweep.spans[used, 1] = right
            sweep.spans[used, 2] = price
            sweep.used[0] = used + 1
        else:  # no room: the last one costs more
            sweep.spans[last, 2] += price * (right - left) / (sweep.spans[last, 1] - sweep.spans[last, 0])
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
def _move_to(chain: Any, scratch: Any, sweep: Any, t: Any) -> Any:
    """Poses and velocities of all bodies at t."""
    for k in range(sweep.along.shape[0]):
        scratch.q[k] = sweep.start[k] + t * sweep.along[k]
    forward_kinematics(chain, scratch.q, scratch.poses)
    set_twists(chain, scratch.poses, sweep)


@inline_kernel
def _push(sweep: Any, top: Any, left: Any, right: Any, first: Any, count: Any, close: Any, sure: Any) -> Any:
    sweep.left[top] = left
    sweep.right[top] = right
    sweep.first[top] = first
    sweep.listed[top] = count
    sweep.close[top] = close
    sweep.sure[top] = sure
    return top + 1


@inline_kernel
def _rake(chain: Any, shapes: Any, world: Any, scratch: Any, looks: Any, enough: Any) -> Any:
    """Look for contact at `looks` places (one less than a power of two), the middle first, and note what is certain of it.

    Returns:
        Number of contacts, which are in `sweep.contact` from right to left; their sum, which ends the work where it is above `enough`.
    """
    sweep = scratch.sweep
    half = 0.5 / (looks + 1)
    total = 0.0
    found = 0
    step = 1.0
    while step > 2.0 * half:
        t = 1.0 - 0.5 * step
        while t > 0.0:
            _move_to(chain, scratch, sweep, t)
            length, charge = certain_contact(world, shapes, scratch, sweep, half)
            if charge > 0.0:
                total += 2.0 * charge
                if total > enough:
                    return found, total
                at = found
                found += 1
                while at > 0 and sweep.contact[at - 1, 0] < t - length:
                    sweep.contact[at, 0] = sweep.contact[at - 1, 0]
                    sweep.contact[at, 1] = sweep.contact[at - 1, 1]
                    at -= 1
                sweep.contact[at, 0] = t - length
                sweep.contact[at, 1] = 2.0 * charge
            t -= step
        step *= 0.5
    return found, total


@inline_kernel
def _sort_points(shapes: Any, world: Any, scratch: Any, sweep: Any, first: Any, begin: Any, half: Any, sure: Any) -> Any:
    """Look at a list of points, up to `begin`, in the middle of an interval: what stays clear is dropped, what stays in contact charged.

    Returns:
        End of the list of the others, which is written behind it; what the interval costs throughout (`sure` and more); the mark of
        the points that it counts (graded); whether nothing could cost more (binary).
    """
    prices = world.prices
    table = world.fields.leaves
    graded = prices.mode == GRADED
    end = begin
    room = sweep.body.shape[0]
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
        reach = reach_of_point(sweep, b, half, px, py, pz)
        gap = mesh_distance(shapes, b, scratch.poses[b], px, py, pz) - world.leaf_radius
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
    return end, sure, throughout, settled


@inline_kernel
def charged_between(chain: Any, shapes: Any, world: Any, scratch: Any, finest: Any, enough: Any) -> Any:
    """∫ price dt over the edge in `scratch.sweep`, whose `bend` is set.

    Args:
        chain, shapes, world, scratch: the arm, its bodies, the obstacles, this thread's memory.
        finest: a charge may be wrong by this much, by t, for each place where contact begins or ends.
        enough: the charge may stop once it is certain to be above this; what is returned then is above this, and a lower bound.
    """
    sweep = scratch.sweep
    prices = world.prices
    if world.fields.present[1] == 0:
        return 0.0
    graded = prices.mode == GRADED
    contacts = 0
    ahead = 0.0
    if enough < np.inf:
        length = 0.0
        for k in range(sweep.along.shape[0]):
            length += sweep.along[k] * sweep.along[k]
        looks = 1
        while looks < sweep.contact.shape[0] and looks * looks * _APART_RAD * _APART_RAD < length:
            looks = 2 * looks + 1
        contacts, ahead = _rake(chain, shapes, world, scratch, looks, enough)
        if ahead > enough:
            return ahead
    if graded:
        finest = finest * _GRADED
    charged = 0.0
    top = _push(sweep, 0, 0.0, 1.0, 0, list_bodies(shapes, sweep), 0, 0.0)
    while top > 0:
        top -= 1
        t0 = sweep.left[top]
        t1 = sweep.right[top]
        while contacts > 0 and sweep.contact[contacts - 1, 0] < t0:
            contacts -= 1
            ahead -= sweep.contact[contacts, 1]
        if charged > enough or charged + ahead - _ROUNDING > enough:
            return charged + max(0.0, ahead - _ROUNDING)
        half = 0.5 * (t1 - t0)
        middle = t0 + half
        first = sweep.first[top]
        begin = first + sweep.listed[top]
        close = sweep.close[top]
        sure = sweep.sure[top]
        _move_to(chain, scratch, sweep, middle)
        if close == 0:
            end, widest = open_spheres(world, shapes, scratch, sweep, first, begin, half)
            if end == begin:
                continue
            points = -1
            if widest <= GATHER_M:
                points = collect_points(world, shapes, scratch, sweep, begin, end, half)
            no_room = top + 2 > sweep.left.shape[0] or end >= sweep.node.shape[0]
            if points == -2 or (points == -1 and 2.0 * half * prices.top <= finest) or no_room:
                charged += _charge(sweep, t0, t1, prices.top)
                continue
            if points == -1:
                top = _push(sweep, top, middle, t1, begin, end - begin, 0, 0.0)
                top = _push(sweep, top, t0, middle, begin, end - begin, 0, 0.0)
                continue
            first = 0
            begin = points
        end, sure, throughout, settled = _sort_points(shapes, world, scratch, sweep, first, begin, half, sure)
        no_room = end >= sweep.body.shape[0]
        inside, highest, end = _what_is_open(world.fields.leaves, scratch, sweep, graded, begin, end, sure, throughout)
        if settled or end == begin:
            charged += _charge(sweep, t0, t1, body_price(prices, sure))
        elif 2.0 * half * body_price(prices, highest) <= finest or top + 2 > sweep.left.shape[0] or no_room:
            # Graded, there are many small steps up and down, whose errors cancel. Else the most that it can be: a search finds gaps.
            most = inside if graded else highest
            charged += _charge(sweep, t0, t1, body_price(prices, sure + most))
            sweep.doubt[0] += 2.0 * half * body_price(prices, max(most, highest - most))
        else:
            top = _push(sweep, top, middle, t1, begin, end - begin, 1, sure)
            top = _push(sweep, top, t0, middle, begin, end - begin, 1, sure)
    return charged
