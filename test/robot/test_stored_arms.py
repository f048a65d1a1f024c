"""Arms that were read before come from the disk, and are what the description says now."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lime_planner.core.errors import RobotError
from lime_planner.robot import stored_arms
from lime_planner.robot.model import load_robot, robot_from_urdf

_ARM = """<robot name="two"><link name="base"/><link name="upper"><collision><geometry>{shape}</geometry></collision></link>
<link name="fore"><collision><geometry><box size="0.1 0.1 0.4"/></geometry></collision></link><link name="tip"/>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit lower="-{limit}" upper="{limit}" velocity="1" effort="1"/></joint>
<joint name="b" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.6"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="c" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0 0 0.4"/></joint></robot>"""
_STL = "solid s\n{}endsolid s\n"
_FACET = "facet normal 0 0 1\nouter loop\n{}endloop\nendfacet\n"


def _write_tetrahedron(path: Path, size: float) -> None:
    corners = size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    facets = [corners[list(face)] for face in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))]
    loops = ["".join(f"vertex {x} {y} {z}\n" for x, y, z in facet) for facet in facets]
    path.write_text(_STL.format("".join(_FACET.format(loop) for loop in loops)))


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored_arms, "cache_root", lambda: tmp_path)


def test_what_is_read_from_the_disk_is_what_was_stored(tmp_path: Path) -> None:
    first = load_robot("kinova_j2n6s300")
    assert len(list(tmp_path.glob("arm-*.pickle"))) == 1
    second = load_robot("kinova_j2n6s300")
    assert second is not first and second.collision_pairs == first.collision_pairs and second.warnings == first.warnings
    assert (second.lower == first.lower).all() and (second.chain.placements == first.chain.placements).all()
    for a, b in zip(first.links, second.links, strict=True):
        assert a.name == b.name and (a.vertices == b.vertices).all() and (a.triangles == b.triangles).all()


def test_an_edited_mesh_limit_or_choice_is_read_anew(tmp_path: Path) -> None:
    mesh = tmp_path / "part.stl"
    shape = '<mesh filename="part.stl"/>'
    _write_tetrahedron(mesh, 0.1)
    arm = robot_from_urdf(_ARM.format(shape=shape, limit=2), base_dir=tmp_path)
    _write_tetrahedron(mesh, 0.2)
    assert robot_from_urdf(_ARM.format(shape=shape, limit=2), base_dir=tmp_path).links[0].vertices.max() == pytest.approx(0.2)
    assert arm.links[0].vertices.max() == pytest.approx(0.1)
    assert robot_from_urdf(_ARM.format(shape=shape, limit=3), base_dir=tmp_path).upper[0] == 3.0
    assert robot_from_urdf(_ARM.format(shape=shape, limit=3), base_dir=tmp_path, tool_frame="fore").tool_frame == "fore"
    mesh.unlink()
    with pytest.raises(RobotError, match=r"part\.stl"):
        robot_from_urdf(_ARM.format(shape=shape, limit=2), base_dir=tmp_path)


def test_a_damaged_file_is_written_again_and_old_ones_go(tmp_path: Path) -> None:
    load_robot("kinova_j2n6s300")
    (stored,) = tmp_path.glob("arm-*.pickle")
    stored.write_bytes(b"\x80")
    old = tmp_path / "arm-0.pickle"
    old.write_bytes(b"")
    os.utime(old, (time.time() - 8 * 86400,) * 2)
    assert load_robot("kinova_j2n6s300").n == 6
    assert len(stored.read_bytes()) > 1000 and not old.exists()


def test_an_arm_from_the_disk_needs_no_pinocchio() -> None:
    text = "import sys; from lime_planner.robot.model import load_robot as l; l('kinova_j2n6s300'); print('pinocchio' in sys.modules)"
    run = [subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True).stdout.strip() for _ in range(2)]
    assert run[1] == "False"
