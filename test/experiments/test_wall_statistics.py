"""The tests of the wall experiment against SciPy and against data with a known answer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from lime_planner.experiments.analysis.statistics import against_zero, long_table, mean_interval, mixed_anova, post_hoc, welch

MARKS = (1000, 2500, 5000)


def made(rng: np.random.Generator, shift: float, slope: float, n: int = 40) -> np.ndarray:
    subject = rng.normal(0.0, 5.0, size=(n, 1))
    return 900.0 + shift + slope * np.arange(3) + subject + rng.normal(0.0, 10.0, size=(n, 3))


def test_welch_agrees_with_scipy(rng: np.random.Generator) -> None:
    a, b = rng.normal(0.0, 1.0, 30), rng.normal(0.8, 3.0, 50)
    a[3] = np.nan  # a failed trial
    c = welch("a", "b", a, b)
    expected = stats.ttest_ind(a[np.isfinite(a)], b, equal_var=False)
    interval = expected.confidence_interval(0.95)
    assert (c.t, c.dof, c.p) == pytest.approx((expected.statistic, expected.df, expected.pvalue), rel=1e-6)
    assert (c.low, c.high) == pytest.approx((interval.low, interval.high))
    assert c.low < c.difference < c.high
    n1, n2 = 29, 50
    pooled = np.sqrt(((n1 - 1) * np.nanvar(a, ddof=1) + (n2 - 1) * b.var(ddof=1)) / (n1 + n2 - 2))
    assert c.hedges_g == pytest.approx(c.difference / pooled * (1 - 3 / (4 * (n1 + n2) - 9)), rel=1e-3)


def test_a_mean_against_zero_agrees_with_scipy(rng: np.random.Generator) -> None:
    values = rng.normal(0.4, 1.0, 12)
    expected = stats.ttest_1samp(values, 0.0)
    interval = expected.confidence_interval(0.95)
    found = against_zero(values)
    assert found is not None
    assert (found.mean, found.t, found.dof, found.p) == pytest.approx((values.mean(), expected.statistic, 11, expected.pvalue))
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high))
    assert against_zero(values[:1]) is None
    alike = against_zero(np.zeros(5))  # pairs that do not differ at all
    assert alike is not None and (alike.low, alike.mean, alike.high) == (0.0, 0.0, 0.0) and np.isnan(alike.p)


def test_mixed_anova_between_effect_is_the_anova_of_trial_means(rng: np.random.Generator) -> None:
    costs = {"a": made(rng, 0.0, -20.0), "b": made(rng, 15.0, -20.0)}
    effects = {e.source: e for e in mixed_anova(costs, MARKS)}
    expected = stats.f_oneway(costs["a"].mean(axis=1), costs["b"].mean(axis=1))
    assert pytest.approx(expected.statistic, rel=1e-6) == effects["algorithm"].F
    assert effects["algorithm"].p == pytest.approx(expected.pvalue, rel=1e-6)
    assert (effects["algorithm"].df1, effects["algorithm"].df2) == (1, 78)
    assert (effects["iterations"].df1, effects["iterations"].df2) == (2, 156)
    assert effects["iterations"].p < 1e-6
    assert effects["Interaction"].p > 0.01
    assert 0.5 <= effects["iterations"].epsilon <= 1.0


def test_sphericity_correction_raises_p(rng: np.random.Generator) -> None:
    costs = {"a": made(rng, 0.0, -1.0), "b": made(rng, 0.0, -1.0)}
    for table in costs.values():
        table[:, 2] += rng.normal(0.0, 60.0, size=len(table))  # variances of the differences far from equal
    e = {e.source: e for e in mixed_anova(costs, MARKS)}["iterations"]
    assert e.epsilon < 0.7
    assert e.p == pytest.approx(stats.f.sf(e.F, e.df1 * e.epsilon, e.df2 * e.epsilon), rel=1e-3)


def test_interaction_is_found(rng: np.random.Generator) -> None:
    costs = {"a": made(rng, 0.0, 0.0), "b": made(rng, 0.0, -30.0)}
    assert {e.source: e.p for e in mixed_anova(costs, MARKS)}["Interaction"] < 0.001


def test_post_hoc_is_holm_corrected(rng: np.random.Generator) -> None:
    costs = {"a": made(rng, 0.0, -10.0), "b": made(rng, 3.0, -10.0), "c": made(rng, 40.0, -10.0)}
    records = [r for r in post_hoc(costs, MARKS) if r["Contrast"] == "algorithm"]
    uncorrected = sorted(r["p_unc"] for r in records)
    assert min(r["p_corr"] for r in records) == pytest.approx(min(1.0, 3 * uncorrected[0]))
    assert len(records) == 3
    assert len(post_hoc(costs, MARKS)) == 3 + 3 + 9


def test_trials_with_a_failure_are_left_out_whole(rng: np.random.Generator) -> None:
    costs = {"a": made(rng, 0.0, 0.0, 5), "b": made(rng, 0.0, 0.0, 5)}
    costs["a"][2, 0] = np.nan
    table = long_table(costs, MARKS)
    assert len(table) == 3 * 9
    assert "a/2" not in set(table["trial"])


def test_mean_interval() -> None:
    x = np.array([1.0, 2.0, 3.0, np.nan])
    mean, error, half = mean_interval(x)
    assert (mean, error) == pytest.approx((2.0, 1.0 / np.sqrt(3)))
    assert half == pytest.approx(error * stats.t.ppf(0.975, 2))
    assert np.isnan(mean_interval(np.array([1.0]))[1])
    assert np.isnan(mean_interval(np.array([np.nan]))[0])
