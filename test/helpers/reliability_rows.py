"""The table of bad (and odd, but good) inputs: each row is sent to the node, and its answer is a line of docs/reliability.md."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from ros_fakes import JOINTS, START, cloud
from sensor_msgs.msg import JointState, PointCloud2, PointField

if TYPE_CHECKING:
    from reliability_rig import Rig

GOOD = [0.05, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0]
NAN, INF = math.nan, math.inf


@dataclass(frozen=True)
class Row:
    """One input.

    Attributes:
        group: the input's name.
        what: what is odd about it, in the page's words.
        arrange: sends it.
        code: the answer's code.
        words: a part of the sentence.
        settings: parameters set before and put back after.
        service: asked then; "" for rows that carry their own answer (parameters).
    """

    group: str
    what: str
    arrange: Callable[[Rig], Any]
    code: str = "BAD_INPUT"
    words: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    service: str = "plan"


def of(msg: PointCloud2, *changes: Callable[[PointCloud2], None]) -> PointCloud2:
    """A cloud after some changes."""
    for change in changes:
        change(msg)
    return msg


def some(*changes: Callable[[PointCloud2], None], count: int = 50, **columns: np.ndarray) -> PointCloud2:
    """A cloud of 50 points after some changes."""
    return of(cloud(count, **columns), *changes)


def fields(*names: str) -> Callable[[PointCloud2], None]:
    return lambda msg: setattr(msg, "fields", [field for name in names for field in msg.fields if field.name == name])


def has(**values: Any) -> Callable[[PointCloud2], None]:
    return lambda msg: [setattr(msg, name, value) for name, value in values.items()]  # type: ignore[func-returns-value]


def x_is(**values: Any) -> Callable[[PointCloud2], None]:
    return lambda msg: [setattr(msg.fields[0], name, value) for name, value in values.items()]  # type: ignore[func-returns-value]


def frame(name: str) -> Callable[[PointCloud2], None]:
    return lambda msg: setattr(msg.header, "frame_id", name)


def points(values: np.ndarray, kind: str = "<f4", **more: Any) -> PointCloud2:
    """A cloud of these numbers, whatever they are."""
    msg = cloud(1)
    size = np.dtype(kind).itemsize
    number = PointField.FLOAT32 if size == 4 else PointField.FLOAT64
    msg.fields = [PointField(name=name, offset=size * k, datatype=number, count=1) for k, name in enumerate("xyz")]
    msg.height, msg.width, msg.point_step, msg.row_step = 1, len(values), 3 * size, 3 * size * len(values)
    msg.is_bigendian = kind.startswith(">")
    msg.data = type(msg.data)("B", values.astype(kind).tobytes())
    return of(msg, *(lambda m, n=n, v=v: setattr(m, n, v) for n, v in more.items()))


BOX = np.random.default_rng(3).uniform(0.3, 0.6, (60, 3))
HALF = np.where(np.arange(60)[:, None] % 2, BOX, NAN)


def empty(msg: PointCloud2) -> None:
    msg.width, msg.data = 0, msg.data[:0]


def stem(make: Callable[[], PointCloud2], after_s: float | None = None) -> Callable[[Rig], Any]:
    return lambda rig: rig.deliver("stem_cloud", make(), after_s)


def leaf(make: Callable[[], PointCloud2], after_s: float | None = None) -> Callable[[Rig], Any]:
    return lambda rig: rig.deliver("leaf_cloud", make(), after_s)


def labelled(make: Callable[[], PointCloud2]) -> Callable[[Rig], Any]:
    return lambda rig: rig.deliver("labelled_cloud", make())


def target(pose: list[float], frame_id: str = "base", after_s: float | None = None) -> Callable[[Rig], Any]:
    return lambda rig: rig.target(pose, frame_id, after_s)


def goal(pose: list[float], frame_id: str = "base") -> Callable[[Rig], Any]:
    return lambda rig: rig.goal(pose, frame_id)


def states(names: list[str], positions: list[float], after_s: float = 0.0) -> Callable[[Rig], Any]:
    return lambda rig: rig.states(JointState(name=names, position=positions), after_s)


def parameter(name: str, value: Any) -> Callable[[Rig], Any]:
    return lambda rig: rig.refused(name, value)


def turned(pose: list[float], quaternion: list[float]) -> list[float]:
    return [*pose[:3], *quaternion]


ARM, Q = list(JOINTS), [float(v) for v in START]
FIELD_X = PointField(name="x", offset=0, datatype=7, count=1)
S, L, B = "stem_cloud", "leaf_cloud", "labelled_cloud"
OK, NONE, STALE, TF = "SUCCEEDED", "NO_CLOUD", "STALE_INPUT", "TF_ERROR"

ROWS = (
    Row(S, "has no field x", stem(lambda: some(fields("y", "z"))), words="no field 'x'; its fields are y, z"),
    Row(S, "has no field y", stem(lambda: some(fields("x", "z"))), words="no field 'y'"),
    Row(S, "has no field z", stem(lambda: some(fields("x", "y"))), words="no field 'z'"),
    Row(S, "has no fields at all", stem(lambda: some(fields())), words="its fields are none"),
    Row(S, "has the field x twice", stem(lambda: some(fields("x", "x", "y", "z"))), words="2 times"),
    Row(S, "has coordinates of an unknown type", stem(lambda: some(x_is(datatype=17))), words="datatype 17"),
    Row(S, "has coordinates of type 0", stem(lambda: some(x_is(datatype=0))), words="datatype 0"),
    Row(S, "has three numbers in the field x", stem(lambda: some(x_is(count=3))), words="count 3"),
    Row(S, "has a field beyond the point", stem(lambda: some(x_is(offset=999))), words="beyond point_step"),
    Row(S, "has points of zero bytes", stem(lambda: some(has(point_step=0))), words="point_step 0"),
    Row(S, "lacks its last byte", stem(lambda: some(lambda m: setattr(m, "data", m.data[:-1]))), words="announces 50 points"),
    Row(S, "has no data", stem(lambda: some(lambda m: setattr(m, "data", m.data[:0]))), words="holds 0 bytes"),
    Row(S, "announces 4 billion points", stem(lambda: some(has(width=4_000_000_000))), words="announces 4000000000 points"),
    Row(S, "announces 4 billion rows", stem(lambda: some(has(height=4_000_000_000))), words="announces 200000000000 points"),
    Row(S, "is organised, with rows too short", stem(lambda: some(has(height=5, width=10, row_step=7))), words="row_step 7"),
    Row(S, "has an empty frame", stem(lambda: some(frame(""))), words="empty frame_id"),
    Row(S, "has the frame '/'", stem(lambda: some(frame("/"))), words="empty frame_id"),
    Row(S, "is in an unknown frame", stem(lambda: some(frame("moon"))), TF, "'moon' to 'base'"),
    Row(S, "is all NaN", stem(lambda: points(np.full((50, 3), NAN))), NONE, "(50 not finite)"),
    Row(S, "is all infinite", stem(lambda: points(np.full((50, 3), INF))), NONE, "(50 not finite)"),
    Row(S, "has doubles too large for floats", stem(lambda: points(np.full((50, 3), 1e300), "<f8")), NONE, "(50 not finite)"),
    Row(S, "is suddenly empty", stem(lambda: some(empty)), NONE, "no stem point"),
    Row(S, "is empty and has no fields", stem(lambda: some(empty, fields())), NONE, "no stem point"),
    Row(S, "never came", lambda rig: rig.forget("stem_cloud"), NONE, "no stem cloud has been received"),
    Row(S, "is stamped 30 s in the future", stem(some, 30.0), words="in the future"),
    Row(S, "is 30 s old, the limit is 5 s", stem(some, -30.0), STALE, "is 30", {"max_cloud_age_s": 5.0}),
    Row(S, "does not come any more", lambda rig: rig.wait(0.15), STALE, "the newest", {"max_cloud_age_s": 0.1}),
    Row(S, "is 30 s apart from the leaf cloud, the limit is 5 s", stem(some, -30.0), STALE, "apart", {"max_cloud_skew_s": 5.0}),
    Row(S, "makes the planner object", stem(lambda: cloud(13)), words="thirteen stems"),
    Row(S, "hits a defect of the planner", stem(lambda: cloud(666)), "INTERNAL_ERROR", "ZeroDivisionError"),
    Row(S, "is a single point", stem(lambda: points(BOX[:1])), OK),
    Row(S, "is organised, half of it NaN", stem(lambda: points(HALF, height=6, width=10, row_step=120)), OK),
    Row(S, "is big-endian", stem(lambda: points(BOX, ">f4")), OK),
    Row(S, "has double coordinates", stem(lambda: points(BOX, "<f8")), OK),
    Row(S, "has further fields", stem(lambda: some(intensity=np.ones(50, np.float32), ring=np.ones(50, np.uint16))), OK),
    Row(S, "has no stamp", lambda rig: rig.deliver(S, some(), None, stamped=False), OK),
    Row(S, "is in a camera's frame known from a parameter", stem(lambda: some(frame("/mast"))), OK),
    Row(S, "is empty, and that is allowed", stem(lambda: some(empty)), OK, "", {"allow_empty_stem_cloud": True}),
    Row(S, "has five million points", lambda rig: rig.five_million(), OK),
    Row(L, "has no field y", leaf(lambda: some(fields("x", "z"))), words="leaf_cloud has no field 'y'"),
    Row(L, "has an empty frame", leaf(lambda: some(frame(""))), words="leaf_cloud has an empty frame_id"),
    Row(L, "is in an unknown frame", leaf(lambda: some(frame("moon"))), TF, "'moon' to 'base'"),
    Row(L, "has a negative permeability_cost", leaf(lambda: some(permeability_cost=np.full(50, -1.0, np.float32))), words="leaf_cloud"),
    Row(L, "has NaN as permeability_cost", leaf(lambda: some(permeability_cost=np.full(50, NAN, np.float32))), words="leaf_cloud"),
    Row(L, "is stamped 30 s in the future", leaf(some, 30.0), words="leaf_cloud lies"),
    Row(L, "is 30 s old, the limit is 5 s", leaf(some, -30.0), STALE, "newest leaf_cloud", {"max_cloud_age_s": 5.0}),
    Row(L, "is empty", leaf(lambda: some(empty)), OK),
    Row(L, "is all NaN", leaf(lambda: points(np.full((50, 3), NAN))), OK),
    Row(L, "never came", lambda rig: rig.forget("leaf_cloud"), OK),
    Row(B, "has no label", labelled(some), words="no field 'label'"),
    Row(B, "has its label under another name", labelled(lambda: some(kind=np.ones(50, np.uint8))), words="no field 'label'"),
    Row(
        B,
        "has the label twice",
        labelled(lambda: some(fields("x", "y", "z", "label", "label"), label=np.ones(50, np.uint8))),
        words="2 times",
    ),
    Row(B, "has labels between the classes", labelled(lambda: some(label=np.full(50, 0.5, np.float32))), words="labelled_cloud"),
    Row(B, "has NaN as labels", labelled(lambda: some(label=np.full(50, NAN, np.float32))), words="labelled_cloud"),
    Row(B, "holds leaves alone", labelled(lambda: some(label=np.zeros(50, np.uint8))), NONE, "no stem point"),
    Row(B, "holds leaves and fruit alone", labelled(lambda: some(label=np.repeat([0, 2], 25).astype(np.uint8))), NONE, "no stem point"),
    Row(B, "holds an unknown class (hard as a stem)", labelled(lambda: some(label=np.full(50, 9, np.int32))), OK),
    Row("grasp_target", "never came", lambda rig: rig.forget("grasp_target"), "NO_TARGET", "no grasp target"),
    Row("grasp_target", "has a position that is NaN", target([NAN, *GOOD[1:]]), words="not finite"),
    Row("grasp_target", "has an infinite position", target([INF, *GOOD[1:]]), words="not finite"),
    Row("grasp_target", "has a rotation that is NaN", target([*GOOD[:6], NAN]), words="not finite"),
    Row("grasp_target", "has a quaternion of zeros", target(turned(GOOD, [0.0] * 4)), words="quaternion"),
    Row("grasp_target", "has an empty frame", target(GOOD, ""), words="empty frame_id"),
    Row("grasp_target", "is in an unknown frame", target(GOOD, "moon"), TF, "'moon' to 'base'"),
    Row("grasp_target", "is out of reach", target([0.05, 0.0, -1.0, *GOOD[3:]]), "NO_IK_SOLUTION", "out of reach"),
    Row("grasp_target", "is stamped 30 s in the future", target(GOOD, "base", 30.0), words="in the future"),
    Row("grasp_target", "is 30 s old, the limit is 5 s", target(GOOD, "base", -30.0), STALE, "", {"max_target_age_s": 5.0}),
    Row("grasp_target", "was sent long ago", lambda rig: rig.wait(0.15), STALE, "grasp_target", {"max_target_age_s": 0.1}),
    Row("grasp_target", "has a quaternion of length 40", target(turned(GOOD, [0.0, 0.0, 0.0, 40.0])), OK),
    Row("grasp_target", "is in a frame known from a parameter", target([0.05, 0.0, -0.6, *GOOD[3:]], "mast"), OK),
    Row("joint_states", "never came", lambda rig: rig.forget("joint_states"), "NO_JOINT_STATE", "no joint state"),
    Row("joint_states", "lack a joint", states(ARM[:2], Q[:2]), words="no joint j3"),
    Row("joint_states", "name a joint twice", states([*ARM, "j3"], [*Q, 0.0]), words="j3 more than once"),
    Row("joint_states", "are NaN", states(ARM, [Q[0], NAN, Q[2]]), words="j2 = nan"),
    Row("joint_states", "are infinite", states(ARM, [Q[0], INF, Q[2]]), words="j2 = inf"),
    Row("joint_states", "have fewer positions than names", states(ARM, Q[:2]), words="3 names but 2 positions"),
    Row("joint_states", "have more positions than names", states(ARM, [*Q, 0.0]), words="3 names but 4 positions"),
    Row("joint_states", "are of the fingers alone", states(["finger"], [0.0]), STALE, "the newest joint state is"),
    Row("joint_states", "name nothing", states([], []), STALE, "the newest joint state is"),
    Row("joint_states", "fall silent", lambda rig: rig.silence(), STALE, "the limit is 0.3 s"),
    Row("joint_states", "are stamped 10 s in the past", states(ARM, Q, -10.0), STALE, "the newest joint state is"),
    Row("joint_states", "are stamped 30 s in the future", states(ARM, Q, 30.0), words="in the future"),
    Row("joint_states", "come in another order", states(ARM[::-1], Q[::-1]), OK),
    Row("joint_states", "have fingers among them", states(["finger", *ARM, "finger_2"], [9.0, *Q, 9.0]), OK),
    Row("joint_states", "are several turns away", states(ARM, [Q[0] + 8 * math.pi, Q[1] - 6 * math.pi, Q[2]]), OK),
    Row("~/preview_to", "asks for a position that is NaN", goal([NAN, *GOOD[1:]]), words="not finite", service="preview_to"),
    Row("~/preview_to", "asks for a quaternion of zeros", goal(turned(GOOD, [0.0] * 4)), words="quaternion", service="preview_to"),
    Row("~/preview_to", "names no frame", goal(GOOD, ""), words="empty frame_id", service="preview_to"),
    Row("~/preview_to", "names an unknown frame", goal(GOOD, "moon"), TF, "'moon' to 'base'", service="preview_to"),
    Row("~/execute", "before any preview", lambda rig: None, "NOTHING_TO_EXECUTE", "~/preview first", service="execute"),
    Row("~/retreat", "before any motion", lambda rig: rig.forget("motion"), "NOTHING_TO_EXECUTE", "no motion", service="retreat"),
    Row("~/stop", "when nothing moves", lambda rig: None, OK, "no motion was running", service="stop"),
    Row("~/plan", "while motion is disabled", lambda rig: None, "MOTION_DISABLED", "not sent", {"motion_enabled": False}),
    Row("~/plan", "while no controller listens", lambda rig: rig.no_controller(), "NO_CONTROLLER", "has no subscriber"),
    Row("parameter", "time_budget_s = -1", parameter("time_budget_s", -1.0), "refused", "out of range Min: 0.01, Max: 600.0", service=""),
    Row("parameter", "time_budget_s = nan", parameter("time_budget_s", NAN), "refused", "out of range", service=""),
    Row("parameter", "time_budget_s = 'soon'", parameter("time_budget_s", "soon"), "refused", "must be a number", service=""),
    Row("parameter", "planner = 'magic'", parameter("planner", "magic"), "refused", "one of lime_star", service=""),
    Row("parameter", "motion_enabled = 1", parameter("motion_enabled", 1), "refused", "must be true or false", service=""),
    Row("parameter", "iterations = nan", parameter("iterations", NAN), "refused", "must be finite", service=""),
    Row("parameter", "leaf_labels = 3", parameter("leaf_labels", 3), "refused", "must be a list", service=""),
    Row("parameter", "label_field = 'x'", parameter("label_field", "x"), "refused", "must name a field", service=""),
    Row("parameter", "workspace_box = [1.0]", parameter("workspace_box", [1.0]), "refused", "multiple of 6", service=""),
    Row(
        "parameter",
        "keep_out_boxes inside out",
        parameter("keep_out_boxes", [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
        "refused",
        "not below",
        service="",
    ),
    Row("parameter", "stem_labels = leaf_labels", parameter("stem_labels", [0]), "refused", "one meaning", service=""),
    Row("parameter", "robot, while it runs", parameter("robot", "kinova_j2n6s300"), "refused", "read-only", service=""),
)
