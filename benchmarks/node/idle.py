"""What the planner node costs while it has nothing to do, and in its other states: processor time and memory of its process.

    python -m benchmarks.node.idle --seconds 30 --json idle.json

The node runs in a process of its own; its user and system time are read from /proc/PID/stat over each state, in per cent of one core:
alone on the graph; with a labelled cloud of 100,000 points at 10 Hz that no request asks for; with an arm beside it that publishes joint
states at 50 Hz; with previews one after the other; at rest again; and with a motion under way. Exit status 0 only if alone it takes less
than 2 %, with clouds less than 5 %, and at most 350 MB of resident memory before the first plan. Other work on the machine changes
these figures little, for they count the node's own time; it stretches them where caches are shared.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from ros_harness import Bench, Program, execution_code, plan_id, program

from benchmarks.node.load import PROFILE, big_scene
from lime_planner.robot.model import home, load_robot

ALONE_PERCENT, CLOUDS_PERCENT, IDLE_MB = 2.0, 5.0, 350.0
ROBOT = "kinova_j2s6s200"
_SETTLING_S = 3.0
_TICKS_HZ = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Figures:
    """What a state cost: per cent of one core, over how long [s], and the resident memory at its end [MB]."""

    percent: float
    seconds: float
    memory_mb: float


def cpu_s(pid: int) -> float:
    """User and system time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_HZ


def memory_mb(pid: int) -> float:
    """Resident memory of a process [MB]."""
    [line] = [line for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines() if line.startswith("VmRSS")]
    return int(line.split()[1]) / 1024.0


class Meter:
    """Measures states of one process."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.states: dict[str, Figures] = {}

    @contextmanager
    def state(self, name: str) -> Iterator[None]:
        """Measure what happens in the block."""
        began_s, used_s = time.monotonic(), cpu_s(self.pid)
        yield
        seconds = time.monotonic() - began_s
        self.states[name] = Figures(
            round(100.0 * (cpu_s(self.pid) - used_s) / seconds, 2), round(seconds, 1), round(memory_mb(self.pid), 1)
        )
        print(f"{name:10} {self.states[name]}", flush=True)


def measure(seconds: float, points: int, domain: int) -> dict[str, Figures]:
    """Run the node through its states."""
    environment = {"FASTRTPS_DEFAULT_PROFILES_FILE": PROFILE, "ROS_PYTHON_CHECK_FIELDS": "0"}

    def node(name: str, *words: str) -> list[str]:
        return ["-m", f"lime_planner.ros.nodes.{name}", *(["--ros-args", *words] if words else [])]

    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        file = Path(folder) / "big.npz"
        big_scene(file, points // 2)
        planner: Program = stack.enter_context(program(node("planner_node"), domain, "serving", **environment))
        planner.wait_for("ready to plan", 900.0)
        meter = Meter(planner.process.pid)
        time.sleep(_SETTLING_S)
        with meter.state("alone"):
            time.sleep(seconds)
        words = [word for name, value in {"file": file, "rate_hz": 10.0, "labelled": "true"}.items() for word in ("-p", f"{name}:={value}")]
        stack.enter_context(program(node("scene_node", *words), domain, "publishing", **environment))
        time.sleep(_SETTLING_S)
        with meter.state("clouds"):
            time.sleep(seconds)
        stack.enter_context(program(node("mock_arm_node"), domain, "mock arm", **environment))
        time.sleep(_SETTLING_S)
        with meter.state("arm"):
            time.sleep(seconds)
        robot = load_robot(ROBOT)
        bench = Bench(robot.joint_names, home(robot), domain=domain, plays_arm=False)
        stack.callback(bench.close)
        assert bench.call("preview").success  # the kernels are loaded
        with meter.state("planning"):
            deadline = time.monotonic() + seconds
            while time.monotonic() < deadline:
                bench.call("preview")
        time.sleep(_SETTLING_S)
        with meter.state("afterwards"):
            time.sleep(seconds)
        answer = bench.call("plan")
        assert answer.success, answer.message
        with meter.state("moving"):
            execution_code(bench, plan_id(answer.message), 120.0)
    return meter.states


def failures(states: dict[str, Figures]) -> list[str]:
    """What does not hold."""
    found = []
    for name, limit in (("alone", ALONE_PERCENT), ("clouds", CLOUDS_PERCENT)):
        if states[name].percent >= limit:
            found.append(f"{name}: {states[name].percent} % of a core, the limit is {limit} %")
    if states["clouds"].memory_mb > IDLE_MB:
        found.append(f"before the first plan: {states['clouds'].memory_mb} MB, the limit is {IDLE_MB} MB")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="length of each state")
    parser.add_argument("--points", type=int, default=100_000, help="points of the cloud")
    parser.add_argument("--domain", type=int, default=1 + os.getpid() % 100)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args(arguments)
    states = measure(options.seconds, options.points, options.domain)
    found = failures(states)
    report = {"states": {name: vars(figures) for name, figures in states.items()}, "failures": found}
    print(json.dumps(report["failures"], indent=1))
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
