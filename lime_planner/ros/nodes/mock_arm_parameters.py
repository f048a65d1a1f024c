"""The mock arm's parameters: one table, declared and checked from here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import Parameter
from lime_planner.motion.controllers.simulated_arm import CONTROLLERS, LONGEST_DELAY_S, Faults

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
