"""Signals at random moments, a few of them; `python -m benchmarks.node.shutdown` sends hundreds."""

from __future__ import annotations

import os

import pytest
from domains import DOMAIN
from ros_harness import ROOT

from benchmarks.node.shutdown import SIGNALS, run

pytestmark = pytest.mark.timed


def test_every_signal_ends_the_node_cleanly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    outcomes = run(1, seed=os.getpid(), domain=DOMAIN, longest_s=1.0, real_share=0.0)
    assert {name: dict(counts) for name, counts in outcomes.items()} == {name: {"clean": 1} for name in SIGNALS}
