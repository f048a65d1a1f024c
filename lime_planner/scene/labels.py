"""What the labels of points mean, by the same rules for the node, the command line and scene files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS

ClassCosts = Mapping[int, float] | Sequence[str]  #: prices by label, or the texts `LABEL: PRICE` of the parameter `class_costs`

LEAF_PRICE = 1.0  #: of a permeable class that `class_costs` does not name
_HIGHEST_PRICE = 1e6


def fruit_in_force(
    leaf_labels: Sequence[int],
    stem_labels: Sequence[int],
    fruit_labels: Sequence[int],
    ignored_labels: Sequence[int],
    class_costs: ClassCosts = (),
) -> tuple[int, ...]:
    """Check that every label has one meaning, and return the fruit's labels that hold.

    The default of the fruit gives way to classes that name its label: who numbers the classes otherwise need not know of it.

    Args:
        leaf_labels: of leaves.
        stem_labels: of stems.
        fruit_labels: of fruit, given or the default.
        ignored_labels: of what is left out.
        class_costs: prices of permeable classes; those of `leaf_labels` may be among them.

    Raises:
        ParameterError: two classes share a label; it names both. A price is none (`class_prices`).
    """
    fruit, priced = tuple(fruit_labels), class_prices(class_costs)
    if fruit == tuple(NODE_PARAMETERS["fruit_labels"].default):
        named = {*leaf_labels, *stem_labels, *ignored_labels, *priced}
        fruit = tuple(label for label in fruit if label not in named)
    classes = {"leaf_labels": leaf_labels, "stem_labels": stem_labels, "fruit_labels": fruit, "ignored_labels": ignored_labels}
    classes["class_costs"] = [label for label in priced if label not in leaf_labels]
    for (first, of_first), (second, of_second) in itertools.combinations(classes.items(), 2):
        both = sorted(set(of_first) & set(of_second))
        if both:
            raise ParameterError(f"{first} and {second} share {', '.join(map(str, both))}; a class has one meaning")
    return fruit


def class_prices(rows: ClassCosts) -> dict[int, float]:
    """Return the prices of classes by label, from the parameter `class_costs` or from a mapping.

    Args:
        rows: one text `LABEL: PRICE` for each class, or labels and prices.

    Raises:
        ParameterError: a row that is no such pair, a label given twice, a price that is negative, not finite or beyond 1e6.
    """
    pairs = [(str(label), str(price)) for label, price in rows.items()] if isinstance(rows, Mapping) else [_pair(row) for row in rows]
    prices: dict[int, float] = {}
    for label_text, price_text in pairs:
        row = f"{label_text}: {price_text}"
        try:
            label, price = int(label_text), float(price_text)
        except ValueError:
            raise ParameterError(f"class_costs: {row!r} must be a whole number and a price, such as '3: 0.25'") from None
        if not (math.isfinite(price) and 0.0 <= price <= _HIGHEST_PRICE):
            raise ParameterError(f"class_costs: the price in {row!r} must lie between 0 and {_HIGHEST_PRICE:g}")
        if label in prices:
            raise ParameterError(f"class_costs: label {label} has two prices, {prices[label]:g} and {price:g}")
        prices[label] = price
    return prices


def _pair(row: object) -> tuple[str, str]:
    label, colon, price = str(row).partition(":")
    if not colon:
        raise ParameterError(f"class_costs: {str(row)!r} must be a label, a colon and a price, such as '3: 0.25'")
    return label.strip(), price.strip()


def point_prices(labels: npt.NDArray[Any], permeability_costs: npt.NDArray[Any], prices: Mapping[int, float]) -> npt.NDArray[Any]:
    """Return the price of each point, (N,): that of its class times its own permeability cost.

    Args:
        labels: (N,) integers.
        permeability_costs: (N,) >= 0.
        prices: of classes, by label; the others' is `LEAF_PRICE`.
    """
    costs = permeability_costs
    for label, price in prices.items():
        if price != LEAF_PRICE:
            costs = np.where(labels == label, price * costs, costs)
    return costs
