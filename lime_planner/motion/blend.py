"""A smooth path beside a polyline: straight segments, and at every corner a short quintic that stays within a stated tolerance.

Only the polyline's neighbourhood has been found free of stems, so the bound on the deviation holds by construction:

- The corner of two segments with directions u and w (unit vectors, turning angle θ) is replaced, from d before it to d after it,
  by the quintic Bézier curve with control points P - d u, P - 0.6 d u, P - 0.2 d u, P + 0.2 d w, P + 0.6 d w, P + d w. Value, first
  and second derivative join the straight parts (the path is C2), and where θ = 0 the curve is the straight line itself, evenly run.
- Its point closest to the corner is the middle, at 6/32 d |w - u| = 0.375 d sin(θ/2) from P. A point of the curve is P - A u + B w
  with A falling and B growing from 0, both 6/32 d in the middle, so its distance to the polyline, at most min(A, B) sin(θ), is never more.
- d is chosen so that 0.375 d sin(θ/2) is at most the tolerance, and d is at most half of either segment. The curve therefore also
  passes within the tolerance of every waypoint kept. At a reversal (θ = π) it runs into the tip and back on the polyline, standing
  still at its turning point.

Waypoints that a straight line replaces within half the tolerance are left out first (Douglas and Peucker 1973); the corners then
have what is left of it. Hundreds of tiny segments would otherwise leave no room for a curve and slow the arm at every one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lime_planner.core.types import Array, Int64

_MIDDLE = 0.375  # distance of the curve's middle from the corner, in units of d sin(θ/2)
# Bézier control points to polynomial coefficients, lowest power first (binomial expansion of degree 5).
_TO_POWERS = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [-5, 5, 0, 0, 0, 0],
        [10, -20, 10, 0, 0, 0],
        [-10, 30, -30, 10, 0, 0],
        [5, -20, 30, -20, 5, 0],
        [-1, 5, -10, 10, -5, 1],
    ],
    dtype=np.float64,
)


def thin(waypoints: Array, tolerance: float) -> tuple[Int64, float]:
    """Choose the waypoints of a polyline that stays within `tolerance` of the given one, and the given one of it.

    Distances are to the chord, ends included: a run to and fro beyond the tolerance is kept, even on one line.

    Args:
        waypoints: (M, n), M >= 1 [rad].
        tolerance: [rad], >= 0.

    Returns:
        The indices kept, ascending, first and last included, and the largest deviation [rad].
    """
    last = len(waypoints) - 1
    keep = np.zeros(last + 1, dtype=bool)
    keep[[0, last]] = True
    worst = 0.0
    stack = [(0, last)]
    while stack:
        first, end = stack.pop()
        if end - first < 2:
            continue
        offset = waypoints[first + 1 : end] - waypoints[first]
        chord = waypoints[end] - waypoints[first]
        square = float(chord @ chord)
        along = np.clip(offset @ chord / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(offset))
        distance = np.linalg.norm(offset - along[:, None] * chord, axis=1)
        furthest = int(np.argmax(distance))
        if distance[furthest] > tolerance:
            split = first + 1 + furthest
            keep[split] = True
            stack += [(first, split), (split, end)]
        else:
            worst = max(worst, float(distance[furthest]))
    return np.flatnonzero(keep), worst


class BlendedPath:
    """The smooth path, with its first two derivatives by the path's coordinate; the geometric path that toppra times.

    The coordinate p runs from 0 to the length of the polyline in joint space [rad], and on the straight parts is that length. Inside
    a corner it still runs by 2 d, as the polyline's does, while the curve is a little shorter: |dq/dp| <= 1.

    Attributes:
        knots: coordinates where the pieces begin, and the end, (S + 1,).
        is_corner: which pieces are corners, (S,).
        dof: number of joints; part of the interface that toppra asks for.
    """

    def __init__(self, waypoints: Array, tolerance: float | Array) -> None:
        """Lay the pieces.

        Args:
            waypoints: (M, n), M >= 2, no two neighbours equal [rad].
            tolerance: largest distance between the curve and its corner [rad], > 0; one number, or one for each waypoint (M,).
        """
        steps = np.diff(waypoints, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        directions = steps / lengths[:, None]
        # |w - u| = 2 sin(θ/2), without the loss of digits of an arc cosine
        half_sines = 0.5 * np.linalg.norm(np.diff(directions, axis=0), axis=1)
        with np.errstate(divide="ignore"):
            at_corners = np.broadcast_to(tolerance, len(waypoints))[1:-1]
            reach = np.minimum(at_corners / (_MIDDLE * half_sines), 0.5 * np.minimum(lengths[:-1], lengths[1:]))
        reach[half_sines < 1e-12] = 0.0
        corners = np.concatenate([[0.0], reach, [0.0]])
        at = np.concatenate([[0.0], np.cumsum(lengths)])
        starts: list[float] = []
        spans: list[float] = []
        pieces: list[Array] = []
        is_corner: list[bool] = []
        for i in range(len(lengths)):
            u, d = directions[i], corners[i + 1]
            straight = lengths[i] - corners[i] - d
            if straight > 1e-12 * lengths[i]:
                coefficients = np.zeros((6, waypoints.shape[1]))
                coefficients[0] = waypoints[i] + corners[i] * u
                coefficients[1] = u
                starts.append(float(at[i] + corners[i]))
                spans.append(1.0)
                pieces.append(coefficients)
                is_corner.append(False)
            if d > 0.0:
                w, P = directions[i + 1], waypoints[i + 1]
                controls = np.stack([P - d * u, P - 0.6 * d * u, P - 0.2 * d * u, P + 0.2 * d * w, P + 0.6 * d * w, P + d * w])
                starts.append(float(at[i + 1] - d))
                spans.append(2.0 * float(d))
                pieces.append(_TO_POWERS @ controls)
                is_corner.append(True)
        self.knots = np.array([*starts, at[-1]])
        self.is_corner = np.array(is_corner)
        self.dof = int(waypoints.shape[1])
        self._spans = np.array(spans)
        self._pieces = np.stack(pieces)
        self._end = waypoints[-1]

    @property
    def length(self) -> float:
        """The last coordinate: the polyline's length [rad]."""
        return float(self.knots[-1])

    @property
    def path_interval(self) -> Array:
        """First and last coordinate, (2,); part of the interface that toppra asks for."""
        return np.array([0.0, self.length])

    def __call__(self, p: npt.ArrayLike, order: int = 0) -> Array:
        """Evaluate the path at the coordinates p [rad], (R,), or its first or second derivative: (R, n); (n,) for a scalar."""
        coordinates = np.asarray(p, dtype=np.float64)
        flat = coordinates.reshape(-1)
        piece = np.clip(np.searchsorted(self.knots, flat, side="right") - 1, 0, len(self._spans) - 1)
        span = self._spans[piece][:, None]
        x = (flat - self.knots[piece])[:, None] / span
        c = self._pieces[piece]
        if order == 0:
            value = c[:, 0] + x * (c[:, 1] + x * (c[:, 2] + x * (c[:, 3] + x * (c[:, 4] + x * c[:, 5]))))
        elif order == 1:
            value = (c[:, 1] + x * (2 * c[:, 2] + x * (3 * c[:, 3] + x * (4 * c[:, 4] + x * 5 * c[:, 5])))) / span
        else:
            value = (2 * c[:, 2] + x * (6 * c[:, 3] + x * (12 * c[:, 4] + x * 20 * c[:, 5]))) / span**2
        return np.asarray(value.reshape(*coordinates.shape, self.dof), dtype=np.float64)
