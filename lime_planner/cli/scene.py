"""`lime-planner scene info`: what a scene file holds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lime_planner.scene.files import Start
    from lime_planner.scene.scene import Scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from lime_planner.cli.json_output import add_json

    parser.epilog = "examples:\n  lime-planner scene info plant.npz\n  lime-planner scene info plant.npz --json | jq .points"
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file: .npz, .ply or .pcd")
    parser.add_argument("--label-field", default="label", metavar="NAME", help="field of the label in PLY and PCD files (default label)")
    add_json(parser, "the same")


def run(args: argparse.Namespace) -> int:
    """Print the counts, the extent and the target."""
    import numpy as np
    from rich.table import Table

    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.output.console import console
    from lime_planner.output.progress import working
    from lime_planner.scene.files import load_start
    from lime_planner.scene.scene import Scene

    with working("reading"):
        scene, start = Scene.load(args.scene, label_field=args.label_field), load_start(args.scene)
    if args.json is not None:
        emit_json(args.json, _figures(args.scene, scene, start))
    if is_stdout(args.json):
        return 0
    table = Table(title=str(args.scene), title_justify="left", show_edge=False, pad_edge=False)
    for heading in ("class", "points", "from x y z [m]", "to x y z [m]"):
        table.add_column(heading.replace("[", r"\["), justify="left" if heading == "class" else "right")
    for name, points in (("leaf", scene.leaf_points), ("stem", scene.stem_points), ("fruit", scene.fruit_points)):
        corners = (points.min(axis=0), points.max(axis=0)) if len(points) else ((), ())
        ends = [" ".join(f"{value:.3f}" for value in corner) or "–" for corner in corners]
        table.add_row(name, str(len(points)), *ends)
    console().print(table)
    print(f"frame: {scene.frame_id}")
    with np.printoptions(precision=4, suppress=True):
        print(f"target: {scene.target_pose if scene.target_pose is not None else 'none'}")
    if start is not None:
        print("start: " + ", ".join(f"{name} {angle:.4f}" for name, angle in zip(start.joint_names, start.q, strict=True)))
    dropped = {name: count for name, count in scene.counts.items() if count and name != "received"}
    print(f"received: {scene.counts.get('received', scene.n_points)}" + "".join(f", {name}: {count}" for name, count in dropped.items()))
    return 0


def _figures(path: Path, scene: Scene, start: Start | None) -> dict[str, Any]:
    points = {"leaf": scene.leaf_points, "stem": scene.stem_points, "fruit": scene.fruit_points}
    corners = {name: [array.min(axis=0).tolist(), array.max(axis=0).tolist()] for name, array in points.items() if len(array)}
    return {
        "file": str(path),
        "frame_id": scene.frame_id,
        "points": {name: len(array) for name, array in points.items()},
        "extent_m": corners,
        "target_pose": None if scene.target_pose is None else scene.target_pose.tolist(),
        "start": None if start is None else dict(zip(start.joint_names, start.q.tolist(), strict=True)),
        "counts": dict(scene.counts),
    }
