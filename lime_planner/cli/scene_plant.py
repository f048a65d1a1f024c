"""`lime-planner scene plant`: a lime plant from a seed."""

from __future__ import annotations

import argparse
from pathlib import Path

_EPILOG = """\
The file holds points, labels (0 leaf, 1 stem, 2 lime), a grasp pose at the lime
that is best hidden among leaves, and as ground truth the leaves' triangles.

examples:
  lime-planner scene plant --seed 3 --out plant.npz
  lime-planner scene plant --density dense --height 1.2 --out plant.npz
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from lime_planner.cli.json_output import add_json

    parser.epilog = _EPILOG
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="scene file to write: .npz, .ply or .pcd")
    parser.add_argument("--seed", type=int, default=15, metavar="N", help="the same seed grows the same plant (default 15)")
    parser.add_argument("--density", default="medium", choices=("sparse", "medium", "dense"), help="how many leaves (default medium)")
    parser.add_argument("--leaves", type=int, metavar="N", help="number of leaves instead of a density")
    parser.add_argument("--limes", type=int, default=8, metavar="N", help="number of limes (default 8)")
    parser.add_argument("--height", type=float, default=0.90, metavar="M", help="height of the plant [m] (default 0.9)")
    parser.add_argument("--radius", type=float, default=0.28, metavar="M", help="radius of its canopy [m] (default 0.28)")
    where = "foot of its trunk in the frame of the arm's base [m] (default 0.62 0 0)"
    parser.add_argument("--position", nargs=3, type=float, default=(0.62, 0.0, 0.0), metavar=("X", "Y", "Z"), help=where)
    add_json(parser, "what was grown")


def run(args: argparse.Namespace) -> int:
    """Grow the plant and write it."""
    import numpy as np

    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.core.atomic_files import check_writable
    from lime_planner.output.progress import working
    from lime_planner.scene.plants.generator import PlantOptions, generate_plant

    options = PlantOptions(
        density=args.density,
        n_leaves=args.leaves,
        n_limes=args.limes,
        height_m=args.height,
        radius_m=args.radius,
        position_m=tuple(args.position),
    )
    if args.seed < 0:
        from lime_planner.core.errors import ParameterError

        raise ParameterError(f"--seed is {args.seed}; it must be at least 0")
    check_writable(args.out)
    with working("growing"):
        scene = generate_plant(np.random.default_rng(args.seed), options)
        scene.save(args.out)
    if args.json is not None:
        counts = {"leaf": len(scene.leaf_points), "stem": len(scene.stem_points), "fruit": len(scene.fruit_points)}
        target = None if scene.target_pose is None else scene.target_pose.tolist()
        emit_json(args.json, {"file": str(args.out), "seed": args.seed, "points": counts, "target_pose": target})
    if is_stdout(args.json):
        return 0
    print(f"{args.out}: {len(scene.leaf_points)} leaf, {len(scene.stem_points)} stem and {len(scene.fruit_points)} lime points")
    return 0
