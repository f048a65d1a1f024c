"""The soak test in short, for both arms and both controllers, with a measured start several turns away."""

from __future__ import annotations

import pytest
from domains import DOMAIN

from benchmarks.node.soak import soak

pytestmark = pytest.mark.timed


@pytest.mark.parametrize(
    ("robot", "controller", "seconds"),
    [
        ("kinova_j2s6s200", "jtc", 5.0),
        ("kinova_j2n6s300", "kinova", 2.0),
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
