"""The demo: scene, arm and planner as processes of their own, a plan asked for and carried out, and a table and a picture of it."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib.util
import signal
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS, parse_assignment, settings_from, validate
from lime_planner.core.status import Status
from lime_planner.robot.builtin import demo_arm
from lime_planner.ros.demo.processes import Corner, DemoError, Processes
from lime_planner.ros.demo.report import MOTION_TIMEOUT_S, Columns, Driven, reached_for, report, verdict

if TYPE_CHECKING:
    from lime_planner.core.parameters import Settings
    from lime_planner.core.types import Array
    from lime_planner.robot.model import Robot
    from lime_planner.ros.demo.client import DemoClient
    from lime_planner.ros.model_loader import Loaded
    from lime_planner.scene.scene import Scene


DEFAULT_SEED = 15
DEFAULT_LOOKS = 2  #: at a generated plant
_PICTURES_HZ = 2.0  # of each camera
_READY_TIMEOUT_S = 600.0  # compiling everything for the first time takes its while on a slow machine
_REPEAT_S = 20.0  # no longer silence than this
_TARGETS_TRIED = 80

_EPILOG = """\
Three nodes run as processes on this machine, in a ROS domain and a namespace of
their own: a scene (clouds and target), a simulated arm, the planner. The demo
asks ~/plan, which moves the (simulated) arm, and measures where it ends. At a
generated plant the scene is what two depth cameras see, one of them on the arm,
and the arm looks before it reaches.

examples:
  make demo
  make demo SCENE=plant.npz
  make demo SCENE=scan.npz DEMO_ARGS='--offset 0.55 0 0.05 --controller kinova'
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the demo's arguments."""
    parser.epilog = _EPILOG
    parser.add_argument("--scene", type=Path, metavar="FILE", help="scene file (.npz, .ply, .pcd); default: a generated lime plant")
    parser.add_argument("--plant-seed", type=int, default=DEFAULT_SEED, metavar="N", help=f"which plant is grown (default {DEFAULT_SEED})")
    parser.add_argument("--scale", type=float, default=1.0, metavar="S", help="metres for each unit of the scene file (default 1)")
    parser.add_argument("--offset", nargs=3, type=float, metavar=("X", "Y", "Z"), help="then move the scene by this [m]")
    pose = ("X", "Y", "Z", "QX", "QY", "QZ", "QW")
    parser.add_argument("--target", nargs=7, type=float, metavar=pose, help="pose of the tool at the fruit; default: the scene's, or drawn")
    parser.add_argument("--label-field", metavar="NAME", help="field of the label in PLY and PCD files (default label)")
    parser.add_argument("--controller", choices=("jtc", "kinova"), default="jtc", help="whose rules the arm follows (default jtc)")
    looks = f"looks of the arm's camera before the reach; 0: every point is known; default: {DEFAULT_LOOKS} at a generated plant, else 0"
    parser.add_argument("--looks", type=int, metavar="N", help=looks)
    parser.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help="folder for picture, figures and logs (default out)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="PARAMETER=VALUE", dest="assignments", help="set any parameter; repeatable"
    )


class Clock:
    """Prints what happens, each line with the time since the start."""

    def __init__(self) -> None:
        """Start."""
        self._began = time.monotonic()

    def say(self, text: str) -> None:
        """Print one line."""
        print(f"[{time.monotonic() - self._began:5.1f} s] {text}", flush=True)


def choose_arm(values: dict[str, Any], clock: Clock) -> None:
    """Where no arm is named and the default one's model is not installed, take the other built-in one, and say so."""
    if "robot" not in values:
        name, why = demo_arm()
        if why:
            clock.say(why)
            values["robot"] = name


