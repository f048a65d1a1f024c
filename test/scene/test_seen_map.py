"""What views show of a plant: shadows, gaps, several views, an arm in the picture, sensors in odd places."""

from __future__ import annotations

import time
import tracemalloc
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lime_planner.core.types import Array
from lime_planner.scene.camera import View, look_at, seen_in_views, seen_scene, visible_points
from lime_planner.scene.clean import clean_scene, remove_arm
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import Scene, merged
from lime_planner.scene.views.depth_map import make_depth_map
from lime_planner.scene.views.seen_map import FREE, LEAF, SHADOW_M, STEM, UNSEEN, SeenMap, make_seen_map

FRONT, BEHIND = (0.0, 0.0, 0.3), (1.4, 0.0, 0.3)


def board(x: float, low: tuple[float, float], high: tuple[float, float], step: float = 0.004) -> Array:
    """An upright board at x, from corner (y, z) to corner (y, z)."""
    y, z = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    return np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])


def scene_of(parts: list[tuple[Array, int, int]], viewpoints: npt.ArrayLike, **members: npt.ArrayLike) -> Scene:
    """A scene of parts: points, their label, their viewpoint."""
    points = np.concatenate([part for part, _, _ in parts])
    labels, ids = (np.concatenate([np.full(len(part[0]), part[k]) for part in parts]) for k in (1, 2))
    return Scene.from_points(points, labels, viewpoints=viewpoints, view_ids=ids, **members)


SHIELD = board(0.5, (-0.1, 0.2), (0.1, 0.4))  # leaves in front ...
TWIG = board(0.7, (-0.2, 0.2), (-0.15, 0.4))  # ... a stem beside them, farther away


def at(seen: SeenMap, *places: tuple[float, float, float]) -> list[int]:
    return [int(code) for code in seen.classify(np.array(places))]


def test_what_was_hit_casts_a_shadow_and_a_gap_does_not() -> None:
    seen = make_seen_map(scene_of([(SHIELD, 0, 0), (TWIG, 1, 0)], [FRONT]), 0.01)
    assert at(seen, (0.6, 0.0, 0.3), (0.7, 0.05, 0.3), (0.55, -0.05, 0.3)) == [UNSEEN] * 3
    assert at(seen, (0.45, 0.0, 0.3), (0.6, -0.15, 0.3)) == [FREE] * 2, "in front of the leaves, and in front of the stem"
    assert at(seen, tuple(SHIELD[0]), tuple(TWIG[0])) == [LEAF, STEM]
    assert at(seen, (0.9, 0.0, 0.3), (0.7, 0.5, 0.3)) == [FREE] * 2, "nothing is unseen outside the plant's box"
    assert seen.unseen_volume_m3 == pytest.approx(len(seen.unseen) * 1e-6)


def test_a_shadow_ends() -> None:
    far = board(1.3, (0.3, 0.2), (0.4, 0.4))  # makes the box long
    seen = make_seen_map(scene_of([(SHIELD, 0, 0), (far, 1, 0)], [FRONT]), 0.01)
    assert at(seen, (0.5 + SHADOW_M - 0.02, 0.0, 0.3), (0.5 + SHADOW_M + 0.02, 0.0, 0.3)) == [UNSEEN, FREE]


def test_another_view_shows_what_is_behind_and_one_that_sees_less_hides_nothing() -> None:
    one = [(SHIELD, 0, 0), (TWIG, 1, 0)]
    both = make_seen_map(scene_of([*one, (SHIELD + [0.004, 0.0, 0.0], 0, 1)], [FRONT, BEHIND]), 0.01)
    assert at(both, (0.6, 0.0, 0.3), (0.65, 0.05, 0.3)) == [FREE] * 2
    # The second camera has a leaf before its lens: it casts a shadow on nearly everything, all of which the first one saw.
    lens = board(1.3, (-0.05, 0.25), (0.05, 0.35))
    before, after = (make_seen_map(scene_of(parts, [FRONT, BEHIND]), 0.01) for parts in (one, [*one, (lens, 0, 1)]))
    assert set(map(tuple, before.unseen.round(3).tolist())) & {(0.6, 0.0, 0.3)} == set()
    places = np.array([(0.6, -0.15, 0.3), (0.45, 0.0, 0.3)])
    assert after.classify(places).tolist() == before.classify(places).tolist() == [FREE, FREE]


def test_a_view_through_a_gap_without_background_shows_what_lies_in_it() -> None:
    """The second camera meets nothing behind the gap in a frame: it looked through."""
    frame = [board(1.0, (-0.3, 0.0), (-0.2, 0.6)), board(1.0, (0.2, 0.0), (0.3, 0.6)), board(1.0, (-0.2, 0.0), (0.2, 0.1))]
    parts = [(SHIELD, 0, 0), *((part, 1, 1) for part in frame), (board(1.0, (-0.2, 0.5), (0.2, 0.6)), 1, 1)]
    seen = make_seen_map(scene_of(parts, [FRONT, BEHIND]), 0.01)
    assert at(seen, (0.6, 0.0, 0.3)) == [FREE]
    alone = make_seen_map(scene_of(parts[:1], [FRONT]), 0.01)
    assert at(alone, (0.54, 0.0, 0.3)) == [UNSEEN]


