"""The soak test in short, for both arms behind both controllers, with a measured start several turns away."""

from __future__ import annotations

import os

import pytest

from benchmarks.node.soak import soak

pytestmark = pytest.mark.alone

DOMAIN = 1 + os.getpid() % 90


@pytest.mark.parametrize(
    ("robot", "controller", "seconds"),
    [
        ("kinova_j2s6s200", "jtc", 8.0),
        ("kinova_j2s6s200", "kinova", 1.0),
        ("kinova_j2n6s300", "jtc", 1.0),
        ("kinova_j2n6s300", "kinova", 3.0),
    ],
)
def test_every_answer_and_every_command_is_as_it_must_be(robot: str, controller: str, seconds: float) -> None:
    report = soak(
        requests=1000, seconds=seconds, seed=5, robot=robot, controller=controller, labelled=controller == "kinova", domain=DOMAIN
    )
    print(report)
    assert report["violations"] == []
    assert report["arrivals"] >= 1
    assert report["motions_judged"] >= 1
