"""The arm's bodies as the fast collision model sees them: signed distance grids and nested spheres.

A body is everything that moves with one joint (body 0 stands still, body i moves with joint i). Of each body we keep

- a signed distance grid in the joint's frame, made from the undecimated meshes: a cloud point looked up in it gives the distance
  between mesh and point to about half a millimetre, which decides every ambiguous case;
- a few *coarse* spheres, each around some *fine* ones that cover the whole body and stick out by a few millimetres only: they
  clear most configurations with a handful of look-ups in the scene's distance fields;
- points on the surface, for the arm against itself.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.atomic_files import replacing
from lime_planner.core.cache_folder import cache_root
from lime_planner.core.quick_open3d import open3d
from lime_planner.core.types import Array, Float32, Int32, Int64
from lime_planner.robot.kinematics import Chain
from lime_planner.robot.model import LinkMesh, Robot

_VERSION = 5  # of what is computed here; part of the cache's key
GRID_PADDING_M = 0.03  # a grid reaches this far beyond its body
_GRID_NODES = 350_000
_FINE_OVERSHOOT_M = {True: 0.004, False: 0.006}  # by whether the body is the gripper's
_COARSE_OVERSHOOT_M = 0.02
_SURFACE_SPACING_M = 0.006
_MAX_COARSE = 60  # a body's coarse spheres are the bits of an integer


class Shapes(NamedTuple):
    """All bodies of an arm, as arrays for compiled code; B bodies, lengths in metres, coordinates in the joints' frames.

    Attributes:
        origin: (B, 3) first node of each signed distance grid.
        spacing: (B,) distance between its nodes.
        size: (B, 3) int64, its nodes per axis.
        offset: (B,) int64, where it starts in `grid`.
        grid: float32, all grids one after the other, negative inside.
        bound: (B, 4) bounding sphere: centre, radius; radius 0 for a body without geometry.
        coarse: (C, 4) spheres; coarse_start: (B + 1,) the body's range.
        fine: (F, 4) spheres; fine_start: (C + 1,) the range of each coarse sphere.
        surface: (S, 3) points on the surface, each near one fine sphere; surface_start: (F + 1,).
        pairs: (P, 2) int64 bodies that can touch each other.
        lever: (n, B) upper bound of the distance of any point of body b from joint j's axis [m/rad]; 0 where j does not move b.
        gripper: index of the body that the exclusion sphere spares.
    """

    origin: Array
    spacing: Array
    size: Int64
    offset: Int64
    grid: Float32
    bound: Array
    coarse: Array
    coarse_start: Int64
    fine: Array
    fine_start: Int64
    surface: Array
    surface_start: Int64
    pairs: Int64
    lever: Array
    gripper: int


def signed_distance_grid(vertices: Array, triangles: Int32) -> tuple[Array, float, Float32]:
    """Sample the signed distance to a mesh on a grid, watertight or not.

    Meshes of real arms have holes and inner parts. What cannot be reached from outside without passing within about one spacing of
    a triangle is inside; on the shell itself, where that rule is too coarse, ray parity decides.

    Returns:
        origin (3,), spacing, values (nx, ny, nz) float32 [m].
    """
    o3d = open3d()
    import scipy.ndimage

    low, high = vertices.min(axis=0) - GRID_PADDING_M, vertices.max(axis=0) + GRID_PADDING_M
    spacing = float(np.clip((np.prod(high - low) / _GRID_NODES) ** (1 / 3), 0.002, 0.01))
    size = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[k] + spacing * np.arange(size[k]) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices.astype(np.float32), triangles.astype(np.uint32))
    unsigned = scene.compute_distance(nodes).numpy()
    regions, _ = scipy.ndimage.label(unsigned > 0.9 * spacing)
    outside = regions == regions[0, 0, 0]
    # Depth from what is outside, not from the nearest triangle: housings are hollow, and what is inside them is inside the arm.
    depth = scipy.ndimage.distance_transform_edt(~outside) * spacing
    enclosed = depth > 2.0 * spacing
    shell = (~outside & ~enclosed & (regions == 0)).nonzero()
    inside = enclosed | (~outside & (regions > 0))
    inside[shell] = scene.compute_occupancy(nodes[shell], nsamples=3).numpy() > 0.5
    deep = np.where(enclosed, np.maximum(unsigned, depth - 1.9 * spacing), unsigned)
    return low, spacing, np.where(inside, -deep, unsigned).astype(np.float32)


def _interpolate(origin: Array, spacing: float, values: Float32, points: Array) -> Array:
    import scipy.ndimage

    coordinates = ((points - origin) / spacing).T
    return np.asarray(scipy.ndimage.map_coordinates(values, coordinates, order=1, mode="nearest"), dtype=np.float64)


def _cover(candidates: Array, depth: Array, points: Array, overshoot: float, limit: int = 400) -> Array:
    """Choose spheres greedily: centre inside the body, radius its depth there plus `overshoot`, until all `points` are covered."""
    from scipy.spatial import cKDTree

    radius = depth + overshoot
    tree = cKDTree(points)
    members = [np.asarray(m) for m in tree.query_ball_point(candidates, radius - 1e-4)]
    counts = np.array([len(m) for m in members])
    uncovered = np.ones(len(points), bool)
    chosen: list[int] = []
    while uncovered.any() and len(chosen) < limit:
        # Lazy greedy: counts only fall, so the first candidate whose refreshed count still leads is the best.
        while True:
            best = int(np.argmax(counts))
            fresh = int(uncovered[members[best]].sum()) if len(members[best]) else 0
            if fresh == counts[best]:
                break
            counts[best] = fresh
        if counts[best] == 0:
            break
        chosen.append(best)
        uncovered[members[best]] = False
    spheres = np.column_stack([candidates[chosen], radius[chosen]])
    left = points[uncovered]
    if len(left):
        spheres = np.vstack([spheres, np.column_stack([left, np.full(len(left), overshoot)])])
    return spheres


def _grow_to_cover(spheres: Array, points: Array) -> Array:
    """Enlarge spheres until every point is covered: the rule that makes them a cover, whatever the sampling missed."""
    enlarged = spheres.copy()
    for start in range(0, len(points), 4096):
        block = points[start : start + 4096]
        gap = np.linalg.norm(block[:, None] - enlarged[None, :, :3], axis=2) - enlarged[None, :, 3]
        nearest = gap.argmin(axis=1)
        missing = gap[np.arange(len(block)), nearest]
        np.maximum.at(enlarged[:, 3], nearest, spheres[nearest, 3] + np.maximum(missing, 0.0))
    return enlarged


def _body(vertices: Array, triangles: Int32, gripper: bool) -> dict[str, Any]:
    import trimesh

    origin, spacing, values = signed_distance_grid(vertices, triangles)
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    count = int(np.clip(mesh.area / (0.0025**2), 2000, 40_000))
    dense = np.vstack([vertices, trimesh.sample.sample_surface(mesh, count, seed=0)[0]])
    surface = dense[_thin(dense, _SURFACE_SPACING_M)]
    inside = np.argwhere(values < 0.0)
    rng = np.random.default_rng(0)
    if len(inside) > 4000:
        inside = inside[rng.choice(len(inside), 4000, replace=False)]
    centres = np.vstack([origin + spacing * inside, surface])
    depth = np.maximum(-_interpolate(origin, spacing, values, centres), 0.0)
    # What must be covered: the surface and the volume.
    targets = np.vstack([surface, centres[: len(inside)][_thin(centres[: len(inside)], 0.008)]])
    fine = _grow_to_cover(_cover(centres, depth, targets, _FINE_OVERSHOOT_M[gripper]), dense)
    # Fewest larger spheres, each made to hold its fine ones whole.
    coarse = _cover(centres, depth, fine[:, :3], _COARSE_OVERSHOOT_M)[:_MAX_COARSE]
    overhang = np.linalg.norm(fine[:, None, :3] - coarse[None, :, :3], axis=2) + fine[:, None, 3] - coarse[None, :, 3]
    parent = overhang.argmin(axis=1)
    keep, parent = np.unique(parent, return_inverse=True)
    coarse = coarse[keep]
    order = np.argsort(parent, kind="stable")
    fine, parent = fine[order], parent[order]
    for c in range(len(coarse)):
        own = fine[parent == c]
        # The centre that needs the smallest radius, from a few candidates: the old centre, the children's mean.
        options = [coarse[c, :3], own[:, :3].mean(axis=0), 0.5 * (own[:, :3].min(axis=0) + own[:, :3].max(axis=0))]
        radii = [float((np.linalg.norm(own[:, :3] - o, axis=1) + own[:, 3]).max()) for o in options]
        best = int(np.argmin(radii))
        coarse[c] = (*options[best], radii[best])
    near = np.argmin(np.linalg.norm(surface[:, None] - fine[None, :, :3], axis=2) - fine[None, :, 3], axis=1)
    by_fine = np.argsort(near, kind="stable")
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    return {
        "origin": origin,
        "spacing": spacing,
        "values": values,
        "bound": np.array([*middle, np.linalg.norm(vertices - middle, axis=1).max()]),
        "coarse": coarse,
        "fine": fine,
        "fine_counts": np.bincount(parent, minlength=len(coarse)),
        "surface": surface[by_fine],
        "surface_counts": np.bincount(near, minlength=len(fine)),
    }


def _thin(points: Array, spacing: float) -> Int64:
    """Indices of one point for each cube of edge `spacing`."""
    return np.unique(np.floor(points / spacing).astype(np.int64), axis=0, return_index=True)[1]


def _levers(chain: Chain, vertices: Sequence[Array]) -> Array:
    """Bound, for each joint and body, the distance of the body's points from the joint's axis over all configurations."""
    n = len(chain.axes)
    lever = np.zeros((n, n + 1))
    for b in range(1, n + 1):
        if not len(vertices[b]):
            continue
        axis = chain.axes[b - 1]
        along = vertices[b] @ axis
        radial = np.sqrt(np.maximum((vertices[b] ** 2).sum(axis=1) - along**2, 0.0)).max()
        lever[b - 1, b] = 1.0 if chain.prismatic[b - 1] else radial
        around = np.linalg.norm(vertices[b], axis=1).max()  # of the points from the origin of the joint below, whatever its angle
        for j in range(b - 1, 0, -1):
            offset = chain.placements[j, :, 3]
            axis = chain.axes[j - 1]
            radial_offset = np.sqrt(max(float(offset @ offset - (offset @ axis) ** 2), 0.0))
            lever[j - 1, b] = 1.0 if chain.prismatic[j - 1] else radial_offset + around
            around += float(np.linalg.norm(offset))
    return lever


def _body_pairs(robot: Robot) -> Int64:
    # Neighbouring bodies meet at their joint; whatever else is fixed to them turns about it without coming closer.
    pairs = {tuple(sorted((robot.links[a].joint, robot.links[b].joint))) for a, b in robot.collision_pairs}
    return np.array(sorted(p for p in pairs if p[1] - p[0] > 1), np.int64).reshape(-1, 2)


def _cache_file(links: Sequence[LinkMesh]) -> Path:
    digest = hashlib.sha256(f"{_VERSION} {GRID_PADDING_M} {_GRID_NODES}".encode())
    for link in links:
        digest.update(f"{link.joint} {link.gripper}".encode())
        digest.update(np.ascontiguousarray(link.vertices).tobytes())
        digest.update(np.ascontiguousarray(link.triangles).tobytes())
    return cache_root() / f"shapes-{digest.hexdigest()[:20]}.npz"


def _compute(robot: Robot) -> dict[str, Any]:
    bodies = len(robot.joint_names) + 1
    parts: dict[str, list[Any]] = {k: [] for k in ("origin", "spacing", "size", "grid", "bound", "coarse", "fine", "surface")}
    counts: dict[str, list[Any]] = {"coarse": [], "fine": [], "surface": []}
    for b in range(bodies):
        own = [link for link in robot.links if link.joint == b]
        if not own:
            for key, empty in (("origin", np.zeros(3)), ("spacing", 1.0), ("size", np.zeros(3, int)), ("bound", np.zeros(4))):
                parts[key].append(empty)
            counts["coarse"].append(0)
            continue
        starts = np.cumsum([0, *[len(link.vertices) for link in own[:-1]]])
        vertices = np.vstack([link.vertices for link in own])
        triangles = np.vstack([link.triangles + s for link, s in zip(own, starts, strict=True)])
        body = _body(vertices, triangles, any(link.gripper for link in own))
        parts["origin"].append(body["origin"])
        parts["spacing"].append(body["spacing"])
        parts["size"].append(body["values"].shape)
        parts["grid"].append(body["values"].ravel())
        for key in ("bound", "coarse", "fine", "surface"):
            parts[key].append(body[key])
        counts["coarse"].append(len(body["coarse"]))
        counts["fine"].extend(body["fine_counts"])
        counts["surface"].extend(body["surface_counts"])
    sizes = np.array(parts["size"], np.int64)
    result: dict[str, Any] = {
        "origin": np.array(parts["origin"]),
        "spacing": np.array(parts["spacing"]),
        "size": sizes,
        "offset": np.concatenate([[0], np.cumsum(sizes.prod(axis=1))[:-1]]).astype(np.int64),
        "grid": np.concatenate([*parts["grid"], np.zeros(1, np.float32)]),
        "bound": np.array(parts["bound"]),
    }
    for key in ("coarse", "fine"):
        result[key] = np.vstack([*parts[key], np.zeros((0, 4))])
    result["surface"] = np.vstack([*parts["surface"], np.zeros((0, 3))])
    for key, values in counts.items():
        result[f"{key}_start"] = np.concatenate([[0], np.cumsum(values)]).astype(np.int64)
    return result


def build_shapes(robot: Robot) -> Shapes:
    """Make the shapes of an arm, or read them from the cache (a few seconds the first time, then a few hundredths)."""
    path = _cache_file(robot.links)
    arrays: dict[str, Any] | None = None
    if path.exists():
        try:
            with np.load(path) as stored:
                arrays = {k: stored[k] for k in stored.files}
        except (OSError, ValueError, EOFError):  # half-written by a process that was stopped: make it again
            arrays = None
    if arrays is None:
        arrays = _compute(robot)
        with replacing(path) as temporary:
            np.savez(temporary, **arrays)
    empty = np.zeros((0, 3))
    vertices = [np.vstack([empty, *[link.vertices for link in robot.links if link.joint == b]]) for b in range(len(robot.joint_names) + 1)]
    gripper = max((link.joint for link in robot.links if link.gripper), default=len(robot.joint_names))
    return Shapes(**arrays, pairs=_body_pairs(robot), lever=_levers(robot.chain, vertices), gripper=int(gripper))
