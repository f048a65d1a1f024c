"""Which of an arm's spheres, and which leaf points, may touch each other within an interval of an edge.

Spheres are nested: a body's own around its coarse ones, each around some fine ones. An interval hands on to its halves the list of
those that were not clear of all leaves throughout, so that whatever is clear is looked at once. A sphere is opened when it is large
for its motion; until then halving the interval tells more.
"""

from __future__ import annotations

from typing import Any

from lime_planner.collision.distance_fields import lower_bound, sample
from lime_planner.collision.leaves.sweep import SLACK_M, reach_of_point, reach_of_sphere, time_within, turning_speed
from lime_planner.collision.point_contact import cells_near, mesh_distance, place, points_in_line
from lime_planner.core.jit import inline_kernel
from lime_planner.planning.prices import body_price, is_settled

GATHER_M = 0.01  #: points are collected as soon as no open sphere moves further than this in half an interval
_OPENED = 0.3  # a sphere is opened where no place in it moves further than this share of its radius
_DEEP_M = 0.006  # leaves that are less deep in a sphere are not looked at: what they touch is left soon
_PROBED = 2  # spheres in contact that are looked at for how long it lasts


@inline_kernel
def list_bodies(shapes: Any, sweep: Any) -> Any:
    """Begin with a list of the spheres of all bodies that move; its length."""
    count = 0
    for b in range(1, shapes.bound.shape[0]):
        if shapes.bound[b, 3] > 0.0:
            sweep.node[count] = b
            sweep.owner[count] = b
            count += 1
    return count


@inline_kernel
def _sphere(shapes: Any, node: Any) -> Any:
    """A sphere by its number (first the bodies' own, then the coarse ones, then the fine ones): centre in its joint's frame, radius."""
    bodies = shapes.bound.shape[0]
    inner = bodies + shapes.coarse.shape[0]
    if node >= inner:
        f = node - inner
        return shapes.fine[f, 0], shapes.fine[f, 1], shapes.fine[f, 2], shapes.fine[f, 3]
    if node >= bodies:
        c = node - bodies
        return shapes.coarse[c, 0], shapes.coarse[c, 1], shapes.coarse[c, 2], shapes.coarse[c, 3]
    return shapes.bound[node, 0], shapes.bound[node, 1], shapes.bound[node, 2], shapes.bound[node, 3]


@inline_kernel
def _inner(shapes: Any, node: Any) -> Any:
    """Numbers of the spheres inside another one: the first, and the one behind the last; equal for a fine one."""
    bodies = shapes.bound.shape[0]
    inner = bodies + shapes.coarse.shape[0]
    if node >= inner:
        return 0, 0
    if node >= bodies:
        return inner + shapes.fine_start[node - bodies], inner + shapes.fine_start[node - bodies + 1]
    return bodies + shapes.coarse_start[node], bodies + shapes.coarse_start[node + 1]


@inline_kernel
def open_spheres(world: Any, shapes: Any, scratch: Any, sweep: Any, first: Any, begin: Any, half: Any) -> Any:
    """Write those of a list's spheres, or the spheres inside them, that may touch a leaf within half an interval behind the list.

    Returns:
        End of the new list, which begins at `begin`; how far the farthest of its spheres gets.
    """
    fields = world.fields
    h = fields.spacing_m
    room = sweep.node.shape[0]
    at = begin
    widest = 0.0
    last = -1
    turning = 0.0
    for item in range(first, begin):
        sweep.todo[0] = sweep.node[item]
        b = sweep.owner[item]
        if b != last:
            turning = turning_speed(sweep.twist, b)
            last = b
        pose = scratch.poses[b]
        top = 1
        while top > 0:
            top -= 1
            node = sweep.todo[top]
            sphere = _sphere(shapes, node)
            x, y, z = place(pose, sphere)
            _, leaf = sample(fields, x, y, z)
            reach = reach_of_sphere(sweep, b, turning, half, x, y, z, sphere[3])
            if lower_bound(leaf, h) - sphere[3] - world.leaf_radius > reach:
                continue
            low, high = _inner(shapes, node)
            # Where there is no room for what is inside, the outer sphere stands for it.
            opens = reach <= max(GATHER_M, _OPENED * sphere[3]) and at + top + high - low < room // 2
            if low < high and opens and top + high - low <= sweep.todo.shape[0]:
                for inner in range(low, high):
                    sweep.todo[top] = inner
                    top += 1
                continue
            if at < room:
                sweep.node[at] = node
                sweep.owner[at] = b
                at += 1
            widest = max(widest, reach)
    return at, widest


