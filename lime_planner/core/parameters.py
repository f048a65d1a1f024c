"""Every setting of the planner, declared once: the node declares it, the command line sets it, the documentation is made from it.

A setting is one field of `Settings` (the pipeline's) or of `NodeSettings` (the node's alone), made by `_row` with its default,
sentence, unit and range. The tables `PARAMETERS` and `NODE_PARAMETERS` are read from the fields.
"""

from __future__ import annotations

import dataclasses
import math
import re
import typing
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, TypeVar

from lime_planner.core.errors import ParameterError
from lime_planner.core.planners import DEFAULT_PLANNER, PLANNERS

T = TypeVar("T")

_NO_FLOOR_Z_M = -1000.0  # says in files and messages, which have no infinity, that there is no floor
#: Parameters that every ROS node has.
_OF_EVERY_NODE = ("use_sim_time", "start_type_description_service")
#: How alike two names are (difflib's ratio) before one is taken for a slip of the other.
_SLIP_RATIO = 0.85


@dataclass(frozen=True)
class Parameter:
    """One setting: what it means, what it may be.

    Attributes:
        name: its name as a ROS parameter and as an attribute of `Settings` or `NodeSettings`.
        default: its default; its type is the setting's type (lists are lists of one type, `element` when the default is empty).
        description: one sentence.
        unit: SI unit, empty where there is none.
        minimum: smallest allowed value, of every element for lists.
        maximum: largest allowed value.
        choices: the allowed values, empty for any.
        read_only: set at start only.
        element: type of a list's elements.
        length_multiple: a list's length must be a multiple of this.
        shapes_obstacles: the obstacles of a plan are made of it, so that they are built again when it changes.
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
    shapes_obstacles: bool = False

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


def _row(
    default: T,
    description: str,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    *,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    length_multiple: int = 1,
    shapes_obstacles: bool = False,
) -> T:
    """A field of a class of settings; the arguments are the attributes of `Parameter`."""
    known = {"description": description, "unit": unit, "minimum": minimum, "maximum": maximum, "choices": choices}
    known |= {"read_only": read_only, "length_multiple": length_multiple, "shapes_obstacles": shapes_obstacles}
    return dataclasses.field(default=default, metadata=known)


# fmt: off
@dataclass(frozen=True, kw_only=True)
class Settings:
    """One consistent set of the pipeline's parameters; `settings_from` makes it of checked values."""

    robot: str = _row("kinova_j2s6s200", "The arm: a built-in model (kinova_j2s6s200, kinova_j2n6s300), `topic`, or a URDF's path.", read_only=True)
    arm_joints: tuple[str, ...] = _row((), "The arm's joints in driver order; empty: the model's own.", read_only=True)
    planning_frame: str = _row("", "Frame of clouds and targets while planning: the root of the arm's chain; empty: the model's.", read_only=True)
    tool_frame: str = _row("", "Frame that must reach the target; empty: the model's `<name>_end_effector`.", read_only=True)
    finger_positions: tuple[str, ...] = _row((), "Where the fingers are on the way, and any other joint outside the arm: `JOINT: POSITION` each; those not named stay as the model has them, open in the built-in ones.", "rad or m", read_only=True)
    planner: str = _row(DEFAULT_PLANNER, "Which search: the default, or one of the paper's three.", choices=tuple(PLANNERS))
    time_budget_s: float = _row(0.5, "Search time; the best path found until then is used.", "s", 0.01, 600.0)
    iterations: int = _row(0, "Search iterations instead of time (the same seed then gives the same path); 0: by time.", "", 0, 100_000_000)
    threads: int = _row(0, "Searches of lime_star side by side, which share what they find; iterations are those of each. 0: cores less one (1 to 8), and one where iterations limit the search.", "", 0, 64)
    seed: int = _row(0, "Seed of the random generator; 0: a fresh one for each plan, echoed in the result.", "", 0, 2**31 - 1)
    c_perm: float = _row(100.0, "Cost of one tree node inside leaves in the paper's metric (C_perm).", "", 0.0, 1e9)
    paper: bool = _row(False, "Whether rrt_star, apf_rrt_star and p_rrt_star plan exactly as published: nodes that count, no certified edges, no polishing.")
    step_rad: float = _row(0.1, "Step of the paper's planners (δ); without `paper` theirs is three times as long.", "rad", 0.001, 1.0)
    leaf_weight: float = _row(-1.0, "Cost of a radian of leaf contact in the integral metric; negative: c_perm / step_rad.", "1/rad", -1.0, 1e9)
    leaf_cost: str = _row("binary", "What a touched leaf costs: `binary` (any contact is 1) or `graded` (grows with the leaf area touched).", choices=("binary", "graded"), shapes_obstacles=True)
    leaf_policy: str = _row("permeable", "`permeable` (leaves cost), `solid` (leaves are obstacles), `ignored` (leaves are free), for comparison.", choices=("permeable", "solid", "ignored"), shapes_obstacles=True)
    max_leaf_contact_rad: float = _row(-1.0, "Refuse paths with more leaf contact than this (LEAF_BUDGET_EXCEEDED); negative: off.", "rad", -1.0, 100.0)
    unseen_price: float = _row(0.3, "Price of a radian in space that no camera has seen, as a share of a leaf's, added to it; 0: none.", "", 0.0, 1e6)
    max_unseen_contact_rad: float = _row(-1.0, "Refuse paths with more of their length in unseen space than this (UNSEEN); negative: off.", "rad", -1.0, 100.0)
    beta: float = _row(1.0, "Strength of the adaptive potential field in apf_rrt_star (β).", "", 0.0, 100.0)
    k_att: float = _row(50.0, "Attractive gain of the potential field in joint space (K_att).", "1/rad²", 0.0, 1e9)
    k_rep_leaf: float = _row(2e-4, "Repulsive gain of leaves (K_rep), for workspace distances.", "m²", 0.0, 1e9)
    k_rep_stem: float = _row(2e-4, "Repulsive gain of stems (K_rep), for workspace distances.", "m²", 0.0, 1e9)
    d_star_m: float = _row(0.1, "Range of the repulsive field (d*), a workspace distance.", "m", 0.001, 10.0)
    goal_radius_rad: float = _row(0.3, "With `paper`, the goal is joined from nodes within this distance of it.", "rad", 0.0, 10.0)
    goal_bias: float = _row(0.05, "Share of the paper's planners' samples that are a goal; the paper names none.", "", 0.0, 1.0)
    ik_starts: int = _row(200, "Random starts of the inverse kinematics.", "", 1, 100_000)
    max_goals: int = _row(24, "Goal configurations handed to the search, the most promising first.", "", 1, 1000)
    stem_margin_m: float = _row(0.005, "Clearance to stems that the search keeps, beyond their radius; less only close to a start or goal that has less.", "m", 0.0, 0.2, shapes_obstacles=True)
    stem_point_radius_m: float = _row(0.004, "Radius of a stem point.", "m", 0.0005, 0.1, shapes_obstacles=True)
    leaf_point_radius_m: float = _row(0.004, "Radius of a leaf point.", "m", 0.0005, 0.1, shapes_obstacles=True)
    target_exclusion_radius_m: float = _row(0.06, "Points this close to the target do not block the gripper's links in the approach zone; 0: off.", "m", 0.0, 0.5, shapes_obstacles=True)
    approach_zone_m: float = _row(0.10, "Distance of the tool from the target within which the exclusion sphere holds.", "m", 0.0, 1.0, shapes_obstacles=True)
    grasp_freedom: str = _row("exact", "What a target pose leaves open: `exact`, `roll` (any turn about the approach), `cone` (also approaches within approach_cone_rad of its own).", choices=("exact", "roll", "cone"))
    approach_distance_m: float = _row(0.08, "Length of the straight last stretch along the tool's +z, orientation kept; 0: none.", "m", 0.0, 0.5, shapes_obstacles=True)
    stop_before_approach: bool = _row(False, "Whether the motion comes to rest where the straight last stretch begins, and on the way back where it ends.")
    min_approach_distance_m: float = _row(0.03, "Shorter stretches are refused for fruit and candidates; an exact pose takes what there is.", "m", 0.0, 0.5)
    approach_cone_rad: float = _row(1.5707963267948966, "Largest angle between an approach and the ray from the base to the fruit, or a pose's own approach.", "rad", 0.0, 3.141592653589793)
    max_grasps: int = _row(1000, "Approaches tried for a target that leaves something open, four in ten of them only where all touch leaves; candidates are all tried.", "", 1, 10_000)
    fruit_radius_m: float = _row(0.025, "Radius of a target fruit of which the cloud shows nothing; 0: such a target is refused.", "m", 0.0, 0.2)
    stalk_radius_m: float = _row(0.015, "Impermeable points this close to the upright line over a fruit's top, up to 0.05 m, are its stalk and let go for the hand; 0: none.", "m", 0.0, 0.05, shapes_obstacles=True)
    self_filter_padding_m: float = _row(0.01, "Points of live clouds this close to the arm's own meshes are taken for the arm.", "m", 0.0, 0.1)
    voxel_m: float = _row(0.01, "Largest spacing of the distance fields.", "m", 0.002, 0.05, shapes_obstacles=True)
    keep_out_boxes: tuple[float, ...] = _row((), "Boxes as hard as stems: min x y z, max x y z of each, in the planning frame.", "m", length_multiple=6, shapes_obstacles=True)
    floor_z_m: float = _row(_NO_FLOOR_Z_M, "Height of a floor as hard as a stem, for all links but the base; -1000: none.", "m", _NO_FLOOR_Z_M, 1000.0, shapes_obstacles=True)
    workspace_box: tuple[float, ...] = _row((), "Box that the arm must stay in: min x y z, max x y z; empty: none.", "m", length_multiple=6, shapes_obstacles=True)
    velocity_scaling: float = _row(1.0, "Share of the joint velocity limits that a motion may use.", "", 0.01, 1.0)
    acceleration_scaling: float = _row(1.0, "Share of the joint acceleration limits that a motion may use.", "", 0.01, 1.0)
    leaf_speed_scale: float = _row(1.0, "Share of the speed used where the arm touches leaves.", "", 0.05, 1.0)
    trajectory_dt_s: float = _row(0.02, "Time grid of the trajectory.", "s", 0.01, 0.5)
    start_limit_tolerance_rad: float = _row(0.03, "A start this far beyond a joint limit is led back inside, one farther out is START_INVALID; a node takes goal_tolerance_rad and half as much again where that is more.", "rad", 0.0, 1.0)
    corner_tolerance_rad: float = _row(0.01, "How far the timed motion may cut the corners of the path, in joint space.", "rad", 0.0005, 0.1)

    @property
    def weight(self) -> float:
        """Cost of one radian of leaf contact [1/rad]: `leaf_weight`, or C_perm / δ."""
        return self.leaf_weight if self.leaf_weight >= 0.0 else self.c_perm / self.step_rad

    @property
    def locked(self) -> dict[str, float]:
        """Positions of joints outside the arm by name, from `finger_positions` [rad or m]."""
        return _joint_positions("finger_positions", self.finger_positions)

    @property
    def floor_height_m(self) -> float:
        """Height of the floor in the planning frame [m]: `floor_z_m`, or -inf where there is none."""
        return self.floor_z_m if self.floor_z_m > _NO_FLOOR_Z_M + 1.0 else -math.inf


