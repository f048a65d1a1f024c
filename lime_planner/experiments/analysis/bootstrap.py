"""Percentile bootstrap intervals for statistics without a formula: medians of ratios, differences of shares, ratios of means."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lime_planner.core.types import Array

RESAMPLES = 1000
SEED = 20_190  # the intervals are part of the tables: the same data give the same ones


@dataclass(frozen=True)
class Estimate:
    """A statistic of the data, and its 95 % bootstrap interval."""

    value: float
    low: float
    high: float

    def text(self, digits: int = 2, scale: float = 1.0) -> str:
        """Return `value (low to high)`."""
        return f"{scale * self.value:.{digits}f} ({scale * self.low:.{digits}f} to {scale * self.high:.{digits}f})"


def median(values: Array) -> float:
    """The median, also of ratios of which some are infinite."""
    ordered = np.sort(values)
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    return float(low if low == high else 0.5 * (low + high))


def _percentiles(values: Array) -> tuple[float, float]:
    # Infinite values (a ratio to nothing) are ordered like others, not interpolated with.
    low, high = np.quantile(np.sort(values), (0.025, 0.975), method="nearest")
    return float(low), float(high)


def by_cluster(groups: Sequence[Array], statistic: Callable[[Array], float]) -> Estimate:
    """Estimate a statistic of rows that belong together in groups: whole groups are drawn, since their rows are no independent draws.

    Args:
        groups: for each group (a plant, say) its rows (m,) or (m, k); empty groups do not count.
        statistic: of all rows together.
    """
    rows = [np.asarray(g, dtype=np.float64) for g in groups if len(g)]
    if not rows:
        return Estimate(float("nan"), float("nan"), float("nan"))
    rng = np.random.default_rng(SEED)
    drawn = [statistic(np.concatenate([rows[i] for i in rng.integers(len(rows), size=len(rows))])) for _ in range(RESAMPLES)]
    return Estimate(statistic(np.concatenate(rows)), *_percentiles(np.array(drawn)))


def by_plant(trials: Sequence[dict[str, Any]], row: Callable[[dict[str, Any]], float | None]) -> list[Array]:
    """Return one number for each trial, in one array for each of their scenes, for `by_cluster`; None leaves a trial out."""
    groups: dict[str, list[float]] = {}
    for trial in trials:
        value = row(trial)
        if value is not None:
            groups.setdefault(trial["scene"], []).append(value)
    return [np.array(values) for values in groups.values()]


def independent(samples: Sequence[Array], statistic: Callable[..., Any]) -> Estimate:
    """Estimate a statistic of several independent samples, each resampled by itself.

    Args:
        samples: (n,) each.
        statistic: `statistic(first, second, ...)` of arrays (..., n), over their last axis.
    """
    rows = [np.asarray(s, dtype=np.float64) for s in samples]
    if any(len(s) == 0 for s in rows):
        return Estimate(float("nan"), float("nan"), float("nan"))
    rng = np.random.default_rng(SEED)
    drawn = statistic(*(s[rng.integers(len(s), size=(RESAMPLES, len(s)))] for s in rows))
    return Estimate(float(statistic(*rows)), *_percentiles(np.asarray(drawn)))
