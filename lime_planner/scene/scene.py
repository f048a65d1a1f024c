"""The one immutable picture of what stands in front of the arm: labelled points, and on generated plants the ground truth."""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ParameterError, SceneError
from lime_planner.core.types import Array, Float32, Int16, Int32, UInt8
from lime_planner.scene.arrays import (
    any_of,
    blocking_of,
    column,
    finite_rows,
    frozen,
    points_of,
    precision_note,
    seen_from,
    view_ids_of,
    whole_labels,
)
from lime_planner.scene.files import Start, read_members, write_members
from lime_planner.scene.labels import ClassCosts, class_prices, fruit_in_force, point_prices
from lime_planner.scene.moving import MOVED, SCALED, carried, placed

#: Labels of the points in scene files and clouds; every other label is impermeable.
LEAF, STEM, FRUIT = 0, 1, 2

#: Root link of the built-in arms, and with it their planning frame.
DEFAULT_FRAME = "base"

FRUIT_LINK_M = 0.012  #: fruit points closer than this belong to one fruit, or to fruits that touch
FRUIT_EXTENT_M = 0.065  #: a cluster longer than this along any axis is several fruits (a lime measures 4-5 cm)
_ONE_PLACE_M = 0.005  # viewpoints closer than this are one camera's, which a moving arm carried between two clouds of one picture
FRUIT_RADIUS_M = 0.03  #: what is let go of such a cluster: its points this close to the target

#: The viewpoints of the points of each class, in the order in which files hold the classes.
VIEW_IDS = ("leaf_view_ids", "stem_view_ids", "fruit_view_ids")