@dataclass(frozen=True, kw_only=True)
class NodeSettings:
    """One consistent set of the parameters of the node alone: its inputs, and motion."""

    motion_enabled: bool = _row(True, "Whether `~/plan`, `~/execute` and `~/retreat` may move the arm.")
    allow_empty_stem_cloud: bool = _row(False, "Whether a motion is allowed with an empty stem cloud or none.")
    max_cloud_age_s: float = _row(0.0, "Refuse to plan on clouds older than this; 0: off.", "s", 0.0, 1e6)
    max_joint_state_age_s: float = _row(0.3, "Refuse to plan or move on joint states older than this; 0: off.", "s", 0.0, 1e6)
    max_target_age_s: float = _row(0.0, "Refuse targets older than this, when ~/plan or ~/preview begins and when ~/plan sends; 0: off.", "s", 0.0, 1e6)
    label_field: str = _row("label", "Field of `labelled_cloud` that holds the class.")
    leaf_labels: tuple[int, ...] = _row((0,), "Classes of `labelled_cloud` that are leaves.")
    stem_labels: tuple[int, ...] = _row((1,), "Classes that are stems (every other class not named here is impermeable too).")
    fruit_labels: tuple[int, ...] = _row((2,), "Classes that are fruit: impermeable, the one at the target excepted. The default gives way to classes that are named elsewhere.")
    ignored_labels: tuple[int, ...] = _row((), "Classes that are left out.")
    class_costs: tuple[str, ...] = _row((), "Prices of permeable classes, `LABEL: PRICE` each: what touching one costs as a share of a leaf's 1; times `permeability_cost` where points have one.")
    max_cloud_skew_s: float = _row(0.0, "Refuse leaf and stem clouds whose stamps are further apart than this; 0: off.", "s", 0.0, 1e6)
    max_clock_skew_s: float = _row(1.0, "Refuse stamps that lie further in the future than this; 0: off.", "s", 0.0, 1e6)
    static_transforms: tuple[str, ...] = _row((), "Known without `/tf`: `parent child x y z qx qy qz qw` of each camera, in metres.", read_only=True)
    fixed_frame: str = _row("", "Frame in which clouds and targets stay where they were seen while the base moves (`odom`, `map`); empty: the planning frame, and a base that moved makes them stale.", read_only=True)
    max_base_motion_m: float = _row(0.01, "Without fixed_frame: how far the base may have moved, in a frame above it, since a cloud's or a target's stamp before that is STALE_INPUT.", "m", 0.0, 100.0)
    tf_timeout_s: float = _row(0.2, "How long a plan waits for the transform of a cloud or a target.", "s", 0.0, 60.0)
    warm_up_timeout_s: float = _row(600.0, "How long a request waits for the compilation of the kernels before it answers NOT_READY.", "s", 0.0, 3600.0)
    fuse_views: bool = _row(True, "Whether what earlier clouds showed stays until a later ray passes through it; false: the newest cloud is all that is known.")
    view_memory_s: float = _row(60.0, "What was last seen longer ago than this is forgotten.", "s", 0.1, 3600.0)
    viewpoints: tuple[float, ...] = _row((), "Where the cameras stand whose clouds do not come in a frame of their own (but in the planning frame, fixed_frame, `map`, `odom`, `base_link` or the like): x y z of each, in the planning frame. Empty: it is not known where such clouds were seen from.", "m", length_multiple=3)
    camera_frame: str = _row("", "Frame of a depth camera that the arm carries: a link of its description, or fastened to one by `static_transforms` or `/tf_static`; its clouds were seen from where the measured joints carried it. Empty: none.", read_only=True)
    look_first: bool = _row(False, "Whether `~/plan` moves the camera of camera_frame first, until unseen_enough or max_looks.")
    max_looks: int = _row(3, "How often `~/plan` looks at most with look_first.", "", 0, 20)
    unseen_enough: float = _row(0.02, "With look_first: no more looks once this little of the best path lies in unseen space.", "rad", 0.0, 100.0)
    controller: str = _row("jtc", "What carries the motion out, and so how it is stopped: a joint trajectory controller by its topic (`jtc`) or its action (`jtc_action`, needs control_msgs), or Kinova's driver.", choices=("jtc", "jtc_action", "kinova"))
    trajectory_action: str = _row("joint_trajectory_controller/follow_joint_trajectory", "Name of the FollowJointTrajectory action of `controller: jtc_action`.", read_only=True)
    start_tolerance_rad: float = _row(0.01, "Largest difference of a joint from the plan's start when the motion is sent.", "rad", 0.0001, 0.1)
    stillness_rad: float = _row(0.003, "The arm is at rest when no joint moved further than this within stillness_time_s.", "rad", 0.0001, 0.1)
    stillness_time_s: float = _row(0.25, "See stillness_rad.", "s", 0.02, 5.0)
    stillness_timeout_s: float = _row(3.0, "How long a request waits for the arm to come to rest before it answers ARM_MOVING.", "s", 0.1, 60.0)
    execution_tolerance_rad: float = _row(0.15, "Stop a motion when a joint is further than this from its path; how fast the path is followed does not count.", "rad", 0.005, 3.0)
    progress_timeout_s: float = _row(5.0, "Stop a motion whose arm has not come on along its path for this long: slow, paused and resumed controllers are waited for.", "s", 0.2, 3600.0)
    goal_tolerance_rad: float = _row(0.02, "A motion has succeeded when the arm rests this close to its last point.", "rad", 0.0005, 0.5)
    goal_time_s: float = _row(2.0, "How long the arm may take to come to rest there once the end of the path is near and the motion should be over.", "s", 0.1, 60.0)
    replan_attempts: int = _row(0, "How often `~/plan` plans again from rest after a motion was stopped by a new stem or a deviation; where no way leads on, back out first.", "", 0, 10)
    deadline_s: float = _row(0.0, "Give a request up as TIMED_OUT after this long, certificate and last checks included; what waits for rest or compiles before does not count; 0: off.", "s", 0.0, 600.0)
    viewer_port: int = _row(0, "Port of the 3-D page; 0: off.", "", 0, 65535, read_only=True)
    viewer_host: str = _row("127.0.0.1", "Address that the 3-D page is served at; elsewhere it is for looking only, unless LIME_PLANNER_VIEWER_TOKEN is set.", read_only=True)
