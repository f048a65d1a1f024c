"""Open3D without its viewers, which come when a program asks for them."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
from lime_planner.core.quick_open3d import open3d
o3d = open3d()
assert o3d.t.geometry.RaycastingScene(nthreads=1) is not None
heavy = [name for name in ("dash", "plotly", "IPython") if name in sys.modules]
assert heavy == [], heavy
import open3d as same
assert same is o3d and open3d() is o3d
import open3d.visualization
assert callable(o3d.visualization.draw_geometries) and o3d.visualization.rendering.OffscreenRenderer
import open3d.visualization.gui
assert not any(type(finder).__module__.startswith("lime_planner") for finder in sys.meta_path)
print("fine")
"""


def test_viewers_are_imported_when_they_are_asked_for() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=120.0)
    assert done.stdout == "fine\n", done.stderr


def test_what_is_imported_already_is_used() -> None:
    code = "import open3d; from lime_planner.core import quick_open3d; print(quick_open3d.open3d() is open3d)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120.0)
    assert done.stdout == "True\n", done.stderr
