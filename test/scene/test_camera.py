"""Simulated depth cameras: what hides what, where noise goes, and `lime-planner scene see`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lime_planner.cli.main import main
from lime_planner.core.errors import ProblemError
from lime_planner.scene.camera import Camera, look_at, seen_scene, visible_points
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import Scene


def sheet(x: float, half: float, spacing: float = 0.004) -> np.ndarray:
    """A square of points across the x axis."""
    along = np.arange(-half, half + 1e-9, spacing)
    y, z = np.meshgrid(along, along)
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)


def test_a_near_sheet_hides_its_shadow_and_nothing_else() -> None:
    """By similar triangles: from the origin, a sheet at 0.5 m of half width 0.1 m hides 0.2 m at 1 m."""
    near, far = sheet(0.5, 0.1), sheet(1.0, 0.4)
    seen, places = visible_points(np.concatenate([near, far]), look_at((0, 0, 0), (1, 0, 0)))
    assert seen[: len(near)].all()
    widest = np.abs(far[:, 1:]).max(axis=1)
    behind = seen[len(near) :]
    assert not behind[widest < 0.19].any()
    assert behind[(widest > 0.22) & (widest < 0.39)].all()
    np.testing.assert_allclose(places, np.concatenate([near, far]), atol=1e-6)


def test_the_picture_ends_at_its_edges_and_its_range() -> None:
    camera = Camera(field_of_view_rad=0.8, nearest_m=0.3, farthest_m=0.9)
    across = sheet(0.6, 0.6, 0.01)
    seen, _ = visible_points(across, look_at((0, 0, 0), (1, 0, 0)), camera=camera)
    sideways = np.abs(np.arctan2(across[:, 1], across[:, 0]))
    assert not seen[sideways > 0.42].any()
    assert seen[(sideways < 0.38) & (np.abs(across[:, 2]) < 0.1)].all()
    for x in (0.2, 1.0):
        assert not visible_points(sheet(x, 0.05), look_at((0, 0, 0), (1, 0, 0)), camera=camera)[0].any()
    assert not visible_points(sheet(-0.6, 0.05), look_at((0, 0, 0), (1, 0, 0)), camera=camera)[0].any()


def test_noise_goes_along_the_ray_and_grows_with_the_square_of_the_distance(rng: np.random.Generator) -> None:
    spread = []
    for x in (0.5, 1.0):
        points = sheet(x, 0.2)
        seen, places = visible_points(points, look_at((0, 0, 0), (1, 0, 0)), camera=Camera(noise_m=0.004), rng=rng)
        assert seen.all()
        across = np.linalg.norm(np.cross(places, points), axis=1) / np.linalg.norm(points, axis=1)
        assert across.max() < 1e-5
        spread.append((places - points)[:, 0].std())
    assert spread[0] == pytest.approx(0.001, rel=0.1)
    assert spread[1] == pytest.approx(0.004, rel=0.1)


def test_drop_outs_lie_at_depth_edges(rng: np.random.Generator) -> None:
    near, far = sheet(0.5, 0.1), sheet(1.0, 0.4)
    points = np.concatenate([near, far])
    whole, _ = visible_points(points, look_at((0, 0, 0), (1, 0, 0)))
    kept, _ = visible_points(points, look_at((0, 0, 0), (1, 0, 0)), camera=Camera(edge_drop_out=1.0), rng=rng)
    lost = whole & ~kept
    assert 0 < lost.sum() < 0.2 * whole.sum()
    angle = np.abs(points[:, 1:] / points[:, :1]).max(axis=1)
    assert np.all((np.abs(angle[lost] - 0.2) < 0.03) | (angle[lost] > 0.39))


def test_views_are_fused_with_the_viewpoint_of_each_point() -> None:
    scene = Scene.from_points(np.concatenate([sheet(0.5, 0.1), sheet(0.7, 0.1)]), np.repeat([0, 1], len(sheet(0.5, 0.1))))
    front, both = seen_scene(scene, [(0, 0, 0)]), seen_scene(scene, [(0, 0, 0), (1.2, 0, 0)])
    assert len(front.leaf_points) == len(scene.leaf_points)
    assert len(front.stem_points) == 0
    assert front.counts["not_seen"] == len(scene.stem_points)
    assert len(both.stem_points) == len(scene.stem_points)
    assert both.leaf_view_ids is not None and (both.leaf_view_ids == 0).all()
    assert both.stem_view_ids is not None and (both.stem_view_ids == 1).all()
    np.testing.assert_allclose(both.viewpoints, [[0, 0, 0], [1.2, 0, 0]], atol=1e-6)


def test_a_camera_where_it_looks_is_refused() -> None:
    scene = Scene.from_points(sheet(0.5, 0.1), np.ones(len(sheet(0.5, 0.1)), dtype=int))
    with pytest.raises(ProblemError, match="two places"):
        seen_scene(scene, [(0.5, 0.0, 0.0)], target=(0.5, 0.0, 0.0))
    with pytest.raises(ProblemError, match="no viewpoint"):
        seen_scene(scene, [])


def test_the_command_writes_a_partial_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, seen = tmp_path / "plant.npz", tmp_path / "seen.npz"
    assert main(["scene", "plant", "--seed", "3", "--out", str(whole)]) == 0
    capsys.readouterr()
    assert main(["scene", "see", str(whole), "--from", "-0.1", "0", "0.6", "--out", str(seen), "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    stems, plant, partial = report["points"]["stem"], Scene.load(whole), Scene.load(seen)
    assert stems == {"seen": len(partial.stem_points), "of": len(plant.stem_points)}
    assert 0.15 < stems["seen"] / stems["of"] < 0.6
    np.testing.assert_allclose(partial.viewpoints, [[-0.1, 0.0, 0.6]], atol=1e-6)
    known = {tuple(point) for point in plant.stem_points}
    assert all(tuple(point) in known for point in partial.stem_points)


@pytest.mark.parametrize(
    ("option", "words"),
    [(("--noise", "-1"), "--noise is -1"), (("--field-of-view", "200"), "between 1 and 170"), (("--from", "nan", "0", "0"), "no place")],
)
def test_wrong_options_are_one_sentence(option: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["scene", "see", str(tmp_path / "no.npz"), "--from", "0", "0", "1", "--out", str(tmp_path / "out.npz"), *option]
    assert main(arguments) != 0
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


@pytest.mark.parametrize("seed", [0, 5, 1000])
def test_in_a_thicket_no_view_shows_more_than_a_quarter_of_the_stems(seed: int) -> None:
    """From the front, from beside it, from behind and from above; of a medium plant the same cameras show more."""

    def shares(density: str) -> list[float]:
        plant = generate_plant(seed, PlantOptions(density=density))
        middle = np.concatenate([plant.leaf_points, plant.stem_points]).mean(axis=0)
        eyes = [(0.0, 0.0, 0.6), (-0.4, 0.2, 0.8), (0.3, -1.0, 0.7), (0.3, 1.0, 0.7), (1.4, 0.0, 0.5), (0.5, 0.0, 1.7)]
        return [len(seen_scene(plant, [eye], target=middle).stem_points) / len(plant.stem_points) for eye in eyes]

    thicket = shares("thicket")
    assert max(thicket) < 0.25, thicket
    assert np.mean(shares("medium")) > 1.5 * np.mean(thicket) > 0.05
