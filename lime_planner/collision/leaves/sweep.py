"""Memory for what leaves cost along one straight edge, and how fast bodies move along it.

How far a body moves in half an interval follows from its velocity in the middle and a bound on its acceleration: the velocity is that
of the place that could touch (the joints' motions added as vectors), so that the bound is close to the truth.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import inline_kernel
from lime_planner.core.types import Array, Int32, Int64

FINEST_RAD = 5e-5  #: an interval that could cost no more than so much contact with a leaf of price 1 is not halved any more
SLACK, SLACK_M = 1.05, 2e-5  #: distances interpolated in a grid change a little faster than the place moves
_POINTS = 1 << 16
_SPHERES = 1 << 16
_CELLS_AHEAD = 1 << 12
_DEPTH = 64
_LOOKS = 31
_SPANS = 1 << 13


class Sweep(NamedTuple):
    """Memory of one thread for one edge a + t · along, t from 0 to 1.

    Attributes:
        start, along: (n,) where the edge begins, and its difference.
        bend: (B,) bound on the second derivative of any of a body's places by t [m].
        twist: (B, 6) angular velocity and velocity at the planning frame's origin of each body in the middle of an interval, by t.
        left, right: (D,) open intervals; first, listed: (D,) int64 their lists, of spheres or, where `close` is 1, of points.
        sure: (D,) price that an interval costs at least.
        node, owner: (S,) int32 spheres that may touch, and their bodies (`spheres`); lists of the intervals one after another.
        todo: (T,) int32 spheres still to be looked at.
        body, point: (K,) int32 the points that may be touched, with the body concerned; lists in the same way.
        contact: (L, 2) where contact that is certain begins, from right to left, by t, and what it costs.
        doubt: (1,) sum of what charges may be wrong by, by t.
        spans: (S, 3) where contact begins and ends, and its price, for figures; used: (1,) int64 how many there are, -1 to keep none.
    """

    start: Array
    along: Array
    bend: Array
    twist: Array
    left: Array
    right: Array
    first: Int64
    listed: Int64
    close: Int64
    sure: Array
    node: Int32
    owner: Int32
    todo: Int32
    body: Int32
    point: Int32
    contact: Array
    doubt: Array
    spans: Array
    used: Int64


def make_sweep(n: int) -> Sweep:
    """Allocate one thread's memory for an arm of n joints."""
    return Sweep(
        start=np.zeros(n),
        along=np.zeros(n),
        bend=np.zeros(n + 1),
        twist=np.zeros((n + 1, 6)),
        left=np.zeros(_DEPTH),
        right=np.zeros(_DEPTH),
        first=np.zeros(_DEPTH, np.int64),
        listed=np.zeros(_DEPTH, np.int64),
        close=np.zeros(_DEPTH, np.int64),
        sure=np.zeros(_DEPTH),
        node=np.zeros(_SPHERES, np.int32),
        owner=np.zeros(_SPHERES, np.int32),
        todo=np.zeros(_CELLS_AHEAD, np.int32),
        body=np.zeros(_POINTS, np.int32),
        point=np.zeros(_POINTS, np.int32),
        contact=np.zeros((_LOOKS, 2)),
        doubt=np.zeros(1),
        spans=np.zeros((_SPANS, 3)),
        used=np.full(1, -1, np.int64),
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
def speed_at(twist: Any, b: Any, x: Any, y: Any, z: Any) -> Any:
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
    return speed_at(twist, b, x, y, z) + turning * radius


@inline_kernel
def reach_of_sphere(sweep: Any, b: Any, turning: Any, half: Any, x: Any, y: Any, z: Any, radius: Any) -> Any:
    """How far any place of a sphere of body b gets within half an interval."""
    return SLACK * half * sphere_speed(sweep.twist, b, turning, x, y, z, radius) + 0.5 * half * half * sweep.bend[b] + SLACK_M


@inline_kernel
def reach_of_point(sweep: Any, b: Any, half: Any, x: Any, y: Any, z: Any) -> Any:
    """How far the place of body b that is at (x, y, z) gets within half an interval."""
    return SLACK * half * speed_at(sweep.twist, b, x, y, z) + 0.5 * half * half * sweep.bend[b] + SLACK_M


@inline_kernel
def time_within(sweep: Any, b: Any, gap: Any, x: Any, y: Any, z: Any) -> Any:
    """For how long, on either side of the middle and by t, the place of body b at (x, y, z) is within `gap` of where it is there."""
    speed = SLACK * speed_at(sweep.twist, b, x, y, z)
    root = math.sqrt(speed * speed + 2.0 * sweep.bend[b] * gap)
    return 2.0 * gap / (speed + root) if root > 0.0 else 1.0