def run(args: argparse.Namespace) -> int:
    """Run the demo; 0 only if the arm ended at the target."""
    clock = Clock()
    values = dict(parse_assignment(text) for text in args.assignments)
    field = label_field(args, values)
    choose_arm(values, clock)
    planning = {name: value for name, value in values.items() if name in PARAMETERS}
    settings = settings_from(planning)
    if settings.robot == "topic":
        raise ParameterError("robot: the demo needs a built-in model or a URDF file")
    if args.looks is not None:
        validate("max_looks", args.looks)
    if importlib.util.find_spec("rclpy") is None:
        raise ModuleNotFoundError("the demo needs ROS 2", name="rclpy")
    from lime_planner.ros.model_loader import build

    clock.say("reading the scene" if args.scene else "growing a lime plant")
    scene = scene_of(args, field)
    try:
        if not args.out.is_dir():
            clock.say(f"making the folder {args.out}")
            args.out.mkdir(parents=True)
    except OSError as error:
        raise ParameterError(f"--out {args.out}: cannot be made ({error.strerror or error})") from error
    corner = Corner.own()
    arm = {"robot": settings.robot, "controller": args.controller}
    looks = (0 if args.scene else DEFAULT_LOOKS) if args.looks is None else args.looks
    # Drawing pictures at the cameras' usual rate would keep one processor busy, of perhaps two that plan.
    seen = {"camera": "all", "labelled": True, "robot": settings.robot, "rate_hz": _PICTURES_HZ} if looks else {}
    with quick_end(), Processes(corner, args.out / "logs") as nodes:
        clock.say(f"starting planner_node and mock_arm_node in ROS domain {corner.domain}, namespace {corner.namespace}")
        looking = _looking(looks, scene, settings) if looks else {}
        nodes.start("planner_node", "lime_planner.ros.nodes.planner_node", {**arm, **looking, **values})
        nodes.start("mock_arm_node", "lime_planner.ros.nodes.mock_arm_node", arm)
        loaded = build(settings, None)
        scene = completed_scene(scene, loaded, planning, clock)
        path = args.out / "scene.npz"
        scene.save(path)
        clock.say("starting scene_node")
        nodes.start("scene_node", "lime_planner.ros.nodes.scene_node", {"file": str(path.resolve()), **seen})
        driven, comparisons = _drive(corner, nodes, loaded, scene, planning, looks, clock)
    picture = report(args, loaded.robot, scene, driven, comparisons)
    clock.say(f"picture: {picture}   figures: {args.out / 'demo.json'}   logs: {args.out / 'logs'}")
    return verdict(loaded.robot, scene, driven)


def _looking(looks: int, scene: Scene, settings: Settings) -> dict[str, Any]:
    """The planner's parameters for a camera on the arm and a fixed one, as the scene node has them."""
    from lime_planner.robot.builtin import BUILTIN_ARMS
    from lime_planner.robot.model import load_robot
    from lime_planner.ros.nodes.scene_cameras import WRIST_FRAME, arm_camera, fixed_cameras

    known = BUILTIN_ARMS.get(settings.robot)
    tool_frame = settings.tool_frame or (load_robot(settings.robot).tool_frame if known is None else known.tool_frame)
    frame = scene.frame_id or settings.planning_frame or "base"  # as the built-in arms have it
    cameras = [arm_camera(tool_frame), *fixed_cameras(dataclasses.replace(scene, frame_id=frame))]
    return {
        "camera_frame": WRIST_FRAME,
        "static_transforms": [camera.transform for camera in cameras],
        "look_first": True,
        "max_looks": looks,
        "unseen_enough": 0.0,  # to be shown
        "replan_attempts": 2,  # a stem may come into sight on the way
    }


def label_field(args: argparse.Namespace, values: dict[str, Any]) -> str:
    """Take the name of the label in the scene's file out of the parameters: the nodes get the scene in clouds whose field is `label`."""
    named = str(values.pop("label_field", NODE_PARAMETERS["label_field"].default))
    return named if args.label_field is None else str(args.label_field)


def scene_of(args: argparse.Namespace, field: str) -> Scene:
    """Load or grow the scene and put it where the options say; its frame is empty where a file names none.

    Args:
        args: of the command.
        field: name of the label in PLY and PCD files.
    """
    import numpy as np

    from lime_planner.scene.plants.generator import generate_plant
    from lime_planner.scene.scene import Scene

    if args.scene is None:
        scene = generate_plant(np.random.default_rng(args.plant_seed))
    else:
        scene = Scene.load(args.scene, scale=args.scale, offset=args.offset, label_field=field)
    if args.target is None:
        return scene
    return dataclasses.replace(scene, target_pose=np.asarray(args.target), fruit_centres=None, fruit_radii=None)


