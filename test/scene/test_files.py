"""Scene files: what is written is read back, and what cannot be used is refused with a sentence that names it."""

from __future__ import annotations

import numpy as np
import pytest

from lime_planner.core.errors import SceneError
from lime_planner.scene.plants.generator import PlantOptions, generate_plant
from lime_planner.scene.scene import Scene

TRUTH = ("leaf_ids", "leaf_triangles", "leaf_triangle_ids", "fruit_centres", "fruit_radii")
IDENTITY = [0.5, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]
PLY = "ply\nformat ascii 1.0\nelement vertex {n}\n{properties}end_header\n{body}"
PCD = (
    "VERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {type}\nCOUNT {count}\n"
    "WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {data}\n"
)
XYZ = ("float x", "float y", "float z")
RGB = ("uchar red", "uchar green", "uchar blue")
CAMERA = "element camera 1\nproperty float focal\nelement vertex"


def ply(properties=("float x", "float y", "float z", "int label"), body="1 2 3 0\n4 5 6 1\n", n=2):
    return PLY.format(n=n, properties="".join(f"property {p}\n" for p in properties), body=body)


def pcd(fields="x y z label", size="4 4 4 4", kind="F F F I", count="1 1 1 1", n=2, data="ascii", body="1 2 3 0\n4 5 6 1\n"):
    return PCD.format(fields=fields, size=size, type=kind, count=count, n=n, data=data) + body


def npz(folder, **members):
    path = folder / "scene.npz"
    np.savez(path, **members)
    return path


@pytest.fixture(scope="module")
def plant():
    return generate_plant(np.random.default_rng(5), PlantOptions(density="sparse"))


def test_npz_keeps_a_plant_bit_for_bit(tmp_path, plant):
    plant.save(tmp_path / "new" / "plant.npz")
    again = Scene.load(tmp_path / "new" / "plant.npz")
    for name in ("leaf_points", "leaf_costs", "stem_points", "fruit_points", "target_pose", *TRUTH):
        np.testing.assert_array_equal(getattr(again, name), getattr(plant, name))
    assert again.frame_id == "base"
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["plant.npz"]


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_ply_and_pcd_keep_points_labels_and_costs(tmp_path, plant, suffix):
    costs = np.linspace(0.0, 3.0, len(plant.leaf_points), dtype=np.float32)
    scene = Scene(plant.leaf_points, costs, plant.stem_points, plant.fruit_points)
    scene.save(tmp_path / f"plant{suffix}")
    again = Scene.load(tmp_path / f"plant{suffix}", frame_id="world")
    for name in ("leaf_points", "leaf_costs", "stem_points", "fruit_points"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scene, name))
    assert again.frame_id == "world"


def test_optional_members_of_an_npz(tmp_path):
    path = npz(
        tmp_path,
        points=np.eye(3),
        labels=[0, 0, 2],
        permeability_cost=[2.0, 0.0, 1.0],
        target_pose=IDENTITY,
        frame_id="field",
        stake_points=[[9.0, 9.0, 9.0]],
    )
    scene = Scene.load(path, scale=2.0, offset=(1.0, 0.0, 0.0))
    assert scene.frame_id == "field"
    assert scene.leaf_costs.tolist() == [2.0, 0.0]
    assert scene.stem_points.tolist() == [[19.0, 18.0, 18.0]]
    assert scene.fruit_points.tolist() == [[1.0, 0.0, 2.0]]
    np.testing.assert_allclose(scene.target_pose[:3], [2.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.ply", ply()),
        ("b.ply", ply(["double x", "double y", "double z", "uchar label"])),
        ("c.ply", ply([*XYZ, "float scalar_Label"])),
        ("d.ply", ply([*XYZ, *RGB, "int label"], "1 2 3 9 9 9 0\n4 5 6 9 9 9 1\n")),
        ("e.ply", ply().replace("end_header", "element face 1\nproperty list uchar int vertex_indices\nend_header") + "3 0 1 1\n"),
        ("f.ply", ply().replace("element vertex", CAMERA).replace("end_header\n", "end_header\n7.5\n")),
        ("g.ply", ply().replace("\n", "\r\n")),
        ("a.pcd", pcd()),
        ("b.pcd", pcd("x y z rgb label", "4 4 4 4 1", "F F F U U", "1 1 1 1 1", body="1 2 3 0 0\n4 5 6 0 1\n")),
        ("c.pcd", pcd("x y z _ label", "4 4 4 1 4", "F F F U U", "1 1 1 4 1", body="1 2 3 0 0 0 0 0\n4 5 6 0 0 0 0 1\n")),
        ("d.pcd", pcd(kind="F F F F").replace("COUNT 1 1 1 1\n", "# made by hand\nCOUNT 1 1 1 1\n")),
    ],
)
def test_variants_of_ply_and_pcd(tmp_path, name, text):
    (tmp_path / name).write_bytes(text.encode())
    scene = Scene.load(tmp_path / name)
    assert scene.leaf_points.tolist() == [[1, 2, 3]]
    assert scene.stem_points.tolist() == [[4, 5, 6]]