# fmt: on


def _joint_positions(name: str, texts: Iterable[str]) -> dict[str, float]:
    """Read the texts `JOINT: POSITION` of a parameter: positions by joint [rad or m].

    Raises:
        ParameterError: a text that is no joint and number, or a joint named twice.
    """
    positions: dict[str, float] = {}
    for text in texts:
        joint, colon, number = (part.strip() for part in text.rpartition(":"))
        try:
            position = float(number)
        except ValueError:
            position = math.nan
        if not colon or not joint or not math.isfinite(position):
            raise ParameterError(f"{name}: {text!r} is not JOINT: POSITION, such as 'j2s6s200_joint_finger_1: 0.5'")
        if joint in positions:
            raise ParameterError(f"{name} names the joint {joint} twice")
        positions[joint] = position
    return positions


def _table(settings: type) -> dict[str, Parameter]:
    """Return the rows of a class of settings by name, a tuple's as a list of its elements' type."""
    types, rows = typing.get_type_hints(settings), {}
    for field in dataclasses.fields(settings):
        of_list = typing.get_origin(types[field.name]) is tuple
        element = typing.get_args(types[field.name])[0] if of_list else float
        default: Any = field.default
        rows[field.name] = Parameter(field.name, list(default) if of_list else default, element=element, **field.metadata)
    return rows


