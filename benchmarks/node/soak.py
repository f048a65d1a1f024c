"""Soak test: planner, mock arm and scene as processes, driven over DDS at random, every answer and every motion command judged.

    python -m benchmarks.node.soak --requests 300
    python -m benchmarks.node.soak --minutes 60 --robot kinova_j2n6s300 --controller kinova --json soak.json

Random scenes, targets (good and bad), preemptions, stops, faults of the arm, bad clouds and parameter changes. After every step:
each request has exactly one answer, in time; no command breaks the contract or touches a stem (`soak_checks`, which asks the planner
nothing); no process crashed. At the end: memory and threads are flat. Exit status 0 only if all of it held. The report is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from ros_harness import ROOT, Program, program

from benchmarks.node.soak_cases import CALM
from benchmarks.node.soak_steps import SoakBench, Steps
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.robot.model import Robot, home, load_robot

GROWTH_MB = 20.0
_LOGGED = re.compile(r"\]: (plan|preview|preview_to|execute|retreat|replan): ([A-Z_]+): .*\[plan_id (\d+)")


class Soak(Steps):
    """One run."""

    def __init__(self, bench: SoakBench, planner: Program, robot: Robot, rng: np.random.Generator, *, labelled: bool) -> None:
        super().__init__(bench, robot, rng, labelled=labelled)
        self.planner = planner
        self.memory: list[tuple[float, float, int]] = []

    def check(self) -> None:
        """Judge the commands, and look at the process."""
        super().check()
        if self.planner.process.poll() is not None:
            raise SystemExit(f"the planner ended with {self.planner.process.returncode}:\n{self.planner.output[-3000:]}")
        status = Path(f"/proc/{self.planner.process.pid}/status").read_text()
        kilobytes, threads = (int(re.search(rf"{key}:\s+(\d+)", status)[1]) for key in ("VmRSS", "Threads"))  # type: ignore[index]
        self.memory.append((time.monotonic(), kilobytes / 1024.0, threads))

    def run(self, requests: int, seconds: float, report_every_s: float = 60.0) -> dict[str, Any]:
        """Take steps until enough requests were made or time has passed."""
        steps = {"go": 3, "arrive": 1, "preempt": 4, "stop": 3, "look_first": 2, "preview_anywhere": 1, "retreat": 2, "burst": 1}
        steps |= {"bad_target": 1, "bad_cloud": 1, "change_scene": 1, "surprise": 2, "fault": 2, "turn": 1, "parameters": 2, "forbid": 1}
        names = list(steps)
        weights = np.array(list(steps.values()), dtype=float)
        began = told = time.monotonic()
        self.new_scene()
        self.reach_nearby()
        while self.requests < requests and time.monotonic() - began < seconds:
            name = str(self.rng.choice(names, p=weights / weights.sum()))
            self.actions[name] += 1
            before = len(self.violations) + len(self.judge.faults)
            getattr(self, name)()
            self.check()
            for sentence in (
                (self.violations + self.judge.faults)[before:] if len(self.violations) + len(self.judge.faults) > before else ()
            ):
                print(f"step {sum(self.actions.values())} ({name}): {sentence}", file=sys.stderr, flush=True)
            if time.monotonic() - told > report_every_s:
                told = time.monotonic()
                _, resident, threads = self.memory[-1]
                print(f"{told - began:.0f} s: {self.requests} requests, {resident:.0f} MB, {threads} threads", file=sys.stderr, flush=True)
        self.answer(self.ask("stop"))
        self.requests -= 1
        self.bench.set_on("mock_arm", {**CALM, "shuffle": False})
        return self.report(time.monotonic() - began)

    def report(self, seconds: float) -> dict[str, Any]:
        """Put the figures together, and the verdict."""
        time.sleep(0.5)
        self.check()
        logged = [match.groups() for match in map(_LOGGED.search, list(self.planner.lines)) if match]
        counts = Counter(int(number) for _, _, number in logged)
        twice = [number for number, count in counts.items() if count > 1]
        missing = [number for number in range(1, max(counts, default=0) + 1) if number not in counts]
        own = sum(kind != "replan" for kind, _, _ in logged)
        if twice or missing or own != self.requests:
            self.violations.append(f"{self.requests} requests, {own} logged; twice: {twice[:5]}, never: {missing[:5]}")
        if "Traceback" in self.planner.output:
            self.violations.append("the planner printed a traceback")
        settled = self.memory[len(self.memory) // 3 :]
        tenth = max(len(settled) // 10, 1)
        first, last = (float(np.median([row[1] for row in part])) for part in (settled[:tenth], settled[-tenth:]))
        threads = sorted({row[2] for row in settled})
        if last - first > GROWTH_MB:
            self.violations.append(f"resident memory grew from {first:.0f} to {last:.0f} MB")
        if threads[-1] - threads[0] > 2:
            self.violations.append(f"the number of threads went from {threads[0]} to {threads[-1]}")
        faults = [*self.violations, *self.judge.faults]
        waits = {
            f"{name}_ms": {"n": len(own), **{f"p{p}": round(1e3 * float(np.percentile(own, p)), 1) for p in (50, 95, 99)}}
            for name, own in self.waits.items()
            if own
        }
        return {
            "seconds": round(seconds, 1),
            "requests": self.requests,
            "steps": dict(self.actions),
            "motions_judged": self.judge.motions,
            "stops_judged": self.judge.stops,
            "arrivals": self.arrived,
            "stems_on_the_way": self.blocked,
            "answers": dict(sorted(self.codes.items())),
            "examples": self.examples,
            **waits,
            "memory_mb": {"settled": round(first, 1), "end": round(last, 1), "most": round(max(row[1] for row in self.memory), 1)},
            "threads": threads,
            "load": [round(value, 1) for value in os.getloadavg()],
            "violations": faults,
        }


def soak(
    *, requests: int, seconds: float, seed: int, robot: str, controller: str, labelled: bool, domain: int, log: Path | None = None
) -> dict[str, Any]:
    """Start the nodes, run, take them down; the report."""
    model = load_robot(robot)
    rng = np.random.default_rng(seed)
    start = home(model) + np.where(model.continuous, 2.0 * np.pi * rng.integers(-3, 4, model.n), 0.0)
    arguments = ["--ros-args", "-p", f"robot:={robot}", "-p", f"controller:={controller}"]
    listed = "[" + ", ".join(f"{value:.6f}" for value in start) + "]"
    settings = ["--params-file", str(ROOT / "config" / f"{robot}.yaml")] if controller == "kinova" else []
    own: dict[str, Any] = {"motion_enabled": "true", "velocity_scaling": 1.0, "acceleration_scaling": 1.0}
    own |= {"max_cloud_age_s": 0.0, "max_target_age_s": 0.0}
    if controller == "kinova":  # plans in the driver's frame; scene, targets and judge stay in the model's root
        own["static_transforms"] = f'["{robot.removeprefix("kinova_")}_link_base base {_root_in_the_drivers_base(model)}"]'
    # With the node's name: a plain -p gives way to a file that names the node.
    more = [word for name, value in own.items() for word in ("-p", f"lime_planner:{name}:={value}")]
    with ExitStack() as stack:
        stack.enter_context(program(["-m", "lime_planner.ros.nodes.mock_arm_node", *arguments, "-p", f"start:={listed}"], domain))
        shown = ["-p", f"labelled:={str(labelled).lower()}", "-p", "approach:=fixed"]
        scene = ["-m", "lime_planner.ros.nodes.scene_node", "--ros-args", *shown]
        stack.enter_context(program(scene, domain, "publishing"))
        planner = stack.enter_context(
            program(["-m", "lime_planner.ros.nodes.planner_node", *arguments, *settings, *more], domain, "serving")
        )
        bench = SoakBench(model.joint_names, start, domain=domain, plays_arm=False)
        try:
            planner.wait_for("ready to plan", 600.0)
            bench.wait_inputs("joint_states", "grasp_target", "labelled_cloud" if labelled else "stem_cloud")
            bench.call("stop")
            return Soak(bench, planner, model, rng, labelled=labelled).run(requests, seconds)
        finally:
            if log is not None:
                log.write_text(planner.output)
            bench.close()


def _root_in_the_drivers_base(model: Robot) -> str:
    """Return x y z qx qy qz qw of a built-in model's root in the frame in which the real arm's configuration plans."""
    at_base = load_robot(model.name, planning_frame=f"{model.name.removeprefix('kinova_')}_link_base")
    T_base_root = at_base.forward(home(model)) @ np.linalg.inv(model.forward(home(model)))
    return " ".join(f"{value:.9f}" for value in matrix_to_pose(T_base_root))


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--requests", type=int, default=1_000_000, help="end after this many requests")
    parser.add_argument("--minutes", type=float, default=1e6, help="end after this long")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robot", default="kinova_j2s6s200", choices=["kinova_j2s6s200", "kinova_j2n6s300"])
    parser.add_argument("--controller", default="jtc", choices=["jtc", "kinova"])
    parser.add_argument("--labelled", action="store_true", help="one labelled cloud instead of leaf and stem clouds")
    parser.add_argument("--domain", type=int, default=1 + os.getpid() % 100)
    parser.add_argument("--json", type=Path, help="write the report here too")
    parser.add_argument("--log", type=Path, help="write the planner's log here at the end")
    options = parser.parse_args(arguments)
    report = soak(
        requests=options.requests,
        seconds=60.0 * options.minutes,
        seed=options.seed,
        robot=options.robot,
        controller=options.controller,
        labelled=options.labelled,
        domain=options.domain,
        log=options.log,
    )
    report = {"robot": options.robot, "controller": options.controller, "seed": options.seed, **report}
    text = json.dumps(report, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")
    return 1 if report["violations"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
