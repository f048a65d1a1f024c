"""Searches side by side: the same result whatever the timing, what they tell each other, and how they end."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.core.elsewhere import usable_cores
from lime_planner.core.parameters import settings_from
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.search import threads_of
from lime_planner.planning.lime_star import side_by_side
from lime_planner.planning.lime_star.planner import LimeOptions, LimeOutcome, plan_lime
from lime_planner.planning.lime_star.run import Run
from lime_planner.planning.space import one
from lime_planner.planning.spaces.plane import PlaneWorld

START, GOALS = np.array([10.0, 50.0]), np.array([[90.0, 50.0], [90.0, 90.0], [55.0, 52.0]])
_STEM = ((30.0, 20.0), (35.0, 20.0), (35.0, 80.0), (30.0, 80.0))
_LEAVES = tuple(((x, y), (x + 9.0, y), (x + 9.0, y + 9.0), (x, y + 9.0)) for x in (40.0, 52.0, 64.0) for y in range(0, 100, 10))
WORLD = PlaneWorld("foliage", (0.0, 0.0), (100.0, 100.0), start=(10.0, 50.0), goal=(90.0, 50.0), impermeable=(_STEM,), permeable=_LEAVES)


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let searches meet often: on the plane they check little."""
    monkeypatch.setattr(side_by_side, "CHECKS", 1500)


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    yield
    assert [t.name for t in threading.enumerate() if t.name.startswith("search ")] == []


def solve(threads: int, seed: int = 5, **limits: Any) -> LimeOutcome:
    given = {"iterations": 3000, "another_space": WORLD.space, **limits}
    return plan_lime(WORLD.space(), START, GOALS, LimeOptions(weight=30.0), seed, threads=threads, **given)


def test_the_same_result_whatever_the_timing(monkeypatch: pytest.MonkeyPatch) -> None:
    meetings: list[int] = []
    meet = side_by_side.Exchange.meet

    def slowly(self: Any, own: int, run: Run) -> None:
        meetings.append(own)
        time.sleep(float(rng.uniform(0.0, 0.02)))  # now one search is ahead, now another
        meet(self, own, run)

    monkeypatch.setattr(side_by_side.Exchange, "meet", slowly)
    alone = plan_lime(WORLD.space(), START, GOALS, LimeOptions(weight=30.0), 5, iterations=3000)
    costs = []
    for threads in (1, 2, 4):
        first: LimeOutcome | None = None
        for number in range(3):
            rng = np.random.default_rng(number)
            meetings.clear()
            outcome = solve(threads)
            assert outcome.status is Status.SUCCEEDED and outcome.path is not None
            assert set(meetings) == (set(range(threads)) if threads > 1 else set())
            if first is not None:
                np.testing.assert_array_equal(outcome.path, first.path)
                assert (outcome.cost, outcome.iterations, outcome.states_checked) == (first.cost, first.iterations, first.states_checked)
            first = outcome
        if threads == 1:
            np.testing.assert_array_equal(first.path, alone.path)
        assert first.history[-1, 2] == first.cost and (np.diff(first.history[:, 2]) < 0.0).all()
        costs.append(first.cost)
    assert max(costs[1:]) <= costs[0] * (1.0 + 1e-3)


def run_of(seed: int, rounds: int) -> Run:
    """A search of some rounds."""
    from lime_planner.planning.lime_star import planner

    space = WORLD.space()
    run = Run(space, START, GOALS, np.zeros(3), LimeOptions(weight=30.0), seed, None, lambda run: run.rounds >= rounds)
    run.start_leaf, run.goal_leaf = one(space, START), np.array([one(space, g) for g in GOALS])
    planner._search(run, lambda _: None)
    return run


def test_what_one_found_the_others_know() -> None:
    ahead, behind = run_of(1, 12), run_of(2, 0)
    behind._over = lambda _: False
    found = side_by_side.findings_of(ahead)
    assert found.cost < behind.best_cost
    kept: Array = behind.exits.cost.copy()
    side_by_side.take_up(behind, found)
    assert behind.best_cost == pytest.approx(found.cost, rel=1e-9) and behind.best_path is not None
    np.testing.assert_array_equal(behind.best_path, found.path)
    assert behind.best_cost in behind.tracks.cost and behind.history[-1][2] == behind.best_cost
    np.testing.assert_array_equal(behind.exits.cost, np.minimum(kept, found.costs))
    before = behind.history.copy()
    side_by_side.take_up(behind, side_by_side.findings_of(run_of(3, 0)))  # nothing that is worse
    assert behind.history == before