_TRUTH = ("leaf_triangles", "leaf_triangle_ids", "fruit_centres", "fruit_radii")
_DISPLACEMENTS = ("stem_displacement_m", "leaf_displacement_m")
_POSES = ("target_pose", "grasp_candidates")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """What stands in front of the arm. All lengths in metres, in the frame `frame_id` (the planning frame), z up.

    Attributes:
        leaf_points: (N, 3) float32, permeable: leaves and every other class with a price.
        leaf_costs: (N,) float32 >= 0, price of each leaf point, multiplies the leaf weight there [-].
        stem_points: (M, 3) float32, impermeable: stems, branches, stakes, wires and whatever has an unknown label.
        fruit_points: (K, 3) float32, every fruit, the target's too (see `impermeable_points`).
        frame_id: the frame of all points.
        target_pose: (7,) float64 x y z qx qy qz qw, T_base_tool at the grasp, or None.
        grasp_candidates: (P, 7) float64 such poses, any of which will do, or None.
        counts: what was received and what was dropped on the way here, by reason [points].
        stem_displacement_m: no received stem or fruit point inside the crop is farther than this from a kept one.
        leaf_displacement_m: the same for the leaf points that were not outliers.
        notes: what is doubtful about where the points came from, a sentence each.
        viewpoints: (V, 3) float32, where the points were seen from; None where that is not known.
        leaf_view_ids: (N,) int16, the viewpoint of each leaf point, -1 where it is not known; None without viewpoints.
        stem_view_ids: (M,) the same of the stem points.
        fruit_view_ids: (K,) the same of the fruit points.
        blocking_points: (B, 3) float32, what cameras saw and what is no obstacle here: the arm itself, ignored classes, what lies out of
            reach. Nothing is known of what they hide.
        blocking_view_ids: (B,) int16, the viewpoint of each.
        stood: (A, n) float64, configurations in which the arm stood when it was seen [rad]: nothing else was where it was.
        leaf_ids: (N,) int32, the leaf each leaf point lies on; generated plants only.
        leaf_triangles: (L, 3, 3) float32, corners of the leaves' surface; generated plants only.
        leaf_triangle_ids: (L,) int32, the leaf each triangle belongs to.
        fruit_centres: (F, 3) float32; generated plants only.
        fruit_radii: (F,) float32.
    """

    leaf_points: Float32
    leaf_costs: Float32
    stem_points: Float32
    fruit_points: Float32
    frame_id: str = DEFAULT_FRAME
    target_pose: Array | None = None
    grasp_candidates: Array | None = None
    counts: Mapping[str, int] = dataclasses.field(default_factory=dict)
    stem_displacement_m: float = 0.0
    leaf_displacement_m: float = 0.0
    notes: tuple[str, ...] = ()
    viewpoints: Float32 | None = None
    leaf_view_ids: Int16 | None = None
    stem_view_ids: Int16 | None = None
    fruit_view_ids: Int16 | None = None
    blocking_points: Float32 | None = None
    blocking_view_ids: Int16 | None = None
    stood: Array | None = None
    leaf_ids: Int32 | None = None
    leaf_triangles: Float32 | None = None
    leaf_triangle_ids: Int32 | None = None
    fruit_centres: Float32 | None = None
    fruit_radii: Float32 | None = None

    def __post_init__(self) -> None:
        """Copy, check and freeze the arrays."""
        for name in ("leaf_points", "stem_points", "fruit_points", "leaf_triangles", "fruit_centres", "blocking_points"):
            value = getattr(self, name)
            if value is not None and not np.ndim(value):
                raise SceneError(f"{name}: one number or text, expected an array of points")
        n_leaf = len(self.leaf_points)
        n_triangles = 0 if self.leaf_triangles is None else len(self.leaf_triangles)
        n_fruit = 0 if self.fruit_centres is None else len(self.fruit_centres)
        n_blocking = 0 if self.blocking_points is None else len(self.blocking_points)
        layout: dict[str, tuple[Any, tuple[int, ...]]] = {
            "leaf_points": (np.float32, (-1, 3)),
            "leaf_costs": (np.float32, (n_leaf,)),
            "stem_points": (np.float32, (-1, 3)),
            "fruit_points": (np.float32, (-1, 3)),
            "target_pose": (np.float64, (7,)),
            "grasp_candidates": (np.float64, (-1, 7)),
            "viewpoints": (np.float32, (-1, 3)),
            "leaf_view_ids": (np.int16, (n_leaf,)),
            "stem_view_ids": (np.int16, (len(self.stem_points),)),
            "fruit_view_ids": (np.int16, (len(self.fruit_points),)),
            "blocking_points": (np.float32, (-1, 3)),
            "blocking_view_ids": (np.int16, (n_blocking,)),
            "stood": (np.float64, (-1, 0 if self.stood is None else np.shape(self.stood)[-1])),
            "leaf_ids": (np.int32, (n_leaf,)),
            "leaf_triangles": (np.float32, (-1, 3, 3)),
            "leaf_triangle_ids": (np.int32, (n_triangles,)),
            "fruit_centres": (np.float32, (-1, 3)),
            "fruit_radii": (np.float32, (n_fruit,)),
        }
        for name, (dtype, shape) in layout.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen(name, value, dtype, shape))
        if (self.leaf_costs < 0).any():
            raise SceneError(f"permeability_cost: {float(self.leaf_costs.min()):g} is below its limit 0")
        if self.target_pose is not None and np.linalg.norm(self.target_pose[3:]) < 1e-6:
            raise SceneError("target_pose: its quaternion has length zero; it must describe a rotation")
        if n_blocking and self.blocking_view_ids is None:
            raise SceneError(f"blocking_view_ids: missing; there are {n_blocking} blocking points")
        for name in (*VIEW_IDS, "blocking_view_ids"):
            ids, n_views = getattr(self, name), 0 if self.viewpoints is None else len(self.viewpoints)
            if ids is not None and len(ids) and not -1 <= int(ids.min()) <= int(ids.max()) < n_views:
                raise SceneError(f"{name}: from {ids.min()} to {ids.max()}, but there are {n_views} viewpoints")
        object.__setattr__(self, "counts", dict(self.counts))

    def __repr__(self) -> str:
        numbers = f"{len(self.leaf_points)} leaf, {len(self.stem_points)} stem and {len(self.fruit_points)} fruit points"
        return f"<Scene of {numbers} in {self.frame_id or 'the planning frame'}, {'no' if self.target_pose is None else 'with a'} target>"

    @property
    def _sizes(self) -> tuple[int, int, int]:
        return len(self.leaf_points), len(self.stem_points), len(self.fruit_points)

    @property
    def n_points(self) -> int:
        """Number of points of all classes."""
        return len(self.leaf_points) + len(self.stem_points) + len(self.fruit_points)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        frame_id: str = "",
        scale: float = 1.0,
        offset: npt.ArrayLike | None = None,
        label_field: str = "label",
        leaf_labels: Sequence[int] = (LEAF,),
        stem_labels: Sequence[int] = (STEM,),
        fruit_labels: Sequence[int] = (FRUIT,),
        ignored_labels: Sequence[int] = (),
        class_costs: ClassCosts = (),
    ) -> Scene:
        """Load a scene file, enlarge it by `scale` about its origin, then move it by `offset`; its target pose goes with it.

        Args:
            path: an `.npz`, `.ply` or `.pcd` file.
            frame_id: the frame of a file that names none; empty: the planning frame of whatever arm plans in it.
            scale: metres for each unit of the file.
            offset: (3,) [m] in the planning frame. It is added in double precision, so that a map's coordinates lose nothing.
            label_field: name of the label in PLY and PCD files; an `.npz` has `labels`.
            leaf_labels: see `from_points`, as the next three.
            stem_labels: the known impermeable labels.
            fruit_labels: the labels of fruit; the default gives way to classes that name it.
            ignored_labels: the labels to drop.
            class_costs: prices of further permeable classes.

        Raises:
            SceneError: the file is missing, of another kind, truncated, empty, without a needed field, a field does not fit, or two
                classes share a label, or a price is none.
        """
        if not isinstance(path, (str, os.PathLike)):
            raise SceneError(f"a scene is loaded from the path of a file, got {path!r}")
        members = read_members(path, label_field)
        frame = str(members.pop("frame_id", "")) or frame_id
        try:
            notes = precision_note(members["points"], scale)
            members = placed(members, scale, (0.0, 0.0, 0.0) if offset is None else offset)
            scene = cls.from_points(
                members.pop("points"),
                members.pop("labels"),
                frame_id=frame,
                leaf_labels=leaf_labels,
                stem_labels=stem_labels,
                fruit_labels=fruit_labels,
                ignored_labels=ignored_labels,
                class_costs=class_costs,
                notes=notes,
                **members,
            )
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from error
        if not scene.n_points:
            dropped = ", ".join(f"{count} {name}" for name, count in scene.counts.items() if count)
            raise SceneError(f"{path}: none of its points can be used ({dropped})")
        return scene

    def save(self, path: str | os.PathLike[str], start: Start | None = None) -> None:
        """Write a scene file; a reader never sees half of it. PLY and PCD keep the points, their labels and costs, and nothing else.

        Args:
            path: an `.npz`, `.ply` or `.pcd` file.
            start: where the arm was when the scene was taken, in an `.npz` only.

        Raises:
            SceneError: the suffix is unknown or the file cannot be written.
        """
        points, labels, costs = self.labelled_points()
        members: dict[str, Any] = {"points": points, "labels": labels, "frame_id": self.frame_id}
        if (costs != 1.0).any():
            members["permeability_cost"] = costs
        if self.leaf_ids is not None:
            members["leaf_ids"] = np.concatenate([self.leaf_ids, np.full(len(points) - len(self.leaf_ids), -1, dtype=np.int32)])
        if self.viewpoints is not None:
            ids = [view_ids_of(getattr(self, name), n) for name, n in zip(VIEW_IDS, self._sizes, strict=True)]
            members["view_ids"] = np.concatenate(ids)
            if self.blocking_points is not None and self.blocking_view_ids is not None:
                members |= {"blocking_points": self.blocking_points, "blocking_view_ids": self.blocking_view_ids}
        members.update({name: value for name in (*_POSES, "viewpoints", *_TRUTH) if (value := getattr(self, name)) is not None})
        members.update({name: value for name in _DISPLACEMENTS if (value := getattr(self, name)) > 0.0})
        write_members(path, members, start)

    def hits_by_view(self) -> list[Float32]:
        """Return what each viewpoint saw, (N, 3) [m] for each of `viewpoints`: points of every class, and what is no obstacle here."""
        if self.viewpoints is None:
            return []
        parts = [self.leaf_points, self.stem_points, self.fruit_points]
        ids = [view_ids_of(getattr(self, name), n) for name, n in zip(VIEW_IDS, self._sizes, strict=True)]
        if self.blocking_points is not None and self.blocking_view_ids is not None:
            parts.append(self.blocking_points)
            ids.append(self.blocking_view_ids)
        points, by = np.concatenate(parts), np.concatenate(ids)
        if len(self.viewpoints) == 1:
            return [points if (by == 0).all() else points[by == 0]]
        order = np.argsort(by, kind="stable")
        ends = np.searchsorted(by[order], np.arange(len(self.viewpoints) + 1))
        return [points[order[begin:end]] for begin, end in itertools.pairwise(ends)]

    def labelled_points(self) -> tuple[Float32, UInt8, Float32]:
        """Return the scene as one cloud: points (N, 3) [m], labels (N,), permeability costs (N,); leaves, then stems, then fruit."""
        points = np.concatenate([self.leaf_points, self.stem_points, self.fruit_points])
        sizes = (len(self.leaf_points), len(self.stem_points), len(self.fruit_points))
        labels = np.repeat(np.array([LEAF, STEM, FRUIT], dtype=np.uint8), sizes)
        costs = np.ones(len(points), dtype=np.float32)
        costs[: sizes[0]] = self.leaf_costs
        return points, labels, costs

    @classmethod
    def from_points(
        cls,
        points: npt.ArrayLike,
        labels: npt.ArrayLike,
        *,
        frame_id: str = DEFAULT_FRAME,
        leaf_labels: Sequence[int] = (LEAF,),
        stem_labels: Sequence[int] = (STEM,),
        fruit_labels: Sequence[int] = (FRUIT,),
        ignored_labels: Sequence[int] = (),
        class_costs: ClassCosts = (),
        permeability_cost: npt.ArrayLike | None = None,
        stake_points: npt.ArrayLike | None = None,
        target_pose: npt.ArrayLike | None = None,
        leaf_ids: npt.ArrayLike | None = None,
        viewpoints: npt.ArrayLike | None = None,
        view_ids: npt.ArrayLike | None = None,
        blocking_points: npt.ArrayLike | None = None,
        blocking_view_ids: npt.ArrayLike | None = None,
        **truth: Any,
    ) -> Scene:
        """Sort one labelled cloud into a scene.

        Points that are not finite are dropped and counted, whatever their label. A label that is none of leaf, fruit and ignored
        makes its points impermeable whether it is listed in `stem_labels` or not; the unlisted ones are counted as
        `unknown_label`. A label has one meaning; only the default of the fruit gives way to classes that name it.

        Args:
            points: (N, 3) [m], in `frame_id`.
            labels: (N,) integers.
            frame_id: the frame of the points.
            leaf_labels: the permeable labels.
            stem_labels: the known impermeable labels.
            fruit_labels: the labels of fruit; none for no fruit.
            ignored_labels: points with these labels are dropped (the ground, say).
            class_costs: prices of classes by label, as a mapping or as `LABEL: PRICE` texts: these labels are permeable too, and a point
                costs the price of its class [-]; leaves cost 1 unless named here.
            permeability_cost: (N,) >= 0, multiplies the price of permeable points [-]; default 1.
            stake_points: (S, 3) [m], further impermeable points.
            target_pose: (7,) T_base_tool at the grasp.
            leaf_ids: (N,) integers, used at leaf points.
            viewpoints: (V, 3) [m], where the points were seen from.
            view_ids: (N,) integers, the viewpoint of each point, -1 where it is not known; with one viewpoint it is everybody's.
            blocking_points: (B, 3) [m], what was seen and is no obstacle; points with ignored labels are added to them.
            blocking_view_ids: (B,) integers, the viewpoint of each.
            **truth: further fields of `Scene`, taken as they are.

        Raises:
            SceneError: sizes differ, labels are no integers, two classes share one, a price or a cost is negative or not finite.
        """
        points = points_of("points", points)
        n = len(points)
        finite = finite_rows(points)
        labels = whole_labels(labels, finite)
        stakes = points_of("stake_points", () if stake_points is None else stake_points)
        finite_stakes = finite_rows(stakes)
        try:
            fruit_labels = fruit_in_force(leaf_labels, stem_labels, fruit_labels, ignored_labels, class_costs)
            prices = class_prices(class_costs)
        except ParameterError as error:
            raise SceneError(str(error)) from None
        permeable = (*leaf_labels, *prices)
        fruit, stem, ignored, leaf = (any_of(labels, wanted) for wanted in (fruit_labels, stem_labels, ignored_labels, permeable))
        unknown = ~(stem | fruit | ignored | leaf)
        counts = {
            "received": n + len(stakes),
            "non_finite": int((~finite).sum() + (~finite_stakes).sum()),
            "ignored": int((ignored & finite).sum()),
            "unknown_label": int((unknown & finite).sum()),
        }
        leaf, fruit, hard = leaf & finite, fruit & finite, (stem | unknown) & finite
        costs: npt.NDArray[Any] = np.ones(n) if permeability_cost is None else column("permeability_cost", permeability_cost, n)
        ids = None if viewpoints is None else seen_from(viewpoints, view_ids, n)
        blocking = blocking_of(blocking_points, blocking_view_ids, points[ignored & finite], None if ids is None else ids[ignored & finite])
        return cls(
            leaf_points=points[leaf],
            leaf_costs=point_prices(labels[leaf], costs[leaf], prices),
            stem_points=np.concatenate([points[hard], stakes[finite_stakes]]),
            fruit_points=points[fruit],
            frame_id=frame_id,
            target_pose=None if target_pose is None else np.asarray(target_pose),
            counts=counts,
            leaf_ids=None if leaf_ids is None else column("leaf_ids", leaf_ids, n)[leaf],
            viewpoints=None if viewpoints is None else points_of("viewpoints", viewpoints),
            leaf_view_ids=None if ids is None else ids[leaf],
            stem_view_ids=None if ids is None else np.concatenate([ids[hard], np.full(int(finite_stakes.sum()), -1, np.int16)]),
            fruit_view_ids=None if ids is None else ids[fruit],
            blocking_points=blocking[0],
            blocking_view_ids=blocking[1],
            **truth,
        )

    def impermeable_points(self, target_position: npt.ArrayLike | None, radius_m: float) -> Float32:
        """Return every point that the arm must not touch, (P, 3) float32 [m]: stems and all fruit but the target's.

        The target's fruit is the cluster of fruit points that holds the one nearest to the target, if that is within
        `radius_m`. Where fruits touch each other the cluster is longer than a lime; then only its points within
        `FRUIT_RADIUS_M` of the target are let go, so that at most a sliver of the neighbour is.

        Args:
            target_position: (3,) [m], or None to keep all fruit.
            radius_m: how far from the target its fruit may be.
        """
        from lime_planner.scene.voxels import linked  # compiled; reading a scene must not load Numba

        if target_position is None or not len(self.fruit_points):
            return np.concatenate([self.stem_points, self.fruit_points])
        centre = np.asarray(target_position, dtype=np.float64)
        from_target = np.linalg.norm(self.fruit_points - centre, axis=1)
        seed = int(from_target.argmin())
        if from_target[seed] > radius_m:
            return np.concatenate([self.stem_points, self.fruit_points])
        near = np.flatnonzero(from_target < from_target[seed] + 2.0 * FRUIT_EXTENT_M)
        cluster = near[linked(self.fruit_points[near], int(np.searchsorted(near, seed)), FRUIT_LINK_M)]
        if np.ptp(self.fruit_points[cluster], axis=0).max() > FRUIT_EXTENT_M:
            cluster = cluster[from_target[cluster] < min(FRUIT_RADIUS_M, radius_m)]
        kept = np.ones(len(self.fruit_points), dtype=bool)
        kept[cluster] = False
        return np.concatenate([self.stem_points, self.fruit_points[kept]])

    def moved(self, offset_xyz: npt.ArrayLike) -> Scene:
        """Return the scene moved by `offset_xyz` (3,) [m], with its target and its ground truth."""
        return self.placed(1.0, offset_xyz)

    def placed(self, scale: float, offset_xyz: npt.ArrayLike) -> Scene:
        """Return the scene enlarged about the origin by `scale` and then moved by `offset_xyz` (3,) [m].

        Raises:
            SceneError: the scale is not above zero, or a number is not finite.
        """
        arrays = {name: value for name in (*MOVED, *SCALED) if (value := getattr(self, name, None)) is not None}
        return dataclasses.replace(self, **placed(arrays, scale, offset_xyz))

    def transformed(self, T: npt.ArrayLike) -> Scene:
        """Return the scene carried along by a rigid motion T (4, 4) [m], with its target and its ground truth, in the same frame."""
        arrays = {name: value for name in MOVED if (value := getattr(self, name, None)) is not None}
        return dataclasses.replace(self, **carried(arrays, T))


