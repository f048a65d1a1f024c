"""Runs the real planner node with the fake pipeline: a program for tests."""

from __future__ import annotations

import os
import sys

from ros_fakes import FakePipeline, FakeRobot

from lime_planner.ros.execution import output
from lime_planner.ros.model_loader import Loaded
from lime_planner.ros.nodes import planner_node
from lime_planner.ros.runtime import run_node


def build(settings: object, urdf: str | None) -> Loaded:
    """Build with the delays of the environment."""
    robot = FakeRobot()
    warm_up_s, duration_s = (float(os.environ.get(name, value)) for name, value in (("FAKE_WARM_UP_S", "0"), ("FAKE_DURATION_S", "0.5")))
    return Loaded(robot, FakePipeline(robot, warm_up_s, duration_s=duration_s))


if __name__ == "__main__":
    output._CANCEL_AFTER_S = float(os.environ.get("FAKE_CANCEL_AFTER_S", output._CANCEL_AFTER_S))
    # No meshes, no filter.
    planner_node.make_arm_filter = lambda robot: lambda scene, q, padding_m: scene
    sys.exit(run_node(lambda: planner_node.PlannerNode(build)))
