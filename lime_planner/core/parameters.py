"""Every setting of the planner in one table: the node declares it, the command line sets it, the documentation is made from it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any

from lime_planner.core.errors import ParameterError
from lime_planner.core.planners import DEFAULT_PLANNER, PLANNERS


@dataclass(frozen=True)
class Parameter:
    """One setting: what it means, what it may be.

    Attributes:
        name: its name as a ROS parameter and as an attribute of `Settings`.
        default: its default; its type is the setting's type (lists are lists of one type, `element` when the default is empty).
        description: one sentence.
        unit: SI unit, empty where there is none.
        minimum: smallest allowed value, of every element for lists.
        maximum: largest allowed value.
        choices: the allowed values, empty for any.
        read_only: set at start only.
        element: type of a list's elements.
        length_multiple: a list's length must be a multiple of this.
        planning: part of `Settings` (used by the pipeline); otherwise the node's alone.
    """

    name: str
    default: Any
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False
    element: type = float
    length_multiple: int = 1

    @property
    def kind(self) -> type:
        """The Python type: bool, int, float, str or list."""
        return type(self.default)

    @property
    def range_text(self) -> str:
        """The allowed values in words, for error messages and documentation."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}"
        if self.minimum is not None:
            return f"at least {self.minimum:g}"
        if self.maximum is not None:
            return f"at most {self.maximum:g}"
        return "any"


# fmt: off
_TABLE = (
    Parameter("robot", "kinova_j2s6s200", "The arm: a built-in model (kinova_j2s6s200, kinova_j2n6s300), `topic`, or a URDF's path.", read_only=True),
    Parameter("arm_joints", [], "The arm's joints in driver order; empty: the model's own.", element=str, read_only=True),
    Parameter("planning_frame", "", "Frame of clouds and targets while planning: the root of the arm's chain; empty: the model's.", read_only=True),
    Parameter("tool_frame", "", "Frame that must reach the target; empty: the model's `<name>_end_effector`.", read_only=True),
    Parameter("planner", DEFAULT_PLANNER, "Which search: the default, or one of the paper's three.", choices=tuple(PLANNERS)),
    Parameter("time_budget_s", 0.5, "Search time; the best path found until then is used.", "s", 0.01, 600.0),
    Parameter("iterations", 0, "Search iterations instead of time (the same seed then gives the same path); 0: by time.", "", 0, 100_000_000),
    Parameter("seed", 0, "Seed of the random generator; 0: a fresh one for each plan, echoed in the result.", "", 0, 2**31 - 1),
    Parameter("c_perm", 100.0, "Cost of one tree node inside leaves in the paper's metric (C_perm).", "", 0.0, 1e9),
    Parameter("step_rad", 0.1, "Step of the paper's planners (δ).", "rad", 0.001, 1.0),
    Parameter("leaf_weight", -1.0, "Cost of a radian of leaf contact in the integral metric; negative: c_perm / step_rad.", "1/rad", -1.0, 1e9),
    Parameter("leaf_cost", "binary", "What a touched leaf costs: `binary` (any contact is 1) or `graded` (grows with the leaf area touched).", choices=("binary", "graded")),
    Parameter("leaf_policy", "permeable", "`permeable` (leaves cost), `solid` (leaves are obstacles), `ignored` (leaves are free), for comparison.", choices=("permeable", "solid", "ignored")),
    Parameter("max_leaf_contact_rad", -1.0, "Refuse paths with more leaf contact than this (LEAF_BUDGET_EXCEEDED); negative: off.", "rad", -1.0, 100.0),
    Parameter("beta", 1.0, "Strength of the adaptive potential field in apf_rrt_star (β).", "", 0.0, 100.0),
    Parameter("k_att", 50.0, "Attractive gain of the potential field in joint space (K_att).", "1/rad²", 0.0, 1e9),
    Parameter("k_rep_leaf", 2e-4, "Repulsive gain of leaves (K_rep), for workspace distances.", "m²", 0.0, 1e9),
    Parameter("k_rep_stem", 2e-4, "Repulsive gain of stems (K_rep), for workspace distances.", "m²", 0.0, 1e9),
    Parameter("d_star_m", 0.1, "Range of the repulsive field (d*), a workspace distance.", "m", 0.001, 10.0),
    Parameter("goal_radius_rad", 0.3, "The paper's planners join the goal from nodes within this distance of it.", "rad", 0.0, 10.0),
    Parameter("goal_bias", 0.05, "Share of the paper's planners' samples that are a goal; the paper names none.", "", 0.0, 1.0),
    Parameter("ik_starts", 200, "Random starts of the inverse kinematics.", "", 1, 100_000),
    Parameter("max_goals", 24, "Goal configurations handed to the search, the most promising first.", "", 1, 1000),
    Parameter("stem_margin_m", 0.005, "Clearance to stems that the search keeps, beyond their radius; less only close to a start or goal that has less.", "m", 0.0, 0.2),
    Parameter("stem_point_radius_m", 0.004, "Radius of a stem point.", "m", 0.0005, 0.1),
    Parameter("leaf_point_radius_m", 0.004, "Radius of a leaf point.", "m", 0.0005, 0.1),
    Parameter("target_exclusion_radius_m", 0.06, "Points this close to the target do not block the gripper's links in the approach zone; 0: off.", "m", 0.0, 0.5),
    Parameter("approach_zone_m", 0.10, "Distance of the tool from the target within which the exclusion sphere holds.", "m", 0.0, 1.0),
    Parameter("self_filter_padding_m", 0.01, "Points of live clouds this close to the arm's own meshes are taken for the arm.", "m", 0.0, 0.1),
    Parameter("voxel_m", 0.01, "Largest spacing of the distance fields.", "m", 0.002, 0.05),
    Parameter("keep_out_boxes", [], "Boxes as hard as stems: min x y z, max x y z of each, in the planning frame.", "m", length_multiple=6),
    Parameter("floor_z_m", -1000.0, "Height of a floor as hard as a stem, for all links but the base; -1000: none.", "m", -1000.0, 1000.0),
    Parameter("workspace_box", [], "Box that the arm must stay in: min x y z, max x y z; empty: none.", "m", length_multiple=6),
    Parameter("velocity_scaling", 1.0, "Share of the joint velocity limits that a motion may use.", "", 0.01, 1.0),
    Parameter("acceleration_scaling", 1.0, "Share of the joint acceleration limits that a motion may use.", "", 0.01, 1.0),
    Parameter("leaf_speed_scale", 1.0, "Share of the speed used where the arm touches leaves.", "", 0.05, 1.0),
    Parameter("trajectory_dt_s", 0.02, "Time grid of the trajectory.", "s", 0.01, 0.5),
    Parameter("corner_tolerance_rad", 0.01, "How far the timed motion may cut the corners of the path, in joint space.", "rad", 0.0005, 0.1),
)

