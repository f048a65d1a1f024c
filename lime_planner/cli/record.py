"""`lime-planner record`: a scene and a start, from live topics or from one moment of a recording, into one file."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError, UsageError
from lime_planner.core.parameters import PARAMETERS, Settings, parse_assignment, settings_from

if TYPE_CHECKING:
    from lime_planner.robot.model import Robot
    from lime_planner.scene.files import Start
    from lime_planner.scene.scene import Scene

_TOLD = ("received", "arm_not_removed")  #: counts that are not about dropped points

_EPILOG = """\
Listens like the planner node, with its parameters: the clouds are brought into
the frame of the arm's base, and the arm's own points are removed. The file
holds the scene, the target, and the arm's joint angles.

examples:
  lime-planner record now.npz && lime-planner plan now.npz --picture now.png
  lime-planner record now.npz --params config/kinova_j2s6s200.yaml \\
      --joint-states /j2s6s200_driver/out/joint_state
  lime-planner plan now.npz --set planning_frame=j2s6s200_link_base
  lime-planner record then.npz --bag rosbag2_2026_05_04 --at 12.5
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from lime_planner.cli.arguments import add_bag, add_parameters, add_topics
    from lime_planner.cli.json_output import add_json

    parser.epilog = _EPILOG
    parser.add_argument("out", metavar="OUT", type=Path, help="scene file to write: .npz")
    parser.add_argument("--wait", type=float, default=10.0, metavar="S", help="how long to wait at most [s] (default 10)")
    parser.add_argument("--partial", action="store_true", help="do without the target or the arm where they are not heard")
    add_bag(parser)
    add_parameters(parser)
    add_topics(parser)
    add_json(parser, "what was heard")


def run(args: argparse.Namespace) -> int:
    """Record, write and tell."""
    if args.out.suffix.lower() != ".npz":
        raise ParameterError(f"{args.out}: a recorded scene ends in .npz")
    if not 0.0 < args.wait <= 3600.0:
        raise ParameterError(f"--wait is {args.wait:g}; allowed: above 0, to 3600 s")
    if args.at is not None and args.bag is None:
        raise UsageError("--at is a moment of a recording; name it with --bag")
    values: dict[str, Any] = {}
    simulated = False
    if args.params is not None:
        from lime_planner.cli.parameter_file import read_parameter_file

        file = read_parameter_file(args.params, args.namespace)
        values, simulated = dict(file.values), file.use_sim_time
        for sentence in file.warnings:
            print(f"{args.params}: {sentence}", file=sys.stderr)
    own = [text for text in args.assignments if text.partition("=")[0] == "use_sim_time"]  # every ROS node has this parameter
    for text in own:
        if text not in ("use_sim_time=true", "use_sim_time=false"):
            raise ParameterError(f"{text}: allowed are true and false")
        simulated = text.endswith("true")
    values.update(parse_assignment(text) for text in args.assignments if text not in own)
    settings = settings_from({name: value for name, value in values.items() if name in PARAMETERS})
    if args.bag is None and importlib.util.find_spec("rclpy") is None:
        raise ModuleNotFoundError("live topics need ROS 2", name="rclpy")
    from lime_planner.cli.arguments import load_arm
    from lime_planner.core.atomic_files import check_writable

    check_writable(args.out)
    robot = load_arm(settings)
    take = _from_bag if args.bag is not None else _live
    scene, start, heard, missing = take(args, values, settings, robot, simulated)
    return _report(args, scene, start, heard, missing)


Taken = tuple["Scene", "Start | None", list[str], list[str]]


def _live(args: argparse.Namespace, values: dict[str, Any], settings: Settings, robot: Robot, simulated: bool) -> Taken:
    from lime_planner.cli.arguments import topics_of
    from lime_planner.output.console import working
    from lime_planner.ros.parameters import snapshot_from
    from lime_planner.ros.tools.listener import Listener
    from lime_planner.ros.tools.record import record

    snapshot = snapshot_from(values)
    topics = topics_of(args)
    with (
        working("listening", seconds=args.wait) as progress,
        Listener(snapshot, robot.joint_names, topics=topics, namespace=args.namespace, use_sim_time=simulated) as listener,
    ):
        recorded = record(listener, snapshot, robot, wait_s=args.wait, partial=args.partial, say=progress.say)
    return recorded.scene, recorded.start, list(recorded.heard), list(recorded.missing)


def _from_bag(args: argparse.Namespace, values: dict[str, Any], settings: Settings, robot: Robot, simulated: bool) -> Taken:
    from lime_planner.cli.arguments import read_bag, topics_of
    from lime_planner.output.console import working

    with working("reading the recording"):
        recorded = read_bag(args.bag, values, robot, settings.self_filter_padding_m, topics_of(args), args.at)
    scene = recorded.scene
    targets = [target for target in (scene.target_pose, scene.fruit_centres, scene.grasp_candidates) if target is not None]
    found = {
        "NO_TARGET: the recording has no grasp_target, fruit_target or grasp_candidates": targets or None,
        "NO_JOINT_STATE: it has no joint_states": recorded.start,
    }
    missing = [sentence for sentence, value in found.items() if value is None]
    if missing and not args.partial:
        raise ParameterError(f"{args.bag}: {'; '.join(missing)} (name the topic, or --partial records without)")
    return recorded.scene, recorded.start, [f"{topic}: at {at_s:.3f} s" for topic, at_s in recorded.heard.items()], missing


def _report(args: argparse.Namespace, scene: Scene, start: Start | None, heard: list[str], missing: list[str]) -> int:
    from lime_planner.cli.json_output import as_lists, emit_json, is_stdout

    scene.save(args.out, start)
    counts = {"leaf": len(scene.leaf_points), "stem": len(scene.stem_points), "fruit": len(scene.fruit_points)}
    if args.json is not None:
        angles = None if start is None else dict(zip(start.joint_names, map(float, start.q), strict=True))
        emit_json(
            args.json,
            {
                **{"file": str(args.out), "frame_id": scene.frame_id, "points": counts, "counts": dict(scene.counts)},
                **{name: as_lists(getattr(scene, name)) for name in ("target_pose", "fruit_centres", "grasp_candidates", "viewpoints")},
                **{"start": angles, "heard": heard, "missing": missing},
            },
        )
    if not is_stdout(args.json):
        for sentence in heard:
            print(sentence)
        listed = ", ".join(f"{count} {name}" for name, count in counts.items())
        dropped = ", ".join(f"{count} {name}" for name, count in scene.counts.items() if count and name not in _TOLD)
        print(f"{args.out}: {listed} points in {scene.frame_id!r}{f' ({dropped})' if dropped else ''}")
        if scene.counts.get("arm_not_removed"):
            print("the arm's own points are still in it: where the arm stood when a cloud was taken is not known")
    for sentence in (*missing, *(f"warning: {note}" for note in scene.notes)):
        print(sentence, file=sys.stderr)
    return 0
