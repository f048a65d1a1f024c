"""Compile everything that planning, stopping and the demo use, and say how far it is; `scripts/setup.sh` calls it.

Usage: python scripts/compile_kernels.py
"""

from __future__ import annotations

import threading
import time

_EVERY_S = 15.0


def main() -> None:
    """Compile in the main thread, and report from another one."""
    done = threading.Event()

    def report() -> None:
        began_s = time.monotonic()
        while not done.wait(_EVERY_S):
            print(f"setup:   still compiling, for {time.monotonic() - began_s:.0f} s", flush=True)

    threading.Thread(target=report, daemon=True).start()
    from lime_planner.motion import stop
    from lime_planner.pipeline import Pipeline
    from lime_planner.robot.builtin import demo_arm
    from lime_planner.robot.model import load_robot

    stop.warm_up()
    Pipeline(load_robot(demo_arm()[0])).warm_up()
    done.set()


if __name__ == "__main__":
    main()