_NODE_TABLE = (
    Parameter("motion_enabled", True, "Whether `~/plan`, `~/execute` and `~/retreat` may move the arm."),
    Parameter("allow_empty_stem_cloud", False, "Whether a motion is allowed with an empty stem cloud or none."),
    Parameter("max_cloud_age_s", 0.0, "Refuse to plan on clouds older than this; 0: off.", "s", 0.0, 1e6),
    Parameter("max_joint_state_age_s", 0.3, "Refuse to plan or move on joint states older than this; 0: off.", "s", 0.0, 1e6),
    Parameter("max_target_age_s", 0.0, "Refuse targets older than this, when ~/plan or ~/preview begins and when ~/plan sends; 0: off.", "s", 0.0, 1e6),
    Parameter("label_field", "label", "Field of `labelled_cloud` that holds the class."),
    Parameter("leaf_labels", [0], "Classes of `labelled_cloud` that are leaves.", element=int),
    Parameter("stem_labels", [1], "Classes that are stems (every other class not named here is impermeable too).", element=int),
    Parameter("fruit_labels", [2], "Classes that are fruit: impermeable, the one at the target excepted. The default gives way to classes that are named elsewhere.", element=int),
    Parameter("ignored_labels", [], "Classes that are left out.", element=int),
    Parameter("max_cloud_skew_s", 0.0, "Refuse leaf and stem clouds whose stamps are further apart than this; 0: off.", "s", 0.0, 1e6),
    Parameter("max_clock_skew_s", 1.0, "Refuse stamps that lie further in the future than this; 0: off.", "s", 0.0, 1e6),
    Parameter("static_transforms", [], "Where tf2 is not there: `parent child x y z qx qy qz qw` of each camera, in metres.", element=str, read_only=True),
    Parameter("tf_timeout_s", 0.2, "How long a plan waits for the transform of a cloud or a target.", "s", 0.0, 60.0),
    Parameter("warm_up_timeout_s", 600.0, "How long a request waits for the compilation of the kernels before it answers NOT_READY.", "s", 0.0, 3600.0),
    Parameter("controller", "jtc", "What carries the motion out, and so how it is stopped: a joint trajectory controller or Kinova's driver.", choices=("jtc", "kinova")),
    Parameter("start_tolerance_rad", 0.01, "Largest difference of a joint from the plan's start when the motion is sent.", "rad", 0.0001, 0.1),
    Parameter("stillness_rad", 0.003, "The arm is at rest when no joint moved further than this within stillness_time_s.", "rad", 0.0001, 0.1),
    Parameter("stillness_time_s", 0.25, "See stillness_rad.", "s", 0.02, 5.0),
    Parameter("stillness_timeout_s", 3.0, "How long a request waits for the arm to come to rest before it answers ARM_MOVING.", "s", 0.1, 60.0),
    Parameter("execution_tolerance_rad", 0.15, "Stop a motion when a joint is further than this from where the plan had it during the last execution_lag_s.", "rad", 0.005, 3.0),
    Parameter("execution_lag_s", 0.4, "How far the arm may lag behind the plan.", "s", 0.0, 5.0),
    Parameter("goal_tolerance_rad", 0.02, "A motion has succeeded when the arm rests this close to its last point.", "rad", 0.0005, 0.5),
    Parameter("goal_time_s", 2.0, "How long the arm may take to come to rest there after the motion's end.", "s", 0.1, 60.0),
    Parameter("replan_attempts", 0, "How often `~/plan` plans again from rest after a motion was stopped by a new stem or a deviation.", "", 0, 10),
    Parameter("deadline_s", 0.0, "Give a request up as TIMED_OUT after this long, certificate and last checks included; what waits for rest or compiles before does not count; 0: off.", "s", 0.0, 600.0),
    Parameter("viewer_port", 0, "Port of the 3-D page; 0: off.", "", 0, 65535, read_only=True),
    Parameter("viewer_host", "127.0.0.1", "Address that the 3-D page is served at; elsewhere it is for looking only, unless LIME_PLANNER_VIEWER_TOKEN is set.", read_only=True),
)
# fmt: on

