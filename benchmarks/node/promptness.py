"""How soon a plan gives up when it is asked to, and how well it keeps its deadline; not collected by pytest, because it measures time.

    python -m benchmarks.node.promptness --plans 40

Plans on a generated plant, on one whose lime has as many points as a camera at close range gives it, and on clouds that fill the whole
reach of the arm, whose fields are as large as fields become, are stopped
at random moments, and others get deadlines. Exit status 0 only if every plan ended within 0.5 s of the stop, and no deadline was passed
by more than 50 ms or a tenth of it.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import threading
import time

import numpy as np

from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import settings_from
from lime_planner.pipeline import Pipeline
from lime_planner.robot.model import home, load_robot
from lime_planner.ros.demo.demo import DEFAULT_SEED
from lime_planner.scene.plants.generator import generate_plant
from lime_planner.scene.scene import Scene

DEADLINES_S = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0)
IDLE_S = 0.5


def crowded(rng: np.random.Generator) -> Scene:
    """Leaves and stems all over the reach, but not where the arm stands."""
    points = rng.uniform(-1.2, 1.2, (400_000, 3)).astype(np.float32)
    points = points[(np.linalg.norm(points[:, :2], axis=1) > 0.6) & (np.linalg.norm(points, axis=1) < 1.2)]
    return Scene.from_points(points, (rng.random(len(points)) < 0.4).astype(int), frame_id="base")


def close_up(rng: np.random.Generator, plant: Scene) -> Scene:
    """The plant with very many points on its lime."""
    assert plant.target_pose is not None
    around = rng.normal(size=(100_000, 3))
    lime = 0.023 * around / np.linalg.norm(around, axis=1)[:, None] + plant.fruit_centres[0]
    return dataclasses.replace(plant, fruit_points=np.concatenate([plant.fruit_points, lime.astype(np.float32)]))


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=40, help="of each kind")
    parser.add_argument("--threads", type=int, default=0, help="searches side by side (default: as the planner chooses)")
    args = parser.parse_args()
    robot = load_robot("kinova_j2s6s200")
    pipeline = Pipeline(robot)
    pipeline.warm_up()
    rng = np.random.default_rng(0)
    start = home(robot)
    plant = generate_plant(np.random.default_rng(DEFAULT_SEED))
    assert plant.target_pose is not None
    bad = False
    for name, scene, T in (
        ("plant", plant, pose_to_matrix(plant.target_pose)),
        ("plant, close up", close_up(rng, plant), pose_to_matrix(plant.target_pose)),
        ("whole reach", crowded(rng), robot.forward(start + 0.5)),
    ):
        for leaf_cost in ("binary", "graded"):
            settings = settings_from({"leaf_cost": leaf_cost, "threads": args.threads})
            late = []
            for number in range(args.plans):
                stop, asked = threading.Event(), [0.0]
                pipeline.obstacles(plant, np.zeros(3) + number, settings)  # so that the fields are built again

                def press(stop: threading.Event = stop, asked: list[float] = asked) -> None:
                    asked[0] = time.monotonic()
                    stop.set()

                timer = threading.Timer(float(rng.uniform(0.0, 1.0)), press)
                timer.start()
                result = pipeline.plan(scene, T, start, settings, should_stop=stop.is_set, seed=1 + number)
                ended = time.monotonic()
                timer.cancel()
                if result.status.name == "CANCELLED":
                    late.append(1e3 * (ended - asked[0]))
            median, most = np.median(late), max(late)
            bad |= most > 1e3 * IDLE_S
            print(f"{name}, {leaf_cost}: {len(late)} stopped, given up after {median:.0f} ms (median), {most:.0f} ms (most)", flush=True)
            for deadline_s in DEADLINES_S:
                over, ends = [], set()
                for number in range(max(args.plans // 4, 1)):
                    pipeline.obstacles(plant, np.zeros(3) - number, settings)
                    began = time.monotonic()
                    ends.add(pipeline.plan(scene, T, start, settings, deadline_s=deadline_s, seed=1 + number).status.name)
                    over.append(1e3 * (time.monotonic() - began - deadline_s))
                bad |= max(over) > max(100.0 * deadline_s, 50.0)
                print(f"    deadline {deadline_s:g} s: {max(over):+.0f} ms at the latest; {', '.join(sorted(ends))}", flush=True)
    print(f"load {os.getloadavg()[0]:.1f}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
