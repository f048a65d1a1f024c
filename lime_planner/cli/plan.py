"""`lime-planner plan`: one plan in a scene file, through the very pipeline that the node uses."""

from __future__ import annotations

import argparse
import dataclasses
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.cli.arguments import (
    LABEL_PARAMETERS,
    add_bag,
    add_label_field,
    add_parameters,
    add_topics,
    load_arm,
    read_bag,
    read_parameters,
    read_scene,
    topics_of,
)
from lime_planner.cli.grasp_targets import add_fruit_options, check_together, targets_of
from lime_planner.core.errors import LimePlannerError, ParameterError, UsageError
from lime_planner.core.parameters import PARAMETERS, Settings, settings_from
from lime_planner.core.planners import PLANNERS

if TYPE_CHECKING:
    from lime_planner.pipeline import Pipeline, PlanResult
    from lime_planner.robot.model import Robot
    from lime_planner.scene.files import Start
    from lime_planner.scene.scene import Scene

_TRIAL_S, _TRIALS_S = 1.0, 6.0  # what a command that may be worth a try, and all of them, are tried for

_EPILOG = """\
SCENE is an .npz with points (N, 3) [m] and labels (0 leaf, 1 stem, 2 fruit), or
a PLY or PCD file with an integer field `label`, z up, in the frame of the arm's
base. What it is about is reached: the fruit at its target, grasped as is best,
else its target_pose; --fruit, --target and --candidates say otherwise. +z of
the tool points out of the palm. Leaves cost, stems are never touched. What
`lime-planner record` wrote also says where the arm starts; a recording (--bag)
is planned on as it is, with the topics that the options name.

examples:
  lime-planner plan plant.npz
  lime-planner plan plant.npz --time 2 --picture plan.png --json plan.json
  lime-planner plan plant.npz --fruit any
  lime-planner plan scan.ply --offset 0.55 0 0.05 --target 0.5 0.1 0.4
  lime-planner plan scan.ply --offset 0.55 0 0.05 --freedom roll \\
      --target 0.5 0.1 0.4 0 0.7071 0 0.7071
  lime-planner plan plant.npz --planner apf_rrt_star --iterations 1500 --seed 1
  lime-planner plan plant.npz --set leaf_cost=graded --set stem_margin_m=0.01
  lime-planner plan --bag rosbag2_2026_05_04 --at 12.5 --leaf /seg/leaf \\
      --stem /seg/stem --target /grasp

The exit status is 0 only for SUCCEEDED; otherwise the code and one sentence go
to standard error, with --json also to FILE. --set understands what
`lime-planner parameters` lists.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    from lime_planner.cli.json_output import add_json

    parser.add_argument("scene", metavar="SCENE", type=Path, nargs="?", help="scene file: .npz, .ply or .pcd")
    target = "centre of a fruit X Y Z [m], or pose of the tool there X Y Z QX QY QZ QW, or with --bag its topic; default: the scene's"
    parser.add_argument("--target", nargs="+", type=_number_or_word, metavar="X", help=target)
    add_fruit_options(parser)
    start = "joint angles at the start [rad]; default: the recorded ones, else the arm's home"
    parser.add_argument("--start", nargs="+", type=float, metavar="Q", help=start)
    parser.add_argument("--planner", choices=PLANNERS, metavar="NAME", help=f"which search: {', '.join(PLANNERS)}")
    budget = parser.add_mutually_exclusive_group()
    budget.add_argument("--iterations", type=int, metavar="N", help="iterations of the search instead of a time")
    budget.add_argument("--time", type=float, metavar="S", help=f"search time [s] (default {PARAMETERS['time_budget_s'].default})")
    parser.add_argument("--seed", type=int, metavar="N", help="seed; the same seed and --iterations give the same path")
    parser.add_argument("--scale", type=float, default=1.0, metavar="S", help="metres for each unit of the scene file (default 1)")
    parser.add_argument("--offset", nargs=3, type=float, metavar=("X", "Y", "Z"), help="then move the scene by this [m]")
    add_json(parser, "every figure, the path and the trajectory")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw plant, arm and path; .png, .svg or .pdf")
    add_label_field(parser)
    add_parameters(parser, live=False)
    add_bag(parser)
    add_topics(parser, without=("grasp_target",))


def _number_or_word(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _sort_arguments(args: argparse.Namespace) -> None:
    """Tell the target's pose, its topic and the scene apart, and refuse what does not go together.

    Raises:
        UsageError: neither or both of scene and recording, or options that belong to the other one.
    """
    words = args.target or []
    if len(words) in (4, 8) and args.scene is None and isinstance(words[-1], str):  # `--target X Y Z QX QY QZ QW SCENE`
        args.scene, args.target, words = Path(words[-1]), words[:-1], words[:-1]
    args.topics = topics_of(args)
    if args.bag is None:
        if args.scene is None:
            taken = args.json is not None and Path(args.json).suffix.lower() in (".npz", ".ply", ".pcd")
            hint = f" (--json took {args.json} for the file to write; name the scene first)" if taken else ""
            raise UsageError(f"give a SCENE, or a recording with --bag{hint}")
        if args.topics or args.at is not None:
            option = "--at" if args.at is not None else f"--{next(iter(args.topics)).split('_')[0]}"
            raise UsageError(f"{option} names a {'moment' if args.at is not None else 'topic'} of a recording; name that with --bag")
    elif args.scene is not None:
        raise UsageError("give a SCENE or a --bag, not both")
    elif args.scale != 1.0 or args.offset is not None:
        raise UsageError("--scale and --offset place scene files; a recording is placed by its transforms")
    if len(words) == 1 and isinstance(words[0], str):
        if args.bag is None:
            raise UsageError(f"--target {words[0]} is a topic; name the recording with --bag, or give 3 or 7 numbers")
        args.topics["grasp_target"], args.target = words[0], None
    elif words and (len(words) not in (3, 7) or any(isinstance(word, str) for word in words)):
        needs = "3 numbers x y z (a fruit), 7 numbers x y z qx qy qz qw (a pose), or with --bag a topic"
        raise UsageError(f"--target needs {needs}; got {' '.join(map(str, words))}")
    check_together(args)


def run(args: argparse.Namespace) -> int:
    """Plan, print a short table, write what was asked for; 0 only for SUCCEEDED."""
    values = read_parameters(args)
    settings = settings_from({name: value for name, value in values.items() if name in PARAMETERS})
    if args.picture is not None and args.picture.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise ParameterError(f"--picture {args.picture}: ends in none of .png, .svg, .pdf")
    _sort_arguments(args)
    if args.bag is not None:
        robot = load_arm(settings)
        recorded = read_bag(args.bag, values, robot, settings.self_filter_padding_m, args.topics, args.at)
        args.scene = args.bag
        return plan_in(recorded.scene, robot, settings, args, recorded.start)
    from lime_planner.scene.files import load_start

    scene = read_scene(args, values)  # before the robot, which takes seconds
    start = load_start(args.scene)
    robot = load_arm(settings)
    if not scene.frame_id:
        scene = dataclasses.replace(scene, frame_id=robot.planning_frame)
    return plan_in(scene, robot, settings, args, start)


def _start(args: argparse.Namespace, robot: Robot, recorded: Start | None) -> Any:
    """Return the configuration to start from (n,) [rad]: the option's, else the recorded one, else the arm's home."""
    import numpy as np

    from lime_planner.robot.model import home

    if args.start is None and recorded is None:
        return home(robot)
    if args.start is None and recorded is not None:
        if set(recorded.joint_names) != set(robot.joint_names):
            names = f"{', '.join(recorded.joint_names)}; the arm has {', '.join(robot.joint_names)}"
            raise ParameterError(f"{args.scene}: its start is of the joints {names} (--start gives another one)")
        return recorded.q[[recorded.joint_names.index(name) for name in robot.joint_names]]
    q_start = np.asarray(args.start)
    if q_start.shape != (robot.n,):
        raise ParameterError(f"--start needs {robot.n} angles, one for each of {', '.join(robot.joint_names)}; got {len(q_start)}")
    return q_start


def plan_in(scene: Scene, robot: Robot, settings: Settings, args: argparse.Namespace, start: Start | None = None) -> int:
    """Plan in a loaded scene and report; `start` is where the arm was when the scene was recorded."""
    from lime_planner.core.status import Status
    from lime_planner.output.console import compile_first, working
    from lime_planner.pipeline import Pipeline
    from lime_planner.pipeline.scene_targets import plan_first

    for note in scene.notes:
        print(f"warning: {note}", file=sys.stderr)
    q_start = _start(args, robot, start)
    targets = targets_of(args, scene, settings, robot.forward(q_start)[:3, 3])
    if not targets:
        return _refuse(args, Status.NO_TARGET.name, Status.NO_TARGET.message(f"{args.scene} has no target_pose; give one with --target"))
    if scene.frame_id != robot.planning_frame:
        frames = f"the scene is in the frame {scene.frame_id!r} and the arm plans in {robot.planning_frame!r}"
        sentence = f"{frames}; without ROS no transform between them is known"
        return _refuse(args, Status.TF_ERROR.name, Status.TF_ERROR.message(sentence))
    should_stop = _stopped_by_signal()
    pipeline = Pipeline(robot)
    compile_first()
    with working("loading"):
        pipeline.warm_up((settings.planner,))  # reading what was compiled must not eat the time budget
    with working("planning", seconds=None if settings.iterations else settings.time_budget_s):
        result = plan_first(
            targets, lambda target: pipeline.plan(scene, target, q_start, settings, should_stop=should_stop, seed=settings.seed)
        )
    code = _report(result, scene, robot, args)
    if not result.succeeded:
        following = _following(result, scene, start, settings, pipeline, args, should_stop)
        if following:
            print(f"try: {following}", file=sys.stderr)
    return code


def _following(
    result: PlanResult,
    scene: Scene,
    start: Start | None,
    settings: Settings,
    pipeline: Pipeline,
    args: argparse.Namespace,
    should_stop: Callable[[], bool],
) -> str:
    """Return the command that is worth a try after a refusal, tried itself in a few seconds; empty where there is none."""
    import numpy as np

    from lime_planner.cli.next_step import Refused, next_command
    from lime_planner.output.console import working
    from lime_planner.pipeline.obstacles import stem_checker

    recorded = args.bag is not None
    end_s = time.monotonic() + _TRIALS_S

    def stopped() -> bool:
        return time.monotonic() > end_s or should_stop()

    def works(words: Sequence[str]) -> bool:
        return not stopped() and _leads_to_a_motion(words, (scene, start) if recorded else None, pipeline, stopped)

    spot = None if result.target is None else result.target.spot(scene, settings)
    refused = Refused(
        tuple(args.words),
        "" if recorded else str(args.scene),
        float(args.scale),
        np.array(args.offset if args.offset is not None else (0.0, 0.0, 0.0)),
        scene,
        pipeline.robot,
        result,
        lambda: stem_checker(pipeline.robot, scene, spot, settings, stopped),
    )
    with working("looking for what to try next"):
        return next_command(refused, works)


def _leads_to_a_motion(
    words: Sequence[str], recorded: tuple[Scene, Start | None] | None, pipeline: Pipeline, should_stop: Callable[[], bool]
) -> bool:
    """Tell whether a command would succeed; what it reads from a recording is given."""
    from lime_planner.cli.main import build_parser
    from lime_planner.pipeline.scene_targets import plan_first
    from lime_planner.scene.files import load_start

    robot = pipeline.robot
    try:
        args = build_parser(words).parse_args(list(words))
        values = read_parameters(args)
        settings = settings_from({name: value for name, value in values.items() if name in PARAMETERS})
        _sort_arguments(args)
        scene, start = recorded or (read_scene(args, values), load_start(args.scene))
        if scene.frame_id not in ("", robot.planning_frame):
            return False
        q_start = _start(args, robot, start)
        targets = targets_of(args, scene, settings, robot.forward(q_start)[:3, 3])
        if not targets:
            return False
        quick = dataclasses.replace(settings, iterations=0, time_budget_s=min(settings.time_budget_s, _TRIAL_S))
        return plan_first(targets, lambda one: pipeline.plan(scene, one, q_start, quick, should_stop=should_stop)).succeeded
    except (LimePlannerError, SystemExit):
        return False


def _stopped_by_signal() -> Callable[[], bool]:
    """Let the first Ctrl-C or SIGTERM end the plan as CANCELLED; the second ends the program."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        return stop.is_set

    def ask(number: int, _: Any) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, ask)
    return stop.is_set


