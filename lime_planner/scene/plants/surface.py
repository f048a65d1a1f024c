"""Points on the surfaces of a generated plant, at an even density, as a depth camera would give them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lime_planner.core.geometry import unit
from lime_planner.core.types import Array, Int64


def perpendicular(axes: Array) -> tuple[Array, Array]:
    """Return two unit vectors (N, 3) that complete the unit vectors `axes` (N, 3) to right-handed frames."""
    helper = np.where(np.abs(axes[..., 2:]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    first = unit(np.cross(helper, axes))
    return first, np.cross(axes, first)


def _spread(rng: np.random.Generator, areas: Array, per_m2: float) -> tuple[Int64, Array]:
    """Draw surface pieces in proportion to their areas [m²]: one draw in each of n equal slices, so that no patch stays bare.

    Returns the pieces (n,) and how far through its piece's area each draw lies (n,), 0 to 1.
    """
    edges = np.cumsum(areas)
    if not len(edges) or edges[-1] <= 0.0:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    n = max(1, round(float(edges[-1]) * per_m2))
    place = (np.arange(n) + rng.random(n)) * (edges[-1] / n)
    index = np.asarray(np.minimum(np.searchsorted(edges, place, side="right"), len(edges) - 1))
    return index, np.clip(1.0 - (edges[index] - place) / areas[index], 0.0, 1.0)


def triangle_areas(triangles: npt.NDArray[np.floating]) -> Array:
    """Return the areas (T,) [m²] of triangles (T, 3, 3) [m]."""
    t = np.asarray(triangles, dtype=np.float64)
    return np.asarray(0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1))


def on_triangles(rng: np.random.Generator, triangles: Array, per_m2: float) -> tuple[Array, Int64]:
    """Return points (N, 3) [m] on triangles (T, 3, 3) and the triangle (N,) each lies on."""
    index, _ = _spread(rng, triangle_areas(triangles), per_m2)
    root, v = np.sqrt(rng.random(len(index))), rng.random(len(index))
    weights = np.stack([1.0 - root, root * (1.0 - v), root * v], axis=1)
    return np.einsum("nk,nkx->nx", weights, triangles[index]), index


def on_cones(rng: np.random.Generator, starts: Array, ends: Array, radii: Array, per_m2: float) -> Array:
    """Return points (N, 3) [m] on the mantles of truncated cones from `starts` to `ends` (S, 3) with radii (S, 2) [m]."""
    along = ends - starts
    lengths = np.linalg.norm(along, axis=1)
    # The draw's place in the area is its place along the axis (nearly, on so slender a cone): a twig has no gaps.
    index, t = _spread(rng, np.pi * radii.sum(axis=1) * lengths, per_m2)
    angle = rng.random(len(index)) * (2.0 * np.pi)
    first, second = perpendicular(unit(along))
    radius = radii[index, 0] * (1.0 - t) + radii[index, 1] * t
    around = np.cos(angle)[:, None] * first[index] + np.sin(angle)[:, None] * second[index]
    return np.asarray(starts[index] + t[:, None] * along[index] + radius[:, None] * around)


def on_spheres(rng: np.random.Generator, centres: Array, radii: Array, per_m2: float) -> Array:
    """Return points (N, 3) [m] on spheres, each a Fibonacci lattice turned at random about the vertical."""
    shells = []
    for centre, radius in zip(centres, radii, strict=True):
        n = max(8, round(4.0 * np.pi * radius**2 * per_m2))
        z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
        angle = np.arange(n) * (np.pi * (3.0 - np.sqrt(5.0))) + rng.random() * (2.0 * np.pi)
        ring = np.sqrt(1.0 - z**2)
        shells.append(centre + radius * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1))
    return np.concatenate(shells) if shells else np.zeros((0, 3))


def jitter(rng: np.random.Generator, points: Array, noise_m: float) -> Array:
    """Add a normal error of standard deviation `noise_m` to each coordinate, cut at three deviations."""
    return points + noise_m * np.clip(rng.standard_normal(points.shape), -3.0, 3.0)


def distance_to_segments(point: Array, starts: Array, ends: Array) -> Array:
    """Return the distances (S,) [m] from one point (3,) to the segments `starts` → `ends` (S, 3)."""
    along = ends - starts
    squared = np.maximum((along**2).sum(axis=1), 1e-18)
    t = np.clip(((point - starts) * along).sum(axis=1) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(starts + t[:, None] * along - point, axis=1))
