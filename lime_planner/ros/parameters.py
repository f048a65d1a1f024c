"""The parameter table as ROS parameters: declared with descriptions and ranges, checked on set, one snapshot for each plan."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import (
    NODE_PARAMETERS,
    PARAMETERS,
    NodeSettings,
    Parameter,
    Settings,
    frozen,
    settings_from,
    unknown_names,
    validate,
)
from lime_planner.scene import point_cloud2
from lime_planner.scene.labels import fruit_in_force

_TABLE = {**PARAMETERS, **NODE_PARAMETERS}
_ARRAYS = {int: RosParameter.Type.INTEGER_ARRAY, float: RosParameter.Type.DOUBLE_ARRAY, str: RosParameter.Type.STRING_ARRAY}


@dataclass(frozen=True)
class Snapshot:
    """All parameters at one moment: what the pipeline gets and what the node keeps for itself."""

    plan: Settings
    node: NodeSettings


def snapshot_from(values: Mapping[str, Any]) -> Snapshot:
    """Make a snapshot of some parameters, the defaults for the rest.

    Raises:
        ParameterError: unknown name, wrong type, out of range, or values that contradict each other.
    """
    checked = {name: validate(name, value) for name, value in values.items()}
    node = NodeSettings(**frozen({name: value for name, value in checked.items() if name in NODE_PARAMETERS}))
    fruit = fruit_in_force(node.leaf_labels, node.stem_labels, node.fruit_labels, node.ignored_labels, node.class_costs)
    if node.label_field in ("", *point_cloud2.XYZ, point_cloud2.COST_FIELD):
        raise ParameterError(f"label_field is {node.label_field!r}; it must name a field that holds nothing but the class")
    plan = settings_from(checked)
    # Where a motion may end, the next one must be able to begin.
    tolerance_rad = max(plan.start_limit_tolerance_rad, 1.5 * node.goal_tolerance_rad)
    return Snapshot(dataclasses.replace(plan, start_limit_tolerance_rad=tolerance_rad), dataclasses.replace(node, fruit_labels=fruit))


class NodeParameters:
    """Declares the table on a node and keeps the current `Snapshot`."""

    def __init__(self, node: Node) -> None:
        """Declare everything.

        Raises:
            ParameterError: a value given at start (file, command line) is not allowed, or its name is nearly that of a parameter.
        """
        self._node = node
        for sentence in unknown_names(node._parameter_overrides):
            node.get_logger().warning(sentence)
        #: Told about every new snapshot, after it is in force.
        self.on_change: Callable[[Snapshot], None] = lambda _: None
        given = {name: parameter.value for name, parameter in node._parameter_overrides.items() if name in _TABLE}
        given |= {name: [] for name, value in given.items() if value is None and _TABLE[name].kind is list}  # a file's [] has no type
        self._snapshot = snapshot_from(given)
        for name, parameter in _TABLE.items():
            # Given values were checked above and are put into the table's own type: 1 is a fine duration in a file.
            value = validate(name, given.get(name, parameter.default))
            node.declare_parameter(name, value, _descriptor(parameter), ignore_override=True)
            if value == [] and not parameter.read_only:
                node.set_parameters([RosParameter(name, _ARRAYS[parameter.element], value)])  # rclpy takes [] for bytes
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    @property
    def snapshot(self) -> Snapshot:
        """The parameters as they are now; immutable, so that one plan sees one set."""
        return self._snapshot

    def _merged(self, changed: Sequence[RosParameter]) -> dict[str, Any]:
        values = {name: self._node.get_parameter(name).value for name in _TABLE}
        values.update({parameter.name: parameter.value for parameter in changed if parameter.name in _TABLE})
        return {name: list(value) if _is_array(value) else value for name, value in values.items()}

    def _check(self, changed: Sequence[RosParameter]) -> SetParametersResult:
        removed = [parameter.name for parameter in changed if parameter.name in _TABLE and parameter.value is None]
        if removed:
            return SetParametersResult(successful=False, reason=f"{', '.join(removed)}: the value cannot be removed")
        try:
            snapshot_from(self._merged(changed))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, changed: Sequence[RosParameter]) -> None:
        self._snapshot = snapshot_from(self._merged(changed))
        self.on_change(self._snapshot)


def _is_array(value: Any) -> bool:
    return hasattr(value, "__iter__") and not isinstance(value, str)


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    descriptor = ParameterDescriptor(
        description=f"{parameter.description}{unit}",
        additional_constraints="" if parameter.range_text == "any" else parameter.range_text,
        read_only=parameter.read_only,
        # Our own check is the stricter one, and it takes the 1 for the 1.0 that people write.
        dynamic_typing=True,
    )
    low, high = parameter.minimum, parameter.maximum
    if parameter.kind is float and (low is not None or high is not None):
        from_value = float(-sys.float_info.max if low is None else low)
        to_value = float(sys.float_info.max if high is None else high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=from_value, to_value=to_value)]
    elif parameter.kind is int and (low is not None or high is not None):
        from_int, to_int = int(-(2**63) if low is None else low), int(2**63 - 1 if high is None else high)
        descriptor.integer_range = [IntegerRange(from_value=from_int, to_value=to_int)]
    return descriptor