def test_gains_of_two_searches_on_one_path_are_joined() -> None:
    nothing = np.zeros((0, 2)), np.zeros(0)

    def found(points: Array, segments: Array) -> side_by_side.Findings:
        return side_by_side.Findings(float(segments.sum()) + 1.5, points, segments, *nothing)

    points = np.array([[0.0, 0.0], [1.0, 3.0], [2.0, 0.0], [3.0, 3.0], [4.0, 0.0]])
    own, other = points.copy(), np.insert(points, 4, [3.5, 1.0], axis=0)
    own[1], other[3] = [1.0, 1.0], [3.0, 1.0]
    one_side = found(own, np.array([1.0, 1.0, 4.0, 4.0]))
    other_side = found(other, np.array([4.0, 4.0, 1.0, 0.5, 0.5]))
    for first, second in ((one_side, other_side), (other_side, one_side)):
        path, cost = side_by_side.spliced(first, second)
        np.testing.assert_array_equal(path, np.array([[0, 0], [1, 1], [2, 0], [3, 1], [3.5, 1], [4, 0]]))
        assert cost == pytest.approx(2.0 + 2.0 + 1.5)
    elsewhere = found(np.array([[0.0, 0.0], [9.0, 9.0]]), np.array([3.0]))
    assert side_by_side.spliced(one_side, elsewhere)[1] == 4.5
    assert side_by_side.spliced(elsewhere, one_side)[0].shape == (2, 2)


def test_ends() -> None:
    asked: set[int] = set()

    def stop() -> bool:
        asked.add(threading.get_ident())
        return False

    assert solve(3, should_stop=stop).status is Status.SUCCEEDED
    assert asked == {threading.get_ident()}
    assert solve(3, should_stop=lambda: True).status is Status.CANCELLED
    without = plan_lime(WORLD.space(), START, GOALS, LimeOptions(weight=30.0), 5, iterations=3000, threads=3)
    np.testing.assert_array_equal(without.path, solve(1).path)  # no further space, no further thread
    with pytest.raises(MemoryError, match="of another thread"):
        solve(3, another_space=lambda: (_ for _ in ()).throw(MemoryError("of another thread")))
    with pytest.raises(KeyboardInterrupt):
        solve(3, should_stop=lambda: (_ for _ in ()).throw(KeyboardInterrupt))


@pytest.mark.timed
@pytest.mark.parametrize("threads", [1, 2, 4])
def test_stops_at_once_and_keeps_its_deadline(threads: int) -> None:
    solve(threads)
    late, overdue = [], []
    for _ in range(4):  # on a machine that others use, now and then one is late
        began_s = time.monotonic()
        outcome = solve(threads, iterations=None, deadline_s=0.4)
        assert outcome.status is Status.SUCCEEDED
        overdue.append(time.monotonic() - began_s - 0.4)
        began_s = time.monotonic()
        outcome = solve(threads, iterations=None, should_stop=lambda began_s=began_s: time.monotonic() - began_s > 0.3)
        assert outcome.status is Status.CANCELLED and outcome.path is not None
        late.append(time.monotonic() - began_s - 0.3)
    assert min(overdue) > -0.01 and sorted(overdue)[1] < 0.04
    assert sorted(late)[1] < 0.05


def test_how_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import lime_planner.pipeline.search as module

    for cores, expected in ((1, 1), (2, 1), (4, 3), (64, 8)):
        monkeypatch.setattr(module, "usable_cores", lambda cores=cores: cores)
        assert threads_of(settings_from({})) == expected
        assert threads_of(settings_from({"iterations": 500})) == 1
        assert threads_of(settings_from({"iterations": 500, "threads": 4})) == 4
    everything = usable_cores(tmp_path)
    (tmp_path / "cpu.max").write_text("max 100000\n")
    assert usable_cores(tmp_path) == everything >= 1
    (tmp_path / "cpu.max").write_text("100000 100000\n")
    assert usable_cores(tmp_path) == 1
    (tmp_path / "cpu.max").write_text("10000 100000\n")
    assert usable_cores(tmp_path) == 1
    (tmp_path / "cpu.max").unlink()
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu" / "cpu.cfs_period_us").write_text("100000\n")
    for quota, expected in (("-1", everything), ("150000", 1)):
        (tmp_path / "cpu" / "cpu.cfs_quota_us").write_text(quota)
        assert usable_cores(tmp_path) == expected
