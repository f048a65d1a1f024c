"""What stands in the page's scene: the plant, the arm, the path and the leaves that are touched."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lime_planner.core.quick_open3d import open3d
from lime_planner.core.types import Array, Bool, Float32, Int32, Int64
from lime_planner.output.approach_lines import APPROACH_COLOURS, approach_lines
from lime_planner.output.picture import ARM, FREE_PATH, LEAFY_PATH, LIME, STEM
from lime_planner.output.timeline import Timeline
from lime_planner.pipeline.obstacles import UNSEEN_VOXEL_M
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.seen_map import make_seen_map

Colour = tuple[int, int, int]

#: Leaves under the page's lamps, which make the picture's bluish green still bluer.
LEAF = (0.10, 0.52, 0.27)

#: Points of a class beyond this number are thinned: a browser without a graphics card draws some 20 frames a second with it.
POINTS_SHOWN = 40_000
UNSEEN = (0.45, 0.40, 0.62)
BESIDE = (0.54, 0.31, 0.62)  # the path of a plan beside the one shown
_TRIANGLES_OF_A_LINK = 3000
_TONES = (0.82, 0.94, 1.06, 1.18)  # of leaves, so that one stands out from the next
_PATH_THICKNESS_M = 0.006
_APPROACHES_SHOWN = 600


def set_visible(handle: Any, visible: bool) -> None:
    """Show or hide a node; nothing is sent to the browsers where nothing changes."""
    if bool(handle.visible) != visible:
        handle.visible = visible


def rgb(colour: tuple[float, float, float], tone: float = 1.0) -> Colour:
    """Return a colour of 0 to 1 as bytes, lighter or darker by `tone`."""
    red, green, blue = (int(round(255.0 * min(1.0, c * tone))) for c in colour)
    return red, green, blue


def thinned(points: npt.NDArray[Any], most: int) -> Int64:
    """Return indices of at most `most` points, evenly spread over their order."""
    return np.unique(np.linspace(0, max(len(points) - 1, 0), min(len(points), most)).round().astype(np.int64))


def spacing_of(points: Float32) -> float:
    """Return the median distance between neighbouring points (N, 3) [m], of a sample of them; 0 for fewer than two."""
    if len(points) < 2:
        return 0.0
    distance, _ = cKDTree(points).query(points[:: max(1, len(points) // 1000)], k=2)
    return float(np.median(np.asarray(distance)[:, 1]))


class Plant:
    """Leaves, stems and limes."""

    def __init__(self, api: Any, scene: Scene, *, centre: Array, reach_m: float, on_lime: Callable[[int], None]) -> None:
        """Add them.

        Args:
            api: viser's scene.
            scene: the plant; what is farther than `reach_m` from `centre` is left out.
            centre: (3,) [m].
            reach_m: see `scene`.
            on_lime: is told the number of a lime that is clicked.
        """
        self._on_lime = on_lime
        self.notes: list[str] = []
        self._api = api
        self._parts: dict[str, list[Any]] = {"leaves": [], "stems": [], "limes": [], "unseen": []}

        def near(points: npt.NDArray[Any]) -> Bool:
            return np.asarray(np.linalg.norm(points - centre, axis=-1) < reach_m)

        if scene.leaf_triangles is not None and len(scene.leaf_triangles):
            self._leaf_meshes(scene, near(scene.leaf_triangles[:, 0]))
        else:
            self._cloud("leaves", scene.leaf_points[near(scene.leaf_points)], LEAF, 0.006)
        self._cloud("stems", scene.stem_points[near(scene.stem_points)], STEM, 0.008)
        if scene.fruit_centres is not None and scene.fruit_radii is not None and len(scene.fruit_centres):
            self._limes(scene)
        else:
            self._cloud("limes", scene.fruit_points[near(scene.fruit_points)], LIME, 0.006)
        unseen = make_seen_map(scene, UNSEEN_VOXEL_M, reach_m=reach_m).unseen
        self._cloud("unseen", unseen[near(unseen)], UNSEEN, 0.004)

    def show(self, part: str, visible: bool) -> None:
        """Show or hide `leaves`, `stems`, `limes` or `unseen`."""
        for handle in self._parts[part]:
            set_visible(handle, visible)

    def remove(self) -> None:
        """Take everything out of the scene."""
        for handles in self._parts.values():
            for handle in handles:
                handle.remove()

    def _cloud(self, part: str, points: Float32, colour: tuple[float, float, float], size_m: float) -> None:
        if not len(points):
            return
        keep = thinned(points, POINTS_SHOWN)
        if len(keep) < len(points):
            self.notes.append(f"{len(keep):,} of {len(points):,} points of {part} are drawn")
        size_m = float(np.clip(1.5 * spacing_of(points[keep]), 0.0015, size_m))
        tones = np.random.default_rng(0).uniform(0.85, 1.12, len(keep))[:, None]
        colours = np.clip(255.0 * np.asarray(colour) * tones, 0, 255).astype(np.uint8)
        self._parts[part].append(
            self._api.add_point_cloud(
                f"/plant/{part}", points[keep], colours, point_size=size_m, point_shape="circle", precision="float32", point_shading="flat"
            )
        )

    def _leaf_meshes(self, scene: Scene, near: Bool) -> None:
        assert scene.leaf_triangles is not None
        triangles = scene.leaf_triangles[near]
        ids = np.arange(len(triangles)) if scene.leaf_triangle_ids is None else scene.leaf_triangle_ids[near]
        tone = (ids * 7) % len(_TONES)
        for number, brightness in enumerate(_TONES):
            corners = triangles[tone == number].reshape(-1, 3)
            if len(corners):
                faces = np.arange(len(corners)).reshape(-1, 3)
                handle = self._api.add_mesh_simple(
                    f"/plant/leaves/{number}",
                    corners,
                    faces,
                    color=rgb(LEAF, brightness),
                    side="double",
                    flat_shading=True,
                    cast_shadow=False,
                )
                self._parts["leaves"].append(handle)

    def _clicked(self, number: int, _event: Any) -> None:
        self._on_lime(number)

    def _limes(self, scene: Scene) -> None:
        assert scene.fruit_centres is not None and scene.fruit_radii is not None
        for number, (centre, radius) in enumerate(zip(scene.fruit_centres, scene.fruit_radii, strict=True)):
            handle = self._api.add_icosphere(
                f"/plant/limes/{number}", float(radius), color=rgb(LIME), subdivisions=2, position=centre, cast_shadow=False
            )
            handle.on_click(partial(self._clicked, number))
            self._parts["limes"].append(handle)


@cache
def _drawn_meshes(robot: Robot) -> tuple[tuple[str, int, Array, Int32], ...]:
    """Return name, joint, vertices and triangles of each link, simplified for drawing."""
    o3d = open3d()

    meshes = []
    for link in robot.links:
        vertices, triangles = link.vertices, link.triangles
        if len(triangles) > _TRIANGLES_OF_A_LINK:
            mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))
            mesh = mesh.simplify_quadric_decimation(_TRIANGLES_OF_A_LINK)
            vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
        meshes.append((link.name, link.joint, vertices, triangles))
    return tuple(meshes)


class Arm:
    """The arm's meshes at one configuration."""

    def __init__(
        self, api: Any, name: str, robot: Robot, colour: tuple[float, float, float], opacity: float | None, *, solid: Sequence[str] = ()
    ) -> None:
        """Add the arm.

        Args:
            api: viser's scene.
            name: of the arm's node.
            robot: the arm.
            colour: 0 to 1.
            opacity: 0 to 1; None for solid.
            solid: names of links that are solid all the same.
        """
        self._robot = robot
        self.q: Array | None = None
        self._root = api.add_frame(name, show_axes=False)
        self._joints = [api.add_frame(f"{name}/{joint}", show_axes=False) for joint in range(robot.n + 1)]
        for number, (link, joint, vertices, triangles) in enumerate(_drawn_meshes(robot)):
            api.add_mesh_simple(
                f"{name}/{joint}/{number}",
                vertices,
                triangles,
                color=rgb(colour),
                opacity=None if link in solid else opacity,
                side="double",
                cast_shadow=False,
            )

    def joint_name(self, joint: int) -> str:
        """Return the scene's name of the frame that moves with a joint, 0 for the base's."""
        return str(self._joints[joint].name)

    def place(self, q: Array) -> None:
        """Put the arm into a configuration (n,) [rad]."""
        if self.q is not None and np.array_equal(self.q, q):
            return
        self.q = np.array(q)
        poses = self._robot.link_poses(q)
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
        for frame, pose, wxyz in zip(self._joints, poses, quaternions, strict=True):
            frame.position, frame.wxyz = pose[:3, 3], wxyz

    def show(self, visible: bool) -> None:
        """Show or hide the arm."""
        set_visible(self._root, visible)

    def remove(self) -> None:
        """Take it out of the scene."""
        self._root.remove()


