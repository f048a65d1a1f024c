"""Records what the planner would see and where the arm is: one scene and one start, from live topics."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from lime_planner.collision.arm_filter import make_arm_filter
from lime_planner.core.errors import Refusal
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.pipeline.targets import Target
from lime_planner.robot.model import Robot
from lime_planner.ros.inputs.arm_camera import ArmCamera
from lime_planner.ros.inputs.latest import TARGETS
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.parameters import Snapshot
from lime_planner.ros.tools.listener import Listener
from lime_planner.scene.files import Start
from lime_planner.scene.from_clouds import CLOUDS
from lime_planner.scene.scene import Scene

_POLL_S = 0.1
_MORE_CAMERAS_S = 1.0  # how long to go on when all is there: cameras take turns on one topic


@dataclass(frozen=True)
class Recorded:
    """What was heard.

    Attributes:
        scene: clouds as the planner uses them, those of several cameras together, without the arm; with the target where there was one.
        start: the arm's configuration; None where it was not heard.
        heard: one sentence for each input that was used.
        missing: one sentence for each that was not.
    """

    scene: Scene
    start: Start | None
    heard: tuple[str, ...]
    missing: tuple[str, ...]


def record(listener: Listener, snapshot: Snapshot, robot: Robot, *, wait_s: float, partial: bool, say: Callable[[str], None]) -> Recorded:
    """Wait until clouds, target and joint states are there, and take them.

    Args:
        listener: has just been made.
        snapshot: the planner's parameters: labels, age limits, padding.
        robot: the arm; its own points are removed from the clouds.
        wait_s: how long to wait at most.
        partial: do without a target and without joint states where they do not come.
        say: is told what is still waited for.

    Raises:
        Refusal: what is needed did not come in time, or cannot be used.
    """

    def complete() -> bool:
        waiting = _waiting(listener)
        say("listening" if not waiting else f"waiting for {' and '.join(waiting)}")
        return not waiting

    inputs, node = listener.inputs, snapshot.node
    source = SceneSource(inputs, listener.frames, robot.planning_frame, make_arm_filter(robot), fixed_frame=node.fixed_frame)
    source.camera = ArmCamera(robot, node.camera_frame, listener.frames) if node.camera_frame else None
    source.memory_s = node.view_memory_s
    listener.tell_arrivals(source.arrived)
    if listener.wait(complete, wait_s, poll_s=_POLL_S) and node.fuse_views:
        say("listening for other cameras")
        listener.wait(lambda: False, _MORE_CAMERAS_S)
    heard: list[str] = []
    missing: list[str] = []
    try:
        scene = source.scene(snapshot, lambda: False)
    except Refusal as refusal:
        raise Refusal(refusal.status, f"{refusal}{_silence(listener, wait_s)}") from None
    heard += [f"{listener.topics[name]}: {_age(listener, name)}" for name in CLOUDS if inputs.slots[name].newest is not None]
    start = None
    try:
        target = inputs.target(node.max_target_age_s, node.max_clock_skew_s)
        scene = dataclasses.replace(scene, **_fields(source.goal(target, snapshot, lambda: False)))
        name = inputs.newest_target
        heard.append(f"{listener.topics[name]}: {_age(listener, name)}")
    except Refusal as refusal:
        missing.append(_told(refusal, partial, listener, wait_s))
    try:
        start = Start(tuple(robot.joint_names), inputs.joints.fresh(node.max_joint_state_age_s, node.max_clock_skew_s).q)
        heard.append(f"{listener.topics['joint_states']}: {len(start.q)} joints")
    except Refusal as refusal:
        missing.append(_told(refusal, partial, listener, wait_s))
    return Recorded(scene, start, tuple(heard), tuple(missing))


def _told(refusal: Refusal, partial: bool, listener: Listener, wait_s: float) -> str:
    sentence = f"{refusal}{_silence(listener, wait_s)}"
    if not partial:
        raise Refusal(refusal.status, f"{sentence} (--partial records without)") from None
    return refusal.status.message(sentence)


def _fields(aim: Target) -> dict[str, Any]:
    """Return a target as the fields of a scene."""
    if aim.kind == "fruit":
        return {"fruit_centres": aim.centre[None]}
    return {"grasp_candidates": matrix_to_pose(aim.poses)} if aim.kind == "candidates" else {"target_pose": matrix_to_pose(aim.poses[0])}


def _waiting(listener: Listener) -> list[str]:
    """Return the inputs that have not been heard: clouds of either kind, the target, the arm."""
    slots = listener.inputs.slots
    there: Mapping[str, bool] = {name: slots[name].newest is not None for name in (*CLOUDS, *TARGETS)}
    waiting = []
    if not there["labelled_cloud"]:
        waiting = [name for name in ("leaf_cloud", "stem_cloud") if not there[name]]
    if not any(there[name] for name in TARGETS):
        waiting.append("grasp_target")
    if listener.inputs.joints.newest is None:
        waiting.append("joint_states")
    return waiting


def _silence(listener: Listener, wait_s: float) -> str:
    waiting = [listener.topics[name] for name in _waiting(listener)]
    return f"; within {wait_s:g} s nothing came on {', '.join(waiting)}" if waiting else ""


def _age(listener: Listener, name: str) -> str:
    sample = listener.inputs.slots[name].newest
    return "" if sample is None else f"message {sample.number}, {sample.age_s():.2f} s old"
