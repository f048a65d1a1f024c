"""A planner node in this process, with a pipeline that costs nothing and everything else real, and a bench around it over DDS.

    python test/helpers/reliability_rig.py

sends every row of `reliability_rows` to the node and writes the answers into docs/reliability.md.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from nav_msgs.srv import GetPlan
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from reliability_rows import GOOD, ROWS, Row, points
from ros_fakes import JOINTS, START, FakePipeline, FakeRobot, cloud
from ros_harness import ROOT, Bench, code_of
from sensor_msgs.msg import JointState

from lime_planner.ros.convert import to_pose
from lime_planner.ros.inputs.latest import Slot
from lime_planner.ros.model_loader import Loaded
from lime_planner.ros.nodes import planner_node

PAGE = ROOT / "docs" / "reliability.md"
BEGIN, END = "<!-- rows: python test/helpers/reliability_rig.py -->", "<!-- end of rows -->"
_VOLATILE = re.compile(r"\d[\d.e+]*")  # ages differ from run to run
_DETAIL = re.compile(r" \[plan_id .*\]$")


class Rig:
    """The node, the bench, and ways to send every odd thing to it."""

    def __init__(self, node: planner_node.PlannerNode, bench: Bench) -> None:
        self.node, self.bench = node, bench
        self.labelled = bench.node.create_publisher(type(cloud(1)), "labelled_cloud", 1)
        self.silent = False

    # ---- arranging ----

    def good(self) -> None:
        """Everything as it should be."""
        self.bench.publish_states = True
        if self.silent:
            self.node.inputs.joints.clear()
            self.wait_until(lambda: self.node.inputs.joints.still(0.25, 0.003), "rest")
        self.silent = False
        self.deliver("leaf_cloud", cloud(20))
        self.deliver("stem_cloud", cloud(10))
        self.target(GOOD)

    def deliver(self, name: str, msg: Any, after_s: float | None = None, *, stamped: bool = True) -> None:
        """Send a cloud stamped now or `after_s` later, and wait until it is there."""
        if stamped:
            self.stamp(msg, after_s or 0.0)
        publisher = {"leaf_cloud": self.bench.leaf, "stem_cloud": self.bench.stem, "labelled_cloud": self.labelled}[name]
        self.sent(name, lambda: publisher.publish(msg))

    def five_million(self) -> None:
        """A cloud of 5 million points; handed over directly, for the wire is not what this row is about."""
        msg = points(np.random.default_rng(0).uniform(-1.0, 1.0, (5_000_000, 3)))
        self.node._on_cloud("stem_cloud", msg)

    def target(self, pose: list[float], frame_id: str = "base", after_s: float | None = None) -> None:
        """Send a target and wait until it is there."""
        msg = GetPlan.Request().goal
        msg.header.frame_id, msg.pose = frame_id, to_pose(pose)
        self.stamp(msg, after_s or 0.0)
        self.sent("grasp_target", lambda: self.bench.target.publish(msg))

    def states(self, msg: JointState, after_s: float) -> None:
        """Only these joint states for long enough that the good ones have become old."""
        self.silence(0.05)
        deadline = time.monotonic() + 0.4
        while time.monotonic() < deadline:
            self.stamp(msg, after_s)
            self.bench.joints.publish(msg)
            time.sleep(0.01)

    def silence(self, duration_s: float = 0.4) -> None:
        """No joint states."""
        self.silent, self.bench.publish_states = True, False
        time.sleep(duration_s)

    def forget(self, name: str) -> None:
        """Have the node as it is before an input came."""
        if name == "joint_states":
            self.silence(0.05)
            self.node.inputs.joints.clear()
        elif name == "motion":
            self.node.execution.way_out.clear()
        else:
            self.node.inputs.slots[name] = Slot(name)
            self.node.source._parts.clear()  # it goes by the clouds' numbers, which begin anew

    def goal(self, pose: list[float], frame_id: str) -> GetPlan.Request:
        """A request of ~/preview_to."""
        request = GetPlan.Request()
        request.goal.header.frame_id, request.goal.pose = frame_id, to_pose(pose)
        return request

    def no_controller(self) -> Callable[[], None]:
        """Nobody listens to the command, until the function returned is called."""
        self.bench.disconnect_controller()
        self.wait_until(lambda: self.node.output.listeners("jtc") == 0, "no controller")
        return self._controller_again

    def _controller_again(self) -> None:
        self.bench.connect_controller()
        self.wait_until(lambda: self.node.output.listeners("jtc") > 0, "a controller")

    def refused(self, name: str, value: Any) -> str:
        """Set a parameter; the reason why not."""
        return self.bench.set(**{name: value})[0]

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        time.sleep(duration_s)

    def stamp(self, msg: Any, after_s: float) -> None:
        """Stamp a message now or later."""
        now = self.bench.node.get_clock().now()
        msg.header.stamp = (now + rclpy.duration.Duration(seconds=after_s)).to_msg()

    def sent(self, name: str, publish: Callable[[], None]) -> None:
        """Publish and wait until the node has it."""
        slot = self.node.inputs.slots[name]
        before = slot.received
        publish()
        self.wait_until(lambda: slot.received > before, f"{name} at the node")

    def wait_until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for a condition."""
        deadline = time.monotonic() + 120.0  # a busy machine loads the kernels for half a minute
        while not condition():
            assert time.monotonic() < deadline, what
            time.sleep(0.001)

    # ---- asking ----

    def answer(self, row: Row) -> str:
        """Send a row, ask, and see that the arm stood still and the next good request succeeds; the answer."""
        self.good()
        self.node.requests.previewed = None
        if row.group == "labelled_cloud":
            self.forget("leaf_cloud")
            self.forget("stem_cloud")
        sent = len(self.bench.commands)
        for name, value in row.settings.items():
            assert self.bench.set(**{name: value}) == [""]
        arranged = row.arrange(self)
        if not row.service:
            message = f"refused: {arranged}"
        else:
            message = self.ask(row, arranged)
        assert len(self.bench.commands) == sent, "a motion was sent"
        for name in row.settings:
            self.bench.set(**{name: self.defaults[name]})
        if callable(arranged):
            arranged()
        self.forget("labelled_cloud")
        self.good()
        follower = self.bench.call("preview")
        assert follower.success, f"the next good request: {follower.message}"
        return _DETAIL.sub("", message)

    def ask(self, row: Row, arranged: Any) -> str:
        """Ask the row's service; inputs that are only odd are previewed, so that the arm stays where it is."""
        if row.service == "preview_to":
            count = len(self.bench.statuses)
            assert not self.bench.call("preview_to", arranged).plan.poses
            self.bench.answer_since(count)
            return str(self.messages[-1])
        service = "preview" if row.code == "SUCCEEDED" and row.service == "plan" else row.service
        response = self.bench.call(service)
        assert response.success == (code_of(response.message) == "SUCCEEDED")
        return str(response.message)

    @property
    def defaults(self) -> dict[str, Any]:
        """The parameters as a fresh node has them."""
        from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS

        return {name: parameter.default for name, parameter in (PARAMETERS | NODE_PARAMETERS).items()}

    @property
    def messages(self) -> list[str]:
        """What the status said last."""
        return [self.node.board.last_message]


