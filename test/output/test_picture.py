"""Pictures: what hides what, and files that are whole or not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lime_planner.core.errors import ParameterError
from lime_planner.output import picture
from lime_planner.output.render import View, cloud_layer, compose, halved, mesh_layer
from lime_planner.robot.model import Robot, home, load_robot
from lime_planner.scene.camera import seen_scene
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import Scene

X, Y, Z = np.eye(3)
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def square(height_m: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    """A square in the plane z = height_m around the origin."""
    corners = np.array([[-half, -half, height_m], [half, -half, height_m], [half, half, height_m], [-half, half, height_m]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


@pytest.fixture(scope="module")
def view() -> View:
    return View(X, Y, (-0.5, 0.5, -0.4, 0.4), 0.01)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("kinova_j2n6s300")


@pytest.fixture(scope="module")
def plant() -> Scene:
    return generate_plant(np.random.default_rng(2), PlantOptions(density="sparse", n_limes=2))


def test_view_looks_against_its_towards_axis(view: View) -> None:
    assert view.towards == pytest.approx(Z)
    assert view.shape == (80, 100)
    assert view.project([[1.0, 2.0, 3.0]])[0] == pytest.approx([1.0, 2.0, 3.0])
    side = View(X, Z, (0.0, 1.0, 0.0, 1.0), 0.1)
    assert side.towards == pytest.approx(-Y)


def test_mesh_covers_the_pixels_it_should(view: View) -> None:
    layer = mesh_layer(view, *square(0.2, 0.1), RED)
    seen = np.isfinite(layer.height_m)
    assert seen.sum() == 20 * 20
    assert layer.height_m[seen] == pytest.approx(0.2, abs=1e-5)
    assert np.argwhere(seen).min(axis=0) == pytest.approx([30, 40])
    assert not np.isfinite(mesh_layer(view, np.zeros((0, 3)), np.zeros((0, 3), dtype=int), RED).height_m).any()


def test_mesh_beside_the_view_is_not_seen(view: View) -> None:
    corners, faces = square(0.0, 0.1)
    assert not np.isfinite(mesh_layer(view, corners + [5.0, 0.0, 0.0], faces, RED).height_m).any()
    half = np.isfinite(mesh_layer(view, corners + [0.5, 0.4, 0.0], faces, RED).height_m)
    assert half.sum() == 10 * 10


def test_nearer_points_hide_farther_ones(view: View) -> None:
    layer = cloud_layer(view, [[0.005, 0.005, 0.1], [0.005, 0.005, 0.3], [0.005, 0.005, 0.2]], BLUE, (0.004, 0.012))
    seen = np.isfinite(layer.height_m)
    assert seen[39, 50]
    assert layer.height_m[seen] == pytest.approx(0.3, abs=1e-5)
    assert not np.isfinite(cloud_layer(view, np.zeros((0, 3)), BLUE, (0.004, 0.012)).height_m).any()


def test_solids_shine_through_the_plant_only_from_behind(view: View) -> None:
    leaf = mesh_layer(view, *square(0.5, 0.1), (0.0, 1.0, 0.0))
    for height, visible in ((0.3, True), (0.7, True), (None, False)):
        solid = [] if height is None else [(mesh_layer(view, *square(height, 0.05), RED), 1.0)]
        image = compose([leaf], solid, veil=0.4)
        red, green, _ = image[40, 50]
        assert bool(red > 0.3) is visible
        assert bool(green > 0.2) is (height != 0.7)
    assert image[0, 0] == pytest.approx([1.0, 1.0, 1.0])
    assert halved(image).shape == (40, 50, 3)


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_picture_is_written_whole(tmp_path: Path, robot: Robot, plant: Scene, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "_PANEL_PIXELS", 200)
    q = home(robot)
    path = tmp_path / "new" / f"plan{suffix}"
    line = np.linspace(robot.forward(q)[:3, 3], plant.target_pose[:3], 20)
    options = {"q_start": q, "q_goal": q + 0.3, "tool_path": line, "tool_leaf": np.linspace(0, 1, 20), "target_pose": plant.target_pose}
    assert picture.draw_picture(path, plant, robot, title="a title", **options) == path
    assert path.read_bytes()[:4] in (b"\x89PNG", b"<?xm")
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_picture_without_plan_and_with_an_empty_scene(tmp_path: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "_PANEL_PIXELS", 100)
    empty = Scene.from_points(np.zeros((0, 3)), np.zeros(0, dtype=int))
    assert picture.draw_picture(tmp_path / "a.png", empty, robot, q_start=home(robot)).is_file()


def test_plant_and_path_are_seen_in_their_colours(tmp_path: Path, robot: Robot, plant: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    monkeypatch.setattr(picture, "_PANEL_PIXELS", 300)
    q = home(robot)
    line = np.linspace(robot.forward(q)[:3, 3], plant.target_pose[:3], 20)
    picture.draw_picture(tmp_path / "a.png", plant, robot, q_start=q, tool_path=line, target_pose=plant.target_pose)
    pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).reshape(-1, 3).astype(int)
    red, green, blue = pixels.T
    assert ((green > red + 40) & (green > blue + 20)).sum() > 2000, "leaves"
    assert ((red > green + 20) & (green > blue + 10) & (red < 180)).sum() > 500, "stems"
    assert (np.abs(pixels - np.round(255 * np.array(picture.FREE_PATH))).max(axis=1) <= 2).sum() > 200, "the path without leaf contact"
    assert ((np.abs(red - green) < 15) & (np.abs(blue - green) < 25) & (red > 60) & (red < 230)).sum() > 2000, "the arm"


def test_what_no_camera_has_seen_is_hatched(tmp_path: Path, robot: Robot, plant: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "_PANEL_PIXELS", 200)
    for name, scene, hatched in (("whole", plant, False), ("seen", seen_scene(plant, [(-0.4, 0.2, 0.8)]), True)):
        picture.draw_picture(tmp_path / f"{name}.svg", scene, robot, q_start=home(robot))
        text = (tmp_path / f"{name}.svg").read_text()
        assert ("unseen, 10 cm deep or more" in text) == hatched
        assert (text.count("<pattern") > 1) == hatched, "in the legend and in the picture"


def test_suffix_and_folder_are_checked(tmp_path: Path, robot: Robot, plant: Scene) -> None:
    with pytest.raises(ParameterError, match=r"\.png, \.svg, \.pdf, not in '\.jpeg'"):
        picture.draw_picture(tmp_path / "a.jpeg", plant, robot, q_start=home(robot))
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterError, match="cannot be written"):
        picture.draw_picture(tmp_path / "file" / "a.png", plant, robot, q_start=home(robot))
