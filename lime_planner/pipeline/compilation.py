"""All kernels compiled ahead of the first plan: in two processes, into the cache on disk, with a sign of life.

The first plan after an installation would wait a minute for the compiler; what is compiled once is read from the disk ever after
(`lime_planner.core.kernel_cache`). `lime-planner compile` does it, and so does whatever plans first and finds the cache empty.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import IO, Any

from lime_planner.core.kernel_cache import all_compiled, note_all_compiled

#: What is compiled side by side: the collision model and what asks it, which comes last there because the arm's shapes are made first,
#: and everything else, beginning with what the other would come to by then. What one has compiled, the other reads from the cache.
PARTS = ("arm", "planners")

_REPORT_EVERY_S = 0.25

#: Told how many functions are compiled, and for how long it has gone on [s].
Report = Callable[[int, float], None]


def ensure_compiled(report: Report = lambda done, elapsed_s: None, robot: str = "kinova_j2s6s200") -> bool:
    """Compile all kernels that the cache does not hold.

    Args:
        report: called about four times a second while it goes on.
        robot: built-in arm to practise on; the kernels are the same for every arm.

    Returns:
        Whether anything was to be done. Where the processes fail, the kernels are left to be compiled when they are first called.
    """
    if all_compiled():
        return False
    began_s = time.monotonic()
    workers = [
        subprocess.Popen([sys.executable, "-m", "lime_planner.pipeline.compilation", part, robot], stdout=subprocess.PIPE, text=True)
        for part in PARTS
    ]
    done = [0] * len(workers)

    def listen(which: int, stream: IO[str]) -> None:
        for _ in stream:
            done[which] += 1

    threads = [
        threading.Thread(target=listen, args=(i, worker.stdout), name="compilation", daemon=True) for i, worker in enumerate(workers)
    ]
    try:
        for thread in threads:
            thread.start()
        report(0, 0.0)
        while any(worker.poll() is None for worker in workers):
            time.sleep(_REPORT_EVERY_S)
            report(sum(done), time.monotonic() - began_s)
        if all(worker.returncode == 0 for worker in workers):
            note_all_compiled()
        else:
            ended = ", ".join(f"{part} with {worker.returncode}" for part, worker in zip(PARTS, workers, strict=True))
            print(f"compiling ahead ended early ({ended}); what is missing is compiled when it is called first", file=sys.stderr)
    finally:
        for worker in workers:
            if worker.poll() is None:
                worker.terminate()
            worker.wait()
    return True


def compile_part(part: str, robot: str) -> None:
    """Compile one of `PARTS` in this process; each function is a line on standard output when it is done."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            pass

        def on_end(self, event: Any) -> None:
            print(event.data["dispatcher"].py_func.__qualname__, flush=True)

    event.register("numba:compile", Listener())
    gc.disable()  # a twentieth of the time; the process ends before it would need it
    from lime_planner.robot.model import load_robot

    if part == "planners":
        from lime_planner.core.planners import PLANNERS
        from lime_planner.motion import stop
        from lime_planner.pipeline.grasps.practice import practise_grasps
        from lime_planner.planning.planner import load_planner
        from lime_planner.planning.practice import practise
        from lime_planner.scene import voxels

        practise_grasps(load_robot(robot))
        voxels.warm_up()
        stop.warm_up()
        for planner in map(load_planner, PLANNERS):
            practise(planner)
        return
    from lime_planner.pipeline.pipeline import Pipeline

    Pipeline(load_robot(robot)).warm_up(())


if __name__ == "__main__":
    compile_part(*sys.argv[1:])
