"""Plans preempted by newer plans, carried out by the Kinova driver's law: where does the arm end?

    python -m benchmarks.node.replay_plans --plans 200

Each first plan is stopped at a random moment by the one-point stop, the newer one is planned from where the law says the arm halted,
and sent after the rest that the node waits for. Exit status 0 only if every arm ends within 0.02 rad of the newest plan's last point.
"""

from __future__ import annotations

import argparse

import numpy as np

from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import settings_from
from lime_planner.core.status import Status
from lime_planner.motion.controllers.replay import replay_kinova
from lime_planner.motion.stop import one_point_stop
from lime_planner.pipeline import Pipeline
from lime_planner.robot.model import home, load_robot
from lime_planner.scene.plants.generator import generate_plant
from lime_planner.scene.plants.grasp_targets import lime_targets

LIMIT_RAD = 0.02
REST_S = 0.35  # `stillness_time_s` of the Kinova configurations


def main(arguments: list[str] | None = None) -> int:
    """Run and print the largest difference."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=200)
    parser.add_argument("--robot", default="kinova_j2s6s200")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(5)
    robot = load_robot(options.robot)
    pipeline, plant = Pipeline(robot), generate_plant(np.random.default_rng(7))
    settings = settings_from({"iterations": 400, "velocity_scaling": 0.8})
    poses = [pose_to_matrix(pose) for pose in lime_targets(plant, rng)]
    poses += [robot.forward(home(robot) + rng.uniform(-0.8, 0.8, robot.n)) for _ in range(20)]
    turns = np.where(robot.continuous, 2.0 * np.pi * rng.integers(-3, 4, robot.n), 0.0)
    worst, done = 0.0, 0
    while done < options.plans:
        start = home(robot) + turns + rng.uniform(-0.2, 0.2, robot.n)
        first = pipeline.plan(plant, poses[int(rng.integers(len(poses)))], start, settings, seed=done + 1)
        if first.status is not Status.SUCCEEDED or first.trajectory is None:
            continue
        sent_s = float(rng.uniform(0.0, first.trajectory.duration_s))
        times_s, track = replay_kinova(first.trajectory)
        stop = one_point_stop(robot.joint_names, track[np.searchsorted(times_s, sent_s)])
        halt = replay_kinova([(0.0, first.trajectory), (sent_s, stop)])[1][-1]
        second = pipeline.plan(plant, poses[int(rng.integers(len(poses)))], halt, settings, seed=done + 1)
        if second.status is not Status.SUCCEEDED or second.trajectory is None:
            continue
        end = replay_kinova([(0.0, first.trajectory), (sent_s, stop), (sent_s + REST_S, second.trajectory)])[1][-1]
        worst = max(worst, float(np.abs(end - second.trajectory.positions[-1]).max()))
        done += 1
    print(f"{done} plans of {options.robot}, each preempting another: at most {worst:.5f} rad from the newest plan's end")
    return 0 if worst <= LIMIT_RAD else 1


if __name__ == "__main__":
    raise SystemExit(main())