def measured_arm(api: Any, robot: Robot) -> Arm:
    """The arm where it is measured to be."""
    return Arm(api, "/arm", robot, ARM, None)


def ghost_arm(api: Any, robot: Robot) -> Arm:
    """The arm where the plan has it at the time slider's moment."""
    return Arm(api, "/ghost", robot, FREE_PATH, 0.45)


class ToolPath:
    """The tool's way, blue where the arm is free, orange where any part of it touches leaves."""

    def __init__(self, api: Any, timeline: Timeline, *, name: str = "/path", colour: tuple[float, float, float] | None = None) -> None:
        """Add the line; one colour makes it the thinner line of a plan to compare with."""
        pieces = np.stack([timeline.tool[:-1], timeline.tool[1:]], axis=1).astype(np.float32)
        touching = np.maximum(timeline.leaf[:-1], timeline.leaf[1:]) > 0.0
        free, leafy = (FREE_PATH, LEAFY_PATH) if colour is None else (colour, colour)
        colours = np.where(touching[:, None, None], rgb(leafy), rgb(free)).astype(np.uint8)
        thickness = _PATH_THICKNESS_M if colour is None else 0.6 * _PATH_THICKNESS_M
        self._line = api.add_line_segments(name, pieces, np.broadcast_to(colours, pieces.shape), thickness=thickness)

    def show(self, visible: bool) -> None:
        """Show or hide the line."""
        set_visible(self._line, visible)

    def remove(self) -> None:
        """Take it out of the scene."""
        self._line.remove()


