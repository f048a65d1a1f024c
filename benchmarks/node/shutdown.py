"""Ends the planner node by signals at random moments after its first log line, many times, and counts the clean ends.

    python -m benchmarks.node.shutdown --times 100

For SIGINT, SIGTERM and a double SIGINT each: exit code 0, no traceback, nothing left of the process, within 30 s. The moments cover
loading, compiling, idling, planning and moving: the node finds a scene, a target and an arm of its own. Exit status 0 only if all were.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from ros_fakes import JOINTS, START, cloud
from ros_harness import Bench, Program

SIGNALS = {
    "SIGINT": (signal.SIGINT,),
    "SIGTERM": (signal.SIGTERM,),
    "SIGINT twice": (signal.SIGINT, signal.SIGINT),
}
FORTH, SLOW = [0.3, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0], [0.3, 8.0, 0.4, 0.0, 0.0, 0.0, 1.0]
REAL, FAKE = ["-m", "lime_planner.ros.nodes.planner_node"], ["test/helpers/fake_planner.py"]


def ended_cleanly(program: list[str], signals: tuple[int, ...], wait_s: float, between_s: float, bench: Bench | None, domain: int) -> str:
    """Start, wait for the first line, wait some more, signal; what was wrong, empty when nothing."""
    node = Program(program, domain)
    try:
        deadline = time.monotonic() + 60.0
        while not node.lines and time.monotonic() < deadline:
            assert node.process.poll() is None, f"ended by itself with {node.process.returncode}"
            time.sleep(0.002)
        until = time.monotonic() + wait_s
        while time.monotonic() < until:
            if bench is not None and bench.clients["plan"].service_is_ready():
                bench.send_clouds(None, cloud(10))
                bench.send_target(FORTH if until * 1e3 % 2 < 1 else SLOW)
                bench.call_async("plan")
            time.sleep(min(0.3, max(until - time.monotonic(), 0.0)))
        for number in signals[:-1]:
            node.process.send_signal(number)
            time.sleep(between_s)
        code = node.end(signals[-1])
    except AssertionError as error:
        node.process.kill()
        return str(error)
    if code != 0:
        return f"exit code {code}: {node.output[-2000:]}"
    if "Traceback" in node.output:
        return node.output[-2000:]
    return "still there" if Path(f"/proc/{node.process.pid}").exists() else ""


def run(times: int, seed: int, domain: int, longest_s: float, real_share: float) -> dict[str, Counter[str]]:
    """End the node `times` times by each kind of signal; the outcomes, "clean" or what was wrong."""
    rng = np.random.default_rng(seed)
    bench = Bench(JOINTS, START, domain=domain)
    outcomes: dict[str, Counter[str]] = {name: Counter() for name in SIGNALS}
    try:
        for count in range(times):
            for name, signals in SIGNALS.items():
                program = REAL if rng.random() < real_share else FAKE
                wait_s, between_s = longest_s * rng.random() ** 2, rng.choice([0.0, 0.001, 0.05, 0.3])
                wrong = ended_cleanly(program, signals, wait_s, between_s, bench if program is FAKE else None, domain)
                outcomes[name][wrong or "clean"] += 1
                if wrong:
                    print(f"{name}, {wait_s:.3f} s after the first line of {program[-1]}: {wrong}", file=sys.stderr, flush=True)
            if count % 10 == 9:
                print(f"{count + 1} of {times}", file=sys.stderr, flush=True)
    finally:
        bench.close()
    return outcomes


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=100, help="ends by each signal")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--longest", type=float, default=6.0, metavar="S", help="latest moment after the first log line [s]")
    parser.add_argument(
        "--real", type=float, default=0.6, metavar="SHARE", help="share of ends with the real pipeline, loading and compiling"
    )
    parser.add_argument("--domain", type=int, default=1 + os.getpid() % 100)
    options = parser.parse_args(arguments)
    os.chdir(Path(__file__).resolve().parents[2])
    outcomes = run(options.times, options.seed, options.domain, options.longest, options.real)
    for name, counts in outcomes.items():
        print(f"{name}: {counts['clean']} of {options.times} clean")
    return 0 if all(counts["clean"] == options.times for counts in outcomes.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
