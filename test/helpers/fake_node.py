"""The planner node as a process, with a pipeline that costs nothing, and the bench around it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from ros_fakes import JOINTS, START, cloud
from ros_harness import Bench, program

FORTH = [0.3, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]
BACK = [-0.3, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]
SLOW = [0.3, 8.0, 0.4, 0.0, 0.0, 0.0, 1.0]  #: takes a while to plan to
ENDLESS = [0.3, 9.0, 0.4, 0.0, 0.0, 0.0, 1.0]
#: For tests of something else than silence: on a busy machine the played arm is not heard for half a second now and then.
PATIENT = ("-p", "max_joint_state_age_s:=10.0", "-p", "goal_time_s:=10.0")


@contextmanager
def fake_node(domain: int) -> Iterator[Bench]:
    """A planner that is ready, and its bench."""
    with program(["test/helpers/fake_planner.py", "--ros-args", *PATIENT], domain, "ready to plan", FAKE_DURATION_S="1.5"):
        bench = Bench(JOINTS, START, domain=domain)
        bench.call("stop")
        yield bench
        bench.close()


@contextmanager
def at_rest(bench: Bench) -> Iterator[None]:
    """The bench at rest, with good inputs; put back afterwards."""
    bench.publish_states = bench.follow = True
    bench.send_clouds(cloud(200), cloud(100))
    bench.send_target(FORTH)
    bench.wait_inputs()
    time.sleep(0.25)  # and has taken up these, not those of the test before
    bench.commands.clear()
    yield
    bench.set(motion_enabled=True, controller="jtc", replan_attempts=0, max_joint_state_age_s=10.0)
    bench.follow = bench.publish_states = True
    bench.call("stop")
    bench.wait(lambda: bench.rests, 10.0, "the end of the motion")
    time.sleep(0.35)  # and the planner has seen it
