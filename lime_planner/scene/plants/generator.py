"""A lime plant from a seed: labelled points as from a camera, and the ground truth that a camera cannot give."""

from __future__ import annotations

import dataclasses

import numpy as np

from lime_planner.core.errors import ParameterError
from lime_planner.core.types import Array
from lime_planner.core.validation import shown
from lime_planner.scene.plants.grasp_targets import hidden_lime_target
from lime_planner.scene.plants.leaves import grow_leaves
from lime_planner.scene.plants.limes import PEDICEL_RADII_M, hang_limes
from lime_planner.scene.plants.skeleton import GOLDEN_ANGLE_RAD, Canopy, Skeleton, grow_skeleton, nodes_along
from lime_planner.scene.plants.surface import jitter, on_cones, on_spheres, on_triangles
from lime_planner.scene.scene import DEFAULT_FRAME, Scene

#: Leaves on a plant of the default size, and twigs on each of its shoots, by name of the density. Leaf area per volume of
#: canopy is about 2, 4, 7 and 14 m²/m³; `dense` is a well-grown citrus, `thicket` one never pruned: a camera sees at most a quarter
#: of its stem points from anywhere.
DENSITIES: dict[str, tuple[int, int]] = {"sparse": (120, 2), "medium": (250, 3), "dense": (450, 4), "thicket": (900, 5)}
USUAL_DENSITIES = ("sparse", "medium", "dense")  #: what experiments grow unless they are asked for others
_DEFAULT_VOLUME_M3 = 0.28 * 0.28 * 0.325


