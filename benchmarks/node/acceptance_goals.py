"""How many of the goals that could be reached are reached; not collected by pytest, because it takes minutes.

    python -m benchmarks.node.acceptance_goals --plants 20 --json out.json

On each scan of the data folder (see `acceptance_scans`) and on generated plants of all densities, targets are drawn by a seeded rule.
Of the solutions of inverse kinematics, with four times the default starts, those count that the exact meshes find free of the arm
itself and of stems by 3 mm or more (exclusion sphere in the approach zone only). Each of them alone, some of each target where there
are many, is a goal for the default planner with its default budget of 0.5 s; it is reached when there is a path and the exact check
certifies it. The table says how many are. Exit status 0 if at least 95 % are, over scans and over plants.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.node.acceptance_scans import data_folder, independent_checker, load_scan
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import settings_from
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline.figures import sample_path
from lime_planner.pipeline.goals import sort_out
from lime_planner.pipeline.search import search
from lime_planner.robot.ik import solve_ik
from lime_planner.robot.model import home, load_robot
from lime_planner.scene.plants.generator import USUAL_DENSITIES, PlantOptions, generate_plant
from lime_planner.scene.plants.grasp_targets import canopy_targets, lime_targets
from lime_planner.scene.scene import Scene

CLEAR_M = 0.003
STEP_RAD = 0.01
LEAST_SHARE = 0.95


def examine(pipeline: Pipeline, scene: Scene, pose: np.ndarray, goals: int, rng: np.random.Generator) -> dict[str, Any]:
    """Plan to some of the solutions of one target that are free; how many of them were reached, and what became of the others."""
    settings = settings_from({})
    q = home(pipeline.robot)
    T = pose_to_matrix(pose)
    independent = independent_checker(pipeline.robot, scene, T[:3, 3], settings)
    solutions = solve_ik(pipeline.robot, T, q, np.random.default_rng(99), starts=1024).solutions
    free = [g for g in solutions if independent.stem_hit(g) is None and independent.stem_distance(g) >= CLEAR_M]
    tried = [free[i] for i in rng.permutation(len(free))[:goals]]
    obstacles = pipeline.obstacles(scene, T[:3, 3], settings)
    checker = obstacles.exact_checker()
    lost: list[str] = []
    for g in tried:
        chosen = sort_out(obstacles, checker, g[None], q)
        if chosen.status is not None:
            lost.append(f"no goal: {chosen.sentence}")
            continue
        anchored = obstacles.with_anchors(chosen.anchors, chosen.needs)
        found, chosen, _ = search(anchored, q, chosen, settings, seed=1, budget_s=settings.time_budget_s, should_stop=lambda: False)
        if found.path is None:
            lost.append(found.status.name)
        elif not independent.certify(sample_path(found.path, STEP_RAD)[0]).ok:
            lost.append("the path touches a stem")
    return {"solutions": len(solutions), "free": len(free), "tried": len(tried), "reached": len(tried) - len(lost), "lost": lost}


def main(arguments: list[str] | None = None) -> int:
    """Run, print the table, write the JSON; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=20)
    parser.add_argument("--targets", type=int, default=5, help="of each scan and plant, at most")
    parser.add_argument("--goals", type=int, default=6, help="tried of each target, at most")
    parser.add_argument("--robot", default="kinova_j2s6s200")
    parser.add_argument("--json", type=Path, help="file for every target")
    options = parser.parse_args(arguments)
    pipeline = Pipeline(load_robot(options.robot))
    pipeline.warm_up()
    rows: list[dict[str, Any]] = []

    def add(kind: str, name: str, scene: Scene, poses: Any) -> None:
        for target, pose in enumerate(poses):
            row = examine(pipeline, scene, np.asarray(pose), options.goals, np.random.default_rng(target))
            rows.append({"kind": kind, "scene": name, "target": target, **row})
            print(f"{name} {target}: {row['reached']} of {row['tried']} (of {row['free']} free) {row['lost']}", file=sys.stderr, flush=True)

    for path in sorted(data_folder().glob("*.npz")):
        scene = load_scan(path)
        add("scan", path.stem, scene, canopy_targets(scene, np.random.default_rng(0), options.targets))
    for seed in range(options.plants):
        density = USUAL_DENSITIES[seed % len(USUAL_DENSITIES)]
        scene = generate_plant(np.random.default_rng(seed), PlantOptions(density=density))
        add("plant", f"{density}:{seed}", scene, lime_targets(scene, np.random.default_rng(0))[: options.targets])
    print("| scenes | targets | with free solutions | goals tried | reached | share |\n|---|---|---|---|---|---|")
    shares = []
    for kind in dict.fromkeys(r["kind"] for r in rows):
        own = [r for r in rows if r["kind"] == kind]
        tried, reached = sum(r["tried"] for r in own), sum(r["reached"] for r in own)
        shares.append(reached / max(tried, 1))
        print(f"| {kind}s | {len(own)} | {sum(r['free'] > 0 for r in own)} | {tried} | {reached} | {100 * shares[-1]:.1f} % |")
    if options.json:
        options.json.write_text(json.dumps({"robot": options.robot, "targets": rows}, indent=1) + "\n")
    return 0 if min(shares) >= LEAST_SHARE else 1


if __name__ == "__main__":
    raise SystemExit(main())
