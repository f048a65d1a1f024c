"""What the labels of points mean, by the same rules for the node, the command line and scene files."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS


def fruit_in_force(
    leaf_labels: Sequence[int],
    stem_labels: Sequence[int],
    fruit_labels: Sequence[int],
    ignored_labels: Sequence[int],
) -> tuple[int, ...]:
    """Check that every label has one meaning, and return the fruit's labels that hold.

    The default of the fruit gives way to classes that name its label: who numbers the classes otherwise need not know of it.

    Args:
        leaf_labels: of leaves.
        stem_labels: of stems.
        fruit_labels: of fruit, given or the default.
        ignored_labels: of what is left out.

    Raises:
        ParameterError: two classes share a label; it names both.
    """
    fruit = tuple(fruit_labels)
    if fruit == tuple(NODE_PARAMETERS["fruit_labels"].default):
        named = {*leaf_labels, *stem_labels, *ignored_labels}
        fruit = tuple(label for label in fruit if label not in named)
    classes = {"leaf_labels": leaf_labels, "stem_labels": stem_labels, "fruit_labels": fruit, "ignored_labels": ignored_labels}
    for (first, of_first), (second, of_second) in itertools.combinations(classes.items(), 2):
        both = sorted(set(of_first) & set(of_second))
        if both:
            raise ParameterError(f"{first} and {second} share {', '.join(map(str, both))}; a class has one meaning")
    return fruit
