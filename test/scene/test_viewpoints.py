"""Where points were seen from: through files, recordings' frames, cleaning, merging and moving."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lime_planner.core.errors import SceneError
from lime_planner.scene.clean import clean_scene
from lime_planner.scene.scene import Scene, merged

VIEWS = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]])


def seen() -> Scene:
    points = np.random.default_rng(1).uniform(0.3, 0.6, (60, 3))
    points[5] = np.nan
    ids = np.arange(60) % 3 - 1
    return Scene.from_points(points, np.arange(60) % 4, viewpoints=VIEWS, view_ids=ids, stake_points=np.eye(3))


def test_every_class_keeps_its_viewpoints() -> None:
    scene = seen()
    expected = np.array([k for k in range(60) if k % 4 == 0])
    assert scene.leaf_view_ids is not None and scene.leaf_view_ids.tolist() == (expected % 3 - 1).tolist()
    assert scene.stem_view_ids is not None and scene.stem_view_ids[-3:].tolist() == [-1] * 3, "stakes"
    assert len(scene.stem_view_ids) == len(scene.stem_points)


def test_files_keep_them_and_they_move_along(tmp_path: Path) -> None:
    scene = seen()
    scene.save(tmp_path / "a.npz")
    again = Scene.load(tmp_path / "a.npz", scale=2.0, offset=(1.0, 0.0, 0.0))
    assert again.viewpoints == pytest.approx(VIEWS * 2.0 + [1.0, 0.0, 0.0])
    for name in ("leaf_view_ids", "stem_view_ids", "fruit_view_ids"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scene, name))
    turned = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]])
    assert scene.transformed(turned).viewpoints == pytest.approx(np.array([[0.0, 0.0, 1.5], [0.0, 0.5, 1.5]]))


def test_cleaning_and_merging_keep_each_point_with_its_viewpoint() -> None:
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (400, 3))
    ids = (points[:, 0] > 0).astype(int)
    scene = clean_scene(Scene.from_points(points, np.arange(400) % 3, viewpoints=VIEWS, view_ids=ids), reach_m=1.0, outlier_neighbours=0)
    bare = Scene.from_points(np.eye(3), [0, 1, 2])
    both = merged([bare, scene, scene], "base")
    assert both.viewpoints is not None and len(both.viewpoints) == 4
    for kind in ("leaf", "stem", "fruit"):
        at, by = getattr(scene, f"{kind}_points"), getattr(scene, f"{kind}_view_ids")
        assert len(at) and (by == (at[:, 0] > 0)).all()
        together = getattr(both, f"{kind}_view_ids")
        assert together.tolist() == [-1, *by.tolist(), *(by + 2).tolist()]


def test_the_viewpoint_of_a_pcd(tmp_path: Path) -> None:
    head = "VERSION 0.7\nFIELDS x y z label\nSIZE 4 4 4 1\nTYPE F F F U\nWIDTH 2\nHEIGHT 1\n"
    for line, expected in (("VIEWPOINT 1 2 3 1 0 0 0\n", [[1, 2, 3]]), ("VIEWPOINT 0 0 0 1 0 0 0\n", None), ("", None)):
        (tmp_path / "a.pcd").write_text(f"{head}{line}DATA ascii\n0.5 0 0.4 0\n0.5 0 0.5 1\n")
        scene = Scene.load(tmp_path / "a.pcd")
        assert (None if scene.viewpoints is None else scene.viewpoints.tolist()) == expected
        assert (scene.leaf_view_ids is None) is (expected is None)


@pytest.mark.parametrize(
    ("views", "ids", "words"),
    [
        (VIEWS, None, "view_ids: missing"),
        (VIEWS, [0, 1, 2], "from -1 to 1"),
        (VIEWS, [0, 1], "view_ids: shape"),
        (VIEWS[:, :2], [0, 0, 0], "viewpoints"),
    ],
)
def test_what_does_not_fit_is_refused(views: np.ndarray, ids: list[int] | None, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        Scene.from_points(np.eye(3), [0, 1, 2], viewpoints=views, view_ids=ids)
