"""Spaces made of functions: the plane expressed so gives what the built-in plane gives."""

from __future__ import annotations

import functools
import gc
import math
import threading
from typing import Any

import numba
import numpy as np
import pytest

from lime_planner.core.errors import ProblemError
from lime_planner.core.parameters import settings_from
from lime_planner.core.planners import PLANNERS
from lime_planner.core.status import Status
from lime_planner.planning.planner import Query, load_planner
from lime_planner.planning.rrt_star.planner import PaperOptions, plan_paper
from lime_planner.planning.spaces.function_space import FIELD, ONE_CONFIGURATION, TWO_CONFIGURATIONS, FunctionSpace, function_space
from lime_planner.planning.spaces.plane import PlaneWorld, wall_g

STEM = ((20.0, 60.0), (30.0, 60.0), (30.0, 100.0), (20.0, 100.0))
WORLD = PlaneWorld("w", (0, 0), (100, 100), (10, 50), (90, 50), wall_g().permeable, (STEM,))


def valid(q: np.ndarray) -> bool:
    return not (20.0 < q[0] < 30.0 and 60.0 < q[1] < 100.0)


def leaf(q: np.ndarray) -> float:
    return float(abs(q[0] - 50.0) < (10.25 if abs(q[1] - 50.0) <= 30.0 else 7.25))


def euclidean(a: np.ndarray, b: np.ndarray) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


def c_valid(q: Any, n: int) -> float:
    return 0.0 if 20.0 < q[0] < 30.0 and 60.0 < q[1] < 100.0 else 1.0


def c_leaf(q: Any, n: int) -> float:
    return 1.0 if abs(q[0] - 50.0) < (10.25 if abs(q[1] - 50.0) <= 30.0 else 7.25) else 0.0


def c_distance(a: Any, b: Any, n: int) -> float:
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2)


def c_field(q: Any, force: Any, d_star: float, k_leaf: float, k_stem: float, n: int) -> float:
    force[0] += 0.0
    return 1e9


@functools.cache
def c_compiled(function: Any, signature: Any = ONE_CONFIGURATION) -> Any:
    """A C function of it; compiled where it is used, and not by all that collect the tests."""
    return numba.cfunc(signature)(function)


def plain() -> FunctionSpace:
    return function_space(WORLD.lower, WORLD.upper, valid=valid, cost=leaf, distance=euclidean, edge_step=0.05)


def compiled() -> FunctionSpace:
    return function_space(
        WORLD.lower,
        WORLD.upper,
        valid=c_compiled(c_valid),
        cost=c_compiled(c_leaf),
        distance=c_compiled(c_distance, TWO_CONFIGURATIONS),
        edge_step=0.05,
    )


def solve(space: Any, options: PaperOptions, iterations: int = 500) -> Any:
    return plan_paper(space, WORLD.start, WORLD.goal, options, 4, iterations=iterations)


@pytest.mark.parametrize("make", [plain, compiled])
@pytest.mark.parametrize("changes", [{}, {"propagate": True}, {"radius": "rrg"}])
def test_plane_of_functions_gives_the_same_tree(make: Any, changes: dict[str, Any]) -> None:
    options = PaperOptions(algorithm="rrt_star", **changes)
    ours, expected = solve(make(), options), solve(WORLD.space(), options)
    assert ours.path is not None
    np.testing.assert_array_equal(ours.tree.parent, expected.tree.parent)
    np.testing.assert_allclose(ours.path, expected.path, rtol=1e-12)  # a square root and a hypotenuse round differently
    assert ours.final.node_cost == pytest.approx(expected.final.node_cost, rel=1e-12)
    assert ours.final.integral_cost == pytest.approx(expected.final.integral_cost, rel=5e-3)


def test_integral_cost_on_functions_comes_close_to_the_exact_one() -> None:
    options = PaperOptions(algorithm="rrt_star", cost="integral", radius="rrg", propagate=True)
    ours, expected = solve(compiled(), options, 2000), solve(WORLD.space(), options, 2000)
    assert ours.final.integral_cost == pytest.approx(expected.final.integral_cost, rel=0.02)


