"""The plane with polygonal obstacles as a space: every question answered exactly, nothing sampled.

Obstacles are open polygons: a point on an outline is outside, so that shortest paths, which touch corners, exist. A configuration
costs the highest price of the permeable polygons that it lies in, 1 for each unless the world says otherwise; overlapping ones are
charged once.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from lime_planner.core.c_structures import reader, vector
from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array, Int64, UInt8
from lime_planner.planning.prices import stretch_cost
from lime_planner.planning.space import N_EDGE_STATES, N_EDGES, N_STATES, SpaceFunctions, SpaceHandle, make_handle, space_functions

PERMEABLE, IMPERMEABLE = 0, 1
_TOUCH = 1e-9  # a point this close to an outline lies on it [map units]


class PlaneSpace(NamedTuple):
    """Data of a planar world for compiled planners; made by `PlaneWorld.space()`, one for each thread.

    Attributes:
        lower: smallest x and y of the map, (2,) [map units].
        upper: largest x and y of the map, (2,).
        counters: see `lime_planner.planning.space`, int64 (8,).
        vertices: corners of all polygons one after another, (V, 2).
        offsets: polygon i has the corners offsets[i] to offsets[i + 1] - 1, int64 (P + 1,).
        kinds: PERMEABLE or IMPERMEABLE for each polygon, uint8 (P,).
        prices: price of each polygon, (P,); 0 for impermeable ones.
        boxes: smallest x, smallest y, largest x, largest y for each polygon, (P, 4).
        scratch: working memory of the edge function, (2 V + 4,).
    """

    lower: Array
    upper: Array
    counters: Int64
    vertices: Array
    offsets: Int64
    kinds: UInt8
    prices: Array
    boxes: Array
    scratch: Array

    def handle(self) -> SpaceHandle:
        """The space as planners take it."""
        return make_handle(self, _functions(), _type())


@hot_kernel
def _inside(vertices: Any, first: int, last: int, x: float, y: float) -> bool:
    """Tell whether (x, y) lies strictly inside the polygon with the corners first to last - 1 (crossing number)."""
    inside = False
    x0, y0 = vertices[last - 1, 0], vertices[last - 1, 1]
    for i in range(first, last):
        x1, y1 = vertices[i, 0], vertices[i, 1]
        dx, dy = x1 - x0, y1 - y0
        side = dx * (y - y0) - dy * (x - x0)
        squared = dx * dx + dy * dy
        if side * side <= _TOUCH * _TOUCH * squared:
            along = dx * (x - x0) + dy * (y - y0)
            if -_TOUCH <= along <= squared + _TOUCH:
                return False
        if (y0 > y) != (y1 > y) and (side > 0.0) == (dy > 0.0):
            inside = not inside
        x0, y0 = x1, y1
    return inside


def is_inside(corners: npt.ArrayLike, point: npt.ArrayLike) -> bool:
    """Tell whether a point (2,) lies strictly inside a polygon (V, 2), by the very rule of the planners [map units]."""
    x, y = np.asarray(point, dtype=np.float64)
    vertices = np.ascontiguousarray(corners, dtype=np.float64)
    return bool(_inside(vertices, 0, len(vertices), x, y))


@hot_kernel
def inside_kind(space: Any, kind: int, x: float, y: float) -> bool:
    """Tell whether (x, y) lies strictly inside any polygon of one kind."""
    for p in range(space.kinds.shape[0]):
        box = space.boxes[p]
        if space.kinds[p] != kind or not (box[0] < x < box[2] and box[1] < y < box[3]):
            continue
        if _inside(space.vertices, space.offsets[p], space.offsets[p + 1], x, y):
            return True
    return False


@hot_kernel
def _price(space: Any, x: float, y: float) -> Any:
    """Highest price of the permeable polygons that (x, y) lies strictly inside; 0 outside of all."""
    price = 0.0
    for p in range(space.kinds.shape[0]):
        box = space.boxes[p]
        if space.prices[p] <= price or not (box[0] < x < box[2] and box[1] < y < box[3]):
            continue
        if _inside(space.vertices, space.offsets[p], space.offsets[p + 1], x, y):
            price = space.prices[p]
    return price


@hot_kernel
def _cuts(space: Any, a: Any, b: Any) -> int:
    """Write the fractions of a → b at which it meets an outline to `space.scratch`, sorted, with 0 and 1, and return their number."""
    ax, ay = a[0], a[1]
    dx, dy = b[0] - ax, b[1] - ay
    squared = dx * dx + dy * dy
    low_x, high_x = min(ax, b[0]), max(ax, b[0])
    low_y, high_y = min(ay, b[1]), max(ay, b[1])
    # A cut too many is harmless (each piece is tested by itself), one too few is not: touching counts, within rounding.
    touch = 1e-12 * (squared + np.sqrt(squared))
    cuts = space.scratch
    cuts[0] = 0.0
    count = 1
    for p in range(space.kinds.shape[0]):
        box = space.boxes[p]
        if box[0] > high_x or box[2] < low_x or box[1] > high_y or box[3] < low_y:
            continue
        first, last = space.offsets[p], space.offsets[p + 1]
        x0, y0 = space.vertices[last - 1, 0] - ax, space.vertices[last - 1, 1] - ay
        side0 = dx * y0 - dy * x0
        for i in range(first, last):
            x1, y1 = space.vertices[i, 0] - ax, space.vertices[i, 1] - ay
            side1 = dx * y1 - dy * x1
            if min(side0, side1) <= touch and max(side0, side1) >= -touch:
                t0 = (dx * x0 + dy * y0) / squared
                t1 = (dx * x1 + dy * y1) / squared
                along = abs(side0) <= touch and abs(side1) <= touch
                t = t1 if along else t0 + (t1 - t0) * side0 / (side0 - side1)
                if 0.0 < t < 1.0:
                    position = count  # insertion sort: a handful of cuts
                    while cuts[position - 1] > t:
                        cuts[position] = cuts[position - 1]
                        position -= 1
                    cuts[position] = t
                    count += 1
            x0, y0, side0 = x1, y1, side1
    cuts[count] = 1.0
    return count + 1


@hot_kernel
def _plane_evaluate(space: Any, q: Any) -> Any:
    space.counters[N_STATES] += 1
    x, y = q[0], q[1]
    # Written so that NaN is outside of the map.
    if not (space.lower[0] <= x <= space.upper[0] and space.lower[1] <= y <= space.upper[1]):
        return -1.0
    if inside_kind(space, IMPERMEABLE, x, y):
        return -1.0
    return _price(space, x, y)


@hot_kernel
def _plane_edge(space: Any, a: Any, b: Any, weight: Any, bound: Any) -> Any:
    space.counters[N_EDGES] += 1
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = np.sqrt(dx * dx + dy * dy)
    if length == 0.0 or length > bound:
        return length
    count = _cuts(space, a, b)
    space.counters[N_EDGE_STATES] += count - 1
    leaf = 0.0
    for i in range(1, count):
        t0, t1 = space.scratch[i - 1], space.scratch[i]
        if t1 > t0:
            t = 0.5 * (t0 + t1)
            x, y = a[0] + t * dx, a[1] + t * dy
            if inside_kind(space, IMPERMEABLE, x, y):
                return np.inf
            leaf += _price(space, x, y) * (t1 - t0)
    return stretch_cost(length, weight * length, leaf) if leaf > 0.0 else length


@hot_kernel
def _nearest_boundary(space: Any, kind: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the distance to the nearest outline of one kind and that outline's nearest point."""
    best, best_x, best_y = np.inf, x, y
    for p in range(space.kinds.shape[0]):
        if space.kinds[p] != kind:
            continue
        box = space.boxes[p]
        gap_x = max(box[0] - x, 0.0, x - box[2])
        gap_y = max(box[1] - y, 0.0, y - box[3])
        if gap_x * gap_x + gap_y * gap_y >= best:
            continue
        first, last = space.offsets[p], space.offsets[p + 1]
        x0, y0 = space.vertices[last - 1, 0], space.vertices[last - 1, 1]
        for i in range(first, last):
            x1, y1 = space.vertices[i, 0], space.vertices[i, 1]
            dx, dy = x1 - x0, y1 - y0
            squared = dx * dx + dy * dy
            t = ((x - x0) * dx + (y - y0) * dy) / squared if squared > 0.0 else 0.0
            t = min(max(t, 0.0), 1.0)
            nx, ny = x0 + t * dx, y0 + t * dy
            gap = (x - nx) ** 2 + (y - ny) ** 2
            if gap < best:
                best, best_x, best_y = gap, nx, ny
            x0, y0 = x1, y1
    return np.sqrt(best), best_x, best_y


