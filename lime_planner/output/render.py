"""Shaded parallel projections of meshes and clouds as images, without a display: what hides what is right in every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from lime_planner.core.quick_open3d import open3d
from lime_planner.core.types import Array, Float32

Image = Float32

#: Where the light comes from, in the image's right, up and towards-the-eye directions.
_LIGHT = np.array([-0.45, 0.65, 0.62])
_AMBIENT = 0.42
_SILHOUETTE_M = 0.02  #: a jump of depth beyond this between neighbouring pixels is an outline


@dataclass(frozen=True)
class View:
    """A parallel projection onto the plane of two axes of the scene's frame, on a grid of pixels.

    Attributes:
        right: (3,) unit vector that points right in the image.
        up: (3,) unit vector that points up in the image.
        extent: left, right, bottom, top of the image along those [m].
        pixel_m: size of a pixel.
    """

    right: Array
    up: Array
    extent: tuple[float, float, float, float]
    pixel_m: float

    @property
    def towards(self) -> Array:
        """Unit vector from the scene to the eye."""
        return np.cross(self.right, self.up)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [pixels]."""
        left, right, bottom, top = self.extent
        return max(1, round((top - bottom) / self.pixel_m)), max(1, round((right - left) / self.pixel_m))

    def project(self, points: npt.ArrayLike) -> Array:
        """Return right, up and towards-the-eye coordinates (N, 3) [m] of points (N, 3)."""
        axes: Array = np.stack([self.right, self.up, self.towards])
        projected: Array = np.asarray(points, dtype=np.float64) @ axes.T
        return projected


@dataclass(frozen=True)
class Layer:
    """One kind of thing as seen in a view.

    Attributes:
        colour: (H, W, 3), 0 to 1.
        height_m: (H, W) how near to the eye; -inf where there is nothing.
    """

    colour: Image
    height_m: Image


