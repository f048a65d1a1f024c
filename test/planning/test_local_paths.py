"""Polishing, tracks, restarts and informed samples of the default planner, on planar walls."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from lime_planner.planning.lime_star.alternatives import Restarts
from lime_planner.planning.lime_star.options import LimeOptions
from lime_planner.planning.lime_star.polish import polish
from lime_planner.planning.lime_star.run import Run
from lime_planner.planning.lime_star.tracks import Tracks, load_track, make_room, near_tracks, new_tracks, take_out
from lime_planner.planning.sampling import draw_between, random_state
from lime_planner.planning.space import line
from lime_planner.planning.spaces.plane import PlaneWorld, random_wall, wall_g

WEIGHT = 100.0 / 3.0


def free_plane() -> PlaneWorld:
    """A plane without obstacles, 100 by 100."""
    return PlaneWorld("free", (0.0, 0.0), (100.0, 100.0), (10.0, 10.0), (90.0, 60.0))


def load(space: Any, *paths: list[list[float]]) -> Tracks:
    """Tracks that hold the given paths, and one empty track more."""
    tracks = new_tracks(len(paths) + 1, 2)
    for t, path in enumerate(paths):
        assert load_track(space, tracks, t, np.array(path), len(path), 0.0, WEIGHT, 1.0, math.inf)
    return tracks


def points(tracks: Tracks, t: int = 0) -> np.ndarray:
    return tracks.points[t, : tracks.size[t]]


# --- informed samples -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("goal", [(60.0, 50.0), (20.0, 50.0), (40.0, 80.0), (51.0, 44.0)])
def test_informed_samples_fill_the_ellipse_evenly(goal: tuple[float, float]) -> None:
    space = free_plane().space().handle()
    a, b, bound = np.array([40.0, 50.0]), np.array(goal), 41.0
    random, q = random_state(3), np.zeros(2)
    drawn = []
    for _ in range(4000):
        volume = draw_between(space, a, b, bound, random, q)
        drawn.append(q.copy())
    apart = float(np.linalg.norm(b - a))

    def area(c: float) -> float:
        return math.pi / 4.0 * c * math.sqrt(c * c - apart * apart)

    assert volume == pytest.approx(area(bound) / 100.0**2)
    length = np.linalg.norm(np.array(drawn) - a, axis=1) + np.linalg.norm(np.array(drawn) - b, axis=1)
    assert length.max() <= bound + 1e-9
    np.testing.assert_allclose(np.mean(drawn, axis=0), 0.5 * (a + b), atol=0.8)
    for smaller in (apart + 0.3 * (bound - apart), apart + 0.7 * (bound - apart)):
        assert np.mean(length < smaller) == pytest.approx(area(smaller) / area(bound), abs=0.03)


@pytest.mark.parametrize("bound", [40.0, 50.0, math.inf, 500.0])
def test_no_informed_sample_where_none_is_of_use(bound: float) -> None:
    q = np.full(2, 7.0)
    space, a, b = free_plane().space().handle(), np.array([20.0, 50.0]), np.array([70.0, 50.0])
    assert draw_between(space, a, b, bound, random_state(1), q) == 0.0
    assert q.tolist() == [7.0, 7.0]


# --- tracks -----------------------------------------------------------------------------------------------------------------------


def test_waypoints_come_and_go() -> None:
    path = [[10.0, 10.0], [20.0, 15.0], [40.0, 30.0], [60.0, 30.0], [90.0, 60.0]]
    tracks = load(free_plane().space().handle(), path)
    before = tracks.segment[0, :4].copy()
    make_room(tracks, 0, 1, 2)
    assert tracks.size[0] == 7
    assert points(tracks)[[0, 1, 4, 5, 6]].tolist() == path
    assert tracks.segment[0, [0, 4, 5]].tolist() == before[[0, 2, 3]].tolist()
    take_out(tracks, 0, 1, 3)
    assert points(tracks).tolist() == [path[i] for i in (0, 1, 3, 4)]


def test_paths_are_compared_along_their_lengths() -> None:
    straight = [[10.0, 10.0], [90.0, 10.0]]
    same = [[10.0, 10.0], [30.0, 10.5], [31.0, 10.5], [90.0, 10.0]]
    above = [[10.0, 10.0], [50.0, 14.0], [90.0, 10.0]]
    elsewhere = [[10.0, 10.0], [90.0, 20.0]]
    tracks = load(free_plane().space().handle(), straight, same, above, elsewhere)
    space = free_plane().space().handle()
    assert near_tracks(space, tracks, 0, 1.0) == (1, 1)
    assert near_tracks(space, tracks, 0, 4.5) == (2, 2)  # the most expensive of them is named
    assert near_tracks(space, tracks, 0, 0.1) == (0, -1)
    assert near_tracks(space, tracks, 3, 5.0)[0] == 0
    assert near_tracks(space, tracks, 0, math.inf)[0] == 3  # the empty track is none


# --- polishing --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [0.0, 3e-4, 1e-2])
def test_polished_paths_are_sound_and_cheaper(tolerance: float) -> None:
    for wall in range(4):
        world = random_wall(wall)
        space = world.space().handle()
        run = run_of(world, [list(world.goal)])
        assert run.reach(np.asarray(world.goal), 2000)
        tracks, first = run.tracks, float(run.best_cost)
        t = int(np.argmin(tracks.cost))
        for seed in range(6):
            polish(space, tracks, t, 100, WEIGHT, run.least, run.most, tolerance, random_state(seed))
            path = points(tracks, t)
            segments = [line(space, a, b, WEIGHT, math.inf) for a, b in itertools.pairwise(path)]
            np.testing.assert_allclose(tracks.segment[t, : len(segments)], segments, rtol=1e-9)
            assert tracks.cost[t] == pytest.approx(sum(segments), rel=1e-9)
            np.testing.assert_array_equal(path[0], world.start)
            np.testing.assert_array_equal(path[-1], world.goal)
        assert tracks.cost[t] < first


def test_polishing_ends_at_the_straight_line_with_no_waypoint_to_spare() -> None:
    space = free_plane().space().handle()
    corners = [[10.0, 10.0], [20.0, 60.0], [35.0, 20.0], [50.0, 80.0], [70.0, 30.0], [90.0, 60.0]]
    tracks = load(space, corners)
    polish(space, tracks, 0, 2000, WEIGHT, 0.4, 14.0, 3e-4, random_state(5))
    assert tracks.cost[0] <= math.hypot(80.0, 50.0) * (1.0 + 1e-3)
    assert tracks.size[0] <= 3


# --- a run's tracks and restarts --------------------------------------------------------------------------------------------------


def run_of(world: PlaneWorld, goals: list[list[float]], seed: int = 1, **limits: Any) -> Run:
    start, options = np.asarray(world.start, dtype=float), LimeOptions(weight=WEIGHT)
    return Run(world.space(), start, np.array(goals), np.zeros(len(goals)), options, seed, **limits)


def adopt(run: Run, path: list[list[float]], **how: Any) -> int:
    run.path[: len(path)] = path
    return run.adopt(len(path), **how)


def test_tracks_do_not_all_become_one_path() -> None:
    run = run_of(free_plane(), [[90.0, 60.0], [10.0, 90.0]])
    other = adopt(run, [[10.0, 10.0], [5.0, 50.0], [10.0, 90.0]])
    for k in range(12):  # each one better than the one before, and nearly the same
        assert adopt(run, [[10.0, 10.0], [50.0, 38.0 - 0.1 * k], [90.0, 60.0]]) >= 0
    held = int(np.isfinite(run.tracks.cost[:-1]).sum())
    assert held == 4 and run.goal_vertex(other) == 2
    assert run.best_cost == pytest.approx(run.tracks.cost[:-1].min())
    # What is dearer than those nearly the same as it is not taken, though there is room.
    assert adopt(run, [[10.0, 10.0], [50.0, 38.5], [90.0, 60.0]]) == -1
    assert int(np.isfinite(run.tracks.cost[:-1]).sum()) == held


def test_a_restart_finds_the_nearer_goal() -> None:
    world = free_plane()
    run = run_of(world, [[15.0, 90.0], [40.0, 12.0]])
    assert adopt(run, [[10.0, 10.0], [15.0, 90.0]]) >= 0
    restarts = Restarts(len(run.goals))
    assert restarts.look(run)
    assert restarts.tried.tolist() == [0.0, 1.0]
    assert run.best_cost == pytest.approx(math.hypot(30.0, 2.0), rel=0.05)
    for _ in range(50):
        run.polish(int(np.argmin(run.tracks.cost)), 50)
    assert not restarts.look(run)  # nothing is left to be gained


def test_a_restart_is_heard_to_be_stopped() -> None:
    asked: list[int] = []

    def over(run: Run) -> bool:
        asked.append(run.iterations)
        return len(asked) > 2

    run = run_of(wall_g(), [list(wall_g().goal)], over=over)
    Restarts(len(run.goals)).look(run)
    assert len(asked) >= 3 and run.iterations <= 75
