"""What the tests of the arm share: robots, scenes and configurations near them, made once."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from conftest import shared_data

from lime_planner.core.parameters import Settings, settings_from
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.robot.kinematics import Chain, forward_kinematics, tool_pose
from lime_planner.robot.model import Robot, load_robot
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import DEFAULT_FRAME, Scene

OFFSET = (0.55, 0.0, 0.05)
SEEDLING_SCALE = 24.0


@cache
def robot_named(name: str = "kinova_j2s6s200") -> Robot:
    """A built-in arm."""
    return load_robot(name)


@cache
def pipeline_of(name: str = "kinova_j2s6s200") -> Pipeline:
    """Its pipeline, not warmed up: what a test needs is compiled when it is needed."""
    return Pipeline(robot_named(name))


def scan_files() -> list[Path]:
    """The real scans, in order of their names; skips where the folder is absent."""
    return sorted(shared_data().glob("*.npz"))


@cache
def scan(name: str) -> Scene:
    """A real scan by (part of) its name, in front of the arm; skips where the folder is absent."""
    path = next(p for p in scan_files() if name in p.name)
    return Scene.load(path, frame_id=DEFAULT_FRAME, scale=SEEDLING_SCALE if "seedling" in name else 1.0, offset=OFFSET)


@cache
def plant(seed: int = 3, density: str = "medium") -> Scene:
    """A generated plant."""
    return generate_plant(np.random.default_rng(seed), PlantOptions(density=density))


def settings(**values: Any) -> Settings:
    """The defaults but for some."""
    return settings_from(values)


def scene_of(stems: Any = (), leaves: Any = (), frame: str = "base") -> Scene:
    """A scene of given stem and leaf points."""
    stems, leaves = (np.asarray(p, dtype=np.float64).reshape(-1, 3) for p in (stems, leaves))
    labels = np.concatenate([np.ones(len(stems), int), np.zeros(len(leaves), int)])
    return Scene.from_points(np.concatenate([stems, leaves]), labels, frame_id=frame)


def obstacles_of(scene: Scene, target: Any = None, robot: str = "kinova_j2s6s200", **values: Any) -> Obstacles:
    """A scene as obstacles for a built-in arm."""
    return pipeline_of(robot).obstacles(scene, None if target is None else np.asarray(target, float), settings(**values))


def box_of(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Joint limits, one turn around zero where there are none."""
    return np.where(np.isfinite(robot.lower), robot.lower, -np.pi), np.where(np.isfinite(robot.upper), robot.upper, np.pi)


def near_configurations(robot: Robot, rng: np.random.Generator, count: int, centre: Any, radius: float) -> np.ndarray:
    """Random configurations (count, n) whose tool is within `radius` of a place."""
    chain: Chain = robot.chain
    low, high = box_of(robot)
    poses, T = np.empty((robot.n + 1, 3, 4)), np.empty((3, 4))
    found = np.empty((count, robot.n))
    have = 0
    while have < count:
        for q in rng.uniform(low, high, (4096, robot.n)):
            forward_kinematics(chain, q, poses)
            tool_pose(chain, poses, T)
            if have < count and np.linalg.norm(T[:, 3] - centre) < radius:
                found[have] = q
                have += 1
    return found
