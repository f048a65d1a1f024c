"""Distance fields against a k-d tree: exact near points, never above the truth once bounded, and at home with odd clouds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from lime_planner.collision.distance_fields import (
    EMPTY_DISTANCE_M,
    Fields,
    PointHash,
    build_fields,
    hash_points,
    lattice_fields,
    lower_bound,
    sample,
)
from lime_planner.core.jit import kernel

NONE = np.zeros((0, 3))
BAND = 3.6  # spacings within which nodes are exact


@kernel
def sample_all(fields, places, out):
    for i in range(places.shape[0]):
        stem, leaf = sample(fields, places[i, 0], places[i, 1], places[i, 2])
        out[i, 0] = stem
        out[i, 1] = leaf
        out[i, 2] = lower_bound(stem, fields.spacing_m)
        out[i, 3] = lower_bound(leaf, fields.spacing_m)


def look_up(fields: Fields, places: np.ndarray) -> np.ndarray:
    """Columns: stem, leaf, lower bounds of both."""
    out = np.zeros((len(places), 4))
    sample_all(fields, np.ascontiguousarray(places, dtype=np.float64), out)
    return out


def nodes(fields: Fields) -> np.ndarray:
    shape = fields.values.shape[:3]
    return fields.origin + fields.spacing_m * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)


def curves(rng: np.random.Generator, count: int, points: int = 60) -> np.ndarray:
    """Thin twigs of points, the hard case for a grid."""
    ends = rng.uniform(0.0, 0.3, (count, 2, 3))
    return np.concatenate([a + np.linspace(0, 1, points)[:, None] * (b - a) for a, b in ends])


def truth(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    return cKDTree(points.astype(np.float32)).query(places)[0]


def test_nodes_are_exact_near_points_and_never_above_the_truth(rng: np.random.Generator) -> None:
    stems, leaves = curves(rng, 4), rng.uniform(0.0, 0.3, (500, 3))
    fields = build_fields(stems, leaves)
    at = nodes(fields)
    for channel, points in enumerate((stems, leaves)):
        exact = truth(points, at)
        values = fields.values[..., channel]
        near = exact < (BAND - 1e-3) * fields.spacing_m
        assert near.sum() > 1000
        np.testing.assert_allclose(values[near], exact[near], atol=1e-6)
        assert (values <= exact + 1e-6).all()
        assert (exact - values).max() <= 1.8 * fields.spacing_m


def test_a_lattice_is_exact_at_every_node(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    places = np.float32([0.4, -0.3, 0.105]) + np.float32(0.01) * rng.integers(0, 25, (300, 3)).astype(np.float32)
    fields = lattice_fields(places, 0.01)
    exact = truth(places, nodes(fields))
    np.testing.assert_allclose(fields.values[..., 1], exact, atol=1e-6)
    assert (fields.values[..., 0] == EMPTY_DISTANCE_M).all() and fields.present.tolist() == [0, 1]
    anywhere = rng.uniform(-0.2, 1.0, (5000, 3))
    assert (look_up(fields, anywhere)[:, 3] <= truth(places, anywhere) + 1e-6).all()
    monkeypatch.setattr("lime_planner.collision.distance_fields._MAX_NODES", 10_000)  # too wide a spread: as for any points
    assert np.prod(lattice_fields(places, 0.01).values.shape[:3]) <= 10_000


@pytest.mark.parametrize("spacing", [0.003, 0.01, 0.05])
def test_lower_bound_is_never_above_the_truth(rng: np.random.Generator, spacing: float) -> None:
    stems, leaves = curves(rng, 5), rng.uniform(0.0, 0.3, (300, 3))
    fields = build_fields(stems, leaves, spacing_m=spacing)
    # Everywhere, inside and outside the grid, and close to the points, where the interpolation errs most.
    close = np.concatenate([stems, leaves])[rng.integers(0, len(stems) + len(leaves), 60_000)]
    places = np.concatenate([rng.uniform(-0.4, 0.7, (40_000, 3)), close + rng.normal(0.0, 2.0 * spacing, close.shape)])
    found = look_up(fields, places)
    for channel, points in enumerate((stems, leaves)):
        exact = truth(points, places)
        assert (found[:, 2 + channel] <= exact + 1e-6).all()
        inside = exact < (BAND - 2.0) * spacing
        # And it is worth something: at most the half diagonal of a cell below.
        assert (exact - found[:, 2 + channel])[inside].max() < 1.75 * spacing
        assert np.abs(found[:, channel] - exact)[inside].max() < 0.87 * spacing


@given(st.integers(0, 2**31), st.integers(1, 4), st.floats(0.002, 0.05), st.floats(-3.0, 3.0))
@settings(max_examples=25, deadline=None)
def test_lower_bound_for_a_few_points_anywhere(seed: int, count: int, spacing: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.02, 0.02, (count, 3)) + shift
    fields = build_fields(points, NONE, spacing_m=spacing)
    places = points[rng.integers(0, count, 2000)] + rng.normal(0.0, 1.0, (2000, 3)) * spacing * rng.uniform(0.0, 6.0, (2000, 1))
    found, exact = look_up(fields, places), truth(points, places)
    assert (found[:, 2] <= exact + 1e-6).all()
    np.testing.assert_allclose(found[:, 1], EMPTY_DISTANCE_M, rtol=1e-6)


def test_outside_the_grid_the_box_serves(rng: np.random.Generator) -> None:
    stems, leaves = rng.uniform(0.0, 0.1, (50, 3)), rng.uniform(0.2, 0.3, (50, 3))
    fields = build_fields(stems, leaves)
    places = rng.uniform(-5.0, 5.0, (5000, 3))
    low, high = fields.origin, fields.origin + fields.spacing_m * (np.array(fields.values.shape[:3]) - 1)
    places = places[((places < low) | (places >= high)).any(axis=1)]
    found = look_up(fields, places)
    for channel, points in enumerate((stems, leaves)):
        exact, size = truth(points, places), np.linalg.norm(np.ptp(points, axis=0))
        assert (found[:, channel] <= exact + 1e-6).all()
        assert (found[:, channel] >= exact - size).all()


def test_empty_clouds(rng: np.random.Generator) -> None:
    places = rng.uniform(-1.0, 1.0, (200, 3))
    nothing = look_up(build_fields(NONE, NONE), places)
    assert np.allclose(nothing[:, :2], EMPTY_DISTANCE_M, rtol=1e-6) and (nothing[:, 2:] > 9.0).all()
    points = rng.uniform(0.0, 0.1, (20, 3))
    only_leaves = look_up(build_fields(NONE, points), places)
    assert np.allclose(only_leaves[:, 0], EMPTY_DISTANCE_M, rtol=1e-6) and (only_leaves[:, 3] <= truth(points, places) + 1e-6).all()
    only_stems = look_up(build_fields(points, NONE), places)
    assert np.allclose(only_stems[:, 1], EMPTY_DISTANCE_M, rtol=1e-6) and (only_stems[:, 2] <= truth(points, places) + 1e-6).all()


def test_one_point_and_many_equal_ones(rng: np.random.Generator) -> None:
    point = np.array([[0.123, -0.456, 0.789]])
    places = point + rng.normal(0.0, 0.02, (2000, 3))
    for cloud in (point, np.repeat(point, 1000, axis=0)):
        fields = build_fields(cloud, NONE)
        found, exact = look_up(fields, places), truth(point, places)
        assert (found[:, 2] <= exact + 1e-6).all()
        assert look_up(fields, point)[0, 0] < fields.spacing_m
        assert len(fields.stems.points) == len(cloud)


@pytest.mark.parametrize("spread", [10.0, 1000.0, 1e6])
@pytest.mark.parametrize("axes", [(0,), (0, 1), (0, 1, 2)])
def test_a_huge_spread_keeps_the_grid_small(rng: np.random.Generator, spread: float, axes: tuple[int, ...]) -> None:
    points = rng.uniform(0.0, 0.1, (200, 3))
    points[:, axes] *= 10.0 * spread
    fields = build_fields(points, points[:5])
    assert fields.values[..., 0].size <= 12_000_000
    assert len(fields.stems.start) < 6_000_000
    exact = cKDTree(fields.stems.points.astype(np.float64))
    places = points[rng.integers(0, len(points), 3000)] + rng.normal(0.0, 1.0, (3000, 3)) * rng.choice([0.01, fields.spacing_m], (3000, 1))
    assert (look_up(fields, places)[:, 2] <= exact.query(places)[0] + 1e-6 * spread).all()


def cell_members(table: PointHash, cell: np.ndarray) -> np.ndarray:
    c = (cell[0] * table.shape[1] + cell[1]) * table.shape[2] + cell[2]
    return table.points[table.start[c] : table.start[c + 1]]


@given(st.integers(0, 2**31), st.integers(1, 300), st.floats(1e-4, 50.0))
@settings(max_examples=30, deadline=None)
def test_the_hash_keeps_every_point_in_its_cell(seed: int, count: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-size, size, (count, 3)).astype(np.float32)
    weights = rng.uniform(0.0, 2.0, count).astype(np.float32)
    table = hash_points(points, weights)
    assert table.start[0] == 0 and table.start[-1] == count and (np.diff(table.start) >= 0).all()
    pairs = np.column_stack([table.points, table.weights])
    before = np.column_stack([points, weights])
    np.testing.assert_array_equal(pairs[np.lexsort(pairs.T)], before[np.lexsort(before.T)])
    for k in rng.integers(0, count, min(count, 20)):
        cell = np.minimum(((points[k] - table.origin) / table.cell_m).astype(int), table.shape - 1)
        assert (cell_members(table, cell) == points[k]).all(axis=1).any()
