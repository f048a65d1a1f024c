"""What the process tests share: start the real executables, play the arm and the cameras, call the services."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as PathMsg
from nav_msgs.srv import GetPlan
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros import qos
from lime_planner.ros.convert import to_pose
from lime_planner.ros.requests.status_board import read_status

ROOT = Path(__file__).resolve().parents[2]
TEST = Path(__file__).resolve().parent


def environment(domain: int, **more: str) -> dict[str, str]:
    """The environment of a test's processes: this machine only, a domain of its own, field types checked."""
    path = os.pathsep.join([str(ROOT), str(TEST), os.environ.get("PYTHONPATH", "")])
    own = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_PYTHON_CHECK_FIELDS": "1",
        "PYTHONPATH": path,
        "PYTHONUNBUFFERED": "1",
        "PYTHONFAULTHANDLER": "1",  # `end` asks a program that hangs where it does
    }
    return {**os.environ, **own, **more}


def _die_with_parent() -> None:
    """Have the kernel end the program when the tests are killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG


class Program:
    """One of the executables in a process of its own."""

    def __init__(self, arguments: Sequence[str], domain: int, **more: str) -> None:
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [sys.executable, *arguments],
            env=environment(domain, **more),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=_die_with_parent,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        return "\n".join(self.lines)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def wait_for(self, text: str, timeout_s: float = 240.0) -> None:
        """Wait until a line with `text` was printed."""
        deadline = time.monotonic() + timeout_s
        while not any(text in line for line in list(self.lines)):
            assert self.process.poll() is None, f"ended with {self.process.returncode}:\n{self.output}"
            assert time.monotonic() < deadline, f"no {text!r} within {timeout_s} s:\n{self.output}"
            time.sleep(0.01)

    def end(self, number: int = signal.SIGINT, timeout_s: float = 30.0) -> int:
        """Send a signal and return the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            code = self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)
            try:
                self.process.wait(10.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self._reader.join(5.0)
            raise AssertionError(f"did not end within {timeout_s} s after signal {number}:\n{self.output}") from None
        self._reader.join(5.0)
        return code


class Bench:
    """Cameras, arm and operator around a planner node, in this process."""

    def __init__(
        self, joint_names: Sequence[str], q: np.ndarray, *, domain: int, namespace: str = "", rate_hz: float = 100.0, plays_arm: bool = True
    ) -> None:
        planner = "lime_planner"
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("bench", context=self.context, namespace=namespace)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.joint_names = list(joint_names)
        self.q = np.array(q, dtype=np.float64)
        self.publish_states = True
        self.follow = plays_arm
        self.commands: list[tuple[float, JointTrajectory]] = []
        self.statuses: list[dict[str, str]] = []
        self.paths: list[PathMsg] = []
        self.health: dict[str, str] = {}
        self._motion: tuple[float, Trajectory] | None = None
        self.leaf = self.node.create_publisher(PointCloud2, "leaf_cloud", qos.LATCHED)
        self.stem = self.node.create_publisher(PointCloud2, "stem_cloud", qos.LATCHED)
        self.target = self.node.create_publisher(PoseStamped, "grasp_target", qos.NEWEST)
        if plays_arm:
            self.joints = self.node.create_publisher(JointState, "joint_states", 10)
            self.node.create_timer(1.0 / rate_hz, self._tick)
        else:  # somebody else does: only listen
            self.node.create_subscription(JointState, "joint_states", self._on_joint_state, qos.JOINT_STATES)
        self.node.create_subscription(
            DiagnosticArray, f"{planner}/status", lambda msg: self.statuses.append(read_status(msg)), qos.EVERY_STATUS
        )
        self.node.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: self.health.update(read_status(msg)), 10)
        self.node.create_subscription(PathMsg, f"{planner}/tool_path", self.paths.append, qos.LATCHED)
        self._controller: Any = None
        self.connect_controller()
        self.clients = {
            name: self.node.create_client(Trigger, f"{planner}/{name}", qos_profile=qos.SERVICE)
            for name in ("plan", "plan_and_wait", "look", "preview", "execute", "retreat", "stop")
        }
        self.clients["preview_to"] = self.node.create_client(GetPlan, f"{planner}/preview_to")
        self._set_parameters = self.node.create_client(SetParameters, f"{planner}/set_parameters")
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def connect_controller(self) -> None:
        """Subscribe to the motion command."""
        self._controller = self.node.create_subscription(JointTrajectory, "joint_trajectory", self._on_command, qos.COMMAND)

    def disconnect_controller(self) -> None:
        """Stop subscribing to the motion command."""
        self.unsubscribe(self._controller)

    def unsubscribe(self, subscription: Any) -> None:
        """Take a subscription down in the executor's thread: in any other one the executor may be about to wait for it."""
        self.result(self.executor.create_task(self.node.destroy_subscription, subscription), 10.0)

    def close(self) -> None:
        """Take everything down."""
        self._done.set()
        self.executor.create_task(lambda: None)
        self._thread.join(5.0)
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def _spin(self) -> None:
        while not self._done.is_set():
            self.executor.spin_once()

    def _on_command(self, msg: JointTrajectory) -> None:
        now = time.monotonic()
        self.commands.append((now, msg))
        times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in msg.points]
        motion = Trajectory.from_samples(
            tuple(msg.joint_names), times, np.array([point.positions for point in msg.points]), np.array([p.velocities for p in msg.points])
        )
        self._motion = (now, motion)

    def _on_joint_state(self, msg: JointState) -> None:
        self.q = np.array([msg.position[msg.name.index(name)] for name in self.joint_names])

    def _tick(self) -> None:
        if self._motion is not None and self.follow:
            began, motion = self._motion
            self.q = motion.sample(min(time.monotonic() - began, motion.duration_s))
        if self.publish_states:
            self.joints.publish(self.joint_state(self.q))

    @property
    def rests(self) -> bool:
        """Whether the played arm has come to the end of what it was sent."""
        return self._motion is None or time.monotonic() - self._motion[0] > self._motion[1].duration_s

    def joint_state(self, q: np.ndarray, names: Sequence[str] | None = None) -> JointState:
        """Make a joint state stamped now."""
        msg = JointState(name=list(names or self.joint_names), position=[float(v) for v in q])
        msg.header.stamp = self.node.get_clock().now().to_msg()
        return msg

    def send_target(self, pose: Sequence[float], frame_id: str = "base") -> None:
        """Publish a target x y z qx qy qz qw, once somebody listens: targets are not kept for whoever comes later."""
        self.wait(self.target.get_subscription_count, 20.0, "a subscriber of the target")
        msg = PoseStamped()
        msg.header.frame_id = frame_id
        msg.header.stamp = self.node.get_clock().now().to_msg()
        msg.pose = to_pose(pose)
        self.target.publish(msg)

    def send_clouds(self, leaf: PointCloud2 | None, stem: PointCloud2 | None) -> None:
        """Publish clouds stamped now."""
        for publisher, msg in ((self.leaf, leaf), (self.stem, stem)):
            if msg is not None:
                msg.header.stamp = self.node.get_clock().now().to_msg()
                publisher.publish(msg)

    def call_async(self, name: str, request: Any = None) -> Any:
        """Send a request; the future has the response."""
        return self.clients[name].call_async(request if request is not None else Trigger.Request())

    def call(self, name: str, request: Any = None, timeout_s: float = 60.0) -> Any:
        """Send a request and wait for the response."""
        assert self.clients[name].wait_for_service(20.0), f"no service {name}"
        return self.result(self.call_async(name, request), timeout_s)

    def result(self, future: Any, timeout_s: float = 60.0) -> Any:
        """Wait for a response."""
        deadline = time.monotonic() + timeout_s
        while not future.done():
            assert time.monotonic() < deadline, f"no answer within {timeout_s} s"
            time.sleep(0.001)
        return future.result()

    def set(self, **values: Any) -> list[str]:
        """Set parameters of the planner; returns the reasons of refusals, empty where accepted."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
        assert self._set_parameters.wait_for_service(20.0)
        response = self.result(self._set_parameters.call_async(request))
        return [outcome.reason if not outcome.successful else "" for outcome in response.results]

    def wait(self, condition: Callable[[], Any], timeout_s: float = 10.0, what: str = "") -> None:
        """Wait until a condition holds."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, f"not within {timeout_s} s: {what}; {self.summary()}"
            time.sleep(0.005)

    def summary(self) -> str:
        """The last statuses without their long figures, for failures."""
        return str([{key: value for key, value in status.items() if len(value) < 150} for status in self.statuses[-3:]])

    def received(self, name: str) -> int:
        """How many messages of an input the planner has received, by its diagnostics."""
        return int(self.health.get(f"{name}.received", "0"))

    def wait_inputs(self, *names: str) -> None:
        """Wait until the planner has inputs, by default a stem cloud and a target.

        It may be ready sooner than it finds the publishers, each seconds after the other on a busy machine.
        """
        wanted = names or ("grasp_target", "stem_cloud")
        self.wait(lambda: all(self.received(name) for name in wanted), 20.0, "the inputs' arrival")

    def status_of(self, response: Any) -> dict[str, str]:
        """The status that ended the plan of this answer; it may come after the answer."""
        return self.wait_phase("DONE", plan_id(response.message))

    def answer_since(self, count: int, timeout_s: float = 5.0) -> dict[str, str]:
        """How a plan ended, by the statuses after the first `count`: for services whose response has no message.

        The end of a motion that was under way reads DONE as well, with the code of its own plan: it does not count.
        """

        def found() -> list[dict[str, str]]:
            return [s for s in self.statuses[count:] if s["phase"] == "DONE" and "execution_code" not in s]

        self.wait(found, timeout_s, "the end of a plan")
        return found()[-1]

    def wait_phase(self, phase: str, plan_id: int | None = None, timeout_s: float = 20.0) -> dict[str, str]:
        """Wait for a status with this phase (and plan) and return it."""

        def found() -> list[dict[str, str]]:
            wanted = str(plan_id)
            return [s for s in list(self.statuses) if s["phase"] == phase and (plan_id is None or s["plan_id"] == wanted)]

        self.wait(found, timeout_s, f"phase {phase} of plan {plan_id}")
        return found()[-1]


@contextmanager
def program(arguments: Sequence[str], domain: int, ready: str | None = None, *, defects: int = 0, **more: str) -> Iterator[Program]:
    """Run an executable; it must end with code 0 after SIGINT, having logged this many defects."""
    running = Program(arguments, domain, **more)
    try:
        if ready is not None:
            running.wait_for(ready)
        yield running
    finally:
        code = running.end()
    assert code == 0, f"ended with {code}:\n{running.output}"
    assert running.output.count("Traceback") == defects, running.output


def code_of(message: str) -> str:
    """The code of an answer."""
    return message.split(":")[0]


def plan_id(message: str) -> int:
    """The request that an answer belongs to."""
    return int(message.split("plan_id ")[1].split(",")[0].rstrip("]"))


def execution_code(bench: Bench, number: int, timeout_s: float = 6.0) -> str:
    """Wait for the end of a motion and return its code."""

    def ended() -> list[dict[str, str]]:
        return [status for status in list(bench.statuses) if status["plan_id"] == str(number) and "execution_code" in status]

    bench.wait(ended, timeout_s, f"end of motion {number}")
    return ended()[-1]["execution_code"]
