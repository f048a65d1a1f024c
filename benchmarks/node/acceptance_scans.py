"""The arm's acceptance on real scans; not collected by pytest, because it takes minutes.

    python -m benchmarks.node.acceptance_scans --seeds 10 --json out.json

On each scan of the data folder (environment variable LIME_PLANNER_DATA, else ../shared/data; moved by 0.55 0 0.05 m, the seedling
scaled 24 times) five targets are drawn by a seeded rule (`lime_planner.scene.plants.grasp_targets.canopy_targets`): a random leaf point
of the middle 60 % of the canopy, at least 3 cm from a stem, approached within 45° of the ray from the base. Each is planned with
every seed at the default settings. Of every plan that succeeds

- the waypoints and the timed motion are checked again at 0.01 rad by the exact meshes against every stem point of the scan as it was
  loaded (exclusion sphere in the approach zone only), by a checker made here from nothing but the scan;
- the trajectory is carried out by the Kinova velocity law and by cubic interpolation, and where it ends is measured;
- the rules of the motion command are read out.

A target counts as reachable where inverse kinematics, with four times the default starts, has a solution that the exact meshes find
free of stems and of the arm itself. The table says how many of those succeed; all others must answer GOAL_IN_STEM or NO_IK_SOLUTION.
Exit status 0 only if every path passes, every end is within 5 mm, and at least 80 % of the plans to reachable targets succeed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.collision.exact import ExactChecker
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import Settings, parse_assignment, settings_from
from lime_planner.core.status import Status
from lime_planner.motion.controllers.replay import replay_jtc, replay_kinova
from lime_planner.motion.trajectory import Trajectory
from lime_planner.pipeline import Pipeline, PlanResult
from lime_planner.pipeline.certify import contract_violations
from lime_planner.pipeline.figures import sample_path
from lime_planner.robot.ik import solve_ik
from lime_planner.robot.model import Robot, home, load_robot
from lime_planner.scene.plants.grasp_targets import canopy_targets
from lime_planner.scene.scene import DEFAULT_FRAME, Scene

OFFSET = (0.55, 0.0, 0.05)
SEEDLING_SCALE = 24.0
TARGETS = 5
STEP_RAD = 0.01
END_ERROR_M = 0.005
LEAST_SHARE = 0.8


def data_folder() -> Path:
    """Where the scans are."""
    named = os.environ.get("LIME_PLANNER_DATA")
    return Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"


def load_scan(path: Path) -> Scene:
    """One scan in front of the arm."""
    return Scene.load(path, frame_id=DEFAULT_FRAME, scale=SEEDLING_SCALE if "seedling" in path.name else 1.0, offset=OFFSET)


def independent_checker(robot: Robot, scene: Scene, target: np.ndarray, settings: Settings) -> ExactChecker:
    """An exact checker of every stem point of a scene (and every fruit but the target's), made without the pipeline."""
    radius = settings.target_exclusion_radius_m
    points = np.concatenate([scene.stem_points, scene.impermeable_points(target, radius)])
    return ExactChecker(
        robot,
        points,
        point_radius_m=settings.stem_point_radius_m,
        exclusion_centre=target if radius > 0.0 else None,
        exclusion_radius_m=radius,
        approach_zone_m=settings.approach_zone_m,
    )


def contacts(checker: ExactChecker, result: PlanResult) -> list[str]:
    """What waypoints and timed motion touch, sampled every 0.01 rad."""
    assert result.trajectory is not None
    found = []
    for what, rows in (("waypoints", sample_path(result.waypoints, STEP_RAD)[0]), ("motion", result.trajectory.configurations(STEP_RAD))):
        certificate = checker.certify(rows)
        if not certificate.ok:
            found.append(f"{what}: {certificate.hit} at {certificate.index} of {len(rows)}")
    return found


def end_errors(robot: Robot, trajectory: Trajectory, T_base_tool: np.ndarray) -> dict[str, float]:
    """Distance of the tool from the target after both controllers have carried the motion out [m]."""
    ends = {"kinova": replay_kinova(trajectory)[1][-1], "jtc": replay_jtc(trajectory)[1][-1]}
    return {name: float(np.linalg.norm(robot.forward(q)[:3, 3] - T_base_tool[:3, 3])) for name, q in ends.items()}


def free_solutions(robot: Robot, checker: ExactChecker, T_base_tool: np.ndarray, q_start: np.ndarray) -> int:
    """How many solutions of inverse kinematics the exact meshes find free."""
    solutions = solve_ik(robot, T_base_tool, q_start, np.random.default_rng(99), starts=1024).solutions
    return sum(checker.stem_hit(q) is None for q in solutions)


def run_one(
    pipeline: Pipeline, scene: Scene, T_base_tool: np.ndarray, settings: Settings, seed: int, checker: ExactChecker
) -> dict[str, Any]:
    """Plan once and examine what comes out."""
    q = home(pipeline.robot)
    began = time.monotonic()
    result = pipeline.plan(scene, T_base_tool, q, settings, seed=seed)
    row: dict[str, Any] = {"seed": seed, "status": result.status.name, "message": result.message, "time_s": time.monotonic() - began}
    row["phases_s"] = dict(result.phases_s)
    if result.status is Status.SUCCEEDED:
        assert result.trajectory is not None
        errors = end_errors(pipeline.robot, result.trajectory, T_base_tool)
        row |= {
            "cost": result.cost,
            "path_length_rad": result.path_length_rad,
            "leaf_contact_rad": result.leaf_contact_rad,
            "min_stem_clearance_m": result.min_stem_clearance_m,
            "end_error_kinova_m": errors["kinova"],
            "end_error_jtc_m": errors["jtc"],
            "contacts": contacts(checker, result),
            "violations": contract_violations(pipeline.robot, result.trajectory, q, settings),
        }
    return row


def table(rows: list[dict[str, Any]]) -> list[str]:
    """One line for each scan, and one for all."""
    head = ("scan", "targets", "reachable", "success", "refused", "end err. mm", "contact", "rules", "leaf rad", "time s", "p95 s")
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for scan in [*dict.fromkeys(r["scan"] for r in rows), "all"]:
        own = [r for r in rows if scan in (r["scan"], "all")]
        tries = [r for r in own if r["free_solutions"] > 0]
        good = [r for r in own if r["status"] == "SUCCEEDED"]
        refused = [r for r in own if r["status"] in ("GOAL_IN_STEM", "NO_IK_SOLUTION")]
        end = max((max(r["end_error_kinova_m"], r["end_error_jtc_m"]) for r in good), default=float("nan"))
        targets, reachable = ({(r["scan"], r["target"]) for r in some} for some in (own, tries))
        spent, leaf = np.array([r["time_s"] for r in good] or [np.nan]), np.array([r["leaf_contact_rad"] for r in good] or [np.nan])
        share = f"{sum(r['status'] == 'SUCCEEDED' for r in tries)} of {len(tries)}"
        cells = [scan, len(targets), len(reachable), share, len(refused), f"{1e3 * end:.2f}", sum(bool(r["contacts"]) for r in good)]
        cells += [sum(bool(r["violations"]) for r in good), f"{np.median(leaf):.3f}"]
        cells += [f"{np.median(spent):.2f}", f"{np.percentile(spent, 95):.2f}"]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Run, print the table, write the JSON; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="plans for each target")
    parser.add_argument("--targets", type=int, default=TARGETS, help="targets for each scan")
    parser.add_argument("--rule-seed", type=int, default=0, help="of the rule that draws the targets")
    parser.add_argument("--robot", default="kinova_j2s6s200")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting other than the default")
    parser.add_argument("--json", type=Path, help="file for every run")
    options = parser.parse_args(arguments)
    settings = settings_from(dict(parse_assignment(text) for text in options.set))
    files = sorted(data_folder().glob("*.npz"))
    if not files:
        print(f"no scans in {data_folder()} (set LIME_PLANNER_DATA)", file=sys.stderr)
        return 2
    robot = load_robot(options.robot)
    pipeline = Pipeline(robot)
    pipeline.warm_up()
    rows: list[dict[str, Any]] = []
    for path in files:
        scene = load_scan(path)
        for target, pose in enumerate(canopy_targets(scene, np.random.default_rng(options.rule_seed), options.targets)):
            T = pose_to_matrix(pose)
            checker = independent_checker(robot, scene, T[:3, 3], settings)
            free = free_solutions(robot, checker, T, home(robot))
            for seed in range(1, options.seeds + 1):
                row = {"scan": path.stem, "target": target, "free_solutions": free, **run_one(pipeline, scene, T, settings, seed, checker)}
                rows.append(row)
            print(f"{path.stem} {target}: {free} free solutions; {row['message']}", file=sys.stderr, flush=True)
    lines = table(rows)
    print("\n".join(lines))
    if options.json:
        options.json.write_text(json.dumps({"settings": options.set, "robot": options.robot, "runs": rows}, indent=1))
    good = [r for r in rows if r["status"] == "SUCCEEDED"]
    tries = [r for r in rows if r["free_solutions"] > 0]
    faults = [r for r in good if r["contacts"] or r["violations"] or max(r["end_error_kinova_m"], r["end_error_jtc_m"]) > END_ERROR_M]
    for r in faults:
        print(f"FAULT {r['scan']} {r['target']} seed {r['seed']}: {r['contacts']} {r['violations']}", file=sys.stderr)
    share = sum(r["status"] == "SUCCEEDED" for r in tries) / max(len(tries), 1)
    return 0 if not faults and share >= LEAST_SHARE else 1


if __name__ == "__main__":
    raise SystemExit(main())
