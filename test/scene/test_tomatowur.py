"""The public scans: conversion of the archive, and what is said when it cannot be had. No test here needs a network."""

from __future__ import annotations

import io
import subprocess
import tarfile

import numpy as np
import pytest

from lime_planner.core.errors import SceneError
from lime_planner.scene.plants import tomatowur
from lime_planner.scene.scene import Scene

FOLDER = "tomatowur-1.3.7/Resources/output_semantic_segmentation/"
# Two leaf points, a main stem of five, a stake, a side stem, a node.
ROWS = ["0.2,0.2,0.30,0.0", "0.1,0.2,0.08,0.0"]
ROWS += [f"0.15,0.{2 + k % 2},{0.1 + 0.005 * k:.3f},1.0" for k in range(5)]
ROWS += ["0.15,0.25,0.60,2.0", "0.16,0.2,0.2,3.0", "0.17,0.2,0.2,4.0"]
SCAN = "x,y,z,class_pred\n" + "\n".join(ROWS) + "\n"


def archive(folder, **files):
    path = folder / "tomatowur-1.3.7.tar.gz"
    with tarfile.open(path, "w:gz") as tar:
        for name, text in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(text.encode())
            tar.addfile(info, io.BytesIO(text.encode()))
    return path


def test_scans_become_scene_files_beside_their_licence(tmp_path, monkeypatch):
    path = archive(
        tmp_path,
        **{
            FOLDER + "Harvest_01_PotNr_179.txt": SCAN,
            FOLDER + "Harvest_02_PotNr_27.txt": SCAN,
            "tomatowur-1.3.7/Resources/Harvest_01_PotNr_179.txt": "not this one",
            FOLDER + "../../../../escape.txt": "nor this",
            "tomatowur-1.3.7/LICENSE": "GNU GENERAL PUBLIC LICENSE\n",
            "tomatowur-1.3.7/src/x/LICENSE": "another",
        },
    )
    monkeypatch.setattr(tomatowur, "_download", lambda folder: path)
    obtained = tomatowur.obtain(tmp_path / "scans")
    assert sorted(p.name for p in (tmp_path / "scans").iterdir()) == [
        "LICENSE_tomatowur.txt",
        "tomato_wur_h01p179.npz",
        "tomato_wur_h02p27.npz",
    ]
    assert obtained.licence.read_text() == "GNU GENERAL PUBLIC LICENSE\n"
    assert "GNU General Public License" in obtained.summary
    assert [p.name for p in obtained.scans] == ["tomato_wur_h01p179.npz", "tomato_wur_h02p27.npz"]
    scene = Scene.load(obtained.scans[0])
    np.testing.assert_allclose(scene.leaf_points, [[0.05, 0.0, 0.22], [-0.05, 0.0, 0.0]], atol=1e-6)
    assert len(scene.stem_points) == 8
    np.testing.assert_allclose(scene.stem_points[-1], [0.0, 0.05, 0.52], atol=1e-6)  # the stake
    assert scene.stem_points[:5, 2].min() == pytest.approx(0.02, abs=1e-6)


@pytest.mark.parametrize(
    ("files", "named"),
    [
        ({}, "0 scans and no licence"),
        ({FOLDER + "Harvest_01_PotNr_1.txt": SCAN}, "1 scans and no licence"),
        ({FOLDER + "Harvest_01_PotNr_1.txt": SCAN.replace("class_pred", "kind")}, "its columns are 'x,y,z,kind'"),
        ({FOLDER + "Harvest_01_PotNr_1.txt": SCAN + "1,2\n"}, "Harvest_01_PotNr_1"),
        ({FOLDER + "Harvest_01_PotNr_1.txt": "x,y,z,class_pred\n"}, "shape"),
    ],
)
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_an_archive_of_another_layout_is_refused(tmp_path, files, named):
    with pytest.raises(SceneError, match=named):
        tomatowur.convert(archive(tmp_path, **files), tmp_path / "out")


def test_a_broken_archive_is_refused(tmp_path):
    (tmp_path / "a.tar.gz").write_bytes(b"no archive")
    with pytest.raises(SceneError, match=r"a\.tar\.gz cannot be converted"):
        tomatowur.convert(tmp_path / "a.tar.gz", tmp_path / "out")


def test_without_a_network_pip_is_quoted_in_one_sentence(tmp_path, monkeypatch):
    # The real pip, told to use no index at all: what it says is what it says without a network.
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    with pytest.raises(SceneError, match=r"is there a network.*No matching distribution found for tomatowur") as caught:
        tomatowur.obtain(tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("stderr", "named", "runs"),
    [
        ("/usr/bin/python3: No module named pip\n", "has no pip", 1),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE.\n    Got 12\nERROR: x\n", "DO NOT MATCH", 1),
        ("ERROR: Could not open requirements file\n", "Could not open", 2),
        ("", "pip says: nothing", 2),
    ],
)
def test_what_pip_says_decides_what_is_said(tmp_path, monkeypatch, stderr, named, runs):
    calls = []

    def run(command, **_):
        calls.append(command)
        return subprocess.CompletedProcess(command, 1, "", stderr)

    monkeypatch.setattr(tomatowur.subprocess, "run", run)
    with pytest.raises(SceneError, match=named):
        tomatowur.obtain(tmp_path)
    assert len(calls) == runs
    assert all("--no-deps" in call and "--requirement" in call for call in calls)


def test_a_download_that_hangs_ends(tmp_path, monkeypatch):
    def run(command, **options):
        raise subprocess.TimeoutExpired(command, options["timeout"])

    monkeypatch.setattr(tomatowur.subprocess, "run", run)
    with pytest.raises(SceneError, match="not downloaded within 600 s"):
        tomatowur.obtain(tmp_path)
