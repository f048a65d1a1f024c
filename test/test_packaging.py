"""The package's description of itself: one version, one list of dependencies, everything installed where ROS looks for it."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import lime_planner

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ET.parse(ROOT / "package.xml").getroot()
SCRIPTS = ("lime-planner", "mock_arm_node", "planner_node", "scene_node")

#: Import name of a library where it differs from its name in setup.py.
IMPORT_NAMES = {"pin": "pinocchio", "python_fcl": "fcl", "open3d_cpu": "open3d", "pyyaml": "yaml"}
#: In setup.py without being imported: data.
DATA_ONLY = {"example_robot_data"}
#: Imported, and a part of another requirement (of Numba, Pinocchio, Matplotlib, viser), or a peer that is compared with where
#: somebody installed it.
BROUGHT_ALONG = {"llvmlite", "coal", "PIL", "msgspec", "websockets", "pyroboplan"}
#: Extras whose libraries the package imports.
EXTRAS = ("experiments", "cluster", "bench", "bags", "completion", "viewer", "video")
#: rosdep key by import name, where a library has one.
ROSDEP_KEYS = {
    "fcl": "python-fcl-pip",
    "open3d": "python3-open3d-pip",
    "pinocchio": "pinocchio",
    "toppra": "toppra",
    "trimesh": "python3-trimesh-pip",
}
#: ROS package by import name, where they differ.
ROS_PACKAGES: dict[str, str] = {}


def imported_roots(folder: Path) -> set[str]:
    """Top-level names imported anywhere below `folder`, those inside functions too."""
    roots = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                roots.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and not node.level:
                roots.add((node.module or "").split(".")[0])
    return roots - set(sys.stdlib_module_names) - {"lime_planner", ""}


def requirements(extra: str | None = None) -> set[str]:
    """Import names of setup.py's INSTALL_REQUIRES, or of one of its EXTRAS_REQUIRE."""
    tree = ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))
    lists = {getattr(node.targets[0], "id", ""): node.value for node in tree.body if isinstance(node, ast.Assign)}
    texts = ast.literal_eval(lists["INSTALL_REQUIRES"]) if extra is None else ast.literal_eval(lists["EXTRAS_REQUIRE"])[extra]
    names = {re.split(r"[<>=;\[ ]", text)[0].lower().replace("-", "_") for text in texts}
    return {IMPORT_NAMES.get(name, name) for name in names}


def manifest_depends() -> set[str]:
    return {element.text or "" for tag in ("depend", "exec_depend") for element in MANIFEST.findall(tag)}


def is_ros(root: str) -> bool:
    return root.endswith(("_msgs", "_srvs", "_interfaces")) or root in {"rclpy", "launch", "launch_ros", "ament_index_python"}


def test_one_version() -> None:
    assert MANIFEST.findtext("version") == lime_planner.__version__


def test_maintainer_has_an_address_that_colcon_accepts() -> None:
    """A malformed one makes colcon fall back, with a mere warning, to a plain Python package."""
    maintainer = MANIFEST.find("maintainer")
    assert maintainer is not None
    assert re.fullmatch(r"[-\w%+]+(\.[-\w%+]+)*@[-\w%]+(\.[-\w%]+)*\.[a-zA-Z]{2,}", maintainer.get("email", ""))


def test_every_library_imported_is_required_and_none_else() -> None:
    own = {"benchmarks", *(path.stem for path in (ROOT / "test" / "helpers").glob("*.py"))}
    sources = imported_roots(ROOT / "lime_planner") | imported_roots(ROOT / "benchmarks")
    imported = {root for root in sources - own if not is_ros(root)}
    required = requirements().union(*map(requirements, EXTRAS))
    assert imported - BROUGHT_ALONG == required - DATA_ONLY


def test_rosdep_keys_match() -> None:
    libraries = {ROSDEP_KEYS.get(name, f"python3-{name}") for name in requirements() - DATA_ONLY}
    used = imported_roots(ROOT / "lime_planner") | imported_roots(ROOT / "launch")
    messages = {
        ROS_PACKAGES.get(root, root) for root in used if is_ros(root) and root not in {"launch", "launch_ros", "ament_index_python"}
    }
    assert manifest_depends() - {"launch", "launch_ros", "ros2launch", "ament_index_python"} == libraries | {"coal"} | messages


def test_entry_points_exist() -> None:
    """Every console script names a module and a function that exist."""
    scripts = re.findall(r'"([\w-]+) = ([\w.]+):(\w+)"', (ROOT / "setup.py").read_text(encoding="utf-8"))
    assert tuple(sorted(name for name, _, _ in scripts)) == SCRIPTS
    for _, module, function in scripts:
        assert callable(getattr(importlib.import_module(module), function)), f"{module}:{function}"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`colcon build`, into a temporary folder."""
    pytest.importorskip("colcon_ros", reason="colcon is not in this environment (extra `colcon`)")
    base = tmp_path_factory.mktemp("colcon")
    folders = ["--base-paths", str(ROOT), "--build-base", str(base / "build"), "--install-base", str(base / "install")]
    command = [sys.executable, "-m", "colcon", "--log-base", str(base / "log"), "build", *folders]
    done = subprocess.run(command, cwd=base, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return base / "install"


def test_colcon_installs_where_ros_looks(installed: Path) -> None:
    prefix = installed / "lime_planner"
    assert tuple(sorted(path.name for path in (prefix / "lib" / "lime_planner").iterdir())) == SCRIPTS
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / "lime_planner").is_file()
    share = prefix / "share" / "lime_planner"
    assert (share / "package.xml").is_file()
    for folder in ("launch", "config", "rviz", "foxglove"):
        expected = {path.relative_to(ROOT) for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts}
        assert {path.relative_to(share) for path in (share / folder).rglob("*") if path.is_file()} == expected
    [package] = prefix.glob("lib/python3.*/site-packages/lime_planner")
    assert (package / "py.typed").is_file()
    assert any(package.rglob("*.urdf"))


def test_colcon_script_runs_the_installed_copy(installed: Path, tmp_path: Path) -> None:
    script = installed / "lime_planner" / "lib" / "lime_planner" / "lime-planner"
    command = f". {installed}/setup.bash && {script} scene plant --density sparse --limes 1 --out {tmp_path}/p.npz && {script} --version"
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith(f"lime-planner {lime_planner.__version__}\n")


@pytest.mark.parametrize("name", lime_planner.__all__)
def test_public_names_load(name: str) -> None:
    assert getattr(lime_planner, name).__name__ == name


def test_importing_the_package_is_light() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "import lime_planner, sys; print({'numpy', 'numba'} & set(sys.modules))"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "set()"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = lime_planner.nothing


def test_links_of_the_readme_lead_somewhere() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link]
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []
