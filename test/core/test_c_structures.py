"""Tuples of arrays as structures in memory: compiled code reads back what was written."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numba.core.types as nt
import numpy as np
import pytest

from lime_planner.core.c_structures import address_of, caller, reader, to_memory, vector
from lime_planner.core.jit import c_function, hot_kernel


class Inner(NamedTuple):
    flags: np.ndarray
    few: bool
    many: int


class Outer(NamedTuple):
    rows: np.ndarray
    inner: Inner
    pair: tuple[float, float]
    share: float
    near: bool


def outer(rows: np.ndarray) -> Outer:
    return Outer(rows, Inner(np.array([3, 4], np.uint8), True, 7), (0.25, 0.5), 1.5, False)


read = reader(lambda: numba.typeof(outer(np.zeros((0, 2)))))


def _total_at(structure: Any, q: Any, n: Any) -> Any:
    whole = read(structure)
    total = whole.share + 100.0 * whole.inner.many + (1000.0 if whole.inner.few else 0.0) + (1e4 if whole.near else 0.0)
    total += whole.pair[0] * whole.pair[1] + whole.inner.flags[1] + whole.rows[1, 0] + whole.rows.shape[0]
    return total + vector(q, n)[n - 1]


call = caller(nt.float64, "iii")


@hot_kernel
def total(function, structure, q):
    return call(function, structure, address_of(q), q.shape[0])


def test_compiled_code_reads_what_was_written() -> None:
    value = outer(np.arange(6.0).reshape(3, 2))
    memory = to_memory(value, numba.typeof(value))
    function = c_function(nt.float64(nt.int64, nt.int64, nt.int64), _total_at)
    expected = 1.5 + 700.0 + 1000.0 + 0.125 + 4.0 + 2.0 + 3.0 + 0.75
    assert total(function.address, memory.ctypes.data, np.array([0.5, 0.75])) == expected


def test_what_compiled_code_does_not_expect_is_refused() -> None:
    expected = numba.typeof(outer(np.zeros((0, 2))))
    with pytest.raises(TypeError, match=r"rows: array\(float32"):
        to_memory(outer(np.zeros((1, 2), np.float32)), expected)
    with pytest.raises(numba.TypingError, match="contiguous float64 array"):
        total(0, 0, np.zeros((4, 2))[:, 0])
