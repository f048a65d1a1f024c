"""Timing on one core, with a fixed reference workload so that figures of different machines can be compared as ratios."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array

_TABLE_VALUES = 4_000_000  # 16 MB of float32, about a plant's distance field
REFERENCE_LOOPS = 200_000


@dataclass(frozen=True)
class Timing:
    """Times of one repeated operation [s], each sample the mean over a number of calls.

    Attributes:
        name: of the operation, in the JSON.
        words: the same for people.
        samples: (K,) seconds for one call.
        calls: calls behind each sample.
        target_s: what it must not exceed (its median), None if nothing is asked.
        note: what else should be known.
    """

    name: str
    words: str
    samples: Array
    calls: int
    target_s: float | None = None
    note: str = ""

    def quantile(self, share: float) -> float:
        """A quantile of the samples [s]; inf where runs failed."""
        return float(np.quantile(np.sort(self.samples), share, method="nearest"))

    @property
    def met(self) -> bool | None:
        """Whether the median keeps the target; None without one."""
        return None if self.target_s is None else self.quantile(0.5) <= self.target_s

    def to_dict(self, reference_s: float) -> dict[str, Any]:
        """JSON-ready; `ratio` is the median in units of the reference loop."""

        def number(value: float) -> float | None:
            return float(f"{value:.6g}") if np.isfinite(value) else None

        median = self.quantile(0.5)
        return {
            "name": self.name,
            "words": self.words,
            "median_s": number(median),
            "q05_s": number(self.quantile(0.05)),
            "q25_s": number(self.quantile(0.25)),
            "q75_s": number(self.quantile(0.75)),
            "q95_s": number(self.quantile(0.95)),
            "samples": len(self.samples),
            "calls_per_sample": self.calls,
            "failures": int((~np.isfinite(self.samples)).sum()),
            "ratio": number(median / reference_s),
            "target_s": self.target_s,
            "met": self.met,
            "note": self.note,
        }


@kernel
def _reference(table: Any, loops: int) -> float:
    """Interpolate at scattered places of a table and take roots: the mix of memory and arithmetic of a collision check."""
    total = 0.0
    place = np.uint64(88172645463325252)
    size = np.uint64(table.shape[0] - 1)
    for _ in range(loops):
        place ^= place << np.uint64(13)
        place ^= place >> np.uint64(7)
        place ^= place << np.uint64(17)
        i = (place >> np.uint64(11)) % size
        f = np.float64(place & np.uint64(1023)) / 1024.0
        value = table[i] * (1.0 - f) + table[i + np.uint64(1)] * f
        total += np.sqrt(value * value + f)
    return total


def repeat(
    name: str, words: str, function: Callable[[], Any], *, samples: int, calls: int = 1, target_s: float | None = None, note: str = ""
) -> Timing:
    """Time a function in this thread's processor time, once warm.

    Args:
        name, words: see `Timing`.
        function: what to time; `calls` operations are done in one call of it.
        samples: how often.
        calls: operations in one call.
        target_s: for one operation [s].
        note: see `Timing`.
    """
    function()
    spent = []
    for _ in range(samples):
        began = time.thread_time()
        function()
        spent.append((time.thread_time() - began) / calls)
    return Timing(name, words, np.array(spent), calls, target_s, note)


def reference_loop(samples: int = 30) -> Timing:
    """Time the reference workload; one operation is one step of it."""
    table = np.linspace(0.0, 1.0, _TABLE_VALUES).astype(np.float32)
    return repeat(
        "reference", "reference loop, one step", lambda: _reference(table, REFERENCE_LOOPS), samples=samples, calls=REFERENCE_LOOPS
    )


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    import numba

    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    load = os.getloadavg() if hasattr(os, "getloadavg") else (float("nan"),) * 3
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "load": [round(v, 2) for v in load],
        "python": platform.python_version(),
        "numba": numba.__version__,
        "numpy": np.__version__,
    }
