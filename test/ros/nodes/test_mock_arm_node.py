"""The mock arm as a process, over DDS: states, motions, rejections in its log, faults changed while it runs, and its end."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from domains import DOMAIN

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from lime_planner.motion.stop import one_point_stop  # noqa: E402
from lime_planner.motion.timing import time_path  # noqa: E402
from lime_planner.robot.builtin import BUILTIN_ARMS  # noqa: E402
from lime_planner.ros.convert import to_joint_trajectory  # noqa: E402

pytestmark = pytest.mark.timed

LIMITS = np.full(6, 0.8)


class Bench:
    """One mock arm process and a node that talks to it."""

    def __init__(self, executor, node, *arguments):
        self.node, self.executor = node, executor
        command = [sys.executable, "-m", "lime_planner.ros.nodes.mock_arm_node", "--ros-args", *arguments]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_PYTHON_CHECK_FIELDS": "1", "RCUTILS_COLORIZED_OUTPUT": "0"}
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
        self.lines = []
        self.reader = threading.Thread(target=lambda: self.lines.extend(self.process.stdout), daemon=True)
        self.reader.start()
        self.states = []
        self.subscription = node.create_subscription(JointState, "joint_states", self.states.append, 10)
        self.publisher = node.create_publisher(JointTrajectory, "joint_trajectory", 1)
        self.setter = node.create_client(SetParameters, "mock_arm/set_parameters")
        self.until(lambda: self.states and self.publisher.get_subscription_count() and self.setter.service_is_ready())

    def until(self, condition, timeout_s=20.0):
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, "".join(self.lines)
            assert self.process.poll() is None, "".join(self.lines)
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def next_state(self):
        count = len(self.states)
        self.until(lambda: len(self.states) > count)
        return self.states[-1]

    def configuration(self):
        state = self.next_state()
        return np.array(state.position)[[state.name.index(name) for name in self.names]]

    @property
    def names(self):
        return [name for name in sorted(self.states[-1].name) if name[-1].isdigit() and "finger" not in name]

    def log(self):
        return "".join(self.lines)

    def send(self, message):
        self.publisher.publish(message)

    def move(self, goal):
        motion = time_path([self.configuration(), goal], LIMITS, 2 * LIMITS, joint_names=self.names)
        self.send(to_joint_trajectory(motion))
        return motion

    def set(self, name, value, kind):
        field = {ParameterType.PARAMETER_DOUBLE: "double_value", ParameterType.PARAMETER_BOOL: "bool_value"}
        field |= {ParameterType.PARAMETER_INTEGER_ARRAY: "integer_array_value", ParameterType.PARAMETER_STRING: "string_value"}
        request = SetParameters.Request(parameters=[Parameter(name=name, value=ParameterValue(type=kind, **{field[kind]: value}))])
        future = self.setter.call_async(request)
        self.until(future.done)
        return future.result().results[0]

    def end(self, *signals):
        for number in signals or (signal.SIGTERM,):
            self.process.send_signal(number)
            time.sleep(0.005)
        code = self.process.wait(timeout=10)
        self.reader.join(timeout=5)
        self.node.destroy_subscription(self.subscription)
        self.node.destroy_publisher(self.publisher)
        self.node.destroy_client(self.setter)
        return code


@pytest.fixture(scope="module")
def ros():
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    node = rclpy.create_node("bench", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield executor, node
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.fixture
def bench(ros):
    started = []

    def start(*arguments):
        started.append(Bench(*ros, *arguments))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                one.end()
        if one.process.poll() is None:
            one.process.kill()


@pytest.mark.parametrize(("controller", "robot", "rate_hz"), [("jtc", "kinova_j2s6s200", 50), ("kinova", "kinova_j2n6s300", 10)])
def test_moves_and_reports(bench, controller, robot, rate_hz):
    arm = bench("-p", f"controller:={controller}", "-p", f"robot:={robot}")
    known = BUILTIN_ARMS[robot]
    assert arm.names == list(known.joint_names)
    fingers = [name for name in arm.states[-1].name if "finger" in name]
    assert len(fingers) == int(robot[-3])
    assert arm.configuration() == pytest.approx(known.home)
    goal = np.add(known.home, [0.3, -0.2, 0.2, 0.3, 0.1, -0.4])
    motion = arm.move(goal)
    count = len(arm.states)
    arm.spin(motion.duration_s + 0.7)
    assert (len(arm.states) - count) / (motion.duration_s + 0.7) == pytest.approx(rate_hz, rel=0.25)
    assert np.abs(arm.configuration() - goal).max() < (1e-6 if controller == "jtc" else 0.02)
    stamp = arm.next_state().header.stamp
    assert abs(time.time() - stamp.sec - 1e-9 * stamp.nanosec) < 0.5
    assert arm.end(signal.SIGTERM) == 0
    assert f"{len(motion)} points" in arm.log() and "Traceback" not in arm.log()


def test_rejections_are_logged_sentences(bench):
    arm = bench("-p", "controller:=jtc")
    before = arm.configuration()
    message = to_joint_trajectory(time_path([before, before + 0.2], LIMITS, LIMITS, joint_names=arm.names))
    message.points[-1].velocities = [0.1] * 6
    arm.send(message)
    arm.until(lambda: "rejected: the velocities of the last point must be zero" in arm.log())
    arm.send(JointTrajectory(joint_names=arm.names))
    arm.until(lambda: "rejected: the message has no points" in arm.log())
    message.points[-1].velocities = [0.0] * 6
    message.header.stamp.sec = 1
    arm.send(message)
    arm.until(lambda: "rejected: by its stamp the motion ended" in arm.log())
    assert (arm.configuration() == before).all()
    arm.move(before + 0.1)
    arm.until(lambda: "accepted" in arm.log())
    assert arm.end(signal.SIGINT, signal.SIGINT) == 0


def test_kinova_is_stopped_by_one_point(bench):
    arm = bench("-p", "controller:=kinova", "-p", "rate_hz:=50")
    start = arm.configuration()
    arm.move(start + 0.6)
    arm.spin(0.7)
    arm.send(to_joint_trajectory(one_point_stop(arm.names, arm.configuration())))
    arm.spin(0.3)
    at = arm.configuration()
    assert np.abs(at - start).max() > 0.05
    arm.spin(0.3)
    assert (arm.configuration() == at).all()
    assert "goes on with that index" in arm.log()


def test_faults_change_while_it_runs(bench):
    arm = bench("-p", "noise_rad:=0")
    start = arm.configuration()
    assert arm.set("noise_rad", 0.05, ParameterType.PARAMETER_DOUBLE).successful
    arm.spin(0.2)
    assert 0.001 < np.abs(arm.configuration() - start).max() < 0.4
    assert arm.set("noise_rad", 0.0, ParameterType.PARAMETER_DOUBLE).successful
    assert arm.set("wrap_offset_turns", [0, 0, 0, 2, 0, -1], ParameterType.PARAMETER_INTEGER_ARRAY).successful
    assert arm.set("shuffle", True, ParameterType.PARAMETER_BOOL).successful
    arm.spin(0.2)
    assert arm.configuration() - start == pytest.approx(2 * np.pi * np.array([0, 0, 0, 2, 0, -1]))
    orders = {tuple(arm.next_state().name) for _ in range(5)}
    assert len(orders) > 1
    assert arm.set("state_delay_s", 0.5, ParameterType.PARAMETER_DOUBLE).successful
    arm.spin(0.2)
    stamp = arm.next_state().header.stamp
    assert 0.4 < time.time() - stamp.sec - 1e-9 * stamp.nanosec < 1.0
    assert arm.set("drop_probability", 1.0, ParameterType.PARAMETER_DOUBLE).successful
    arm.spin(0.2)
    count = len(arm.states)
    arm.spin(0.4)
    assert len(arm.states) == count
    assert arm.set("drop_probability", 0.0, ParameterType.PARAMETER_DOUBLE).successful
    arm.next_state()


def test_refused_faults_say_why(bench):
    arm = bench()
    for name, value, kind, words in (
        ("noise_rad", 5.0, ParameterType.PARAMETER_DOUBLE, "noise_rad is 5.0; allowed: 0 to 1"),
        ("gain_error", "x", ParameterType.PARAMETER_STRING, "gain_error must be of type float, got 'x'"),
        ("wrap_offset_turns", [1, 2], ParameterType.PARAMETER_INTEGER_ARRAY, "wrap_offset_turns needs 0, 1 or 6 numbers, got 2"),
        ("controller", "kinova", ParameterType.PARAMETER_STRING, "read-only"),
    ):
        result = arm.set(name, value, kind)
        assert not result.successful and words in result.reason
    arm.next_state()


@pytest.mark.parametrize("signals", [(signal.SIGINT,), (signal.SIGTERM,), (signal.SIGINT, signal.SIGINT)])
def test_signals_end_it_cleanly_in_a_motion(bench, signals):
    arm = bench("-p", "arm_joints:=[a1,a2]", "-p", "start:=[0.1,7.0]")
    assert arm.configuration() == pytest.approx([0.1, 7.0])
    arm.send(to_joint_trajectory(time_path([[0.1, 7.0], [1.0, 6.0]], LIMITS[:2], LIMITS[:2], joint_names=("a1", "a2"))))
    arm.until(lambda: "accepted" in arm.log())
    assert arm.end(*signals) == 0
    assert "Traceback" not in arm.log()


@pytest.mark.parametrize(
    ("argument", "words"),
    [("controller:=mine", "controller is 'mine'; allowed: one of jtc, kinova"), ("robot:=topic", "the mock arm needs arm_joints")],
)
def test_bad_parameters_end_it_with_a_sentence(argument, words):
    command = [sys.executable, "-m", "lime_planner.ros.nodes.mock_arm_node", "--ros-args", "-p", argument]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=30, env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)})
    assert ended.returncode == 1 and words in ended.stderr and "Traceback" not in ended.stderr