def test_the_arm_in_the_picture_casts_a_shadow() -> None:
    """The arm's own points are taken out of the obstacles; what they hide stays unseen, through cropping and files as well."""
    arm, back = board(0.3, (-0.1, 0.25), (0.1, 0.35)), board(0.6, (-0.3, 0.1), (0.3, 0.5))
    behind = (np.abs(back[:, 1]) > 0.21) | (np.abs(back[:, 2] - 0.3) > 0.105)  # what the arm leaves of the plant
    scene = scene_of([(arm, 1, 0), (back[behind], 0, 0)], [FRONT])
    without = remove_arm(scene, lambda points: np.asarray(points[:, 0] - 0.4), 0.01)
    assert without.counts["on_arm"] == len(arm) and len(without.stem_points) == 0
    assert at(make_seen_map(without, 0.01), (0.58, 0.0, 0.3)) == [UNSEEN]
    cropped = clean_scene(scene, base_position=(0.6, 0.0, 0.3), reach_m=0.31, outlier_neighbours=0)
    assert at(make_seen_map(cropped, 0.01), (0.58, 0.0, 0.3)) == [UNSEEN], "a thing between camera and reach"


def test_what_hides_survives_files_moves_and_merging(tmp_path: Path) -> None:
    ground, leaf = board(0.3, (-0.1, 0.25), (0.1, 0.35)), board(0.6, (-0.2, 0.2), (0.2, 0.4))
    parts = np.concatenate([ground, leaf])
    labels = np.repeat([7, 0], [len(ground), len(leaf)])
    scene = Scene.from_points(parts, labels, ignored_labels=(7,), viewpoints=[FRONT])
    assert scene.blocking_points is not None and len(scene.blocking_points) == len(ground)
    scene.save(tmp_path / "a.npz")
    again = Scene.load(tmp_path / "a.npz", offset=(0.0, 0.0, 1.0))
    assert again.blocking_points == pytest.approx(scene.blocking_points + np.float32([0.0, 0.0, 1.0]))
    both = merged([Scene.from_points(leaf, np.zeros(len(leaf)), viewpoints=[BEHIND]), scene], scene.frame_id)
    assert both.blocking_view_ids is not None and (both.blocking_view_ids == 1).all()
    front, back = both.hits_by_view()[1], both.hits_by_view()[0]
    assert len(front) == len(parts) and len(back) == len(leaf)


def test_without_a_known_origin_everything_counts_as_seen() -> None:
    bare = Scene.from_points(SHIELD, np.zeros(len(SHIELD)))
    assert make_seen_map(bare, 0.01).views == () and not len(make_seen_map(bare, 0.01).unseen)
    unknown = scene_of([(SHIELD, 0, -1), (TWIG, 1, 0)], [FRONT])
    seen = make_seen_map(unknown, 0.01)
    assert len(seen.views) == 1 and at(seen, (0.6, 0.0, 0.3), (0.73, -0.17, 0.3)) == [FREE, UNSEEN]


def test_an_origin_inside_the_plant() -> None:
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(60_000, 3))
    sphere *= 0.2 / np.linalg.norm(sphere, axis=1, keepdims=True)
    centre = np.array([0.5, 0.0, 0.5])
    seen = make_seen_map(scene_of([(sphere + centre, 0, 0), (centre[None], 0, 0)], [centre]), 0.01)
    inside, outside = centre + 0.9 * sphere[:50], centre + 1.15 * sphere[:50]
    assert (seen.classify(inside) == FREE).all() and (seen.classify(outside) == UNSEEN).all()


def test_thinned_clouds_do_not_let_rays_through_their_gaps() -> None:
    scene = scene_of([(board(0.5, (-0.3, 0.0), (0.3, 0.6), 0.001), 0, 0)], [FRONT])
    thinned = clean_scene(scene, reach_m=2.0, max_leaf_points=8000)
    assert thinned.leaf_displacement_m > 0.003
    assert at(make_seen_map(thinned, 0.005), *((0.53, y, 0.3) for y in np.arange(-0.2, 0.2, 0.01))) == [UNSEEN] * 40


