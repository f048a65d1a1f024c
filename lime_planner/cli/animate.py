"""`lime-planner animate`: a saved plan as a moving picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import settings_from

_EPILOG = """\
PLAN is what `lime-planner plan --json` wrote, or `result.save` in Python;
--scene names its scene where the plan does not. The motion runs in its own
time, seen from beside. Orange: leaves that the arm touches, and the part of the
tool's path on which it touches any.

examples:
  lime-planner plan plant.npz --json plan.json
  lime-planner animate plan.json --out reach.gif
  lime-planner animate plan.json --out reach.mp4 --fps 30 --width 960
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    parser.add_argument("plan", metavar="PLAN", type=Path, help="a saved plan (.json)")
    parser.add_argument("--scene", type=Path, metavar="SCENE", help="its scene's file; default: the one that the plan names")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the animation: .gif or .mp4")
    parser.add_argument("--fps", type=float, default=15.0, metavar="N", help="pictures a second (default 15)")
    parser.add_argument("--width", type=int, default=560, metavar="PIXELS", help="width of a picture (default 560)")


def run(args: argparse.Namespace) -> int:
    """Draw and write; 0 when the file is there."""
    from rich.progress import Progress

    from lime_planner.cli.arguments import load_arm
    from lime_planner.core.atomic_files import check_writable
    from lime_planner.output.animation import SUFFIXES, animate, check_format
    from lime_planner.output.console import console
    from lime_planner.output.saved_plan import read_plan
    from lime_planner.pipeline import Pipeline
    from lime_planner.pipeline.result import PlanRecord

    if not 1.0 <= args.fps <= 60.0:
        raise ParameterError(f"--fps {args.fps:g}: allowed are 1 to 60")
    if not 120 <= args.width <= 3840:
        raise ParameterError(f"--width {args.width}: allowed are 120 to 3840")
    if args.out.suffix.lower() not in SUFFIXES:
        raise ParameterError(f"--out {args.out}: ends in none of {', '.join(SUFFIXES)}")
    check_format(args.out)
    check_writable(args.out)
    plan = read_plan(args.plan)
    settings = settings_from(plan.parameters)
    scene = plan.load_scene(args.scene)
    robot = load_arm(settings)
    shown = PlanRecord(1, scene, settings, plan.target, plan.result(robot))
    screen = console(error=True)
    with Progress(console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task("drawing", total=None)
        animate(
            args.out,
            Pipeline(robot),
            shown,
            fps=args.fps,
            width=args.width,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    print(f"animation: {args.out} ({args.out.stat().st_size / 1e6:.1f} MB)")
    return 0
