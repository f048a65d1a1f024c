"""Where along a path the arm touches leaves, and what that costs: the integral that searches minimise, looked at more finely."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lime_planner.collision.edge_cost import arm_charge
from lime_planner.collision.joint_space import ArmSpace
from lime_planner.core.types import Array, Bool
from lime_planner.pipeline.obstacles import Obstacles

_FINEST_RAD = 2e-5  # less than half of what searches settle for (`lime_planner.collision.leaves.sweep.FINEST_RAD`)


@dataclass(frozen=True, eq=False)
class LeafSpans:
    """Contact along a path.

    Attributes:
        spans: (S, 3) where contact begins and ends, as lengths along the path [rad], and the price there [-]; in order, not overlapping.
        doubt_rad: by how much `charged_rad` may be wrong at most [rad].
    """

    spans: Array
    doubt_rad: float

    @property
    def contact_rad(self) -> float:
        """Length of the path in contact [rad]."""
        return float((self.spans[:, 1] - self.spans[:, 0]).sum())

    @property
    def charged_rad(self) -> float:
        """∫ price ds over the path [rad]."""
        return float(((self.spans[:, 1] - self.spans[:, 0]) * self.spans[:, 2]).sum())

    def price_at(self, lengths: npt.ArrayLike) -> Array:
        """Return the price at some lengths along the path (K,) [rad], 0 out of contact."""
        at = np.asarray(lengths, dtype=np.float64)
        if not len(self.spans):
            return np.zeros(at.shape)
        before = np.clip(np.searchsorted(self.spans[:, 0], at, side="right") - 1, 0, None)
        begin, end, price = self.spans[before].T
        return np.asarray(np.where((begin <= at) & (at <= end), price, 0.0))

    def charged_until(self, lengths: npt.ArrayLike) -> Array:
        """Return ∫ price ds from the path's begin to some lengths along it (K,) [rad]."""
        at = np.asarray(lengths, dtype=np.float64)
        begin, end, price = self.spans.T
        borders = np.concatenate([[0.0], np.column_stack([begin, end]).ravel()])
        charged = np.concatenate([[0.0], np.cumsum(np.column_stack([np.zeros(len(price)), price * (end - begin)]).ravel())])
        return np.asarray(np.interp(at, borders, charged))

    def touches(self, begin: npt.ArrayLike, end: npt.ArrayLike) -> Bool:
        """Tell of some stretches (K,), given by lengths along the path [rad], whether there is any contact on them."""
        low, high = np.asarray(begin, dtype=np.float64), np.asarray(end, dtype=np.float64)
        if not len(self.spans):
            return np.zeros(low.shape, dtype=np.bool_)
        after = np.searchsorted(self.spans[:, 1], low, side="left")  # the first span that ends behind the stretch's begin
        there = after < len(self.spans)
        return np.asarray(there & (self.spans[np.minimum(after, len(self.spans) - 1), 0] <= high))


def leaf_spans(obstacles: Obstacles, waypoints: Array) -> LeafSpans:
    """Find the contact along a polyline, whatever the stems say and whether leaves matter to the search or not.

    Args:
        obstacles: the scene.
        waypoints: (M, n) [rad], M at least 1.
    """
    return _spans(obstacles.measuring_space(), waypoints)


def unseen_spans(obstacles: Obstacles, waypoints: Array) -> LeafSpans:
    """Find where along a polyline the arm is in space that no camera has seen, at price 1; see `leaf_spans`."""
    space = obstacles.unseen_space()
    return LeafSpans(np.zeros((0, 3)), 0.0) if space is None else _spans(space, waypoints)


def _spans(space: ArmSpace, waypoints: Array) -> LeafSpans:
    found, doubt, along = [np.zeros((0, 3))], 0.0, 0.0
    for a, b in itertools.pairwise(np.ascontiguousarray(waypoints, dtype=np.float64)):
        length = float(np.linalg.norm(b - a))
        space.sweep.used[0] = 0
        doubt += arm_charge(space, a, b, _FINEST_RAD)[1]
        spans = space.sweep.spans[: space.sweep.used[0]].copy()
        spans[:, :2] = along + length * spans[:, :2]
        found.append(spans)
        along += length
    return LeafSpans(_joined(np.concatenate(found)), doubt)


def _joined(spans: Array) -> Array:
    """Join spans of one price that meet at a waypoint."""
    if len(spans) < 2:
        return spans
    apart = (spans[1:, 0] > spans[:-1, 1] + 1e-12) | (spans[1:, 2] != spans[:-1, 2])
    first = np.flatnonzero(np.concatenate([[True], apart]))
    last = np.concatenate([first[1:] - 1, [len(spans) - 1]])
    return np.column_stack([spans[first, 0], spans[last, 1], spans[first, 2]])