#: Settings of the pipeline, by name.
PARAMETERS: dict[str, Parameter] = {p.name: p for p in _TABLE}
#: Settings of the node alone (inputs and motion), by name.
NODE_PARAMETERS: dict[str, Parameter] = {p.name: p for p in _NODE_TABLE}


@dataclass(frozen=True)
class Settings:
    """One consistent set of the pipeline's parameters; names, units and meanings are those of `PARAMETERS`."""

    robot: str
    arm_joints: tuple[str, ...]
    planning_frame: str
    tool_frame: str
    planner: str
    time_budget_s: float
    iterations: int
    seed: int
    c_perm: float
    step_rad: float
    leaf_weight: float
    leaf_cost: str
    leaf_policy: str
    max_leaf_contact_rad: float
    beta: float
    k_att: float
    k_rep_leaf: float
    k_rep_stem: float
    d_star_m: float
    goal_radius_rad: float
    goal_bias: float
    ik_starts: int
    max_goals: int
    stem_margin_m: float
    stem_point_radius_m: float
    leaf_point_radius_m: float
    target_exclusion_radius_m: float
    approach_zone_m: float
    self_filter_padding_m: float
    voxel_m: float
    keep_out_boxes: tuple[float, ...]
    floor_z_m: float
    workspace_box: tuple[float, ...]
    velocity_scaling: float
    acceleration_scaling: float
    leaf_speed_scale: float
    trajectory_dt_s: float
    corner_tolerance_rad: float

    @property
    def weight(self) -> float:
        """Cost of one radian of leaf contact [1/rad]: `leaf_weight`, or C_perm / δ."""
        return self.leaf_weight if self.leaf_weight >= 0.0 else self.c_perm / self.step_rad


