"""Collision geometry of a URDF as triangle meshes in the frames of the arm's joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from lime_planner.core.errors import RobotError
from lime_planner.core.types import Array, Int32

_SEGMENTS = 48  # of a cylinder's rim: the circumscribed prism is 0.2 % wider than the cylinder
_SUBDIVISIONS = 3  # of the icosahedron that becomes a sphere: 1280 triangles, 0.7 % wider than the sphere


_BVH: WeakKeyDictionary[LinkMesh, Any] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class LinkMesh:
    """All collision geometry of one link as one undecimated triangle mesh. Compared by identity.

    Attributes:
        name: the URDF's name of the link.
        joint: 0 for a link that stands still with the base, i for one that moves with arm joint i (1-based).
        vertices: (V, 3) float64 in that joint's frame, the planning frame for joint 0 [m].
        triangles: (T, 3) int32, indices of vertices.
        gripper: True for the last arm link and everything beyond it.
    """

    name: str
    joint: int
    vertices: Array
    triangles: Int32
    gripper: bool


def bvh_of(link: LinkMesh) -> Any:
    """Return python-fcl's bounding volume hierarchy of a link's triangles (float64), built once for each link."""
    import fcl

    model = _BVH.get(link)
    if model is None:
        model = fcl.BVHModel()
        model.beginModel(len(link.vertices), len(link.triangles))
        model.addSubModel(link.vertices, link.triangles)
        model.endModel()
        _BVH[link] = model
    return model


class LinkObjects(dict[int, Any]):
    """A robot's links for FCL, by index, each made when first asked for: 5 ms a link, and most never come near anything."""

    def __init__(self, links: Sequence[LinkMesh]) -> None:
        """Make none yet."""
        super().__init__()
        self._links = links

    def __missing__(self, link: int) -> Any:
        """Make one, where its frame is."""
        import fcl

        made = self[link] = fcl.CollisionObject(bvh_of(self._links[link]))
        return made


def triangulate(shape: Any, name: str) -> tuple[Array, Int32]:
    """Turn one of Pinocchio's (Coal's) collision shapes into vertices (V, 3) [m] and triangles (T, 3).

    Meshes are taken as they are, duplicate vertices merged. Cylinders, spheres and capsules become circumscribed polyhedra: never
    smaller than the shape, and at most 1 % of the radius larger.

    Raises:
        RobotError: a shape of another kind, or a mesh without triangles.
    """
    import coal

    if isinstance(shape, coal.BVHModelBase):
        vertices = np.array(shape.vertices(), dtype=np.float64).reshape(-1, 3)
        corners = [shape.tri_indices(i) for i in range(shape.num_tris)]
        triangles = np.array([(t[0], t[1], t[2]) for t in corners], dtype=np.int64).reshape(-1, 3)
        if len(triangles) == 0 or not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).any():
            raise RobotError(f"the collision mesh of link {name} has no triangles, no extent, or a vertex that is not finite")
        if len(vertices) >= 3 * len(triangles):  # an STL file repeats the corners in every triangle
            vertices, place = np.unique(vertices, axis=0, return_inverse=True)
            triangles = place.reshape(-1)[triangles]
        return vertices, triangles.astype(np.int32)
    import trimesh

    if isinstance(shape, coal.Box):
        mesh = trimesh.creation.box(extents=2.0 * np.asarray(shape.halfSide))
    elif isinstance(shape, coal.Cylinder):
        radius = shape.radius / np.cos(np.pi / _SEGMENTS)
        mesh = trimesh.creation.cylinder(radius=radius, height=2.0 * shape.halfLength, sections=_SEGMENTS)
    elif isinstance(shape, coal.Sphere):
        mesh = trimesh.creation.icosphere(subdivisions=_SUBDIVISIONS, radius=1.0)
        inner = float(np.abs(np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles[:, 0])).min())
        mesh.apply_scale(shape.radius / inner)
    else:
        raise RobotError(f"link {name} has a collision shape of kind {type(shape).__name__}; use a mesh, box, cylinder or sphere")
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int32)


def join_meshes(parts: list[tuple[Array, Int32]]) -> tuple[Array, Int32]:
    """Concatenate meshes given in the same frame."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    triangles = np.concatenate([triangles + offset for (_, triangles), offset in zip(parts, offsets, strict=True)])
    return np.ascontiguousarray(vertices), np.ascontiguousarray(triangles, dtype=np.int32)
