"""What several pictures show together: what later rays passed through is forgotten, what they do not reach stays."""

from __future__ import annotations

import numpy as np

from lime_planner.scene.camera import Camera, View, look_at, seen_in_views
from lime_planner.scene.from_clouds import one_picture
from lime_planner.scene.scene import Scene, merged
from lime_planner.scene.views.fused import PASSED_M, Picture, Rays, add_picture, fused

FRONT, SIDE = np.array([0.0, 0.0, 0.5]), np.array([0.55, -0.6, 0.5])
LENS = Camera(width=320, height=240)


def patch(x: float, y: float, half_m: float = 0.03) -> np.ndarray:
    """A square of points across the x axis, 3 mm apart."""
    steps = np.arange(-half_m, half_m, 0.003)
    return np.array([(x, y + a, 0.5 + b) for a in steps for b in steps])


WALL = patch(0.9, 0.0, 0.25)  # stems behind everything


def scene(*leaves: np.ndarray, stems: np.ndarray = WALL) -> Scene:
    points = np.concatenate([*leaves, stems])
    return Scene.from_points(points, np.repeat([0, 1], [len(points) - len(stems), len(stems)]))


def seen(whole: Scene, origin: np.ndarray, at_s: float, blockers: np.ndarray | None = None) -> Picture:
    view = View(look_at(origin, [0.6, 0.0, 0.5]), None if blockers is None else blockers.astype(np.float32))
    return Picture(seen_in_views(whole, [view], camera=LENS), at_s)


def near(points: np.ndarray, place: tuple[float, float]) -> int:
    return int((np.linalg.norm(points[:, :2] - place, axis=1) < 0.05).sum())


def test_a_leaf_that_moved_is_forgotten_where_a_later_ray_passes() -> None:
    pictures = add_picture([], seen(scene(patch(0.5, 0.0)), FRONT, 1.0))
    assert near(pictures[0].scene.leaf_points, (0.5, 0.0)) == len(patch(0.5, 0.0))
    pictures = add_picture(pictures, seen(scene(patch(0.5, 0.12)), FRONT, 2.0))
    both = fused(pictures, "base")
    assert near(both.leaf_points, (0.5, 0.0)) == 0
    assert near(both.leaf_points, (0.5, 0.12)) == len(patch(0.5, 0.12))
    # The old rays ended at the leaf: what was behind it is not taken for seen by them.
    assert both.blocking_points is not None and near(both.blocking_points, (0.5, 0.0)) == len(patch(0.5, 0.0))


def test_the_arm_in_a_later_picture_hides_and_forgets_nothing() -> None:
    before = seen(scene(patch(0.5, 0.0)), FRONT, 1.0)
    arm = patch(0.3, 0.0, 0.1)
    later = seen(scene(patch(0.5, 0.0)), FRONT, 2.0, blockers=arm)
    assert near(later.scene.leaf_points, (0.5, 0.0)) == 0  # in the arm's shadow
    both = fused(add_picture([before], later), "base")
    assert near(both.leaf_points, (0.5, 0.0)) == len(patch(0.5, 0.0))


def test_a_camera_that_sees_less_takes_nothing_away() -> None:
    whole = scene(patch(0.5, 0.0), patch(0.6, 0.1))
    first = seen(whole, FRONT, 1.0)
    few = Scene.from_points(patch(0.5, 0.0)[::7], np.zeros(len(patch(0.5, 0.0)[::7])), viewpoints=[SIDE])  # no return from the rest
    pictures = add_picture([first], Picture(few, 2.0))
    assert len(pictures[0].scene.leaf_points) == len(first.scene.leaf_points)
    assert len(pictures[0].scene.stem_points) == len(first.scene.stem_points)


def test_a_picture_that_comes_late_is_judged_by_the_later_ones() -> None:
    late, newer = seen(scene(patch(0.5, 0.0)), FRONT, 1.0), seen(scene(), FRONT, 2.0)
    pictures = add_picture([newer], late)
    assert [picture.taken_s for picture in pictures] == [1.0, 2.0]
    assert near(pictures[0].scene.leaf_points, (0.5, 0.0)) == 0


def turned(whole: Scene, angle_deg: float, aside_m: float) -> Scene:
    """What a camera at the origin of x and y, calibrated so wrong, takes a scene for."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    T = np.eye(4)
    T[:2, :2], T[1, 3] = [[c, -s], [s, c]], aside_m
    return whole.transformed(T)


def test_a_calibration_5_mm_and_1_degree_wrong_forgets_no_stem() -> None:
    twig = np.array([(0.6, 0.0, z) for z in np.arange(0.4, 0.6, 0.002)])
    whole = scene(stems=np.concatenate([twig, WALL]))
    first = seen(whole, FRONT, 1.0)
    known = near(first.scene.stem_points, (0.6, 0.0))
    kept = Rays(seen(turned(whole, 1.0, 0.005), FRONT, 2.0)).left_of(first).scene.stem_points
    assert near(kept, (0.6, 0.0)) == known == len(twig)
    # A stem that is gone is forgotten all the same, and so is one that stands 5 cm beside where it was.
    gone = Rays(seen(turned(whole, 5.0, 0.0), FRONT, 2.0)).left_of(first).scene.stem_points
    assert near(gone, (0.6, 0.0)) == 0


def test_points_as_deep_as_the_newer_ones_stay() -> None:
    first = seen(scene(patch(0.5, 0.0)), FRONT, 1.0)
    shifted = seen(scene(patch(0.5 + 0.5 * PASSED_M, 0.0)), FRONT, 2.0)
    assert len(add_picture([first], shifted)[0].scene.leaf_points) == len(first.scene.leaf_points)


def test_leaf_and_stem_cloud_of_one_camera_are_one_view() -> None:
    leaf = Scene.from_points(patch(0.5, 0.0), np.zeros(len(patch(0.5, 0.0))), viewpoints=[FRONT])
    stem = Scene.from_points(WALL, np.ones(len(WALL)), viewpoints=[FRONT + 0.001])
    other = Scene.from_points(WALL, np.ones(len(WALL)), viewpoints=[SIDE])
    one = merged([leaf, stem, other], "base", one_picture=True)
    assert one.viewpoints is not None and len(one.viewpoints) == 2
    assert sorted(len(hits) for hits in one.hits_by_view()) == sorted([len(leaf.leaf_points) + len(WALL), len(WALL)])
    assert len(merged([leaf, stem, other], "base").viewpoints) == 3  # type: ignore[arg-type]


def test_clouds_of_cameras_that_are_known_keep_what_each_of_them_saw() -> None:
    """Only where who saw what was worked out is it worked out again with the other cloud."""
    behind = patch(0.9, 0.0)  # the leaf is before it, for the camera in front
    leaf = Scene.from_points(patch(0.5, 0.0, 0.1), np.zeros(len(patch(0.5, 0.0, 0.1))), viewpoints=[SIDE])
    stem = Scene.from_points(behind, np.ones(len(behind)), viewpoints=[FRONT])
    known = one_picture([leaf, stem], "base")
    assert known.stem_view_ids is not None and (known.stem_view_ids >= 0).all()
    shared = Scene.from_points(behind, np.ones(len(behind)), viewpoints=[FRONT, SIDE], view_ids=np.zeros(len(behind), np.int16))
    told = one_picture([leaf, shared], "base")
    assert told.stem_view_ids is not None and (told.stem_view_ids == -1).all()