@hot_kernel
def _plane_repulsion(space: Any, q: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
    smallest = np.inf
    for kind in range(2):
        if inside_kind(space, kind, q[0], q[1]):
            smallest = 0.0
            continue
        d, x, y = _nearest_boundary(space, kind, q[0], q[1])
        smallest = min(smallest, d)
        if 0.0 < d <= d_star:
            gain = k_leaf if kind == PERMEABLE else k_stem
            push = gain * (1.0 / d - 1.0 / d_star) / (d * d * d)  # -dU_rep/dd along the unit vector away from the outline
            force[0] += push * (q[0] - x)
            force[1] += push * (q[1] - y)
    return smallest


@functools.cache
def _type() -> Any:
    whole, real, rows = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2))
    return numba.typeof(PlaneSpace(real, real, whole, rows, whole, np.zeros(0, np.uint8), real, rows, real))


_read = reader(_type)


def _evaluate_at(structure: Any, q: Any, n: Any) -> Any:
    return _plane_evaluate(_read(structure), vector(q, n))


def _edge_at(structure: Any, a: Any, b: Any, n: Any, weight: Any, bound: Any) -> Any:
    return _plane_edge(_read(structure), vector(a, n), vector(b, n), weight, bound)


def _repulsion_at(structure: Any, q: Any, n: Any, d_star: Any, k_leaf: Any, k_stem: Any, force: Any) -> Any:
    return _plane_repulsion(_read(structure), vector(q, n), d_star, k_leaf, k_stem, vector(force, n))


@functools.cache
def _functions() -> SpaceFunctions:
    return space_functions(_evaluate_at, _edge_at, _repulsion_at)
