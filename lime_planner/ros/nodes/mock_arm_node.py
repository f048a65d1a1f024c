"""The node `mock_arm`: an arm without an arm, for demos and tests. It plays `joint_trajectory` and publishes `joint_states`."""

from __future__ import annotations

import array
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import Parameter
from lime_planner.motion.controllers.command import Command
from lime_planner.motion.controllers.replay import TICK_S
from lime_planner.motion.controllers.simulated_arm import CONTROLLERS, LONGEST_DELAY_S, Faults, SimulatedArm
from lime_planner.robot.builtin import BUILTIN_ARMS
from lime_planner.ros.programs import answered
from lime_planner.ros.qos import COMMAND
from lime_planner.ros.runtime import run_node

#: Reliable, which suits reliable and best-effort subscribers.
_STATES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE
)
_RATES_HZ = {"jtc": 50.0, "kinova": 10.0}
_LONGEST_STEP_S = 1.0  # a machine that slept does not make the arm race


_ROBOT = "A built-in arm, or a URDF file; gives joint names and starting configuration unless arm_joints and start are given."
TABLE: tuple[Parameter, ...] = (
    Parameter("robot", "kinova_j2s6s200", _ROBOT, read_only=True),
    Parameter("arm_joints", [], "Names of the joints in the driver's order; empty for the robot's.", read_only=True, element=str),
    Parameter("controller", "jtc", "Whose rules the arm follows.", choices=CONTROLLERS, read_only=True),
    Parameter("start", [], "Configuration at start; empty for the robot's ready pose.", unit="rad", read_only=True),
    Parameter("rate_hz", 0.0, "Rate of joint_states; 0: 50 (jtc) or 10 (kinova).", unit="Hz", minimum=0.0, maximum=1000.0, read_only=True),
    Parameter("seed", 0, "Seed of noise, drops and orders.", minimum=0, read_only=True),
    Parameter("lag_s", 0.0, "Fault: time constant with which the arm follows its controller.", unit="s", minimum=0.0, maximum=10.0),
    Parameter("gain_error", 0.0, "Fault: part by which motions come out too large.", minimum=-1.0, maximum=1.0),
    Parameter("speed_scaling", 1.0, "Fault: pace of a joint trajectory controller, part of the planned one.", minimum=0.0, maximum=1.0),
    Parameter("noise_rad", 0.0, "Fault: standard deviation of the reported positions.", unit="rad", minimum=0.0, maximum=1.0),
    Parameter("drop_probability", 0.0, "Fault: part of the states that are not published.", minimum=0.0, maximum=1.0),
    Parameter("state_delay_s", 0.0, "Fault: age of the states when they are published.", unit="s", minimum=0.0, maximum=LONGEST_DELAY_S),
    Parameter("stall_at_fraction", 0.0, "Fault: motions stop at this part of their duration; 0 for never.", minimum=0.0, maximum=1.0),
    Parameter("shuffle", False, "Fault: the joints come in another order each time."),
    Parameter("extra_joints", [], "Fault: further joints to publish, besides the fingers.", element=str),
    Parameter("report_wrapped", False, "Fault: joints that turn without end are reported within [-π, π)."),
    Parameter("wrap_offset_turns", [], "Fault: turns added to each joint's reported angle; one for all, or one a joint.", element=int),
)
_BY_NAME = {parameter.name: parameter for parameter in TABLE}


def checked(name: str, value: Any) -> Any:
    """Return a value as its parameter's own type.

    Raises:
        ParameterError: wrong type or out of range.
    """
    parameter = _BY_NAME[name]
    if parameter.kind is list:
        if value is None or isinstance(value, (str, bytes, bool, int, float)):
            raise ParameterError(f"{name} must be a list, got {value!r}")
        return [_scalar(parameter, item, parameter.element) for item in value]
    return _scalar(parameter, value, parameter.kind)


def _scalar(parameter: Parameter, value: Any, kind: Any) -> Any:
    if not isinstance(value, (int, float) if kind is float else kind) or (kind is not bool and isinstance(value, bool)):
        raise ParameterError(f"{parameter.name} must be of type {kind.__name__}, got {value!r}")
    low, high = parameter.minimum, parameter.maximum
    in_range = (low is None or value >= low) and (high is None or value <= high)
    if not in_range or (parameter.choices and value not in parameter.choices):
        raise ParameterError(f"{parameter.name} is {value!r}; allowed: {parameter.range_text}")
    return kind(value)


class MockArmParameters:
    """The table on a node: declared, and read in the table's types; the faults as one value."""

    def __init__(self, node: Node) -> None:
        """Declare everything.

        Raises:
            ParameterError: a value given at start is not allowed.
        """
        self._node = node
        for parameter in TABLE:
            given = node._parameter_overrides.get(parameter.name)
            value = checked(parameter.name, parameter.default if given is None else given.value)
            description = parameter.description + (f" [{parameter.unit}]" if parameter.unit else "")
            limits = "" if parameter.range_text == "any" else parameter.range_text
            descriptor = ParameterDescriptor(
                description=description, additional_constraints=limits, read_only=parameter.read_only, dynamic_typing=True
            )
            node.declare_parameter(parameter.name, value, descriptor, ignore_override=True)

    def __getitem__(self, name: str) -> Any:
        """Return a parameter's value in its own type."""
        value = self._node.get_parameter(name).value
        return checked(name, list(value) if _BY_NAME[name].kind is list else value)

    def faults(self, changed: Mapping[str, Any] | None = None) -> Faults:
        """Return the faults as they are set, or as they would be with some changed."""
        values: dict[str, Any] = {name: self[name] for name in Faults.__dataclass_fields__}
        values.update({name: checked(name, value) for name, value in (changed or {}).items() if name in values})
        frozen: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        return Faults(**frozen)


