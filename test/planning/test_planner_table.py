"""Every planner of the table keeps the protocol, and the one that the documentation shows is a planner."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import PARAMETERS, settings_from
from lime_planner.core.planners import DEFAULT_PLANNER, PLANNERS
from lime_planner.core.status import Status
from lime_planner.planning.planner import Query, load_planner
from lime_planner.planning.spaces.plane import PlaneWorld

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"


def test_the_parameter_offers_the_table() -> None:
    assert PARAMETERS["planner"].choices == tuple(PLANNERS)
    assert PARAMETERS["planner"].default == DEFAULT_PLANNER
    with pytest.raises(ParameterError, match=r"'dijkstra'.*lime_star"):
        load_planner("dijkstra")


@pytest.mark.parametrize("name", PLANNERS)
def test_a_planner_keeps_the_protocol(name: str) -> None:
    planner = load_planner(name)
    assert planner.name == name
    assert re.fullmatch(r"[^.].*[a-z)]\.", planner.summary, re.DOTALL)
    wall = ((40.0, 20.0), (60.0, 20.0), (60.0, 80.0), (40.0, 80.0))
    world = PlaneWorld("wall", (0.0, 0.0), (100.0, 100.0), start=(10.0, 50.0), goal=(90.0, 50.0), impermeable=(wall,))
    start, goals = np.array([10.0, 50.0]), np.array([[50.0, 50.0], [90.0, 50.0], [90.0, 90.0]])  # the first one is in the wall
    options = planner.options(settings_from({"planner": name, "step_rad": 1.0, "goal_radius_rad": 5.0}))
    first, again = (planner.run(Query(world.space(), start, goals, 7, iterations=2000), options) for _ in range(2))
    assert first.status is Status.SUCCEEDED and first.path is not None and again.path is not None
    assert first.iterations >= 2000 and first.checks > 0
    np.testing.assert_array_equal(first.path, again.path)
    np.testing.assert_array_equal(first.path[0], start)
    assert np.abs(goals[1:] - first.path[-1]).max(axis=1).min() == 0.0
    tree = first.tree()
    assert len(tree.edges) == len(tree.leafy) and tree.edges.max(initial=-1) < len(tree.configurations)
    if planner.anytime:
        assert len(first.history) and all(b[2] < a[2] for a, b in itertools.pairwise(first.history))
    stopped = planner.run(Query(world.space(), start, goals, 7, should_stop=lambda: True), options)
    assert stopped.status is Status.CANCELLED
    if planner.anytime:  # impatient where no way leads, and only there
        across = PlaneWorld(
            "across",
            (0.0, 0.0),
            (100.0, 100.0),
            start=(10.0, 50.0),
            goal=(90.0, 50.0),
            impermeable=(((40.0, -1.0), (60.0, -1.0), (60.0, 101.0), (40.0, 101.0)),),
        )
        short = planner.run(Query(across.space(), start, goals[1:], 7, iterations=4000, patience=0.25), options)
        assert short.path is None and short.status is Status.NO_PATH and 1000 <= short.iterations < 2500
        assert planner.run(Query(world.space(), start, goals[1:], 7, iterations=4000, patience=0.25), options).iterations >= 4000
    late = planner.run(Query(world.space(), start, goals[:1], 7, deadline_s=0.05), options)
    assert late.status is Status.GOAL_IN_STEM and late.path is None


_RUN_THE_PAGES_PLANNER = """
import sys
import numpy as np
import lime_planner.planning
from lime_planner.core.planners import PLANNERS
lime_planner.planning.__path__.append(sys.argv[1])
PLANNERS |= eval("{" + sys.argv[2] + "}")
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import settings_from
from lime_planner.pipeline import Pipeline
from lime_planner.robot.model import home, load_robot
from lime_planner.scene.plants.generator import generate_plant
scene, robot = generate_plant(np.random.default_rng(7)), load_robot("kinova_j2s6s200")
for iterations in (400, 1000, 1000):
    settings = settings_from({"planner": "via_point", "iterations": iterations})
    result = Pipeline(robot).plan(scene, pose_to_matrix(scene.target_pose), home(robot), settings, seed=1)
    print(result.status.name, result.planner, result.cost_metric, result.iterations, result.cost)
"""


def test_the_planner_of_the_page_plans(tmp_path: Path) -> None:
    section = PAGE.read_text(encoding="utf-8").split("\n## A planner\n")[1].split("\n## ")[0]
    entry, line = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    assert 30 < len([text for text in entry.splitlines() if text.strip()]) <= 50
    folder = tmp_path / "via_point"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "entry.py").write_text(entry, encoding="utf-8")
    arguments = [sys.executable, "-c", _RUN_THE_PAGES_PLANNER, str(tmp_path), line.strip()]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    short, long, again = (text.split() for text in done.stdout.splitlines())
    assert [short[:3], long[:3]] == [["SUCCEEDED", "via_point", "integral"]] * 2, done.stdout
    assert float(long[4]) <= float(short[4]) and long == again
