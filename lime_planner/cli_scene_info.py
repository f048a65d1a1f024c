"""`lime-planner scene info`: what a scene file holds."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = "example:\n  lime-planner scene info plant.npz"
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file: .npz, .ply or .pcd")
    parser.add_argument("--label-field", default="label", metavar="NAME", help="field of the label in PLY and PCD files (default label)")


def run(args: argparse.Namespace) -> int:
    """Print the counts, the extent and the target."""
    import numpy as np
    from rich.table import Table

    from lime_planner.scene.files import load_scene
    from lime_planner.viewer.tables import console

    scene = load_scene(args.scene, label_field=args.label_field)
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
    dropped = {name: count for name, count in scene.counts.items() if count and name != "received"}
    print(f"received: {scene.counts.get('received', scene.n_points)}" + "".join(f", {name}: {count}" for name, count in dropped.items()))
    return 0
