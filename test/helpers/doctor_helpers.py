"""What the tests of `lime-planner doctor` share."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from domains import DOMAIN

from lime_planner.cli import main as cli
from lime_planner.doctor.machine import shipped_profile

Findings = dict[str, dict[str, str]]
Doctor = Callable[..., tuple[int, Findings]]


@pytest.fixture(autouse=True)
def surroundings(monkeypatch: pytest.MonkeyPatch) -> None:
    """A good environment, whatever the tests' own is."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(shipped_profile()))
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)


@pytest.fixture(name="doctor")
def doctor_fixture(capsys: pytest.CaptureFixture[str]) -> Doctor:
    def examine(*arguments: Any) -> tuple[int, Findings]:
        code = cli.main(["doctor", "--json", "-", *map(str, arguments)])
        answer = json.loads(capsys.readouterr().out)
        assert answer["ok"] is (code == 0)
        return code, {finding["check"]: finding for finding in answer["findings"]}

    return examine


def assert_named(findings: Findings, check: str, *words: str, level: str = "fault") -> None:
    finding = findings[check]
    assert finding["level"] == level, finding
    assert all(word in finding["sentence"] for word in words), finding
    assert finding["cure"], finding
    assert all("\n" not in text for text in finding.values())
