"""The paper's tests (section IV), by pingouin: mixed ANOVA, post-hoc comparisons, t-tests, effect sizes, confidence intervals."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lime_planner.core.types import Array


@dataclass(frozen=True)
class Effect:
    """One line of an ANOVA table.

    Attributes:
        source: factor, or "Interaction".
        df1: degrees of freedom of the effect, uncorrected.
        df2: of its error.
        F: statistic.
        p: p-value, Greenhouse-Geisser corrected where the iterations take part (the within factor has three or more levels).
        eta_squared: partial η².
        epsilon: Greenhouse-Geisser ε, NaN for the between factor.
    """

    source: str
    df1: int
    df2: int
    F: float
    p: float
    eta_squared: float
    epsilon: float


@dataclass(frozen=True)
class Comparison:
    """An unpaired two-tailed t-test of a against b with Welch's correction.

    Attributes:
        a: first group.
        b: second group.
        difference: mean of a minus mean of b.
        low: lower end of the difference's 95 % confidence interval.
        high: its upper end.
        t: statistic.
        dof: Welch's degrees of freedom.
        p: p-value.
        hedges_g: effect size.
    """

    a: str
    b: str
    difference: float
    low: float
    high: float
    t: float
    dof: float
    p: float
    hedges_g: float


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    # pingouin 0.7 uses what pandas 4 will drop, and its Bayes factors, which are not used here, overflow on clear differences.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", FutureWarning)
        warnings.filterwarnings("ignore", category=RuntimeWarning, module="pingouin")
        yield


def long_table(costs: dict[str, Array], marks: Sequence[int]) -> Any:
    """Return a data frame with one line for each trial and mark; trials with a failure at any mark are left out whole.

    Args:
        costs: for each algorithm, (trials, marks), NaN for failures.
        marks: iterations.
    """
    import pandas as pd  # type: ignore[import-untyped, unused-ignore]

    lines = [
        (f"{name}/{trial}", name, int(mark), float(value))
        for name, values in costs.items()
        for trial, row in enumerate(values)
        if np.isfinite(row).all()
        for mark, value in zip(marks, row, strict=True)
    ]
    return pd.DataFrame(lines, columns=["trial", "algorithm", "iterations", "cost"])


def mixed_anova(costs: dict[str, Array], marks: Sequence[int]) -> list[Effect]:
    """Two-way mixed ANOVA: iterations within trials, algorithm between them, with the Greenhouse-Geisser correction.

    Args:
        costs: for each algorithm (two or more), (trials, marks), NaN for failures.
        marks: iterations (two or more).
    """
    import pingouin  # type: ignore[import-untyped, unused-ignore]

    with _quiet():
        table = pingouin.mixed_anova(
            data=long_table(costs, marks), dv="cost", within="iterations", subject="trial", between="algorithm", correction=True
        )
    effects = []
    for line in table.to_dict("records"):
        corrected = float(line.get("p_GG_corr", np.nan))
        effects.append(
            Effect(
                source=str(line["Source"]),
                df1=int(line["DF1"]),
                df2=int(line["DF2"]),
                F=float(line["F"]),
                p=corrected if np.isfinite(corrected) else float(line["p_unc"]),
                eta_squared=float(line["np2"]),
                epsilon=float(line.get("eps", np.nan)),
            )
        )
    return effects


def post_hoc(costs: dict[str, Array], marks: Sequence[int]) -> list[dict[str, Any]]:
    """All pairwise comparisons after the ANOVA, Holm-corrected within each family.

    Returns:
        Records with Contrast, A, B (and iterations for simple effects), T, dof, p_corr and hedges.
    """
    import pingouin  # type: ignore[import-untyped, unused-ignore]

    with _quiet():
        table = pingouin.pairwise_tests(
            data=long_table(costs, marks),
            dv="cost",
            within="iterations",
            subject="trial",
            between="algorithm",
            padjust="holm",
            effsize="hedges",
            correction=True,
        )
    return [{str(k): v for k, v in line.items()} for line in table.to_dict("records")]


def welch(a: str, b: str, first: Array, second: Array) -> Comparison:
    """Compare two groups of costs; NaN (failures) are left out.

    Args:
        a: name of the first group.
        b: name of the second.
        first: costs, (trials,).
        second: costs, (trials,).
    """
    import pingouin  # type: ignore[import-untyped, unused-ignore]

    x, y = first[np.isfinite(first)], second[np.isfinite(second)]
    with _quiet():
        line = pingouin.ttest(x, y, paired=False, alternative="two-sided", correction=True).to_dict("records")[0]
    low, high = _confidence_interval(x, y)
    return Comparison(
        a=a,
        b=b,
        difference=float(x.mean() - y.mean()),
        low=low,
        high=high,
        t=float(line["T"]),
        dof=float(line["dof"]),
        p=float(line["p_val"]),
        hedges_g=float(pingouin.compute_effsize(x, y, eftype="hedges")),
    )


@dataclass(frozen=True)
class MeanTest:
    """A two-tailed one-sample t-test of a mean against 0.

    Attributes:
        mean: of the values.
        low: lower end of the mean's 95 % confidence interval.
        high: its upper end.
        t: statistic, NaN where the values do not differ.
        dof: degrees of freedom.
        p: p-value.
    """

    mean: float
    low: float
    high: float
    t: float
    dof: int
    p: float


def against_zero(values: Array) -> MeanTest | None:
    """Test the mean of logarithms of ratios, or of paired differences, against 0; None with fewer than two values.

    Args:
        values: (n,).
    """
    if len(values) < 2:
        return None
    mean, error, half = mean_interval(values)
    if error == 0.0:  # all alike: the interval is a point, and there is nothing to test with
        return MeanTest(mean, mean, mean, float("nan"), len(values) - 1, float("nan"))
    from scipy import stats

    found = stats.ttest_1samp(values, 0.0)
    return MeanTest(mean, mean - half, mean + half, float(found.statistic), len(values) - 1, float(found.pvalue))


def _confidence_interval(x: Array, y: Array) -> tuple[float, float]:
    # pingouin rounds its interval to two digits, so it is taken from SciPy.
    from scipy import stats

    interval = stats.ttest_ind(x, y, equal_var=False).confidence_interval(0.95)
    return float(interval.low), float(interval.high)


def mean_interval(values: Array) -> tuple[float, float, float]:
    """Return mean, standard error and half the width of the mean's 95 % confidence interval, NaN left out."""
    from scipy import stats

    x = values[np.isfinite(values)]
    if len(x) < 2:
        return (float(x.mean()) if len(x) else float("nan")), float("nan"), float("nan")
    error = float(x.std(ddof=1) / np.sqrt(len(x)))
    return float(x.mean()), error, error * float(stats.t.ppf(0.975, len(x) - 1))
