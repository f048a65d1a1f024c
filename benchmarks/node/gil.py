"""Measures which part of a plan keeps Python's lock from other threads, and how long.

    python -m benchmarks.node.gil --plans 20

Plans run in a thread, as in the node; another thread asks for the lock every millisecond and notes how late it gets it, as a service
callback would. On a busy machine every wait contains the scheduler's: the search, which is compiled and holds no lock, shows how much.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lime_planner.collision.arm_filter import make_arm_filter
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import settings_from
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline import context as steps
from lime_planner.pipeline import pipeline as core
from lime_planner.pipeline import recheck as follow
from lime_planner.robot.model import home, load_robot
from lime_planner.ros.inputs.clouds import decode_cloud, encode_cloud
from lime_planner.ros.nodes.planner_node import _SWITCH_INTERVAL_S
from lime_planner.scene.plants.generator import generate_plant
from lime_planner.scene.scene import Scene

TICK_S = 0.001


class Recorder(steps.Clock):
    """Notes when each phase of a plan was."""

    spans: list[tuple[str, float, float]] = []  # noqa: RUF012 - one list for all plans, on purpose

    def lap(self, phase: str) -> None:
        began = self.last
        super().lap(phase)
        self.spans.append((phase, began, self.last))


def span(name: str, call: Callable[[], Any]) -> Any:
    """Note when a call was."""
    began = time.monotonic()
    result = call()
    Recorder.spans.append((name, began, time.monotonic()))
    return result


def main(arguments: list[str] | None = None) -> int:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=20)
    parser.add_argument("--points", type=int, default=100_000, help="points of leaf and stem cloud each")
    parser.add_argument("--threads", type=int, default=0, help="searches side by side (default: as the planner chooses)")
    options = parser.parse_args(arguments)
    core.Clock = follow.Clock = Recorder  # type: ignore[misc]
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    robot = load_robot("kinova_j2s6s200")
    pipeline, arm_filter = Pipeline(robot), make_arm_filter(robot)
    pipeline.warm_up()
    plant = generate_plant(np.random.default_rng(7))
    rng = np.random.default_rng(0)
    leaf, stem = (points[rng.integers(0, len(points), options.points)] for points in (plant.leaf_points, plant.stem_points))
    messages = [encode_cloud(points + rng.normal(scale=0.001, size=points.shape).astype(np.float32)) for points in (leaf, stem)]
    for msg in messages:
        msg.header.frame_id = "base"
    assert plant.target_pose is not None
    T, q, settings = pose_to_matrix(plant.target_pose), home(robot), settings_from({"threads": options.threads})
    Recorder.spans.clear()

    def plan() -> None:
        for seed in range(1, options.plans + 1):
            clouds = span("decode", lambda: [decode_cloud(msg, "cloud").points for msg in messages])
            points, labels = np.concatenate(clouds), np.repeat([0, 1], [len(cloud) for cloud in clouds])
            scene = span("scene", lambda points=points, labels=labels: Scene.from_points(points, labels, frame_id="base"))
            scene = span("arm_filter", lambda scene=scene: arm_filter(scene, q, 0.01))
            result = pipeline.plan(scene, T, q, settings, seed=seed)
            print(f"{seed}: {result.message[:100]}", file=sys.stderr)

    worker = threading.Thread(target=plan)
    waits: list[tuple[float, float]] = []
    worker.start()
    while worker.is_alive():
        began = time.monotonic()
        time.sleep(TICK_S)
        now = time.monotonic()
        waits.append((now, now - began - TICK_S))
    at, late = (np.array(column) for column in zip(*waits, strict=True))
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; waits in ms")
    print(f"{'phase':20} {'mean s':>8} {'median':>8} {'p95':>8} {'p99':>8} {'longest':>8}")
    for name in dict.fromkeys(span[0] for span in Recorder.spans):
        own = [(a, b) for phase, a, b in Recorder.spans if phase == name]
        inside = np.concatenate([late[(at >= a) & (at - late <= b)] for a, b in own])
        if len(inside):
            figures = [*np.percentile(inside, [50, 95, 99]), inside.max()]
            print(f"{name:20} {np.mean([b - a for a, b in own]):8.3f} " + " ".join(f"{1e3 * value:8.1f}" for value in figures))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