#: Settings of the pipeline, by name.
PARAMETERS: dict[str, Parameter] = _table(Settings)
#: Settings of the node alone (inputs and motion), by name.
NODE_PARAMETERS: dict[str, Parameter] = _table(NodeSettings)

_SHAPING = tuple(name for name, parameter in PARAMETERS.items() if parameter.shapes_obstacles)


def obstacle_settings(settings: Settings) -> tuple[Any, ...]:
    """Return the values that obstacles are made of: where they are equal, so are the obstacles of a scene and a target."""
    return tuple(getattr(settings, name) for name in _SHAPING)


_IN_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


def _number(parameter: Parameter, value: Any, element: type) -> Any:
    if element is bool or isinstance(value, bool):
        if element is bool and isinstance(value, bool):
            return value
        raise ParameterError(f"{parameter.name} must be {_IN_WORDS[element]}, got {value!r}")
    if element is str:
        if not isinstance(value, str):
            raise ParameterError(f"{parameter.name} must be text, got {value!r}")
        return value
    if not isinstance(value, Real):  # NumPy's numbers are such too
        raise ParameterError(f"{parameter.name} must be {_IN_WORDS[element]}, got {value!r}")
    try:
        finite = math.isfinite(value)
    except OverflowError:  # a whole number beyond every float
        finite = False
    if not finite:
        raise ParameterError(f"{parameter.name} must be finite, got {value!r}")
    number = element(value)
    if element is int and number != value:
        raise ParameterError(f"{parameter.name} must be {_IN_WORDS[element]}, got {value!r}")
    low, high = parameter.minimum, parameter.maximum
    if (low is not None and number < low) or (high is not None and number > high):
        raise ParameterError(f"{parameter.name} is {number!r}; allowed: {parameter.range_text} {parameter.unit}".rstrip())
    return number


