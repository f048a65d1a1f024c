"""What `lime-planner doctor` checks on a running system: planner, arm, clouds, target, frames and clocks, judged as the node would."""

from __future__ import annotations

import importlib.util
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lime_planner.core.errors import Refusal
from lime_planner.core.geometry import clean_name
from lime_planner.core.status import Status
from lime_planner.doctor.findings import Finding, Level, fault, ok, warning
from lime_planner.ros.inputs.clouds import decode_cloud
from lime_planner.ros.inputs.frames import lookup
from lime_planner.ros.inputs.latest import TARGETS, Sample
from lime_planner.ros.parameters import Snapshot
from lime_planner.ros.qos import is_best_effort, is_latched
from lime_planner.ros.tools.listener import Listener
from lime_planner.scene.from_clouds import CLOUDS

#: A cloud older than this is worth a warning where the parameters set no limit [s].
_OLD_S = 10.0
#: Publishers that have not been found after this long are taken for absent: Fast DDS announces itself again every 3 s [s].
_DISCOVERY_S = 3.5
_HEALTH_S = 1.2  # the planner tells about its health once a second

#: The UDP ports that are open on this machine, and how DDS participants choose theirs (RTPS 2.2, section 9.6.1).
_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
_BASE, _DOMAIN_GAIN, _FIRST, _PARTICIPANT_GAIN = 7400, 250, 10, 2

_CURES = {
    Status.TF_ERROR: "publish the transform (tf2), or name the camera's place in static_transforms",
    Status.STALE_INPUT: "see whether its publisher still works, and compare the clocks of the machines",
    Status.NO_CLOUD: "see what the camera and the segmentation publish",
    Status.NO_JOINT_STATE: "start the arm's driver",
}
_BAD_MESSAGE = "correct what its publisher sends"


@dataclass(frozen=True)
class Arm:
    """What the checks must know of the arm: its joints, and the frame it plans in."""

    name: str
    joint_names: tuple[str, ...]
    planning_frame: str


@dataclass(frozen=True)
class Live:
    """What was heard within a given time, and what was expected.

    Attributes:
        listener: it has listened long enough.
        snapshot: the parameters that the node has or will have.
        arm: the arm of these parameters; None where it is not known.
        expected: whether silence is a fault: the user said so, or a planner node runs.
        waited_s: for how long it listened at most.
        use_sim_time: whether the time is taken from `/clock`.
    """

    listener: Listener
    snapshot: Snapshot
    arm: Arm | None
    expected: bool
    waited_s: float
    use_sim_time: bool

    def absent(self, check: str, sentence: str, cure: str) -> Finding:
        """Report what is not there: a fault where it was expected."""
        return Finding(check, Level.FAULT if self.expected else Level.WARNING, sentence, cure)


def live_findings(
    listener: Listener, snapshot: Snapshot, arm: Arm | None, *, expected: bool, wait_s: float, use_sim_time: bool
) -> list[Finding]:
    """Listen for at most `wait_s` seconds and judge what was heard.

    Args:
        listener: has just been made.
        snapshot: the parameters to judge by.
        arm: the arm that should be heard; None leaves its names unchecked.
        expected: a robot is expected to run.
        wait_s: how long to listen to those who publish.
        use_sim_time: whether the node takes its time from `/clock`.
    """
    listener.wait(lambda: _complete(listener.publishers), _DISCOVERY_S)
    listener.wait(lambda: _complete(lambda name: _heard(listener, name)), wait_s)
    planners = listener.planners()
    live = Live(listener, snapshot, arm, expected or bool(planners), wait_s, use_sim_time)
    return [
        *_domains(live),
        _planner(live, planners),
        _clock(live),
        _transforms(live),
        _joint_states(live),
        *_clouds(live),
        _target(live),
        _controller(live),
    ]


def _complete(there: Callable[[str], object]) -> bool:
    """Tell whether all that a plan needs is there: the arm, a target, and clouds of either kind."""
    clouds = there("labelled_cloud") or (there("leaf_cloud") and there("stem_cloud"))
    return bool(clouds and there("joint_states") and any(there(name) for name in TARGETS))


def _heard(listener: Listener, name: str) -> bool:
    return listener.joint_state is not None if name == "joint_states" else listener.inputs.slots[name].newest is not None


