"""Bootstrap intervals: their width, clusters, infinite ratios, and that they never change."""

from __future__ import annotations

import math

import numpy as np

from lime_planner.experiments.analysis.bootstrap import by_cluster, independent, median


def test_interval_of_a_mean_is_as_wide_as_theory_says() -> None:
    rows = np.random.default_rng(1).normal(5.0, 2.0, 200)
    estimate = by_cluster(list(rows[:, None]), lambda x: float(x.mean()))
    assert estimate.value == rows.mean()
    half = 1.96 * rows.std() / math.sqrt(200)
    assert abs((estimate.high - estimate.low) / (2.0 * half) - 1.0) < 0.1
    assert estimate == by_cluster(list(rows[:, None]), lambda x: float(x.mean()))


def test_rows_of_one_group_are_no_independent_draws() -> None:
    means = np.random.default_rng(2).normal(0.0, 1.0, 40)
    groups = [np.full(10, m) for m in means]
    together = by_cluster(groups, lambda x: float(x.mean()))
    alone = by_cluster(list(np.concatenate(groups)[:, None]), lambda x: float(x.mean()))
    assert together.high - together.low > 2.5 * (alone.high - alone.low)


def test_infinite_ratios_do_not_spoil_a_median() -> None:
    groups = [np.array([0.2, 0.4]), np.array([0.5]), np.array([math.inf]), np.zeros(0), np.array([0.3, 0.3])]
    estimate = by_cluster(groups, median)
    assert estimate.value == 0.35
    assert estimate.low >= 0.2
    assert not math.isnan(estimate.high)


def test_ratio_of_means_of_two_samples() -> None:
    rng = np.random.default_rng(3)
    estimate = independent([rng.normal(50.0, 5.0, 100), rng.normal(100.0, 5.0, 100)], lambda a, b: a.mean(axis=-1) / b.mean(axis=-1))
    assert estimate.low < 0.5 < estimate.high
    assert estimate.high - estimate.low < 0.05
    assert math.isnan(independent([np.zeros(0), np.ones(3)], lambda a, b: a.mean(axis=-1) / b.mean(axis=-1)).value)
    assert estimate.text(1, 100.0) == "49.3 (48.1 to 50.5)"