def no_parameter(name: str, known: Iterable[str]) -> ParameterError:
    """Return the error of a name that is no parameter, with those of the known ones that may have been meant."""
    import difflib

    close = difflib.get_close_matches(name, dict.fromkeys(known), n=3)
    hint = f"; did you mean {', '.join(close)}?" if close else ""
    return ParameterError(f"there is no parameter {name!r}{hint}")


def validate(name: str, value: Any) -> Any:
    """Return `value` as the parameter's own type.

    Raises:
        ParameterError: unknown name (the text lists close ones), wrong type, out of range.
    """
    parameter = PARAMETERS.get(name) or NODE_PARAMETERS.get(name)
    if parameter is None:
        raise no_parameter(name, [*PARAMETERS, *NODE_PARAMETERS])
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


def unknown_names(given: Iterable[str]) -> list[str]:
    """Return the names of start values that mean nothing to the planner node, one sentence each.

    A file may hold other nodes' parameters too, so a name alone is no error; a name that is nearly one of the table's is a slip, and what
    it was to forbid would be allowed without it.

    Raises:
        ParameterError: a name that is nearly one of the table's.
    """
    import difflib

    known = {**PARAMETERS, **NODE_PARAMETERS}
    sentences = []
    for name in given:
        if name in known or name in _OF_EVERY_NODE or name.startswith("qos_overrides."):
            continue
        close = difflib.get_close_matches(name, known, n=3, cutoff=_SLIP_RATIO)
        if close:
            raise ParameterError(f"there is no parameter {name!r}; did you mean {', '.join(close)}?")
        sentences.append(f"there is no parameter {name!r}; its value is ignored")
    return sentences


