"""What a plan is to reach, from the command line: a pose, a fruit, or a file of candidates."""

from __future__ import annotations

import argparse
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lime_planner.core.errors import ParameterError, ProblemError, UsageError
from lime_planner.core.validation import TextFileError, read_json, read_text

if TYPE_CHECKING:
    import numpy.typing as npt

    from lime_planner.core.parameters import Settings
    from lime_planner.core.types import Array
    from lime_planner.pipeline.targets import Target
    from lime_planner.scene.scene import Scene

FREEDOMS = ("exact", "roll", "cone")


def add_fruit_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that leave the grasp to the planner."""
    fruit = "a fruit of the scene, by its number, `nearest`, or `any`: the planner chooses how to grasp it"
    parser.add_argument("--fruit", metavar="N", help=fruit)
    candidates = "poses of the tool, any of which will do: rows x y z qx qy qz qw in a .csv, .txt, .json, .npy or .npz file"
    parser.add_argument("--candidates", type=Path, metavar="FILE", help=candidates)
    parser.add_argument("--freedom", choices=FREEDOMS, help="what a target pose leaves open (parameter grasp_freedom)")


def check_together(args: argparse.Namespace) -> None:
    """Refuse more than one target.

    Raises:
        UsageError: see above.
    """
    given = [name for name in ("target", "fruit", "candidates") if getattr(args, name) is not None]
    if len(given) > 1:
        raise UsageError(f"{' and '.join(f'--{name}' for name in given)} each say what to reach; give one of them")
    if args.freedom not in (None, "exact") and given and given[0] != "target":
        raise UsageError(f"--freedom is about a target pose; --{given[0]} leaves the approach open anyway")


def targets_of(args: argparse.Namespace, scene: Scene, settings: Settings, tool: Array) -> list[Target]:
    """Return what is to be reached, in the order in which it is to be tried; none where neither options nor scene say.

    Args:
        args: with `target` (numbers), `fruit` and `candidates`.
        scene, settings: loaded.
        tool: (3,) where the tool is [m].

    Raises:
        ProblemError, SceneError, ParameterError: what was given is no target; the text says why.
    """
    from lime_planner.pipeline.scene_targets import fruit_targets, own_target
    from lime_planner.pipeline.targets import candidates_target, target_of

    if args.target is None and args.candidates is None:
        _check_size(args.scale, scene)
    if args.fruit is not None:
        which: Any = int(args.fruit) if args.fruit.lstrip("-").isdigit() else args.fruit
        return fruit_targets(scene, which, tool)
    if args.candidates is not None:
        try:
            return [candidates_target(read_candidates(args.candidates))]
        except ProblemError as error:
            raise ProblemError(f"{args.candidates}: {error}") from None
    if args.target is not None:
        return [target_of(args.target, settings.grasp_freedom)]
    own = own_target(scene, settings.grasp_freedom, tool)
    return [] if own is None else [own]


def _check_size(scale: float, scene: Scene) -> None:
    """Refuse a scene whose fruit is too large to be one, with the option that would change that.

    Raises:
        ParameterError: see above.
    """
    from lime_planner.pipeline.targets import LARGEST_RADIUS_M

    radius_m = 0.0 if scene.fruit_radii is None or not len(scene.fruit_radii) else float(scene.fruit_radii.max())
    if radius_m <= LARGEST_RADIUS_M:
        return
    made = f"--scale {scale:g} makes the scene's fruit" if scale != 1.0 else "the scene's fruit is"
    hint = "it is metres for each unit of the file" if scale != 1.0 else "is the file in millimetres? --scale 0.001 then"
    raise ParameterError(f"{made} {radius_m:.4g} m in radius, at most {LARGEST_RADIUS_M:g} m are allowed: {hint}")


def read_candidates(path: Path) -> npt.ArrayLike:
    """Read poses from a file: rows of seven numbers as text, a JSON list of them (or `candidates` in an object), an .npy, or an .npz.

    Raises:
        ParameterError: it cannot be read, or its suffix says nothing.
    """
    import numpy as np

    suffix = path.suffix.lower()
    try:
        if suffix == ".json":
            data = read_json(path)
            return data.get("candidates", []) if isinstance(data, dict) else data  # type: ignore[no-any-return]
        if suffix in (".csv", ".txt"):
            lines = [line.split("#")[0].replace(",", " ").replace(";", " ").split() for line in read_text(path).splitlines()]
            rows = [line for line in lines if line]
            if rows and not _all_numbers(rows[0]):  # a heading
                rows = rows[1:]
            for number, row in enumerate(rows, start=1):
                if len(row) != 7 or not _all_numbers(row):
                    raise ParameterError(f"pose {number} needs 7 numbers x y z qx qy qz qw, got {' '.join(row)!r}")
            return [[float(word) for word in row] for row in rows]
        if suffix in (".npy", ".npz"):
            loaded = np.load(path, allow_pickle=False)
            if suffix == ".npy":
                return np.asarray(loaded)
            names = list(loaded.files)
            name = "candidates" if "candidates" in names else names[0] if len(names) == 1 else ""
            if not name:
                raise ParameterError(f"it has no array `candidates`, but {', '.join(names) or 'none'}")
            return np.asarray(loaded[name])
    except (ParameterError, TextFileError, OSError) as error:
        raise ParameterError(f"{path}: cannot be read as grasp candidates ({getattr(error, 'strerror', None) or error})") from None
    except (ValueError, EOFError, zipfile.BadZipFile):
        raise ParameterError(f"{path}: cannot be read as grasp candidates (it is no {suffix} file, or holds no numbers)") from None
    raise ParameterError(f"{path}: ends in none of .csv, .txt, .json, .npy, .npz")


def _all_numbers(words: list[str]) -> bool:
    try:
        for word in words:
            float(word)
    except ValueError:
        return False
    return True
