"""Big clouds at 10 Hz, and what they do to plans and to the other services.

    python -m benchmarks.node.load --seconds 20 --json load.json

Planner, mock arm and scene run as processes with the Fast DDS profile of config/. First the clouds (100,000 leaf and 100,000 stem
points) are published once: idle services and plans are timed. Then they come at 10 Hz, from a reliable and from a best-effort
publisher, and the same is timed again. Exit status 0 only if at least 95 % of the clouds are used or superseded by newer ones, plans
take at most 1.5 times as long as before, and the 95th percentile of a service's latency is at most 10 ms above idle, while planning too.
All figures of one line come from one run; the machine's load stands beside them, and on a busy machine they say little.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.srv import GetParameters
from ros_harness import ROOT, Bench, Program, program

from lime_planner.robot.model import home, load_robot
from lime_planner.scene.plants.generator import generate_plant
from lime_planner.scene.scene import Scene

PROFILE = str(ROOT / "config" / "fastdds_big_clouds.xml")
CLOUDS = ("leaf_cloud", "stem_cloud")
COUNTS = ("received", "used", "superseded", "refused", "lost")
SHARE, SLOWER, LATER_MS = 0.95, 1.5, 10.0


def big_scene(path: Path, points: int) -> None:
    """A plant with this many leaf points and this many stem points."""
    plant, rng = generate_plant(np.random.default_rng(7)), np.random.default_rng(0)
    leaf, stem = (
        own[rng.integers(0, len(own), points)] + rng.normal(scale=0.0005, size=(points, 3)).astype(np.float32)
        for own in (plant.leaf_points, plant.stem_points)
    )
    labels = np.repeat([0, 1, 2], [points, points, len(plant.fruit_points)])
    everything = np.concatenate([leaf, stem, plant.fruit_points])
    Scene.from_points(everything, labels, frame_id="base", target_pose=plant.target_pose).save(path)


class Load:
    """A bench that times."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.client = bench.node.create_client(GetParameters, "lime_planner/get_parameters")
        assert self.client.wait_for_service(20.0)

    def services(self, seconds: float, busy: bool) -> dict[str, Any]:
        """Latencies of a service [ms], and of previews [s], made one after the other while it is asked if `busy`."""
        waits, plans = [], []
        preview, began = None, 0.0
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline or (preview is not None and not preview.done()):
            if busy and (preview is None or preview.done()):
                if preview is not None:
                    plans.append((time.monotonic() - began, preview.result().message.split(":")[0]))
                preview, began = self.bench.call_async("preview"), time.monotonic()
            asked = time.monotonic()
            self.bench.result(self.client.call_async(GetParameters.Request(names=["seed"])))
            waits.append(time.monotonic() - asked)
            time.sleep(0.01)
        good = [duration for duration, code in plans if code == "SUCCEEDED"]
        p50, p95 = (round(1e3 * float(np.percentile(waits, p)), 2) for p in (50, 95))
        figures: dict[str, Any] = {"service_p50_ms": p50, "service_p95_ms": p95, "calls": len(waits), "load": round(os.getloadavg()[0], 1)}
        if busy:
            figures |= {"plans": len(plans), "succeeded": len(good), "plan_median_s": round(float(np.median(good)), 3) if good else None}
        return figures

    def counts(self) -> dict[str, int]:
        """The planner's counts of both clouds together."""
        self.bench.health.clear()
        self.bench.wait(lambda: f"stem_cloud.{COUNTS[0]}" in self.bench.health, 5.0, "diagnostics")
        return {key: sum(int(self.bench.health[f"{name}.{key}"]) for name in CLOUDS) for key in COUNTS}


def measure(points: int, seconds: float, domain: int) -> dict[str, Any]:
    """Run everything; the figures."""
    report: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        file = Path(folder) / "big.npz"
        big_scene(file, points)
        environment = {"FASTRTPS_DEFAULT_PROFILES_FILE": PROFILE}

        def scene(rate_hz: float, reliable: bool) -> Program:
            given = {"file": file, "rate_hz": rate_hz, "reliable": str(reliable).lower()}
            words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
            return program(["-m", "lime_planner.ros.nodes.scene_node", "--ros-args", *words], domain, "publishing", **environment)  # type: ignore[return-value]

        stack.enter_context(program(["-m", "lime_planner.ros.nodes.mock_arm_node"], domain, **environment))
        planner = stack.enter_context(program(["-m", "lime_planner.ros.nodes.planner_node"], domain, "serving", **environment))
        planner.wait_for("ready to plan", 900.0)
        bench = Bench(load_robot("kinova_j2s6s200").joint_names, home(load_robot("kinova_j2s6s200")), domain=domain, plays_arm=False)
        stack.callback(bench.close)
        load = Load(bench)
        with scene(0.0, True):
            bench.wait(lambda: bench.received("stem_cloud") and bench.received("leaf_cloud"), 20.0, "clouds")
            assert bench.call("preview").success
            report["quiet"] = {"idle": load.services(seconds, False), "planning": load.services(seconds, True)}
        for name, reliable in (("reliable", True), ("best effort", False)):
            with scene(10.0, reliable):
                time.sleep(3.0)
                before = load.counts()
                figures = {"idle": load.services(seconds, False), "planning": load.services(seconds, True)}
                after = load.counts()
                report[name] = figures | {"clouds": {key: after[key] - before[key] for key in COUNTS}}
    report["failures"] = failures(report)
    return report


def failures(report: dict[str, Any]) -> list[str]:
    """What does not hold."""
    found = []
    quiet = report["quiet"]
    idle_ms, plan_s = quiet["idle"]["service_p95_ms"], quiet["planning"]["plan_median_s"]
    if quiet["planning"]["service_p95_ms"] > idle_ms + LATER_MS:
        found.append(f"while planning, a service's p95 is {quiet['planning']['service_p95_ms']} ms; idle {idle_ms} ms")
    for name in ("reliable", "best effort"):
        own, clouds = report[name], report[name]["clouds"]
        share = (clouds["used"] + clouds["superseded"]) / max(clouds["received"] + clouds["lost"], 1)
        own["share"] = round(share, 3)
        if share < SHARE:
            found.append(f"{name}: {share:.1%} of the clouds used or superseded")
        for phase in ("idle", "planning"):
            if own[phase]["service_p95_ms"] > idle_ms + LATER_MS:
                found.append(f"{name}, {phase}: a service's p95 is {own[phase]['service_p95_ms']} ms; idle {idle_ms} ms")
        if plan_s is None or own["planning"]["plan_median_s"] is None or own["planning"]["plan_median_s"] > SLOWER * plan_s:
            found.append(f"{name}: plans take {own['planning']['plan_median_s']} s; quiet {plan_s} s")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each phase")
    parser.add_argument("--points", type=int, default=100_000, help="points of each cloud")
    parser.add_argument("--domain", type=int, default=1 + os.getpid() % 100)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args(arguments)
    report = measure(options.points, options.seconds, options.domain)
    text = json.dumps(report, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")
    return 1 if report["failures"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
