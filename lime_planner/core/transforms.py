"""Rigid transforms between named frames, chained over any number of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lime_planner.core.types import Array


def clean_name(frame: str) -> str:
    """Return a frame's name without the leading slash of old publishers."""
    return frame.strip().lstrip("/")


class TransformTree:
    """Which frame lies where, seen from which other."""

    def __init__(self) -> None:
        """Start without any frame."""
        self._neighbours: dict[str, dict[str, Array]] = {}

    @property
    def frames(self) -> list[str]:
        """The names of all frames, sorted."""
        return sorted(self._neighbours)

    def add(self, parent: str, child: str, T_parent_child: npt.ArrayLike) -> None:
        """Add a transform (4, 4) [m], or replace the one between these two frames."""
        T = np.asarray(T_parent_child, dtype=np.float64)
        parent, child = clean_name(parent), clean_name(child)
        self._neighbours.setdefault(parent, {})[child] = T
        self._neighbours.setdefault(child, {})[parent] = np.asarray(np.linalg.inv(T), dtype=np.float64)

    def find(self, target: str, source: str) -> Array | None:
        """Return T_target_source (4, 4), or None where no chain connects them."""
        target, source = clean_name(target), clean_name(source)
        reached = {target: np.eye(4)}
        front = [target]
        while front and source not in reached:
            following = []
            for frame in front:
                for neighbour, T_frame_neighbour in self._neighbours.get(frame, {}).items():
                    if neighbour not in reached:
                        reached[neighbour] = reached[frame] @ T_frame_neighbour
                        following.append(neighbour)
            front = following
        return reached.get(source)