class ApproachLines:
    """The approaches that were tried, as lines towards the fruit, coloured by what became of them."""

    def __init__(self, api: Any, poses: Array, outcomes: Int64) -> None:
        """Add lines of the approaches (A, 7); none where there was nothing to choose."""
        self._lines = None
        if not len(poses):
            return
        keep = thinned(poses, _APPROACHES_SHOWN)
        pieces = approach_lines(poses[keep]).astype(np.float32)
        colours = np.array([rgb(APPROACH_COLOURS[int(outcome)]) for outcome in outcomes[keep]], dtype=np.uint8)
        self._lines = api.add_line_segments("/approaches", pieces, np.repeat(colours[:, None], 2, axis=1), thickness=0.002)

    def show(self, visible: bool) -> None:
        """Show or hide the lines."""
        if self._lines is not None:
            set_visible(self._lines, visible)

    def remove(self) -> None:
        """Take them out of the scene."""
        if self._lines is not None:
            self._lines.remove()


class Touched:
    """The leaves that the arm touches at the slider's moment, lit up; those touched before it, dimmed."""

    def __init__(self, api: Any, scene: Scene, timeline: Timeline) -> None:
        """Prepare; nothing is lit before the first `light`."""
        self._api = api
        self._timeline = timeline
        self._points = scene.leaf_points[timeline.leaf_points]
        self._leaves = None if scene.leaf_ids is None or scene.leaf_triangle_ids is None else scene.leaf_ids[timeline.leaf_points]
        self._scene = scene
        self._sample = -1
        self._keys: list[bytes] = [b"", b""]
        self._handles: list[Any] = [None, None]
        self._visible = True

    def light(self, sample: int) -> int:
        """Light what is touched at a sample of the timeline; return the number of leaves (of points, where leaves are not known)."""
        now = self._timeline.touched[sample]
        if sample != self._sample:
            self._sample = sample
            before = self._timeline.touched[: sample + 1].any(axis=0) & ~now
            self._draw(0, "/touched/now", now, rgb(LEAFY_PATH), 0.009)
            self._draw(1, "/touched/before", before, rgb((0.96, 0.72, 0.48)), 0.006)
        return self.count(now)

    def count(self, marks: Bool) -> int:
        """Return how many leaves (or points) some of the touched points are."""
        return int(marks.sum()) if self._leaves is None else len(np.unique(self._leaves[marks]))

    @property
    def unit(self) -> str:
        """What `light` counts."""
        return "leaf points" if self._leaves is None else "leaves"

    def show(self, visible: bool) -> None:
        """Show or hide."""
        self._visible = visible
        for handle in self._handles:
            if handle is not None:
                set_visible(handle, visible)

    def remove(self) -> None:
        """Take it out of the scene."""
        for number, handle in enumerate(self._handles):
            if handle is not None:
                handle.remove()
                self._handles[number] = None

    def _draw(self, number: int, name: str, marks: Bool, colour: Colour, size_m: float) -> None:
        which = np.flatnonzero(marks) if self._leaves is None else np.unique(self._leaves[marks])
        if which.tobytes() == self._keys[number] and self._handles[number] is not None:
            return
        self._keys[number] = which.tobytes()
        if self._handles[number] is not None:
            self._handles[number].remove()
            self._handles[number] = None
        if not len(which):
            return
        if self._leaves is None:
            handle = self._api.add_point_cloud(
                name, self._points[which], colour, point_size=size_m, point_shape="circle", precision="float32"
            )
        else:
            assert self._scene.leaf_triangles is not None and self._scene.leaf_triangle_ids is not None
            corners = self._scene.leaf_triangles[np.isin(self._scene.leaf_triangle_ids, which)]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
            lifted = (corners[None] + 0.0008 * np.array([1.0, -1.0])[:, None, None, None] * normals[None, :, None]).reshape(-1, 3)
            faces = np.arange(len(lifted)).reshape(-1, 3)
            handle = self._api.add_mesh_simple(
                name, lifted.astype(np.float32), faces, color=colour, side="double", flat_shading=True, cast_shadow=False
            )
        handle.visible = self._visible
        self._handles[number] = handle