def test_field_function_biases_the_search_as_the_built_in_one_does() -> None:
    from lime_planner.planning.spaces.plane_space import PERMEABLE

    def field(q: np.ndarray, force: np.ndarray, d_star: float, k_leaf: float, k_stem: float) -> float:
        smallest = math.inf
        for kind, polygon in ((PERMEABLE, WORLD.permeable[0]), (1, STEM)):
            inside = leaf(q) > 0.0 if kind == PERMEABLE else not valid(q)
            if inside:
                smallest = 0.0
                continue
            corners = np.array(polygon)
            best, point = math.inf, q
            for a, b in zip(np.roll(corners, 1, axis=0), corners, strict=True):
                t = float(np.clip((q - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0))
                d = float(np.linalg.norm(q - a - t * (b - a)))
                if d < best:
                    best, point = d, a + t * (b - a)
            smallest = min(smallest, best)
            if 0.0 < best <= d_star:
                gain = k_leaf if kind == PERMEABLE else k_stem
                force += gain * (1.0 / best - 1.0 / d_star) / best**3 * (q - point)
        return smallest

    space = function_space(WORLD.lower, WORLD.upper, valid=valid, cost=leaf, field=field)
    for algorithm in ("apf_rrt_star", "p_rrt_star"):
        options = PaperOptions(algorithm=algorithm)
        ours, expected = solve(space, options, 300), solve(WORLD.space(), options, 300)
        np.testing.assert_allclose(ours.tree.rows, expected.tree.rows, atol=1e-6)


def test_compiled_field_function_is_called() -> None:
    space = function_space(WORLD.lower, WORLD.upper, valid=c_compiled(c_valid), field=c_compiled(c_field, FIELD))
    assert solve(space, PaperOptions(), 500).path is not None


def test_metric_of_the_callers_own() -> None:
    def stretched(a: np.ndarray, b: np.ndarray) -> float:
        return math.hypot(2.0 * (a[0] - b[0]), a[1] - b[1])

    space = function_space((0, 0), (10, 10), valid=lambda q: True, distance=stretched)
    outcome = plan_paper(space, (1, 1), (9, 9), PaperOptions(algorithm="rrt_star", delta=2.0, propagate=True), 0, iterations=400)
    assert outcome.path is not None
    steps = [stretched(a, b) for a, b in zip(outcome.path, outcome.path[1:], strict=False)]
    assert outcome.final.length == pytest.approx(sum(steps))
    assert max(steps[:-1]) <= 2.0 + 1e-9


def test_functions_live_as_long_as_their_space() -> None:
    space = function_space((0, 0), (1, 1), valid=lambda q: bool(q[0] >= 0.0), cost=lambda q: float(q[1] > 0.5))
    gc.collect()
    assert plan_paper(space, (0.1, 0.1), (0.2, 0.2), PaperOptions(delta=0.1), 0, iterations=200).status is Status.SUCCEEDED


def test_exceptions_in_functions_reach_the_caller() -> None:
    def broken(q: np.ndarray) -> bool:
        if q[0] > 0.5:
            raise KeyError("no such leaf")
        return True

    space = function_space((0, 0), (1, 1), valid=broken)
    with pytest.raises(KeyError, match="no such leaf"):
        plan_paper(space, (0.1, 0.1), (0.2, 0.2), PaperOptions(algorithm="rrt_star", delta=0.1), 0, iterations=500)
    # The exception is delivered once; the space works afterwards.
    left = function_space((0, 0), (0.4, 1), valid=broken)
    assert plan_paper(left, (0.1, 0.1), (0.2, 0.2), PaperOptions(delta=0.1), 0, iterations=200).path is not None


@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize("at_once", [False, True])
def test_every_planner_hands_an_exception_on(name: str, at_once: bool) -> None:
    def broken(q: Any) -> bool:
        if at_once or 0.3 < q[0] < 0.4:
            raise KeyError("no such leaf")
        return True

    planner = load_planner(name)
    space = function_space((0, 0), (1, 1), valid=broken)
    query = Query(space, np.array([0.1, 0.1]), np.array([[0.8, 0.8]]), 1, iterations=500)
    with pytest.raises(KeyError, match="no such leaf"):
        planner.run(query, planner.options(settings_from({"planner": name})))


def test_python_functions_work_from_another_thread() -> None:
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(solve(plain(), PaperOptions(algorithm="rrt_star"), 300)))
    thread.start()
    thread.join()
    np.testing.assert_array_equal(found[0].tree.parent, solve(WORLD.space(), PaperOptions(algorithm="rrt_star"), 300).tree.parent)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lower": (0.0,)}, "equal length"),
        ({"lower": (5.0, 200.0)}, "below upper"),
        ({"lower": (math.nan, 0.0)}, "below upper"),
        ({"edge_step": 0.0}, "edge_step must be positive"),
        ({"valid": None}, "valid must be a callable"),
        ({"cost": 3}, "cost must be a callable"),
    ],
)
def test_malformed_spaces_are_refused(change: dict[str, Any], words: str) -> None:
    arguments = {"lower": (0.0, 0.0), "upper": (100.0, 100.0), "valid": valid, **change}
    with pytest.raises(ProblemError, match=words):
        function_space(arguments.pop("lower"), arguments.pop("upper"), **arguments)