def test_another_label_field_and_points_that_are_not_finite(tmp_path):
    (tmp_path / "a.ply").write_text(ply([*XYZ, "int kind"], "1 2 3 5\nnan 5 6 5\n7 8 9 6\n", 3))
    scene = Scene.load(tmp_path / "a.ply", label_field="kind", leaf_labels=(5,), stem_labels=(6,))
    assert len(scene.leaf_points) == len(scene.stem_points) == scene.counts["non_finite"] == 1


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("a.txt", "hello", "ends in one of"),
        ("a.npz", "hello", "not a readable"),
        ("b.npz", "", "not a readable"),
        ("a.ply", "hello\n", "no PLY file"),
        ("b.ply", "", "no PLY file"),
        ("c.ply", ply(XYZ, "1 2 3\n4 5 6\n"), "no field 'label'; it has x, y, z"),
        ("d.ply", ply(["float y", "float z", "int label"], "1 2 0\n4 5 1\n"), "no field 'x'"),
        ("e.ply", ply(n=3), "truncated|its header says 3"),
        ("f.ply", ply(n=10**12), "truncated"),
        ("g.ply", ply(n=-2), "-2 points"),
        ("h.ply", ply(n=0, body=""), "holds no points"),
        ("i.ply", ply(body="1 2 3 0\n4 five 6 1\n"), "'five' is not a number"),
        ("j.ply", ply(body="1 2 3 0\n4 5 6\n         "), "truncated: 7 numbers, its header needs 8"),
        ("k.ply", ply([*XYZ, "quad label"]), "header cannot be read"),
        ("l.ply", ply(body="nan 2 3 0\nnan 5 6 1\n"), "none of its points can be used .*2 non_finite"),
        ("m.ply", ply([*XYZ, "float label"], "1 2 3 0.5\n4 5 6 1\n"), "whole numbers"),
        ("a.pcd", "hello\n", "no PCD file"),
        ("b.pcd", pcd("x y z", "4 4 4", "F F F", "1 1 1", body="1 2 3\n4 5 6\n"), "no field 'label'"),
        ("c.pcd", pcd(count="1 1 1"), "differ in length"),
        ("d.pcd", pcd(data="binary"), "truncated: 16 bytes of points, its header needs 32"),
        ("e.pcd", pcd(data="binary", n=10**12), "truncated"),
        ("f.pcd", pcd(data="zipped"), "none of ascii"),
        ("g.pcd", pcd(data="binary_compressed", body=""), "truncated: the sizes"),
        ("h.pcd", pcd(n=0, body=""), "holds no points"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_sentence(tmp_path, name, content, named):
    (tmp_path / name).write_text(content)
    with pytest.raises(SceneError, match=named) as caught:
        Scene.load(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("members", "named"),
    [
        ({"labels": [0]}, "no array 'points'; it has labels"),
        ({"points": np.eye(3)}, "no array 'labels'"),
        ({"points": np.eye(3), "labels": [0, 1]}, r"labels: shape \(2,\), expected \(3,\)"),
        ({"points": np.eye(3)[:, :2], "labels": [0, 1, 1]}, "points: shape"),
        ({"points": np.zeros((0, 3)), "labels": []}, "holds no points"),
        ({"points": np.full((2, 3), np.nan), "labels": [0, 1]}, "none of its points can be used"),
        ({"points": np.eye(3), "labels": [0, 1, 1], "permeability_cost": [-1, 1, 1]}, "permeability_cost"),
        ({"points": np.eye(3), "labels": [0, 1, 1], "target_pose": [0, 0, 0]}, "target_pose"),
        ({"points": np.eye(3), "labels": [0, 1, 1], "leaf_triangles": np.zeros((2, 3))}, "leaf_triangles"),
        ({"points": np.eye(3), "labels": [0, 1, 1], "frame_id": np.array({"a": 1}, dtype=object)}, "not a readable"),
        ({"points": np.array([[1, 2, None]], dtype=object), "labels": [0]}, "not a readable"),
        ({"points": np.full((2, 3), "1.5"), "labels": [0, 1]}, "points: of type <U3, expected numbers"),
        ({"points": np.eye(3) * 1j, "labels": [0, 1, 1]}, "points: of type complex128, expected numbers"),
        ({"points": np.float64(3.0), "labels": [0]}, r"points: shape \(\), expected"),
        ({"points": np.zeros(3, "f4, f4, f4"), "labels": [0, 1, 1]}, "points: of type .*expected numbers"),
        ({"points": np.eye(3), "labels": [0, 1, 1], "frame_id": ["a", "b"]}, "frame_id: .*expected one text"),
        ({"points": np.eye(3), "labels": [0, 1, 1], "target_pose": "here"}, "target_pose: of type <U4"),
    ],
)
def test_an_npz_that_does_not_fit_is_refused(tmp_path, members, named):
    with pytest.raises(SceneError, match=named):
        Scene.load(npz(tmp_path, **members))


class Payload:
    """What a pickled member would do on loading."""

    touched = False

    def __reduce__(self):
        return (setattr, (Payload, "touched", True))


def test_a_pickled_member_is_never_run(tmp_path):
    path = npz(tmp_path, points=np.array([Payload()], dtype=object), labels=[0])
    Payload.touched = False
    with pytest.raises(SceneError):
        Scene.load(path)
    assert Payload.touched is False


@pytest.mark.parametrize("suffix", [".npz", ".ply", ".pcd"])
def test_damaged_and_truncated_files_end_in_a_scene_or_a_sentence(tmp_path, rng, plant, suffix):
    whole = tmp_path / f"whole{suffix}"
    few = Scene(plant.leaf_points[:300], plant.leaf_costs[:300], plant.stem_points[:100], plant.fruit_points[:50])
    few.save(whole)
    content = whole.read_bytes()
    refused = 0
    for trial in range(80):
        damaged = bytearray(content)
        if trial % 2:
            damaged = damaged[: rng.integers(len(damaged))]
        else:
            for place in rng.integers(min(len(damaged), 400), size=3):
                damaged[place] = rng.integers(256)
        path = tmp_path / f"damaged{suffix}"
        path.write_bytes(damaged)
        try:
            assert Scene.load(path).n_points <= 450
        except SceneError:
            refused += 1
    assert refused >= 40, "every truncated file must be refused"


def test_missing_files_and_folders_that_cannot_be_written(tmp_path, plant):
    with pytest.raises(SceneError, match="no such file"):
        Scene.load(tmp_path / "none.npz")
    (tmp_path / "file").write_text("in the way")
    for suffix in (".npz", ".ply"):
        with pytest.raises(SceneError, match="cannot be written"):
            plant.save(tmp_path / "file" / f"a{suffix}")
    with pytest.raises(SceneError, match="ends in one of"):
        plant.save(tmp_path / "a.xyz")


def test_the_real_scans_load(shared_data):
    files = sorted(shared_data.glob("*.npz"))
    assert files
    for path in files:
        scale = 24.0 if "seedling" in path.name else 1.0
        scene = Scene.load(path, scale=scale, offset=(0.55, 0.0, 0.05))
        with np.load(path) as raw:
            stakes = len(raw["stake_points"]) if "stake_points" in raw.files else 0
            assert len(scene.leaf_points) == (raw["labels"] == 0).sum()
            assert len(scene.stem_points) == (raw["labels"] == 1).sum() + stakes
        heights = np.concatenate([scene.leaf_points, scene.stem_points])[:, 2]
        assert 0.049 < heights.min() < 0.1
        assert 0.3 < heights.max() < 0.75


def test_a_folder_is_called_one(tmp_path):
    for name in ("scans", "scan.npz"):
        (tmp_path / name).mkdir()
        with pytest.raises(SceneError, match=f"{name}: is a folder, not a scene file"):
            Scene.load(tmp_path / name)
