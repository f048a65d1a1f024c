"""Reads PLY and PCD files of random make, and damaged ones: `python -m benchmarks.scene_files.fuzz --files 2000 --seed 1`.

A whole file must give exactly what was written. A truncated one must be refused, or give the same where the points had not been
touched; one with broken bytes must end in a scene or in a sentence. Anything else is printed and counted, and makes the exit status 1.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.scene_files.writer import CloudFile, random_file
from lime_planner.core.errors import SceneError
from lime_planner.scene.files import read_members
from lime_planner.scene.scene import Scene


def difference(file: CloudFile, path: Path) -> str:
    """Read a whole file; return what is wrong with what came, empty where it is right."""
    members = read_members(path, "label")
    if members["points"].dtype != file.points.dtype and not (members["points"].dtype == np.float64 and b"ascii" in file.content[:4000]):
        return f"points are {members['points'].dtype}, expected {file.points.dtype}"
    if not np.array_equal(members["points"].astype(file.points.dtype), file.points, equal_nan=True):
        return "other points"
    if not np.array_equal(members["labels"].astype(np.float64), file.labels, equal_nan=True):
        return "other labels"
    costs = members.get("permeability_cost")
    expected = file.costs
    if (costs is None) != (expected is None) or (costs is not None and expected is not None and not np.array_equal(costs, expected)):
        return "other costs"
    finite = np.isfinite(file.points.astype(np.float32)).all(axis=1)
    if not finite.any():
        return ""
    scene = Scene.load(path)
    sizes = tuple(int((finite & mask).sum()) for mask in (file.labels == 0, file.labels == 2, ~np.isin(file.labels, (0, 2))))
    found = (len(scene.leaf_points), len(scene.fruit_points), len(scene.stem_points))
    return "" if found == sizes else f"leaf, fruit and stem points {found}, expected {sizes}"


def damage(file: CloudFile, rng: np.random.Generator) -> tuple[bytes, bool]:
    """Return a damaged copy, and whether it is truncated only."""
    content = bytearray(file.content)
    if rng.random() < 0.5:
        left = bytes(content[: rng.integers(len(content))])
        if b"ascii" in file.content[:4000]:
            left = left[: len(left.rstrip()) - len(left.split()[-1]) if left.split() else 0]  # no reader sees that 253 became 25
        return left, True
    for place in rng.integers(len(content), size=int(rng.integers(1, 5))):
        content[place] = rng.integers(256)
    return bytes(content), False


def outcome_of_damaged(file: CloudFile, path: Path, truncated: bool) -> str:
    """Read a damaged file; return `refused` or `read`, or what is wrong."""
    try:
        if truncated:
            return "read" if not difference(file, path) else "wrong: a truncated file gives something else"
        Scene.load(path)
    except SceneError as error:
        text = str(error)
        return "refused" if text.startswith(str(path)) and "\n" not in text else f"wrong: the sentence {text!r}"
    return "read"


def run(files: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Read files of random make, each whole and damaged; return how it went, and what went wrong."""
    counts: Counter[str] = Counter()
    faults: list[str] = []
    for number in range(files):
        rng = np.random.default_rng([seed, number])
        file = random_file(rng)
        path = folder / f"cloud{file.suffix}"
        path.write_bytes(file.content)
        label = f"file {number}: {file.suffix} {file.make}"
        try:
            wrong = difference(file, path)
            counts[f"{file.suffix} {'right' if not wrong else 'wrong'}"] += 1
            if wrong:
                faults.append(f"{label}: {wrong}")
            content, truncated = damage(file, rng)
            path.write_bytes(content)
            outcome = outcome_of_damaged(file, path, truncated)
            counts[f"{'truncated' if truncated else 'broken'} {outcome.split(':')[0]}"] += 1
            if outcome.startswith("wrong"):
                faults.append(f"{label}: {outcome}")
        except Exception as error:  # whatever gets out of the reader is what is looked for here
            counts["other exceptions"] += 1
            faults.append(f"{label}: {type(error).__name__}: {error}")
    return counts, faults


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description="Read PLY and PCD files of random make, whole and damaged.")
    parser.add_argument("--files", type=int, default=2000, metavar="N", help="number of files (default 2000)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed (default 1)")
    args = parser.parse_args()
    began_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        counts, faults = run(args.files, args.seed, Path(folder))
    for fault in faults:
        print(fault)
    print(", ".join(f"{name}: {count}" for name, count in sorted(counts.items())))
    print(f"{args.files} files, seed {args.seed}: {len(faults)} faults, {time.perf_counter() - began_s:.0f} s")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