def participants_by_domain() -> dict[int, int]:
    """Return the number of participants of this machine in each domain; empty where the system does not tell."""
    ports: set[int] = set()
    for table in _TABLES:
        try:
            lines = table.read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        ports |= {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    counts: Counter[int] = Counter()
    for port in ports:
        domain, offset = divmod(port - _BASE, _DOMAIN_GAIN)
        # Each participant has two ports next to each other; the first one is even.
        if domain >= 0 and offset >= _FIRST and (offset - _FIRST) % _PARTICIPANT_GAIN == 0 and port + 1 in ports:
            counts[domain] += 1
    return dict(sorted(counts.items()))


def _domains(live: Live) -> list[Finding]:
    """Where nothing is heard here, tell about the domains in which this machine's nodes are."""
    own = int(os.environ.get("ROS_DOMAIN_ID") or 0)
    others = {domain: count for domain, count in participants_by_domain().items() if domain != own}
    if not others or any(live.listener.publishers(name) for name in ("joint_states", *CLOUDS)):
        return []
    listed = ", ".join(f"{domain} ({count})" for domain, count in others.items())
    sentence = f"nothing is heard in domain {own}; processes of this machine are in: {listed}"
    return [live.absent("domains", sentence, "export ROS_DOMAIN_ID with the number that the arm and the cameras have")]


def _planner(live: Live, planners: list[str]) -> Finding:
    if not planners:
        return ok("planner", "no planner_node runs in this domain")
    if len(set(planners)) < len(planners):
        twice = next(name for name in planners if planners.count(name) > 1)
        sentence = f"{planners.count(twice)} nodes are named {twice}: both answer, and both may move the arm"
        return fault("planner", sentence, "end one of them, or start it in a namespace of its own")
    live.listener.wait(lambda: bool(live.listener.health), _HEALTH_S)
    health = live.listener.health
    if not health:
        return fault("planner", f"{planners[0]} runs, but tells nothing on /diagnostics", "see its log, and start it again")
    engine, motion = health["engine"], "enabled" if health.get("motion_enabled") == "true" else "disabled"
    sentence = f"{', '.join(planners)}: {engine}, motion is {motion}, last answer {health.get('last_status') or 'none yet'}"
    refusals = [text for key, text in health.items() if key.endswith(".refusal")]
    if refusals:
        return warning("planner", f"{sentence}; it refuses: {'; '.join(refusals)}", _BAD_MESSAGE)
    return ok("planner", sentence)


def _clock(live: Live) -> Finding:
    published = live.listener.node.count_publishers("/clock")
    if live.use_sim_time and not published:
        return fault(
            "clock", "use_sim_time is set, and /clock has no publisher: the time stands still", "start the simulator, or unset use_sim_time"
        )
    if published and not live.use_sim_time:
        return warning(
            "clock",
            "/clock is published, and use_sim_time is not set",
            "set use_sim_time: true for the planner, or end the simulator",
        )
    return ok("clock", "simulated time from /clock" if published else "system time")


def _transforms(live: Live) -> Finding:
    count = len(live.snapshot.node.static_transforms)
    given = f"static_transforms names {count}" if count else "static_transforms is empty"
    if importlib.util.find_spec("tf2_msgs") is not None:
        return ok("transforms", f"/tf and /tf_static are read; {given}")
    frame = live.arm.planning_frame if live.arm is not None else "the planning frame"
    return ok("transforms", f"without tf2_msgs clouds and targets come in {frame!r}; {given}")


def _joint_states(live: Live) -> Finding:
    name, listener = "joint_states", live.listener
    topic, joints = listener.topics[name], listener.inputs.joints
    if not listener.publishers(name):
        others = [other for other in listener.topics_of("sensor_msgs/msg/JointState") if other != topic]
        hint = f"joint states are on {', '.join(others)}: --joint-states TOPIC" if others else "start the arm's driver (or mock_arm_node)"
        return live.absent(name, f"{topic} has no publisher", hint)
    msg = listener.joint_state
    if msg is None:
        return fault(
            name,
            f"{topic} has a publisher, and no message came within {live.waited_s:g} s",
            "see whether the arm is switched on, and the driver's log",
        )
    if live.arm is None:
        return ok(name, f"{topic} is heard, joints {', '.join(msg.name)}")
    if set(msg.name).isdisjoint(live.arm.joint_names) and joints.newest is None:
        sentence = f"{topic} names no joint of {live.arm.name}; it has {', '.join(msg.name) or 'none'}"
        return fault(name, sentence, f"set `robot` or `arm_joints` to the arm that is there; expected {', '.join(live.arm.joint_names)}")
    node = live.snapshot.node
    try:
        joints.fresh(node.max_joint_state_age_s, node.max_clock_skew_s)
    except Refusal as refusal:
        return fault(
            name, f"{topic}: {refusal}", _CURES.get(refusal.status, "compare names and clocks with what the arm's driver publishes")
        )
    state = joints.newest
    late_ms = 1e3 * max(state.latency_s, 0.0) if state is not None else 0.0
    return ok(name, f"{topic}: all {len(live.arm.joint_names)} joints of {live.arm.name}, {late_ms:.0f} ms old on arrival")


def _clouds(live: Live) -> list[Finding]:
    listener = live.listener
    there = {name: listener.publishers(name) for name in CLOUDS}
    if there["labelled_cloud"] and not there["leaf_cloud"] and not there["stem_cloud"]:
        return [_cloud(live, "labelled_cloud")]
    return [_cloud(live, name) for name in CLOUDS if name != "labelled_cloud" or there[name]]


def _cloud(live: Live, name: str) -> Finding:
    listener = live.listener
    topic, sample = listener.topics[name], listener.inputs.slots[name].newest
    if not listener.publishers(name):
        option = f"--{name.removesuffix('_cloud')} TOPIC"
        others = [other for other in listener.topics_of("sensor_msgs/msg/PointCloud2") if other not in listener.topics.values()]
        hint = f"clouds are on {', '.join(others)}: {option}" if others else "start the camera and the segmentation (or scene_node)"
        return live.absent(name, f"{topic} has no publisher", hint)
    if sample is None:
        return fault(
            name,
            f"{topic} has a publisher, and no cloud came within {live.waited_s:g} s",
            "see the camera's log; big clouds need the Fast DDS profile on the publisher's side",
        )
    try:
        points, finite = _usable(live, name, sample)
    except Refusal as refusal:
        return fault(name, str(refusal), _CURES.get(refusal.status, _BAD_MESSAGE))
    age_s, frame = sample.age_s(), sample.msg.header.frame_id
    offers = listener.offers(name)
    latched = any(map(is_latched, offers))
    sentence = f"{topic}: {finite} points in {frame!r}, {age_s:.1f} s old{' (latched)' if latched else ''}"
    if finite < points:
        sentence += f", {points - finite} not finite"
    if not finite and name != "leaf_cloud" and not live.snapshot.node.allow_empty_stem_cloud:
        return fault(name, sentence, _CURES[Status.NO_CLOUD])
    if age_s > _OLD_S and not latched:
        return warning(name, sentence, f"{_CURES[Status.STALE_INPUT]}; max_cloud_age_s makes the planner refuse old clouds")
    if any(map(is_best_effort, offers)) and not os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE"):
        return warning(name, f"{sentence}, best effort", "publish reliably, or set the Fast DDS profile on the publisher's side")
    return ok(name, sentence)


def _usable(live: Live, name: str, sample: Sample) -> tuple[int, int]:
    """Return how many points a cloud has, and how many of them are finite.

    Raises:
        Refusal: what the planner node would answer.
    """
    node = live.snapshot.node
    if sample.refusal is not None:
        raise Refusal(Status.BAD_INPUT, sample.refusal)
    sample.check_time(name, node.max_cloud_age_s, node.max_clock_skew_s)
    cloud = decode_cloud(sample.msg, name, required=(node.label_field,) if name == "labelled_cloud" else ())
    _look_up(live, sample)
    return len(cloud.points), int(np.isfinite(cloud.points).all(axis=1).sum())


def _look_up(live: Live, sample: Sample) -> None:
    """Ask for the transform into the planning frame as the node would.

    Raises:
        Refusal: TF_ERROR.
    """
    header = sample.msg.header
    frame = clean_name(header.frame_id)
    if live.arm is not None and frame != live.arm.planning_frame:
        lookup(live.listener.frames, live.arm.planning_frame, frame, header.stamp, live.snapshot.node.tf_timeout_s, lambda: False)


def _target(live: Live) -> Finding:
    listener, node = live.listener, live.snapshot.node
    name = listener.inputs.newest_target
    topic, sample = listener.topics[name], listener.inputs.slots[name].newest
    if sample is None:
        publishers = listener.publishers(name)
        sentence = f"{topic} has a publisher and no message yet" if publishers else f"{topic} has no publisher"
        return warning(name, sentence, "a plan needs one, or a fruit on fruit_target, or grasp_candidates; ~/preview_to brings its own")
    try:
        target = listener.inputs.target(node.max_target_age_s, node.max_clock_skew_s)
        _look_up(live, sample)
    except Refusal as refusal:
        return fault(name, f"{topic}: {refusal}", _CURES.get(refusal.status, _BAD_MESSAGE))
    x, y, z = target.aim.centre
    return ok(name, f"{topic}: {x:.3f} {y:.3f} {z:.3f} m in {sample.msg.header.frame_id!r}, {sample.age_s():.1f} s old")


def _controller(live: Live) -> Finding:
    topic = live.listener.node.resolve_topic_name("joint_trajectory")
    count = live.listener.node.count_subscribers(topic)
    if not count:
        return live.absent(
            "controller", f"{topic} has no subscriber: no motion is carried out", "start the arm's controller, or remap joint_trajectory"
        )
    if count > 1:
        return warning("controller", f"{count} nodes subscribe to {topic}: each may move an arm", "leave one of them")
    return ok("controller", f"one subscriber to {topic}")
