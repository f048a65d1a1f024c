"""A tree that grows by algorithm 1, with everything that its compiled loop takes: space, field, rules, working memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.types import Array
from lime_planner.planning.rrt_star import kernels
from lime_planner.planning.rrt_star.options import PaperOptions
from lime_planner.planning.rrt_star.potential_field import Field, farthest_corner
from lime_planner.planning.rrt_star.tree import add_node, enlarged, new_tree
from lime_planner.planning.space import one, raise_pending


class Growth:
    """The tree and how it grows.

    Attributes:
        space: handle of the space; goals: (G, n).
        options, rules, field: the gains and readings.
        tree: its arrays; node 0 is the start.
    """

    def __init__(self, space: Any, start: Array, goals: Array, options: PaperOptions, capacity: int) -> None:
        """Plant the start.

        Args:
            space: the space; start: (n,); goals: (G, n); options: gains and readings.
            capacity: nodes that there is room for at first.
        """
        lower, upper = np.asarray(space.lower), np.asarray(space.upper)
        self.space, self._given, self.goals, self.options = space.handle(), space, goals, options
        self.rules = options.rules()
        self.field = Field(
            k_att=float(options.k_att),
            k_leaf=float(options.k_rep_permeable),
            k_stem=float(options.k_rep_impermeable),
            d_star=float(options.d_star),
            beta=float(options.beta),
            explore_inside=options.inside_leaves == "explore",
            force_max=2.0 * options.k_att * farthest_corner(lower, upper, goals),
        )
        self._scratch = kernels.Scratch(*(np.zeros(len(start)) for _ in range(4)))
        self.tree = new_tree(capacity, len(start))
        add_node(self.tree, start, max(one(self.space, start), 0.0), -1, 0.0)

    def make_room(self, nodes: int) -> None:
        """Make room for so many more nodes."""
        if self.tree.size[0] + nodes > len(self.tree.parent):
            self.tree = enlarged(self.tree, 2 * (int(self.tree.size[0]) + nodes))

    def extend(self, samples: Array) -> None:
        """Run one iteration for each of the samples (m, n)."""
        self.make_room(len(samples))
        kernels.grow(self.space, self.field, self.rules, self.goals, self.tree, samples, self._scratch)
        raise_pending(self._given)