@contextmanager
def rig(domain: int) -> Iterator[Rig]:
    """A node and a bench."""
    build = planner_node.make_arm_filter
    planner_node.make_arm_filter = lambda robot: lambda scene, q, padding_m: scene  # type: ignore[assignment]  # a robot without a body
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    robot = FakeRobot()
    overrides = [Parameter("static_transforms", value=["base mast 0 0 1 0 0 0 1"])]
    node = planner_node.PlannerNode(
        lambda settings, urdf: Loaded(robot, FakePipeline(robot, plan_s=0.002)), context=context, parameter_overrides=overrides
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    done = threading.Event()

    def spin() -> None:
        while not done.is_set():
            executor.spin_once(0.1)

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    bench = Bench(JOINTS, START, domain=domain)
    try:
        bench.call("stop")
        made = Rig(node, bench)
        made.wait_until(lambda: node.loader.ready, "the model")
        made.wait_until(lambda: made.labelled.get_subscription_count() > 0, "subscriptions")
        made.good()
        made.wait_until(lambda: node.inputs.joints.still(0.25, 0.003), "rest")
        yield made
    finally:
        bench.close()
        node.shut_down()
        done.set()
        thread.join(5.0)
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
        planner_node.make_arm_filter = build


def masked(message: str) -> str:
    """An answer without the numbers that differ from run to run."""
    return _VOLATILE.sub("#", message)


def line(number: int, row: Row, answer: str) -> str:
    """A row of the page."""
    settings = "".join(f" (`{name}: {str(value).lower()}`)" for name, value in row.settings.items())
    return f"| {number} | `{row.group}` | {row.what}{settings} | {answer.replace('|', '/')} |"


def written() -> list[str]:
    """The rows of the page as it stands."""
    text = PAGE.read_text(encoding="utf-8")
    return [row for row in text[text.index(BEGIN) : text.index(END)].splitlines() if re.match(r"\| \d", row)]


def main() -> int:
    """Write the page's rows."""
    with rig(88) as made:
        rows = [line(number, row, made.answer(row)) for number, row in enumerate(ROWS, 1)]
    text = PAGE.read_text(encoding="utf-8")
    head = "| | input | what is odd about it | answer |\n|---|---|---|---|\n"
    begin, end = text.index(BEGIN) + len(BEGIN), text.index(END)
    PAGE.write_text(text[:begin] + "\n\n" + head + "\n".join(rows) + "\n\n" + text[end:], encoding="utf-8")
    print(f"{len(rows)} rows in {PAGE}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
