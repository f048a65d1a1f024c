"""Problems for comparisons of planners: scene, target and start, from which every planner gets one and the same space and goals."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.collision.joint_space import ArmSpace
from lime_planner.core.errors import ParameterError, ProblemError
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.parameters import Settings, settings_from
from lime_planner.core.types import Array
from lime_planner.pipeline.goals import Goals, find_goals, sampling_box
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.planning.rrt_star import kernels as paper_kernels
from lime_planner.robot.model import load_robot
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import DEFAULT_FRAME, Scene

SCAN_OFFSET_M = (0.55, 0.0, 0.05)  # a scan's stem foot, in front of the arm
SEEDLING_HEIGHT_M = 0.1  # a lower scan is a seedling ...
SEEDLING_SCALE = 24.0  # ... and enlarged to a plant of about 0.6 m
IK_SEED = 1  # goals are the same for every planner and seed


@dataclass(frozen=True)
class SceneSpec:
    """Where a scene comes from: a scan in a file, or a generated plant.

    Attributes:
        name: in tables and keys.
        path: file of a scan, empty for a generated plant; scale and offset_m [m] apply to it.
        density, seed: of a generated plant; leaves: its number of leaves, 0 for as many as its density has.
    """

    name: str
    path: str = ""
    scale: float = 1.0
    offset_m: tuple[float, float, float] = SCAN_OFFSET_M
    density: str = "medium"
    seed: int = 0
    leaves: int = 0

    @classmethod
    def scan(cls, path: Path) -> SceneSpec:
        """A scan in front of the arm; a seedling is enlarged."""
        scene = Scene.load(path, frame_id=DEFAULT_FRAME)
        points = np.concatenate([scene.leaf_points, scene.stem_points])
        height = float(np.ptp(points[:, 2]))
        name = path.stem.removeprefix("tomato_").removesuffix("_pred").removesuffix("_human")
        return cls(name, str(path), SEEDLING_SCALE if height < SEEDLING_HEIGHT_M else 1.0)

    @classmethod
    def plant(cls, text: str) -> SceneSpec:
        """A generated plant from DENSITY:SEED.

        Raises:
            ParameterError: the text is something else.
        """
        density, colon, number = text.partition(":")
        if not colon or not number.isdigit():
            raise ParameterError(f"a generated plant is named DENSITY:SEED, for example dense:3; got {text!r}")
        PlantOptions(density=density)
        return cls(f"{density}-{number}", density=density, seed=int(number))

    def load(self) -> Scene:
        """Load or grow the scene."""
        if self.path:
            return Scene.load(self.path, frame_id=DEFAULT_FRAME, scale=self.scale, offset=self.offset_m)
        return generate_plant(np.random.default_rng(self.seed), PlantOptions(density=self.density, n_leaves=self.leaves or None))


@dataclass(frozen=True)
class ProblemSpec:
    """One problem in a form that fits into JSON and goes to other processes.

    Attributes:
        scene: where the plant comes from.
        target: number of the target in the scene's fixed draw.
        case: `plain`, or what makes it hard: `narrow`, `leaf_start`, `far`.
        pose: (7,) of the tool at the target [m, quaternion].
        start: (n,) configuration [rad].
        robot: name of the arm.
    """

    scene: SceneSpec
    target: int
    case: str
    pose: tuple[float, ...]
    start: tuple[float, ...]
    robot: str = "kinova_j2s6s200"

    @property
    def key(self) -> str:
        """Short name: scene/target, with the case where it is not plain."""
        return f"{self.scene.name}/{self.target}" + ("" if self.case == "plain" else f"/{self.case}")

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, and back with `from_dict`."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> ProblemSpec:
        """Read what `to_dict` wrote."""
        scene = dict(data["scene"])
        scene["offset_m"] = tuple(scene["offset_m"])
        values = {**data, "scene": SceneSpec(**scene), "pose": tuple(data["pose"]), "start": tuple(data["start"])}
        return cls(**values)


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem as planners get it.

    Attributes:
        spec: where it comes from.
        obstacles: with the anchors of start and goals; goals: valid ones, most promising first.
        start: (n,); lower, upper: (n,) sampling box [rad].
        settings: of the pipeline, defaults throughout.
    """

    spec: ProblemSpec
    obstacles: Obstacles = field(repr=False)
    goals: Goals = field(repr=False)
    start: Array
    lower: Array
    upper: Array
    settings: Settings = field(repr=False)

    def space(self) -> ArmSpace:
        """A space with memory and counters of its own."""
        return self.obstacles.space(self.lower, self.upper)

    def cost(self, path: npt.ArrayLike | None) -> float:
        """J of a path (M, n), integrated by the compiled edge cost on a space of its own; inf without a path or through a stem."""
        if path is None:
            return float("inf")
        rows = np.ascontiguousarray(path, dtype=np.float64)
        goals = self.goals.configurations
        if np.abs(rows[0] - self.start).max() > 1e-6 or np.abs(goals - rows[-1]).max(axis=1).min() > 1e-6:
            return float("inf")
        return float(paper_kernels.measure(self.space().handle(), rows, self.settings.weight)[3])


@functools.lru_cache(maxsize=2)
def pipeline_of(robot: str) -> Pipeline:
    """The pipeline of an arm; one for each process."""
    return Pipeline(load_robot(robot))


@functools.lru_cache(maxsize=2)
def scene_of(spec: SceneSpec) -> Scene:
    """A scene; the last ones are kept."""
    return spec.load()


def find_problem(spec: ProblemSpec) -> tuple[Problem | None, str]:
    """Build a problem's obstacles and goals as the pipeline would, or say why there are none.

    Goals that the exact meshes refuse are left out before any planner sees them, so that all planners are judged by the same ones.
    """
    pipeline = pipeline_of(spec.robot)
    settings = settings_from()
    T = pose_to_matrix(np.array(spec.pose))
    start = np.array(spec.start)
    obstacles = pipeline.obstacles(scene_of(spec.scene), T[:3, 3], settings)
    checker = obstacles.exact_checker()
    hit = checker.stem_hit(start)
    if hit is not None:
        return None, f"start: {hit}"
    goals = find_goals(obstacles, checker, T, start, np.random.default_rng(IK_SEED))
    if goals.status is not None:
        return None, goals.status.message(goals.sentence)
    lower, upper = sampling_box(obstacles, start, goals.configurations)
    ready = obstacles.with_anchors(goals.anchors, goals.needs)
    return Problem(spec, ready, goals, start, lower, upper, settings), ""


@functools.lru_cache(maxsize=4)
def build_problem(spec: ProblemSpec) -> Problem:
    """Build a problem that is known to have goals; the last ones are kept.

    Raises:
        ProblemError: it has none.
    """
    problem, reason = find_problem(spec)
    if problem is None:
        raise ProblemError(f"{spec.key}: {reason}")
    return problem
