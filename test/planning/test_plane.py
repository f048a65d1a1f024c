"""The plane: exact interval lengths, open sets, forces, and worlds from files."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lime_planner.core.errors import ProblemError, SceneError
from lime_planner.experiments.wall.optimum import plane_optimum
from lime_planner.planning.space import line, one, repulsion
from lime_planner.planning.spaces.plane import PlaneWorld, load_world, random_wall, wall_g, world_from_dict

INF = float("inf")


def repulsion_one(space: Any, q: Any, d_star: float, k_leaf: float, k_stem: float, force: Any) -> float:
    return float(repulsion(space.handle(), q, d_star, k_leaf, k_stem, force))


def world(permeable: Any = (), impermeable: Any = ()) -> PlaneWorld:
    return PlaneWorld("test", (0.0, 0.0), (100.0, 100.0), (10.0, 50.0), (90.0, 50.0), tuple(permeable), tuple(impermeable))


def box(x0: float, y0: float, x1: float, y1: float) -> tuple[tuple[float, float], ...]:
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def cost(space: Any, a: Any, b: Any, weight: float = 10.0) -> float:
    return line(space, np.array(a, dtype=float), np.array(b, dtype=float), weight, INF)


coordinate = st.floats(0.0, 100.0, allow_nan=False, width=32)
point = st.tuples(coordinate, coordinate)
triangle = st.tuples(point, point, point)
leaves = st.lists(triangle, min_size=0, max_size=4)


def test_edge_is_charged_for_its_exact_length_inside() -> None:
    space = world([box(40.0, 0.0, 43.0, 100.0)]).space().handle()
    assert cost(space, (10, 50), (90, 50)) == pytest.approx(80.0 + 10.0 * 3.0, abs=1e-9)
    assert cost(space, (40.5, 50), (42.5, 50)) == pytest.approx(2.0 + 20.0, abs=1e-9)
    assert cost(space, (10, 10), (30, 90)) == pytest.approx(np.hypot(20, 80), abs=1e-9)


def test_thin_sheet_in_the_middle_of_an_edge_is_charged_and_blocks() -> None:
    sheet = box(49.9999, -10.0, 50.0001, 110.0)
    assert cost(world([sheet]).space(), (10, 50), (90, 50), 1e6) == pytest.approx(80.0 + 200.0, rel=1e-6)
    assert cost(world([], [sheet]).space(), (10, 50), (90, 50)) == INF


def test_overlapping_leaves_are_charged_once() -> None:
    space = world([box(40, 0, 50, 100), box(45, 0, 55, 100), box(46, 10, 48, 90)]).space().handle()
    assert cost(space, (10, 50), (90, 50)) == pytest.approx(80.0 + 150.0)


def test_polygons_cost_their_price_and_the_highest_where_they_overlap() -> None:
    sheets = [box(40, -10, 50, 110), box(45, -10, 55, 110), box(60, -10, 70, 110)]
    priced = dataclasses.replace(world(sheets), prices=(0.5, 2.0, 0.0))
    assert cost(priced.space(), (10, 50), (90, 50)) == pytest.approx(80.0 + 10.0 * (5 * 0.5 + 10 * 2.0))
    assert [one(priced.space(), np.array([x, 50.0])) for x in (42.0, 47.0, 52.0, 65.0)] == [0.5, 2.0, 2.0, 0.0]
    straight = plane_optimum(priced, 10.0)
    assert straight.cost == pytest.approx(80.0 + 10.0 * 22.5, rel=1e-6)


def test_polygons_are_open_and_the_map_is_closed() -> None:
    space = world([box(40, 40, 60, 60)], [box(70, 40, 80, 60)]).space().handle()
    at = {(50, 50): 1.0, (40, 50): 0.0, (40, 40): 0.0, (75, 50): -1.0, (70, 50): 0.0, (0, 0): 0.0, (100, 100): 0.0, (100.001, 50): -1.0}
    for q, expected in at.items():
        assert one(space, np.array(q, dtype=float)) == expected, q
    assert one(space, np.array([np.nan, 50.0])) == -1.0
    assert cost(space, (40, 30), (40, 70)) == 40.0  # along a face
    assert cost(space, (70, 30), (70, 70)) == 40.0
    assert cost(space, (60, 50), (80, 30)) == pytest.approx(np.hypot(20, 20))  # touches the corner of the stem at (70, 40)


def test_concave_polygon_is_entered_twice() -> None:
    u_shape = ((30.0, 30.0), (70.0, 30.0), (70.0, 70.0), (60.0, 70.0), (60.0, 40.0), (40.0, 40.0), (40.0, 70.0), (30.0, 70.0))
    assert cost(world([u_shape]).space(), (10, 60), (90, 60)) == pytest.approx(80.0 + 200.0)


@given(leaves, point, point, st.floats(0.0, 1.0))
@settings(max_examples=200, deadline=None)
def test_edge_cost_is_symmetric_adds_up_and_is_at_least_the_distance(shapes: Any, a: Any, b: Any, t: float) -> None:
    space = world(shapes).space().handle()
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    whole = cost(space, a, b)
    middle = (a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]))
    assert length - 1e-9 <= whole <= length * 11.0 + 1e-9
    # A leaf thinner than the tolerance of "on the outline" (1e-9) may count in one cut and not in the other.
    assert whole == pytest.approx(cost(space, b, a), abs=1e-5, rel=1e-9)
    assert whole == pytest.approx(cost(space, a, middle) + cost(space, middle, b), abs=1e-5, rel=1e-9)


@given(leaves, point, point)
@settings(max_examples=100, deadline=None)
def test_edge_cost_agrees_with_sampling(shapes: Any, a: Any, b: Any) -> None:
    space = world(shapes).space().handle()
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    t = (np.arange(2000) + 0.5) / 2000
    points = np.array(a) + t[:, None] * (np.array(b) - np.array(a))
    share = np.mean([one(space, p) for p in points])
    pieces = 2 * 3 * max(len(shapes), 1)  # every crossing may be misplaced by one sample
    assert abs(cost(space, a, b) - length * (1.0 + 10.0 * share)) <= 10.0 * length * pieces / 2000 + 1e-6


def test_bound_stops_early_with_a_lower_bound() -> None:
    space = wall_g().space().handle()
    a, b = np.array([10.0, 50.0]), np.array([90.0, 50.0])
    assert 50.0 < line(space, a, b, 1.0, 50.0) <= line(space, a, b, 1.0, INF)


@given(st.integers(0, 500), coordinate, coordinate)
@settings(max_examples=100, deadline=None)
def test_repulsion_is_the_negative_gradient_of_the_potential(seed: int, x: float, y: float) -> None:
    space = random_wall(seed).space()
    d_star, k_leaf, k_stem = 5.0, 500.0, 300.0

    def potential(q: np.ndarray) -> float:
        total = 0.0
        for k_l, k_s in ((k_leaf, 0.0), (0.0, k_stem)):
            only = space._replace(kinds=np.where(space.kinds == (0 if k_l else 1), space.kinds, 9).astype(np.uint8))
            d = repulsion_one(only, q, d_star, 0.0, 0.0, np.zeros(2))
            if 0.0 < d <= d_star:
                total += 0.5 * (k_l + k_s) * (1.0 / d - 1.0 / d_star) ** 2
        return total

    q, force, h = np.array([x, y]), np.zeros(2), 1e-6
    d = repulsion_one(space, q, d_star, k_leaf, k_stem, force)
    if not d > 0.05:
        return  # inside, or where the field is too steep for differences
    numeric = [-(potential(q + h * e) - potential(q - h * e)) / (2 * h) for e in np.eye(2)]
    if np.abs(np.array(numeric) - force).max() > 1e-3 * (1.0 + np.abs(force).max()):
        # The nearest point jumps on a medial axis and the field ends at d*: neighbours on both sides differ there.
        around = [np.zeros(2) for _ in range(4)]
        for step, out in zip([(3e-6, 0), (-3e-6, 0), (0, 3e-6), (0, -3e-6)], around, strict=True):
            repulsion_one(space, q + np.array(step), d_star, k_leaf, k_stem, out)
        spread = max(np.abs(out - force).max() for out in around)
        assert spread > 1e-4 * (1.0 + np.abs(force).max())


def test_worlds_go_through_their_file_unchanged(tmp_path: Any) -> None:
    for original in (wall_g(), random_wall(3), dataclasses.replace(wall_g(), prices=(0.5,))):
        path = tmp_path / "wall.json"
        path.write_text(json.dumps(original.to_dict()))
        assert load_world(path) == original


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start": [1.0]}, "start must be two numbers"),
        ({"goal": [1.0, None]}, "goal must be two numbers"),
        ({"goal": [500.0, 5.0]}, r"goal \[500, 5\] is outside of the map \[0, 0\] to \[100, 100\]"),
        ({"impermeable": [box(1, 1, 2, 2), box(80, 40, 100, 60)]}, r"^goal \[90, 50\] lies in impermeable\[1\]$"),
        ({"impermeable": [box(0, 0, 100, 100)]}, r"^start \[10, 50\] lies in impermeable\[0\]$"),
        ({"map": {"lower": [0, 0]}}, "map must be an object"),
        ({"map": {"lower": [0, 0], "upper": [0, 9]}}, "must be below"),
        ({"permeable": [[[0, 0], [1, 1]]]}, r"permeable\[0\] must be a list of at least 3 corners"),
        ({"impermeable": [[[0, 0], [1, 1], ["a", 2]]]}, r"impermeable\[0\]\[2\]"),
        ({"permeable": 3}, "permeable must be a list of polygons"),
        ({"walls": []}, "unknown field 'walls'"),
        ({"prices": [1.0, 2.0]}, "prices must be 1 numbers, one for each permeable polygon"),
        ({"prices": [-1.0]}, "prices must be finite numbers from 0 on, got -1.0"),
        ({"start": [float("inf"), 0.0]}, "start must be finite"),
    ],
)
def test_wrong_files_are_refused_by_field(change: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        world_from_dict({**wall_g().to_dict(), **change})


def test_start_and_goal_may_lie_on_an_outline_and_among_leaves() -> None:
    changed = {"impermeable": [box(90, 50, 95, 60)], "permeable": [box(0, 0, 100, 100)], "start": [0, 0]}
    read = world_from_dict({**wall_g().to_dict(), **changed})
    assert one(read.space(), np.array(read.start)) == 0.0
    assert one(read.space(), np.array(read.goal)) == 1.0


def test_unreadable_files_are_refused(tmp_path: Any) -> None:
    with pytest.raises(SceneError, match="cannot read the wall file"):
        load_world(tmp_path / "absent.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(SceneError, match="not JSON"):
        load_world(tmp_path / "bad.json")
    with pytest.raises(SceneError, match="'start' is missing"):
        world_from_dict({"map": {"lower": [0, 0], "upper": [1, 1]}, "goal": [0, 0]})
    with pytest.raises(ProblemError, match="must not be negative"):
        random_wall(-1)


@given(st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_random_walls_are_repeatable_and_keep_start_and_goal_free(seed: int) -> None:
    wall = random_wall(seed)
    assert wall == random_wall(seed)
    assert wall.impermeable
    space = wall.space().handle()
    assert one(space, np.array(wall.start)) == 0.0
    assert one(space, np.array(wall.goal)) == 0.0