def completed_scene(scene: Scene, loaded: Loaded, planning: Mapping[str, Any], clock: Clock) -> Scene:
    """Give the scene what it lacks: the arm's frame, and a target among its leaves.

    Raises:
        DemoError: it is in another frame, or no drawn target can be reached.
    """
    import numpy as np

    from lime_planner.pipeline.scene_targets import own_target

    frame = loaded.robot.planning_frame
    scene = dataclasses.replace(scene, frame_id=scene.frame_id or frame)
    if scene.frame_id != frame:
        raise DemoError(f"the scene is in the frame {scene.frame_id!r}, the arm plans in {frame!r}", Status.TF_ERROR)
    if own_target(scene, "exact", np.zeros(3)) is None:
        clock.say("the scene has no target; looking for a place in its canopy that the arm can reach")
        loaded.pipeline.warm_up()
        scene = _with_drawn_target(scene, loaded, planning)
    return scene


def _with_drawn_target(scene: Scene, loaded: Loaded, planning: Mapping[str, Any]) -> Scene:
    """Give a scan without fruit a target among its leaves: the first of some drawn ones to which a path is found."""
    import numpy as np

    from lime_planner.core.geometry import pose_to_matrix
    from lime_planner.robot.model import home
    from lime_planner.scene.plants.grasp_targets import canopy_targets

    poses = canopy_targets(scene, np.random.default_rng(DEFAULT_SEED), _TARGETS_TRIED)
    settings = settings_from(planning)
    for pose in poses:
        result = loaded.pipeline.plan(scene, pose_to_matrix(pose), home(loaded.robot), settings, seed=DEFAULT_SEED)
        if result.status is Status.SUCCEEDED:
            return dataclasses.replace(scene, target_pose=pose)
        if result.status in (Status.START_INVALID, Status.START_IN_STEM):
            raise DemoError(f"{result.message.partition(': ')[2]}; move the scene with --offset X Y Z", result.status)
    sentence = f"no path was found to any of {len(poses)} places drawn in the canopy"
    raise DemoError(f"{sentence}; give a --target, or move the scene with --offset X Y Z", Status.GOAL_IN_STEM)