def _check_together(settings: Settings) -> None:
    for name, box in (("keep_out_boxes", settings.keep_out_boxes), ("workspace_box", settings.workspace_box)):
        for k in range(0, len(box), 6):
            low, high = box[k : k + 3], box[k + 3 : k + 6]
            if any(a >= b for a, b in zip(low, high, strict=True)):
                raise ParameterError(f"{name}: box {k // 6} has its minimum {list(low)} not below its maximum {list(high)}")
    if len(settings.workspace_box) > 6:
        raise ParameterError(f"workspace_box needs 6 numbers, got {len(settings.workspace_box)}")
    _joint_positions("finger_positions", settings.finger_positions)


def frozen(checked: Mapping[str, Any]) -> dict[str, Any]:
    """Return checked values as the fields hold them: lists as tuples."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in checked.items()}


def settings_from(mapping: Mapping[str, Any] | None = None) -> Settings:
    """Make `Settings` from some parameters, the defaults for the rest; the node's own are checked and left out.

    Raises:
        ParameterError: see `validate`; also where two parameters contradict each other.
    """
    checked = {name: validate(name, value) for name, value in (mapping or {}).items()}
    settings = Settings(**frozen({name: value for name, value in checked.items() if name in PARAMETERS}))
    _check_together(settings)
    return settings


def read_yaml(text: str) -> Any:
    """Read YAML with the numbers that ROS reads: 1e3 and 5e-3 are numbers, which YAML 1.1 takes for text.

    Raises:
        yaml.YAMLError: the text is no YAML, or holds something else than data.
    """
    import yaml

    def joined(before: Any, value: Any) -> Any:
        if not isinstance(before, dict) or not isinstance(value, dict):
            return value
        return {**before, **{key: joined(before.get(key), below) for key, below in value.items()}}

    class Loader(yaml.SafeLoader):
        """The safe loader; a class of its own, so that YAML read elsewhere keeps its meaning."""

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
            """Join maps that stand under the same name twice, as ROS does with a node's sections."""
            self.flatten_mapping(node)
            found: dict[Any, Any] = {}
            for key_node, value_node in node.value:
                key, value = self.construct_object(key_node, deep=True), self.construct_object(value_node, deep=True)
                if not isinstance(key, Hashable):
                    raise yaml.constructor.ConstructorError("in a map", node.start_mark, "a key is no name", key_node.start_mark)
                found[key] = joined(found.get(key), value)
            return found

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
    name = name.strip().replace("-", "_")  # as options are spelt
    parameter = PARAMETERS.get(name.strip()) or NODE_PARAMETERS.get(name.strip())
    parsed: Any
    try:
        parsed = value if parameter is not None and parameter.kind is str else read_yaml(value)
    except yaml.YAMLError as error:
        raise ParameterError(f"{name} cannot be read from {value!r}: {str(error).splitlines()[0]}") from None
    return name.strip(), validate(name.strip(), parsed)