class MockArmNode(Node):
    """Wiring between messages and a `SimulatedArm`."""

    def __init__(self) -> None:
        """Stand at the starting configuration.

        Raises:
            ParameterError: a parameter that cannot be used.
        """
        super().__init__("mock_arm")
        self._table = MockArmParameters(self)
        names, fingers, start, continuous = self._arm()
        controller = self._table["controller"]
        rng = np.random.default_rng(self._table["seed"])
        self._sim = SimulatedArm(
            names, start, rng=rng, controller=controller, finger_joints=fingers, continuous=continuous, faults=self._table.faults()
        )
        self.add_on_set_parameters_callback(self._check_faults)
        self.add_post_set_parameters_callback(self._take_faults)
        self._publisher = self.create_publisher(JointState, "joint_states", _STATES)
        self._truth = self.create_publisher(JointState, "~/true_joint_states", _STATES)
        self.create_subscription(JointTrajectory, "joint_trajectory", self._take_command, COMMAND)
        rate_hz = self._table["rate_hz"] or _RATES_HZ[controller]
        self._last_s = time.monotonic()
        self.create_timer(TICK_S, self._advance)
        self.create_timer(1.0 / rate_hz, self._publish)
        self.get_logger().info(f"mock arm of {len(names)} joints, controller {controller}, joint_states at {rate_hz:g} Hz")

    def _arm(self) -> tuple[tuple[str, ...], tuple[str, ...], list[float], Any]:
        """Return joint names, finger joints, starting configuration and which joints are continuous (None for all)."""
        robot, names, start = self._table["robot"], tuple(self._table["arm_joints"]), self._table["start"]
        fingers: tuple[str, ...] = ()
        continuous: Any = None
        ready: list[float] = []
        if robot in BUILTIN_ARMS:
            arm = BUILTIN_ARMS[robot]
            names = names or arm.joint_names
            # j2n6s300: the digit after the s is the number of fingers.
            fingers = tuple(f"{arm.prefix}_joint_finger_{i + 1}" for i in range(int(arm.prefix[5])))
            ready = list(arm.home)
            continuous = arm.continuous if len(names) == len(arm.joint_names) else None
        elif not names:
            if robot == "topic":
                raise ParameterError("robot is 'topic': the mock arm needs arm_joints then")
            from lime_planner.robot.model import home, load_robot  # Pinocchio: only where it is needed

            model = load_robot(robot)
            names, continuous, ready = model.joint_names, model.continuous, [float(angle) for angle in home(model)]
        return names, fingers, start or (ready if len(ready) == len(names) else [0.0] * len(names)), continuous

    def _take_command(self, msg: JointTrajectory) -> None:
        stamp = msg.header.stamp
        start_s = None
        if stamp.sec or stamp.nanosec:
            start_s = (Time.from_msg(stamp, clock_type=self.get_clock().clock_type) - self.get_clock().now()).nanoseconds * 1e-9
        times_s = tuple(point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in msg.points)
        positions, velocities, accelerations = (
            tuple(tuple(getattr(point, what)) for point in msg.points) for what in ("positions", "velocities", "accelerations")
        )
        self._advance()
        verdict = self._sim.command(Command(tuple(msg.joint_names), times_s, positions, velocities, accelerations, start_s))
        if not verdict.accepted:
            self.get_logger().error(f"joint_trajectory {verdict.sentence}")
            return
        self.get_logger().info(f"joint_trajectory accepted: {len(times_s)} points, {times_s[-1]:.3f} s")
        if verdict.sentence:
            self.get_logger().warning(f"joint_trajectory: {verdict.sentence}")

    def _advance(self) -> None:
        now_s = time.monotonic()
        self._sim.step(min(now_s - self._last_s, _LONGEST_STEP_S))
        self._last_s = now_s

    def _publish(self) -> None:
        self._advance()
        truth = JointState()
        truth.header.stamp = self.get_clock().now().to_msg()
        truth.name, truth.position = list(self._sim.joint_names), array.array("d", np.asarray(self._sim.configuration, float).tobytes())
        self._truth.publish(truth)
        reading = self._sim.state()
        if reading is None:
            return
        msg = JointState()
        msg.header.stamp = (self.get_clock().now() - Duration(nanoseconds=round(reading.age_s * 1e9))).to_msg()
        msg.name = list(reading.joint_names)
        msg.position = array.array("d", reading.positions.tobytes())
        msg.velocity = array.array("d", reading.velocities.tobytes())
        self._publisher.publish(msg)

    def _check_faults(self, changed: list[RosParameter]) -> SetParametersResult:
        try:
            faults = self._table.faults({parameter.name: parameter.value for parameter in changed})
            self._sim.check(faults)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_faults(self, _changed: list[RosParameter]) -> None:
        self._sim.faults = self._table.faults()


def parameter_help() -> list[tuple[str, str]]:
    """Return every parameter's name and what it is, default and range included, for `--help`."""
    rows = []
    for parameter in TABLE:
        default = "" if parameter.default in ([], "") else f", default {parameter.default}"
        limits = "" if parameter.range_text == "any" else f", {parameter.range_text}"
        rows.append((parameter.name, f"{parameter.description} [{parameter.unit or parameter.kind.__name__}{default}{limits}]"))
    return rows


def main() -> int:
    """Run the node until a signal."""
    code = answered("mock_arm_node", sys.argv[1:])
    return run_node(MockArmNode) if code is None else code


if __name__ == "__main__":
    sys.exit(main())
