"""What a configuration costs: the price of what the arm touches, in the one place that fast check, edges, figures and the plane share.

Every permeable point has a *price*: the price of its class (`class_costs`, 1 for leaves; `lime_planner.scene.labels`) times its own
`permeability_cost`. What a configuration costs follows from the prices of the points that the arm touches there, in one of two ways:

- `BINARY`: the highest of them, whatever else is touched;
- `GRADED`: their sum over patches of the surface, in units of about one leaf.

A path costs J = ∫ (1 + w · price) ds. A class with another price is a row of the parameter `class_costs`, and nothing here changes.
Something with a price that is no point is one more summand of the price. There is one: space that no camera has seen costs its own share
of a leaf's price (`unseen_price`), added to what is touched there, once, however much of it the arm is in (`with_unseen`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import inline_kernel
from lime_planner.core.types import Float32

BINARY, GRADED = 0, 1
PATCH_M = 0.01  #: graded: the points of one cell of this edge stand for one patch of leaf ...
PATCHES_PER_LEAF = 20.0  #: ... and this many touched patches, about one leaf, cost as much as a binary contact


class Prices(NamedTuple):
    """How prices of points become the price of a configuration, as compiled code sees it.

    Attributes:
        mode: BINARY or GRADED.
        top: highest price of any point; under BINARY no configuration costs more.
    """

    mode: int
    top: float


def price_of_points(points: Float32, costs: Float32, mode: int) -> tuple[Float32, Prices]:
    """Return what each point adds to a configuration's price, (N,), and how they add up.

    Graded, the points of one cell of `PATCH_M` share its price, however many they are.

    Args:
        points: (N, 3) permeable points [m]; costs: (N,) their prices; mode: BINARY or GRADED.
    """
    shares = costs
    if mode == GRADED and len(points):
        cells = np.floor(points / PATCH_M).astype(np.int64)
        cells -= cells.min(axis=0)
        # One number for each cell: rows of three would take ten times as long to tell apart.
        _, inverse, counts = np.unique(
            np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1)), return_inverse=True, return_counts=True
        )
        shares = np.asarray(costs / counts[inverse], dtype=np.float32)
    return shares, Prices(mode, float(shares.max(initial=0.0)))


@inline_kernel
def body_price(prices: Any, touched: Any) -> Any:
    """Price of one body of the arm, from the highest price (binary) or the sum of the prices (graded) of the points that it touches."""
    return touched / PATCHES_PER_LEAF if prices.mode == GRADED else touched


@inline_kernel
def with_body(prices: Any, price: Any, body: Any) -> Any:
    """Price of a configuration once another body's is known."""
    return price + body if prices.mode == GRADED else max(price, body)


@inline_kernel
def is_settled(prices: Any, price: Any) -> Any:
    """Whether nothing further that is touched can change a price."""
    return prices.mode == BINARY and price >= prices.top


@inline_kernel
def with_unseen(price: Any, share: Any, unseen: Any) -> Any:
    """Price with that of unseen space, `share` of a leaf's: of a configuration, 0 or 1 of it there, or of a stretch with ∫ unseen ds."""
    return price + share * unseen


@inline_kernel
def stretch_cost(length: Any, weight: Any, charged: Any) -> Any:
    """J of a stretch of a path: its length, and `weight` for each unit of ∫ price ds over it."""
    return length + weight * charged