def _refuse(args: argparse.Namespace, code: str, message: str) -> int:
    """Report an outcome that needed no planning."""
    from lime_planner.cli.json_output import emit_json

    if args.json is not None:
        emit_json(args.json, {"status": code, "message": message})
    print(message, file=sys.stderr)
    return 1


def _provenance(args: argparse.Namespace) -> dict[str, Any]:
    """Return what it takes to show a plan again: the scene and how it was placed, and the parameters that were set."""
    values = read_parameters(args)
    placement = {"scale": args.scale, "offset": args.offset, **{name: values[name] for name in LABEL_PARAMETERS if name in values}}
    parameters = {name: value for name, value in values.items() if name in PARAMETERS}
    return {"scene": str(args.scene), "placement": placement, "parameters": parameters}


def _report(result: PlanResult, scene: Scene, robot: Robot, args: argparse.Namespace) -> int:
    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.core.status import Status
    from lime_planner.output.console import print_plans, warn

    figures = result.figures()
    for sentence in figures["warnings"]:
        warn(sentence)
    quiet = is_stdout(args.json)
    if args.json is not None:
        file = args.json
        emit_json(file, {**figures, **result.origin(), **_provenance(args)})
        args.json = None  # a picture that cannot be drawn now changes nothing about the plan
        if not quiet:
            print(f"figures: {file}")
    if args.picture is not None:
        from lime_planner.output.picture import draw_plan

        draw_plan(result, scene, robot, args.picture)
        if not quiet:
            print(f"picture: {args.picture}")
    if result.status is not Status.SUCCEEDED:
        print(result.message, file=sys.stderr)
        return 1
    if quiet:
        return 0
    print(result.message)
    trajectory = result.trajectory
    extra = [("duration of the motion [s]", [f"{trajectory.duration_s:.2f}" if trajectory is not None else "–"])]
    extra += [("iterations", [str(result.iterations)]), ("seed", [str(result.seed)])]
    print_plans(f"{result.planner} in {args.scene.name}", [("plan", figures)], extra)
    return 0