@contextlib.contextmanager
def quick_end() -> Any:
    """Turn SIGTERM into an exception, so that the nodes are ended on the way out."""

    def end(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _drive(
    corner: Corner, nodes: Processes, loaded: Loaded, scene: Scene, planning: Mapping[str, Any], looks: int, clock: Clock
) -> tuple[Driven, Columns]:
    """Ask for the plan and follow the motion; the plans to compare with are made meanwhile."""
    from lime_planner.ros.demo.client import DemoClient

    told = [0]

    def check() -> None:
        nodes.check()
        looks = int(client.status.get("looks") or 0)
        if looks > told[0]:
            told[0] = looks
            before, after = (1e3 * float(client.status.get(f"look_unseen_{when}_m3") or "nan") for when in ("before", "after"))
            clock.say(f"look {looks}: {before:.2f} dm³ of the best way were unseen, {after:.2f} are left")

    with DemoClient(corner, loaded.robot.joint_names, check) as client:
        client.wait(client.planner_serves, 60.0, "the planner's service and the arm's joint states")
        clock.say("all nodes are up")
        _wait_until_ready(client, nodes.check, clock)
        clock.say(f"calling {corner.namespace}/lime_planner/plan")
        before = len(client.states)
        success, message = client.plan(60.0 + MOTION_TIMEOUT_S * looks)
        check()
        clock.say(message)
        if looks:
            before = len(client.states)  # the reach begins where the last look ended
        q_start = client.states[max(0, before - 1)]
        with ThreadPoolExecutor(1) as pool:
            comparisons = pool.submit(_compare, loaded, scene, q_start, planning)
            if success:
                _follow(client, nodes, loaded.robot, scene, clock)
            columns = comparisons.result()
        for heading, figures in columns:
            clock.say(f"for comparison, {heading}: {figures['message']}")
        return Driven(success, message, dict(client.status), client.states[max(0, before - 1) :]), columns


def _wait_until_ready(client: DemoClient, check: Callable[[], None], clock: Clock) -> None:
    """Follow the planner's loading and compiling; it says in its health message how far it is."""
    from lime_planner.core.kernel_cache import all_compiled

    began, said, due = time.monotonic(), "", 0.0
    while client.engine != "ready":
        state, waited_s = client.engine, time.monotonic() - began
        if state and (state != said or waited_s > due):
            doing = "loading its compiled functions" if "compil" in state and all_compiled() else state
            clock.say(f"the planner is {'still ' if state == said else ''}{doing}")
            said, due = state, waited_s + _REPEAT_S
        if "cannot be loaded" in said or "failed" in said:
            raise DemoError(said, Status.BAD_INPUT)
        if waited_s > _READY_TIMEOUT_S:
            raise DemoError(f"the planner was not ready after {_READY_TIMEOUT_S:g} s; it says: {said or 'nothing'}")
        check()
        time.sleep(0.05)


def _follow(client: DemoClient, nodes: Processes, robot: Robot, scene: Scene, clock: Clock) -> None:
    """Print where the tool is until the motion has ended and the arm rests."""
    import numpy as np

    deadline = time.monotonic() + MOTION_TIMEOUT_S
    request = client.status.get("plan_id")
    grasp = reached_for(scene, client.status)
    assert grasp is not None
    while not client.status.get("execution_code"):
        distance_m = float(np.linalg.norm(robot.forward(client.states[-1])[:3, 3] - grasp[:3]))
        clock.say(f"the arm moves; the tool is {1000.0 * distance_m:.0f} mm from the target")
        next_line = time.monotonic() + 1.0
        while time.monotonic() < next_line and not client.status.get("execution_code"):
            nodes.check()
            time.sleep(0.02)
        if time.monotonic() > deadline:
            return
    client.wait(client.still, 5.0, "the arm to rest")
    if client.status.get("execution_code") == Status.STEM_APPEARED.name or client.status.get("plan_id") != request:
        _follow_replanned(client, nodes, robot, scene, clock, request)


def _follow_replanned(client: DemoClient, nodes: Processes, robot: Robot, scene: Scene, clock: Clock, request: str | None) -> None:
    """Follow the motion that is planned again after a stem came into sight, if there is one."""
    clock.say(client.status["message"] if client.status.get("plan_id") != request else client.status.get("execution_message", ""))
    with contextlib.suppress(DemoError):
        client.wait(lambda: client.status.get("plan_id") != request, 1.0, "another plan")
    if client.status.get("plan_id") == request:
        return
    client.wait(lambda: client.status.get("phase") in ("EXECUTING", "DONE"), MOTION_TIMEOUT_S, "the plan from where the arm was stopped")
    if client.status.get("code") == Status.SUCCEEDED.name:
        _follow(client, nodes, robot, scene, clock)


def _compare(loaded: Loaded, scene: Scene, q_start: Array, planning: Mapping[str, Any]) -> Columns:
    """Plan the same reach to the pose that came with the scene, with leaves as solid obstacles, and with leaves ignored (but counted)."""
    from lime_planner.pipeline.scene_targets import own_target
    from lime_planner.pipeline.targets import pose_target

    own = own_target(scene, "exact", loaded.robot.forward(q_start)[:3, 3])
    assert own is not None
    loaded.pipeline.warm_up()
    cases = [("leaves solid", "solid", own), ("leaves ignored", "ignored", own)]
    if own.kind == "fruit" and scene.target_pose is not None:
        cases.insert(0, ("fixed pose", "permeable", pose_target(scene.target_pose)))
    columns: Columns = []
    for heading, policy, aim in cases:
        settings = settings_from({**planning, "leaf_policy": policy})
        result = loaded.pipeline.plan(scene, aim, q_start, settings, seed=settings.seed or 1)
        columns.append((heading, result.figures()))
    return columns