def test_hidden_stems_lie_in_unseen_space_and_seen_ones_do_not() -> None:
    """On a plant: of the stem points in the picture that one camera does not see, nine in ten lie in unseen voxels."""
    plant = generate_plant(np.random.default_rng(0), PlantOptions(density="dense"))
    eye, aim = (0.0, 0.0, 0.6), plant.stem_points.mean(axis=0)
    part = seen_scene(plant, [eye], target=aim)
    seen = make_seen_map(part, 0.01)
    local = (plant.stem_points - np.array(eye)) @ look_at(eye, aim)[:3, :3]
    pictured = (np.abs(local[:, :2] / local[:, 2:]) < [0.6, 0.45]).all(axis=1)
    visible, _ = visible_points(plant.stem_points, look_at(eye, aim), blockers=np.concatenate([plant.leaf_points, plant.fruit_points]))
    codes = seen.classify(plant.stem_points)
    assert (codes[pictured & ~visible] != FREE).mean() > 0.85
    assert (codes[visible & pictured] == UNSEEN).mean() < 0.02


def test_a_camera_calibrated_5_mm_and_1_degree_wrong() -> None:
    """Its stems stand in the wrong place, which no map can know; what counts as unseen hardly changes."""
    plant = generate_plant(np.random.default_rng(1), PlantOptions(density="dense"))
    aim = plant.stem_points.mean(axis=0)
    views = [look_at(place, aim) for place in ((-0.4, 0.2, 0.8), (0.3, -1.0, 0.7), (0.3, 1.0, 0.7))]
    parts = [seen_in_views(plant, [View(view)]) for view in views]
    error = np.eye(4)
    error[:3, :3] = Rotation.from_rotvec([np.radians(1.0), 0.0, 0.0]).as_matrix()
    error[0, 3] = 0.005
    wrong = parts[1].transformed(views[1] @ error @ np.linalg.inv(views[1]))
    right, shifted = (make_seen_map(merged([parts[0], second, parts[2]], "base"), 0.01) for second in (parts[1], wrong))
    known = np.any([cKDTree(part.stem_points).query(plant.stem_points)[0] < 1e-4 for part in parts], axis=0)
    hidden = plant.stem_points[~known]
    shares = [float((seen.classify(hidden) == UNSEEN).mean()) for seen in (right, shifted)]
    assert len(hidden) > 500 and shares[0] > 0.4 and abs(shares[1] - shares[0]) < 0.1
    assert shifted.unseen_volume_m3 == pytest.approx(right.unseen_volume_m3, rel=0.1)


def test_depth_maps_take_odd_clouds() -> None:
    for hits in (np.zeros((0, 3)), np.full((5, 3), np.nan), np.zeros((5, 3)), np.full((5, 3), 1e30)):
        assert np.isfinite(make_depth_map(hits, np.zeros(3), 0.01).depths).any()


def drawn_again(scene: Scene, count: int) -> Scene:
    """A scene's points until there are so many, a millimetre apart from each other."""
    rng = np.random.default_rng(0)
    points, labels, _ = scene.labelled_points()
    ids = np.concatenate([scene.leaf_view_ids, scene.stem_view_ids, scene.fruit_view_ids])  # type: ignore[list-item]
    pick = rng.integers(0, len(points), count)
    jitter = rng.normal(0.0, 0.001, (count, 3))
    return Scene.from_points(points[pick] + jitter, labels[pick], viewpoints=scene.viewpoints, view_ids=ids[pick])


def most_held(scene: Scene) -> int:
    """Memory that making a map takes at its peak [bytes], beside the scene itself."""
    make_seen_map(scene, 0.005)
    tracemalloc.start()
    try:
        make_seen_map(scene, 0.005)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_grows_with_the_plant_and_not_with_its_box() -> None:
    """Five million points: little more than one copy of them (60 MB); two plants eight metres apart: twice what one takes."""
    plant = generate_plant(np.random.default_rng(0), PlantOptions(density="dense"))
    one = drawn_again(seen_scene(plant, [(0.0, 0.0, 0.6)]), 100_000)
    assert most_held(one) < 25e6
    assert most_held(drawn_again(one, 5_000_000)) < 100e6
    stems, aside = one.stem_points, np.array([8.0, 0.0, 0.0], np.float32)
    eye = np.array([0.0, 0.0, 0.6])
    near = scene_of([(stems, 1, 0)], [eye])
    far = scene_of([(stems, 1, 0), (stems + aside, 1, 1)], [eye, eye + aside])
    assert most_held(far) < 2.2 * most_held(near)


@pytest.mark.timed
def test_a_map_is_made_in_time() -> None:
    """100,000 points at 5 mm within 60 ms, five views within 0.3 s; processor time."""
    plant = generate_plant(np.random.default_rng(0), PlantOptions(density="dense"))
    eyes = [(0.0, 0.0, 0.6), (0.2, -0.7, 0.6), (0.2, 0.7, 0.6), (0.1, 0.0, 1.2), (0.0, -0.4, 0.3)]

    for views, count, limit_s in ((1, 100_000, 0.06), (5, 100_000, 0.3)):
        scene = drawn_again(seen_scene(plant, eyes[:views]), count)
        make_seen_map(scene, 0.005)
        taken = []
        for _ in range(3):
            began = time.process_time()
            make_seen_map(scene, 0.005)
            taken.append(time.process_time() - began)
        assert min(taken) < limit_s, (views, count, taken)