def merged(parts: Sequence[Scene], frame_id: str, *, one_picture: bool = False) -> Scene:
    """Put the scenes of several clouds of one frame together; the counts add up, ground truth and targets are left out.

    Args:
        parts: the scenes.
        frame_id: their frame.
        one_picture: whether parts that were seen from one place are parts of one picture, leaves and stems of one camera say: where one of
            them shows nothing, the camera may have seen the other.
    """
    views = [part.viewpoints for part in parts if part.viewpoints is not None]
    ids: dict[str, Any] = {}
    if views:
        firsts = np.cumsum([0, *(0 if part.viewpoints is None else len(part.viewpoints) for part in parts)])
        for k, name in enumerate(VIEW_IDS):
            own = [view_ids_of(getattr(part, name), part._sizes[k]) for part in parts]
            ids[name] = np.concatenate([np.where(i < 0, i, i + first).astype(np.int16) for i, first in zip(own, firsts[:-1], strict=True)])
        ids["viewpoints"] = np.concatenate(views)
        hiding = [(part.blocking_points, part.blocking_view_ids, first) for part, first in zip(parts, firsts[:-1], strict=True)]
        known = [(points, by + np.int16(first)) for points, by, first in hiding if points is not None and by is not None]
        if known:
            ids["blocking_points"], ids["blocking_view_ids"] = (np.concatenate(columns) for columns in zip(*known, strict=True))
        if one_picture:
            ids |= _from_one_place(ids)
    stood = [part.stood for part in parts if part.stood is not None]
    if stood:
        ids["stood"] = np.unique(np.concatenate(stood), axis=0)
    counts: dict[str, int] = {}
    for part in parts:
        for name, count in part.counts.items():
            counts[name] = counts.get(name, 0) + count
    return Scene(
        leaf_points=np.concatenate([np.empty((0, 3), np.float32), *(part.leaf_points for part in parts)]),
        leaf_costs=np.concatenate([np.empty(0, np.float32), *(part.leaf_costs for part in parts)]),
        stem_points=np.concatenate([np.empty((0, 3), np.float32), *(part.stem_points for part in parts)]),
        fruit_points=np.concatenate([np.empty((0, 3), np.float32), *(part.fruit_points for part in parts)]),
        frame_id=frame_id,
        counts=counts,
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
        stem_displacement_m=max((part.stem_displacement_m for part in parts), default=0.0),
        leaf_displacement_m=max((part.leaf_displacement_m for part in parts), default=0.0),
        **ids,
    )


def _from_one_place(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Give viewpoints that are one place one number."""
    places = columns["viewpoints"]
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    first, number = np.unique((apart < _ONE_PLACE_M).argmax(axis=1), return_inverse=True)
    numbers = np.append(number, -1).astype(np.int16)  # the last one stands for -1
    return {"viewpoints": places[first]} | {name: numbers[ids] for name, ids in columns.items() if name.endswith("view_ids")}
