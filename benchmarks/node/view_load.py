"""What the 3-D page costs a plan; not collected by pytest, because it takes minutes.

    python -m benchmarks.node.view_load --rounds 5

The demo's nodes run as processes, the planner with its page. Previews with a budget of iterations (so that their time tells of the
work) are timed in turns: no page is open; a browser has the page open in the background, as on another machine (nothing is drawn here);
and a browser draws it by software on this machine, which costs a core or two whatever the planner does. Exit status 0 only if the
open page costs at most 10 % (median).
"""

from __future__ import annotations

import argparse
import os
import socket
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from browser import Tab, chromium
from std_srvs.srv import Trigger

from benchmarks.node.acceptance_requests import call
from lime_planner.robot.model import load_robot
from lime_planner.ros.demo.client import DemoClient
from lime_planner.ros.demo.demo import DEFAULT_SEED
from lime_planner.ros.demo.processes import Corner, Processes
from lime_planner.scene.plants.generator import generate_plant

SLOWER = 1.10
ITERATIONS = 6000
PREVIEWS = 6  # in each turn; the first one, during which the page may still be loading, does not count
TURNS = ("no page open", "page open elsewhere", "page drawn here")


def main() -> int:
    """Run the previews and print what they took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    corner = Corner.own()
    taken: dict[str, list[float]] = {name: [] for name in TURNS}
    with tempfile.TemporaryDirectory() as folder, Processes(corner, Path(folder) / "logs") as nodes, chromium() as browser:
        scene = Path(folder) / "scene.npz"
        generate_plant(np.random.default_rng(DEFAULT_SEED)).save(scene)
        nodes.start("planner_node", "lime_planner.ros.nodes.planner_node", {"viewer_port": port, "iterations": ITERATIONS, "seed": 3})
        nodes.start("mock_arm_node", "lime_planner.ros.nodes.mock_arm_node", {})
        nodes.start("scene_node", "lime_planner.ros.nodes.scene_node", {"file": str(scene)})
        with DemoClient(corner, load_robot("kinova_j2s6s200").joint_names, nodes.check) as client:
            preview = client.node.create_client(Trigger, "lime_planner/preview")
            client.wait(client.planner_serves, 60.0, "the planner's service")
            client.wait(lambda: client.engine == "ready", 600.0, "the planner to be ready")
            time.sleep(3.0)
            for _ in range(args.rounds):
                for turn in TURNS:
                    tab = None if turn == TURNS[0] else Tab(browser, f"http://127.0.0.1:{port}")
                    if tab is not None:
                        tab.page.locator("canvas").first.wait_for()
                        if turn == TURNS[1]:  # the page stays connected and draws nothing, as far as this machine is concerned
                            tab.page.evaluate("window.requestAnimationFrame = () => 0")
                        time.sleep(3.0)
                    for number in range(PREVIEWS):
                        began = time.monotonic()
                        answer = call(client, preview, 60.0)
                        if not answer.success:
                            print(answer.message)
                            return 1
                        if number:
                            taken[turn].append(time.monotonic() - began)
                        time.sleep(0.3)
                    if tab is not None:
                        tab.close()
    quiet = float(np.median(taken[TURNS[0]]))
    for turn, times in taken.items():
        median, late = np.quantile(times, [0.5, 0.95])
        print(f"{turn:20} median {median:.3f} s, 95th percentile {late:.3f} s, ratio {median / quiet:.3f}")
    print(f"load {os.getloadavg()[0]:.1f}")
    return 0 if np.median(taken[TURNS[1]]) <= SLOWER * quiet else 1


if __name__ == "__main__":
    sys.exit(main())