def _number(parameter: Parameter, value: Any, element: type) -> Any:
    if element is bool or isinstance(value, bool):
        if element is bool and isinstance(value, bool):
            return value
        raise ParameterError(f"{parameter.name} must be a {element.__name__}, got {value!r}")
    if element is str:
        if not isinstance(value, str):
            raise ParameterError(f"{parameter.name} must be text, got {value!r}")
        return value
    wanted = "whole number" if element is int else "number"
    if not isinstance(value, Real):  # NumPy's numbers are such too
        raise ParameterError(f"{parameter.name} must be a {wanted}, got {value!r}")
    try:
        finite = math.isfinite(value)
    except OverflowError:  # a whole number beyond every float
        finite = False
    if not finite:
        raise ParameterError(f"{parameter.name} must be finite, got {value!r}")
    number = element(value)
    if element is int and number != value:
        raise ParameterError(f"{parameter.name} must be a {wanted}, got {value!r}")
    low, high = parameter.minimum, parameter.maximum
    if (low is not None and number < low) or (high is not None and number > high):
        raise ParameterError(f"{parameter.name} is {number!r}; allowed: {parameter.range_text} {parameter.unit}".rstrip())
    return number


def validate(name: str, value: Any) -> Any:
    """Return `value` as the parameter's own type.

    Raises:
        ParameterError: unknown name (the text lists close ones), wrong type, out of range.
    """
    parameter = PARAMETERS.get(name) or NODE_PARAMETERS.get(name)
    if parameter is None:
        import difflib

        close = difflib.get_close_matches(name, [*PARAMETERS, *NODE_PARAMETERS], n=3)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        raise ParameterError(f"there is no parameter {name!r}{hint}")
    if parameter.kind is list:
        try:
            elements = None if isinstance(value, str) else list(value)
        except TypeError:
            elements = None
        if elements is None:
            raise ParameterError(f"{name} must be a list, got {value!r}")
        values = [_number(parameter, v, parameter.element) for v in elements]
        if len(values) % parameter.length_multiple:
            raise ParameterError(f"{name} needs a multiple of {parameter.length_multiple} numbers, got {len(values)}")
        return values
    checked = _number(parameter, value, parameter.kind)
    if parameter.choices and checked not in parameter.choices:
        raise ParameterError(f"{name} is {checked!r}; allowed: {parameter.range_text}")
    return checked


def _check_together(values: Mapping[str, Any]) -> None:
    for name in ("keep_out_boxes", "workspace_box"):
        box = values[name]
        for k in range(0, len(box), 6):
            low, high = box[k : k + 3], box[k + 3 : k + 6]
            if any(a >= b for a, b in zip(low, high, strict=True)):
                raise ParameterError(f"{name}: box {k // 6} has its minimum {list(low)} not below its maximum {list(high)}")
    if len(values["workspace_box"]) > 6:
        raise ParameterError(f"workspace_box needs 6 numbers, got {len(values['workspace_box'])}")


def settings_from(mapping: Mapping[str, Any] | None = None) -> Settings:
    """Make `Settings` from some parameters, the defaults for the rest.

    Raises:
        ParameterError: see `validate`; also where two parameters contradict each other.
    """
    given = dict(mapping or {})
    values: dict[str, Any] = {}
    for name, value in given.items():
        checked = validate(name, value)
        if name in PARAMETERS:
            values[name] = checked
    for name, parameter in PARAMETERS.items():
        values.setdefault(name, parameter.default)
    _check_together(values)
    frozen = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    chosen: Any = {f.name: frozen[f.name] for f in fields(Settings)}
    return Settings(**chosen)


def read_yaml(text: str) -> Any:
    """Read YAML with the numbers that ROS reads: 1e3 and 5e-3 are numbers, which YAML 1.1 takes for text.

    Raises:
        yaml.YAMLError: the text is no YAML, or holds something else than data.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        """The safe loader; a class of its own, so that nobody else's YAML changes its meaning."""

    plain = re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", plain, list("-+.0123456789"))  # asked after YAML 1.1's own
    return yaml.load(text, Loader=Loader)


def parse_assignment(text: str) -> tuple[str, Any]:
    """Read `NAME=VALUE` as YAML would (lists in brackets), checked.

    Raises:
        ParameterError: no `=`, unknown name, or a value out of range.
    """
    import yaml

    name, sep, value = text.partition("=")
    if not sep:
        raise ParameterError(f"expected NAME=VALUE, got {text!r}")
    parameter = PARAMETERS.get(name.strip()) or NODE_PARAMETERS.get(name.strip())
    parsed: Any
    try:
        parsed = value if parameter is not None and parameter.kind is str else read_yaml(value)
    except yaml.YAMLError as error:
        raise ParameterError(f"{name} cannot be read from {value!r}: {str(error).splitlines()[0]}") from None
    return name.strip(), validate(name.strip(), parsed)
