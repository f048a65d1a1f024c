"""`lime-planner view`: the 3-D page of a scene file, of a saved plan, or of running nodes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import PARAMETERS, settings_from
from lime_planner.viewer.serving import DEFAULT_PORT, announce, until_signal

if TYPE_CHECKING:
    from lime_planner.viewer.scene_backend import SceneBackend

_EPILOG = """\
The page opens in any browser. Press Plan, look at the path, drag the target
somewhere else, press Plan again. Execute moves a simulated arm; with --nodes it
is the planner node's own page, and Execute moves what listens to that node.

Only this machine can reach the page. --host lets others look; --allow-motion
with a token of yours lets those who know the token use the buttons too.

examples:
  lime-planner view
  lime-planner view plant.npz
  lime-planner plan plant.npz --json plan.json && lime-planner view plan.json
  make view
  lime-planner view plant.npz --host 0.0.0.0 --allow-motion correct-horse
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from lime_planner.cli.arguments import add_label_field, add_parameters

    parser.epilog = _EPILOG
    parser.add_argument("what", metavar="FILE", nargs="?", type=Path, help="a scene (.npz, .ply, .pcd) or a saved plan (.json)")
    parser.add_argument(
        "--nodes", action="store_true", help="start scene, simulated arm and planner as ROS nodes, and show the planner's page"
    )
    parser.add_argument("--scene", type=Path, metavar="SCENE", help="with a saved plan: its scene; default: the one that the plan names")
    parser.add_argument("--port", type=int, metavar="N", help=f"port of the page (default: the first free one from {DEFAULT_PORT})")
    parser.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help="address to serve at; default: this machine only")
    parser.add_argument("--allow-motion", default="", metavar="TOKEN", help="with --host: who knows TOKEN may use the buttons")
    parser.add_argument("--no-browser", action="store_true", help="print the address only")
    pose = ("X", "Y", "Z", "QX", "QY", "QZ", "QW")
    parser.add_argument("--target", nargs=7, type=float, metavar=pose, help="pose of the tool at the fruit [m, -]; default: the scene's")
    parser.add_argument("--start", nargs="+", type=float, metavar="Q", help="joint angles at the start [rad]; default: the arm's home")
    parser.add_argument("--scale", type=float, default=1.0, metavar="S", help="metres for each unit of the scene file (default 1)")
    parser.add_argument("--offset", nargs=3, type=float, metavar=("X", "Y", "Z"), help="then move the scene by this [m]")
    add_label_field(parser)
    add_parameters(parser, live=False)
    parser.set_defaults(planner=None, iterations=None, seed=None, time=None)


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; 0 then."""
    from lime_planner.viewer.access import Access

    access = Access(args.host, args.allow_motion)
    if args.port is not None and not 1 <= args.port <= 65535:
        raise ParameterError(f"--port {args.port}: allowed are 1 to 65535")
    if args.allow_motion and access.local:
        raise ParameterError("--allow-motion is for pages that other machines can open; give --host too")
    if args.scene is not None and (args.nodes or args.what is None or args.what.suffix.lower() != ".json"):
        raise ParameterError("--scene is for a saved plan (.json); a scene by itself is given as FILE")
    if args.nodes:
        from lime_planner.cli.parameter_file import given_parameters
        from lime_planner.ros.demo.live_view import run_with_nodes

        return run_with_nodes(args, access, given_parameters(args))
    from lime_planner.viewer.page import Page
    from lime_planner.viewer.serving import free_port

    port = free_port(access.host, DEFAULT_PORT) if args.port is None else args.port
    backend = _backend(args)
    try:
        page = Page(backend, access, port)
        try:
            with until_signal() as signals:
                announce(page.url, access, open_browser=not args.no_browser)
                signals.wait()
        finally:
            page.close()
    finally:
        backend.close()
    return 0


def _backend(args: argparse.Namespace) -> SceneBackend:
    """Make the backend of a scene file, of a saved plan, or of nothing yet."""
    import numpy as np

    from lime_planner.cli.arguments import load_arm, read_parameters, read_scene
    from lime_planner.output.saved_plan import read_plan
    from lime_planner.viewer.scene_backend import SceneBackend

    values = read_parameters(args)
    start = None if args.start is None else np.asarray(args.start)
    options: dict[str, Any] = {"target": None if args.target is None else np.asarray(args.target), "q_start": start}
    if args.what is not None and args.what.suffix.lower() == ".json":
        plan = read_plan(args.what)
        values = {**plan.parameters, **values}
        options |= {
            "scene": plan.load_scene(args.scene),
            "saved": plan.result,
            "q_start": plan.q_start if start is None else start,
            "target": (plan.asked or plan.target) if args.target is None else options["target"],
            "title": args.what.name,
        }
    elif args.what is not None:
        options |= {"scene": read_scene(argparse.Namespace(**{**vars(args), "scene": args.what}), values), "title": args.what.name}
    settings = settings_from({name: value for name, value in values.items() if name in PARAMETERS})
    return SceneBackend(lambda: load_arm(settings), settings, **options)
