"""From request to published trajectory, over DDS with the demo's own processes; not collected by pytest, because it takes minutes.

    python -m benchmarks.node.acceptance_requests --requests 20

Scene, arm and planner run as three processes on the demo's plant. The scene publishes both clouds again twice a second, so that no
request finds the fields of the one before. Each request calls `~/plan` and waits for the motion command on `joint_trajectory`; then the
arm is stopped and goes back by `~/retreat`. Exit status 0 only if every request succeeds, with a median of at most 2 s and a 95th
percentile of at most 4 s.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from lime_planner.robot.model import load_robot
from lime_planner.ros import qos
from lime_planner.ros.demo.client import DemoClient
from lime_planner.ros.demo.demo import DEFAULT_SEED
from lime_planner.ros.demo.processes import Corner, Processes
from lime_planner.scene.plants.generator import generate_plant

MEDIAN_S, P95_S = 2.0, 4.0


def call(client: DemoClient, service: Any, timeout_s: float = 30.0) -> Any:
    """Call a service of the planner and wait for the answer."""
    future = service.call_async(Trigger.Request())
    client.wait(future.done, timeout_s, f"an answer of {service.srv_name}")
    return future.result()


def main() -> int:
    """Run the requests and print what they took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--requests", type=int, default=20)
    args = parser.parse_args()
    robot = load_robot("kinova_j2s6s200")
    corner = Corner.own()
    times: list[float] = []
    refused: list[str] = []
    with tempfile.TemporaryDirectory() as folder, Processes(corner, Path(folder) / "logs") as nodes:
        scene = Path(folder) / "scene.npz"
        generate_plant(np.random.default_rng(DEFAULT_SEED)).save(scene)
        nodes.start("planner_node", "lime_planner.ros.nodes.planner_node", {})
        nodes.start("mock_arm_node", "lime_planner.ros.nodes.mock_arm_node", {})
        nodes.start("scene_node", "lime_planner.ros.nodes.scene_node", {"file": str(scene), "rate_hz": 2.0})
        with DemoClient(corner, robot.joint_names, nodes.check) as client:
            commands: list[float] = []
            node = client.node
            node.create_subscription(JointTrajectory, "joint_trajectory", lambda _: commands.append(time.monotonic()), qos.COMMAND)
            plan = node.create_client(Trigger, "lime_planner/plan")
            retreat = node.create_client(Trigger, "lime_planner/retreat")
            client.wait(client.planner_serves, 60.0, "the planner's service")
            client.wait(lambda: client.engine == "ready", 600.0, "the planner to be ready")
            client.wait(lambda: len(client.states) > 20, 10.0, "joint states")
            time.sleep(2.0)
            for number in range(args.requests):
                commands.clear()
                began = time.monotonic()
                answer = call(client, plan)
                if not answer.success:
                    refused.append(answer.message)
                    print(f"{number + 1:3d}: {answer.message}", flush=True)
                    continue
                client.wait(lambda: bool(commands), 5.0, "the motion command")
                times.append(commands[0] - began)
                print(f"{number + 1:3d}: {times[-1]:.2f} s   {answer.message[:110]}", flush=True)
                time.sleep(1.0)
                client.wait(lambda: client.still(states=40), 60.0, "the arm to rest")
                back = call(client, retreat)
                if not back.success:
                    refused.append(back.message)
                    print(f"     {back.message}", flush=True)
                time.sleep(1.0)
                client.wait(lambda: client.still(states=40), 60.0, "the arm to be back")
    if not times:
        print("no request succeeded")
        return 1
    median, p95 = np.quantile(times, [0.5, 0.95])
    load = os.getloadavg()[0]
    print(f"{len(times)} requests: median {median:.2f} s, 95th percentile {p95:.2f} s, {len(refused)} refused, load {load:.1f}")
    return 0 if median <= MEDIAN_S and p95 <= P95_S and not refused else 1


if __name__ == "__main__":
    sys.exit(main())
