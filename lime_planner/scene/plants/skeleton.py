"""The woody part of a generated plant: trunk, branches and twigs as chains of truncated cones."""

from __future__ import annotations

import dataclasses

import numpy as np

from lime_planner.core.geometry import unit
from lime_planner.core.types import Array, Int64
from lime_planner.scene.plants.surface import perpendicular

GOLDEN_ANGLE_RAD = np.pi * (3.0 - np.sqrt(5.0))  #: turn from one bud to the next around a shoot of citrus, nearly


@dataclasses.dataclass(frozen=True)
class Canopy:
    """The ellipsoid that holds the branches: centre (3,) [m] and half axes (3,) [m]."""

    centre: Array
    half_axes: Array

    def room(self, points: Array, directions: Array) -> Array:
        """Return the distance (N,) [m] from points (N, 3) along unit directions to the ellipsoid; 0 from outside."""
        p, d = (points - self.centre) / self.half_axes, directions / self.half_axes
        a, b, c = (d * d).sum(axis=1), (p * d).sum(axis=1), (p * p).sum(axis=1) - 1.0
        return np.where(c < 0.0, (-b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / a, 0.0)


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """Segments of all wood: starts, ends (S, 3) [m], radii (S, 2) [m], level (S,): 0 trunk, 1 branches, 2 shoots, 3 twigs."""

    starts: Array
    ends: Array
    radii: Array
    levels: Int64


@dataclasses.dataclass(frozen=True)
class _Level:
    """One order of branching; lengths and radii in metres, angles in radians."""

    children: int  # on each branch of the order before
    segments: int
    length_m: tuple[float, float]
    radii_m: tuple[float, float]  # at the base and at the tip
    angle_rad: tuple[float, float]  # between parent and child
    wander: float  # how much the direction changes from segment to segment
    upward: float  # how much each segment turns towards the light


def _levels(twigs: int, size: float) -> tuple[_Level, ...]:
    return (
        _Level(7, 6, (0.22 * size, 0.36 * size), (0.0050, 0.0026), (0.65, 1.25), 0.13, 0.10),
        _Level(4, 4, (0.10 * size, 0.18 * size), (0.0025, 0.0016), (0.60, 1.10), 0.16, 0.06),
        _Level(twigs, 3, (0.05 * size, 0.10 * size), (0.0015, 0.0010), (0.60, 1.10), 0.18, 0.02),
    )


def _chain(rng: np.random.Generator, starts: Array, directions: Array, lengths: Array, order: _Level) -> Array:
    """Grow B branches at once; return their nodes (B, segments + 1, 3) [m]."""
    nodes = [starts]
    step = (lengths / order.segments)[:, None]
    for _ in range(order.segments):
        nodes.append(nodes[-1] + step * directions)
        directions = unit(directions + order.wander * rng.standard_normal(directions.shape) + np.array([0.0, 0.0, order.upward]))
    return np.stack(nodes, axis=1)


def _buds(rng: np.random.Generator, parents: Array, order: _Level, first: float) -> tuple[Array, Array]:
    """Place `order.children` buds on each parent (B, K, 3) from the fraction `first` to its tip; return positions and directions."""
    b, k = parents.shape[0], parents.shape[1] - 1
    fraction = first + (1.0 - first) * (np.arange(order.children) + rng.uniform(0.2, 1.0, (b, order.children))) / order.children
    segment = np.minimum((fraction * k).astype(np.int64), k - 1)
    t = (fraction * k - segment)[..., None]
    row = np.arange(b)[:, None]
    before, after = parents[row, segment], parents[row, segment + 1]
    axis = unit(after - before)
    one, two = perpendicular(axis)
    turn = np.arange(order.children) * GOLDEN_ANGLE_RAD + rng.uniform(0.0, 2.0 * np.pi, (b, 1)) + rng.normal(0.0, 0.3, fraction.shape)
    turn = turn[..., None]
    angle = rng.uniform(*order.angle_rad, fraction.shape)[..., None]
    out = np.cos(angle) * axis + np.sin(angle) * (np.cos(turn) * one + np.sin(turn) * two)
    return (before + t * (after - before)).reshape(-1, 3), unit(out).reshape(-1, 3)


def grow_skeleton(rng: np.random.Generator, base: Array, trunk_m: float, canopy: Canopy, twigs: int) -> Skeleton:
    """Grow the wood: a trunk of which the lower `trunk_m` are bare, then three orders of branching inside the canopy.

    Args:
        rng: the only source of chance.
        base: (3,) [m], where the trunk leaves the ground.
        trunk_m: height of the lowest branches over the base.
        canopy: the ellipsoid to fill.
        twigs: twigs on each shoot.
    """
    size = float(canopy.half_axes.mean() / 0.3)
    top = canopy.centre[2] + 0.35 * canopy.half_axes[2] - base[2]
    trunk = _Level(1, 10, (top, top), (0.0095, 0.0050), (0.0, 0.0), 0.05, 0.12)
    upright = unit(np.array([[rng.normal(0.0, 0.06), rng.normal(0.0, 0.06), 1.0]]))
    nodes = _chain(rng, base[None, :], upright, np.array([top]), trunk)
    chains = [(nodes, trunk.radii_m)]
    first = trunk_m / top
    for order in _levels(twigs, size):
        starts, directions = _buds(rng, nodes, order, first)
        lengths = rng.uniform(*order.length_m, len(starts))
        room = canopy.room(starts, directions)
        lengths = np.minimum(lengths, np.maximum(0.9 * room, 0.3 * order.length_m[0]))
        nodes = _chain(rng, starts, directions, lengths, order)
        chains.append((nodes, order.radii_m))
        first = 0.25
    pieces = []
    for level, (chain, (r0, r1)) in enumerate(chains):
        count, k = chain.shape[0], chain.shape[1] - 1
        radius = np.linspace(r0, r1, k + 1)
        radii = np.broadcast_to(np.stack([radius[:-1], radius[1:]], axis=1), (count, k, 2)).reshape(-1, 2)
        pieces.append((chain[:, :-1].reshape(-1, 3), chain[:, 1:].reshape(-1, 3), radii, np.full(count * k, level)))
    starts, ends, radii, levels = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return Skeleton(starts, ends, radii, levels)


def nodes_along(rng: np.random.Generator, skeleton: Skeleton, n: int, level: int) -> tuple[Array, Array]:
    """Draw n nodes evenly along all wood of this level and finer; return positions (n, 3) [m] and axes (n, 3)."""
    chosen = np.flatnonzero(skeleton.levels >= level)
    starts, along = skeleton.starts[chosen], skeleton.ends[chosen] - skeleton.starts[chosen]
    edges = np.cumsum(np.linalg.norm(along, axis=1))
    place = (np.arange(n) + rng.random(n)) * (edges[-1] / max(n, 1))
    index = np.minimum(np.searchsorted(edges, place, side="right"), len(edges) - 1)
    length = np.linalg.norm(along[index], axis=1)
    t = 1.0 - (edges[index] - place) / length
    return starts[index] + t[:, None] * along[index], along[index] / length[:, None]