def _shade(colour: Image, normals: Array) -> Image:
    """Darken colours (N, 3) by the angle between normals (N, 3), in image axes, and the light; both sides are lit."""
    facing = np.where(normals[:, 2:3] < 0.0, -normals, normals)
    lit = np.clip(facing @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    shaded: Image = (colour * (_AMBIENT + (1.08 - _AMBIENT) * lit)[:, None]).clip(0.0, 1.0).astype(np.float32)
    return shaded


def mesh_layer(view: View, vertices: npt.ArrayLike, triangles: npt.ArrayLike, colours: npt.ArrayLike) -> Layer:
    """Draw triangles, outlined where depth jumps.

    Args:
        view: the projection.
        vertices: (V, 3) [m].
        triangles: (T, 3) indices.
        colours: (T, 3) or (3,), 0 to 1.
    """
    o3d = open3d()

    height, width = view.shape
    layer = _empty(view)
    faces = np.asarray(triangles, dtype=np.uint32).reshape(-1, 3)
    if not len(faces):
        return layer
    corners = view.project(vertices).astype(np.float32)
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(o3d.core.Tensor(corners), o3d.core.Tensor(faces))
    # Rays are cast only where the mesh can be seen.
    (x0, y0, _), (x1, y1, above) = corners.min(axis=0), corners.max(axis=0) + 1.0
    left, _, _, top = view.extent
    columns = np.arange(max(0, int((x0 - left) / view.pixel_m)), min(width, int((x1 - 1.0 - left) / view.pixel_m) + 1))
    rows = np.arange(max(0, int((top - y1 + 1.0) / view.pixel_m)), min(height, int((top - y0) / view.pixel_m) + 1))
    if not len(columns) or not len(rows):
        return layer
    rays = np.zeros((len(rows), len(columns), 6), dtype=np.float32)
    rays[..., 0] = left + (columns + 0.5) * view.pixel_m
    rays[..., 1] = (top - (rows + 0.5) * view.pixel_m)[:, None]
    rays[..., 2] = above
    rays[..., 5] = -1.0
    hits = {name: tensor.numpy() for name, tensor in caster.cast_rays(o3d.core.Tensor(rays)).items()}
    seen = np.isfinite(hits["t_hit"])
    colour = np.broadcast_to(np.asarray(colours, dtype=np.float32), (len(faces), 3))[hits["primitive_ids"][seen].astype(np.int64)]
    at = tuple(grid[seen] for grid in np.broadcast_arrays(*np.ix_(rows, columns)))
    layer.height_m[at] = above - hits["t_hit"][seen]
    layer.colour[at] = _shade(colour, hits["primitive_normals"][seen].astype(np.float64))
    _outline(layer)
    return layer


def cloud_layer(view: View, points: npt.ArrayLike, colour: npt.ArrayLike, radii_m: tuple[float, float]) -> Layer:
    """Draw points as small discs, shaded by the surface that their neighbours suggest.

    Args:
        view: the projection.
        points: (N, 3) [m].
        colour: (3,), 0 to 1.
        radii_m: smallest and largest radius of a disc; in between, discs just close the gaps between neighbours.
    """
    layer = _empty(view)
    placed = view.project(np.asarray(points).reshape(-1, 3))
    if not len(placed):
        return layer
    distance, _ = cKDTree(placed).query(placed[:: max(1, len(placed) // 2000)], k=2)
    radius_m = float(np.clip(1.3 * np.median(np.asarray(distance)[:, 1]), *radii_m)) if len(placed) > 1 else radii_m[1]
    shades = _shade(np.broadcast_to(np.asarray(colour, dtype=np.float32), (len(placed), 3)), _normals(placed))
    order = np.argsort(placed[:, 2], kind="stable")
    placed, shades = placed[order], shades[order]
    left, _, _, top = view.extent
    height, width = view.shape
    column = np.floor((placed[:, 0] - left) / view.pixel_m).astype(np.int64)
    row = np.floor((top - placed[:, 1]) / view.pixel_m).astype(np.int64)
    reach = max(1, round(radius_m / view.pixel_m))
    winner = np.full(height * width, -1, dtype=np.int64)
    for down in range(-reach, reach + 1):
        for across in range(-reach, reach + 1):
            if down * down + across * across > reach * reach + 1:
                continue
            r, c = row + down, column + across
            inside = np.flatnonzero((r >= 0) & (r < height) & (c >= 0) & (c < width))
            cells = r[inside] * width + c[inside]
            # Points are in order of height and a repeated cell keeps the last assignment: the larger index is the nearer point.
            winner[cells] = np.maximum(winner[cells], inside)
    seen = winner >= 0
    layer.height_m.reshape(-1)[seen] = placed[winner[seen], 2]
    layer.colour.reshape(-1, 3)[seen] = shades[winner[seen]]
    return layer


def compose(plant: list[Layer], solid: list[tuple[Layer, float]], veil: float) -> Image:
    """Lay layers over each other on white, nearest on top, and return the image (H, W, 3).

    Args:
        plant: layers that let what is solid shine through.
        solid: layers with their own opacity.
        veil: opacity of the plant where something solid lies behind it.
    """
    nearest = plant[0]
    for layer in plant[1:]:
        nearer = layer.height_m > nearest.height_m
        nearest = Layer(np.where(nearer[..., None], layer.colour, nearest.colour), np.where(nearer, layer.height_m, nearest.height_m))
    image = np.where(np.isfinite(nearest.height_m)[..., None], nearest.colour, np.float32(1.0))
    # Only where something solid is seen do the layers have to be put in order.
    seen = np.zeros(nearest.height_m.shape, dtype=bool)
    for layer, _ in solid:
        seen |= np.isfinite(layer.height_m)
    rows, columns = np.nonzero(seen)
    layers = [(nearest, veil), *solid]
    heights = np.stack([layer.height_m[rows, columns] for layer, _ in layers])
    colours = np.stack([layer.colour[rows, columns] for layer, _ in layers])
    opacity = np.isfinite(heights) * np.array([[alpha] for _, alpha in layers], dtype=np.float32)
    mixed = np.ones((len(rows), 3), dtype=np.float32)
    pixel = np.arange(len(rows))
    for place in np.argsort(heights, axis=0):
        mixed += (colours[place, pixel] - mixed) * opacity[place, pixel][:, None]
    image[rows, columns] = mixed
    return image


def halved(image: Image) -> Image:
    """Return the image at half the resolution: smooth edges from a picture drawn twice as large."""
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    half: Image = image[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))
    return half


def _empty(view: View) -> Layer:
    height, width = view.shape
    return Layer(np.ones((height, width, 3), dtype=np.float32), np.full((height, width), -np.inf, dtype=np.float32))


def _outline(layer: Layer) -> None:
    """Darken, in place, the nearer of two neighbouring pixels where depth jumps."""
    height = np.where(np.isfinite(layer.height_m), layer.height_m, -1e3)
    edge = np.zeros(height.shape, dtype=bool)
    for axis in (0, 1):
        for step in (-1, 1):
            edge |= height - np.roll(height, step, axis=axis) > _SILHOUETTE_M
    layer.colour[edge] *= 0.45


def _normals(points: Array) -> Array:
    """Estimate the surface normals (N, 3) of a cloud."""
    if len(points) < 10:
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))
    o3d = open3d()

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.012, max_nn=20))
    return np.asarray(cloud.normals)