@inline_kernel
def certain_contact(world: Any, shapes: Any, scratch: Any, sweep: Any, half: Any) -> Any:
    """How long contact at the poses given lasts for certain on either side, up to `half` and by t, and what each side costs at least.

    Only the first spheres that are found in contact are looked at: what is returned is a bound.
    """
    fields = world.fields
    table = fields.leaves
    radius = world.leaf_radius
    length, charge = 0.0, 0.0
    probed = 0
    most = half * body_price(world.prices, world.prices.top)
    for outer in range(shapes.bound.shape[0] - 1, 0, -1):
        b = outer
        if shapes.bound[b, 3] <= 0.0:
            continue
        sweep.todo[0] = b
        pose = scratch.poses[b]
        top = 1
        while top > 0:
            top -= 1
            node = sweep.todo[top]
            sphere = _sphere(shapes, node)
            x, y, z = place(pose, sphere)
            _, leaf = sample(fields, x, y, z)
            if leaf > sphere[3] + radius - _DEEP_M:
                continue
            begin, end = _inner(shapes, node)
            if begin < end:
                if top + end - begin <= sweep.todo.shape[0]:
                    for inner in range(begin, end):
                        sweep.todo[top] = inner
                        top += 1
                continue
            touched = False
            reach = sphere[3] + radius
            low0, high0, low1, high1, low2, high2 = cells_near(table, x, y, z, reach)
            for i in range(low0, high0 + 1):
                for j in range(low1, high1 + 1):
                    p_begin, p_end = points_in_line(table, i, j, low2, high2)
                    for p in range(p_begin, p_end):
                        px = float(table.points[p, 0])
                        py = float(table.points[p, 1])
                        pz = float(table.points[p, 2])
                        if (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2 > reach * reach:
                            continue
                        depth = radius - mesh_distance(shapes, b, pose, px, py, pz) - SLACK_M
                        if depth > 0.0:
                            touched = True
                            lasts = min(half, time_within(sweep, b, depth, px, py, pz))
                            costs = lasts * body_price(world.prices, float(table.weights[p]))
                            if costs > charge:
                                length, charge = lasts, costs
            if touched:
                probed += 1
                if probed >= _PROBED or charge >= most:
                    return length, charge
    return length, charge


@inline_kernel
def collect_points(world: Any, shapes: Any, scratch: Any, sweep: Any, first: Any, end: Any, half: Any) -> Any:
    """Write a list of the leaf points that the spheres of a list may touch within half an interval.

    Returns:
        Its length; -1 where there is no room; -2 where a point is touched throughout and none could cost more (binary).
    """
    fields = world.fields
    table = fields.leaves
    radius = world.leaf_radius
    at = 0
    last = -1
    mark = 0
    turning = 0.0
    for item in range(first, end):
        b = sweep.owner[item]
        pose = scratch.poses[b]
        if b != last:
            turning = turning_speed(sweep.twist, b)
            scratch.last_mark[0] += 1
            mark = scratch.last_mark[0]
            last = b
        sphere = _sphere(shapes, sweep.node[item])
        x, y, z = place(pose, sphere)
        reach = sphere[3] + radius + reach_of_sphere(sweep, b, turning, half, x, y, z, sphere[3])
        low0, high0, low1, high1, low2, high2 = cells_near(table, x, y, z, reach)
        for i in range(low0, high0 + 1):
            for j in range(low1, high1 + 1):
                p_begin, p_end = points_in_line(table, i, j, low2, high2)
                for p in range(p_begin, p_end):
                    if scratch.marks[p] == mark:
                        continue
                    px = float(table.points[p, 0])
                    py = float(table.points[p, 1])
                    pz = float(table.points[p, 2])
                    if (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2 > reach * reach:
                        continue
                    scratch.marks[p] = mark
                    gap = mesh_distance(shapes, b, pose, px, py, pz) - radius
                    moves = reach_of_point(sweep, b, half, px, py, pz)
                    if gap > moves:
                        continue
                    if gap < -moves and is_settled(world.prices, float(table.weights[p])):
                        return -2
                    if at >= sweep.body.shape[0]:
                        return -1
                    sweep.body[at] = b
                    sweep.point[at] = p
                    at += 1
    return at