@dataclasses.dataclass(frozen=True)
class PlantOptions:
    """What plant to grow. The defaults stand it in front of an arm of 0.9 m reach whose base is the origin.

    Attributes:
        density: a key of `DENSITIES`; sets the number of leaves by the canopy's volume.
        n_leaves: the number of leaves, instead of what `density` gives.
        n_limes: how many limes; fewer where there is no room.
        position_m: where the trunk leaves the ground, in the planning frame.
        height_m: from there to the top of the canopy.
        trunk_m: from there to the lowest branch and the bottom of the canopy.
        radius_m: of the canopy, seen from above.
        leaf_length_m: shortest and longest blade.
        lime_diameter_m: smallest and largest lime.
        leaf_points_per_m2: density of the points on leaves and limes (one side of a leaf is seen).
        stem_points_per_m2: density of the points on wood.
        noise_m: standard deviation of the points' error along each axis, cut at three deviations.
        robot_position_m: base of the arm; the target is approached from its side.
        frame_id: name of the planning frame.
    """

    density: str = "medium"
    n_leaves: int | None = None
    n_limes: int = 8
    position_m: tuple[float, float, float] = (0.62, 0.0, 0.0)
    height_m: float = 0.90
    trunk_m: float = 0.25
    radius_m: float = 0.28
    leaf_length_m: tuple[float, float] = (0.05, 0.09)
    lime_diameter_m: tuple[float, float] = (0.04, 0.05)
    leaf_points_per_m2: float = 150_000.0
    stem_points_per_m2: float = 40_000.0
    noise_m: float = 0.0005
    robot_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame_id: str = DEFAULT_FRAME

    def __post_init__(self) -> None:
        """Check the ranges; ParameterError names the option, its value and its limit."""
        if self.density not in DENSITIES:
            raise ParameterError(f"density: {self.density!r} is none of {', '.join(DENSITIES)}")
        ranges: dict[str, tuple[float, float]] = {
            "n_leaves": (1, 20_000),
            "n_limes": (0, 200),
            "height_m": (0.2, 5.0),
            "trunk_m": (0.05, 4.0),
            "radius_m": (0.1, 3.0),
            "leaf_points_per_m2": (100.0, 1e7),
            "stem_points_per_m2": (100.0, 1e7),
            "noise_m": (0.0, 0.05),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ParameterError(f"{name}: {value} is outside {low:g} to {high:g}")
        for name in ("leaf_length_m", "lime_diameter_m"):
            small, large = getattr(self, name)
            if not 0.005 <= small <= large <= 0.5:
                raise ParameterError(f"{name}: {small} to {large} is no range within 0.005 to 0.5")
        for name in ("position_m", "robot_position_m"):
            value = getattr(self, name)
            if not all(abs(v) <= 100.0 for v in value):
                raise ParameterError(f"{name}: {' '.join(f'{v:g}' for v in value)} is outside -100 to 100")
        if self.height_m - self.trunk_m < 0.1:
            raise ParameterError(f"trunk_m: {self.trunk_m} leaves less than 0.1 m of canopy under height_m {self.height_m}")


def generate_plant(rng: np.random.Generator | int, options: PlantOptions | None = None) -> Scene:
    """Grow a lime plant from a seed, or a generator; the same seed gives the same scene.

    Leaves with their petioles are permeable; trunk, branches, twigs and the limes' pedicels are impermeable. The target pose is
    a grasp (see `lime_planner.scene.plants.grasp_targets`) of the lime that is best hidden among leaves; None on a plant without limes.

    Raises:
        ParameterError: `rng` is neither, or `options` are none.
    """
    if not isinstance(rng, np.random.Generator):
        if isinstance(rng, bool) or not isinstance(rng, (int, np.integer)) or rng < 0:
            raise ParameterError(f"rng must be a seed, a whole number of at least 0, or a NumPy generator, got {shown(rng)}")
        rng = np.random.default_rng(rng)
    if options is not None and not isinstance(options, PlantOptions):
        raise ParameterError(f"options must be PlantOptions, got {shown(options)}")
    options = options or PlantOptions()
    base = np.array(options.position_m, dtype=np.float64)
    half_height = 0.5 * (options.height_m - options.trunk_m)
    canopy = Canopy(base + np.array([0.0, 0.0, options.trunk_m + half_height]), np.array([options.radius_m, options.radius_m, half_height]))
    n_leaves, twigs = DENSITIES[options.density]
    if options.n_leaves is None:
        n_leaves = max(1, round(n_leaves * float(canopy.half_axes.prod()) / _DEFAULT_VOLUME_M3))
    else:
        n_leaves = options.n_leaves
    skeleton = grow_skeleton(rng, base, options.trunk_m, canopy, twigs)

    robot = np.array(options.robot_position_m, dtype=np.float64)
    front = (robot - base) * np.array([1.0, 1.0, 0.0])
    front = front / max(float(np.linalg.norm(front)), 1e-9)
    centres, radii, stalks = hang_limes(rng, skeleton, canopy, options.n_limes, options.lime_diameter_m, front)
    leaves = _leaves_beside_limes(rng, skeleton, n_leaves, options, centres, radii)
    triangles = leaves.reshape(-1, 3, 3)

    leaf_points, on = on_triangles(rng, triangles, options.leaf_points_per_m2)
    wood = on_cones(rng, skeleton.starts, skeleton.ends, skeleton.radii, options.stem_points_per_m2)
    tops = centres + radii[:, None] * (stalks - centres) / np.linalg.norm(stalks - centres, axis=1, keepdims=True)
    pedicels = on_cones(rng, stalks, tops, np.tile(PEDICEL_RADII_M, (len(stalks), 1)), options.stem_points_per_m2)
    fruit = on_spheres(rng, centres, radii, options.leaf_points_per_m2)
    stems = np.concatenate([wood, pedicels])
    scene = Scene(
        leaf_points=jitter(rng, leaf_points, options.noise_m).astype(np.float32),
        leaf_costs=np.ones(len(leaf_points), dtype=np.float32),
        stem_points=jitter(rng, stems, options.noise_m).astype(np.float32),
        fruit_points=jitter(rng, fruit, options.noise_m).astype(np.float32),
        frame_id=options.frame_id,
        counts={"received": len(leaf_points) + len(stems) + len(fruit)},
        leaf_ids=(on // leaves.shape[1]).astype(np.int32),
        leaf_triangles=triangles.astype(np.float32),
        leaf_triangle_ids=np.repeat(np.arange(n_leaves, dtype=np.int32), leaves.shape[1]),
        fruit_centres=centres.astype(np.float32),
        fruit_radii=radii.astype(np.float32),
    )
    return dataclasses.replace(scene, target_pose=hidden_lime_target(scene, rng, base_position=robot))


def _leaves_beside_limes(
    rng: np.random.Generator, skeleton: Skeleton, n: int, options: PlantOptions, centres: Array, radii: Array
) -> Array:
    """Grow n leaves; one that would pierce a lime is turned around its twig until it does not, or moved to another node."""
    trunk_xy = np.array(options.position_m[:2])
    nodes, axes = nodes_along(rng, skeleton, n, 2)
    turns = np.arange(n) * GOLDEN_ANGLE_RAD + rng.normal(0.0, 0.3, n)
    leaves = grow_leaves(rng, nodes, axes, turns, trunk_xy, options.leaf_length_m)
    for attempt in range(12):
        probes = np.concatenate([leaves, leaves.mean(axis=2, keepdims=True)], axis=2).reshape(n, -1, 1, 3)
        inside = (np.linalg.norm(probes - centres, axis=3) < radii + 0.001).any(axis=(1, 2))
        bad = np.flatnonzero(inside)
        if not len(bad):
            break
        if attempt >= 6:
            order = rng.permutation(n)[: len(bad)]
            nodes[bad], axes[bad] = nodes[order], axes[order]
        turns = rng.uniform(0.0, 2.0 * np.pi, len(bad))
        leaves[bad] = grow_leaves(rng, nodes[bad], axes[bad], turns, trunk_xy, options.leaf_length_m)
    return leaves
