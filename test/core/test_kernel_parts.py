"""Kernels that others call: compiled once, as parts of their callers, and by themselves only where Python calls them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.core.jit import copy_row, hot_kernel, inline_kernel, kernel


@inline_kernel
def _innermost(x: Any) -> Any:
    return 2.0 * x


@hot_kernel
def _inner(row: Any, k: Any, sign: Any) -> Any:
    return sign * _innermost(row[k])


@kernel
def _outer(rows: Any, small: Any) -> Any:
    first = np.empty(rows.shape[1])
    copy_row(rows[0], first)
    return _inner(first, 0, 1) + _inner(rows[1], small, -1.0) + _inner(rows[1], rows.shape[1] - 1, 0.5)


def test_a_kernel_is_compiled_alone_only_where_python_calls_it() -> None:
    rows = np.arange(6.0).reshape(2, 3) + 1.0
    assert _outer(rows, np.int32(1)) == 2.0 - 10.0 + 6.0
    if not _outer.stats.cache_hits:  # type: ignore[attr-defined]  # compiled here and not read from the disk
        signatures = list(_inner.part.overloads)  # type: ignore[attr-defined]
        # One for whole numbers of whatever size and whether constant, one for each type of the sign.
        assert sorted(str(signature[1:]) for signature in signatures) == ["(int64, float64)", "(int64, int64)"]
        assert len(_innermost.part.overloads) == 1  # type: ignore[attr-defined]
    assert not _inner.overloads and not _innermost.overloads  # type: ignore[attr-defined]
    assert _inner(rows[0], 2, 1.0) == 6.0
    assert len(_inner.overloads) == 1  # type: ignore[attr-defined]


def test_a_kernel_that_raises_inside_another_one_tells_so() -> None:
    @kernel
    def refuse(x: Any) -> Any:
        if x < 0.0:
            raise ValueError("below zero")
        return x

    @kernel
    def ask(x: Any) -> Any:
        return refuse(x) + 1.0

    assert ask(1.0) == 2.0
    try:
        ask(-1.0)
    except ValueError as error:
        assert "below zero" in str(error)
    else:
        raise AssertionError("nothing was raised")
