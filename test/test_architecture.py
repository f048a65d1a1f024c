"""The house keeps its shape: what may import what, how long a file and how full a folder may be, and words that do not belong."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "lime_planner"
BENCHMARKS = ROOT / "benchmarks"
TESTS = ROOT / "test"
MAX_LINES = 500
MAX_FILES = 20

#: Imports point only backwards along this order, lazy ones and those for type checkers included. Folders of one row do not know each other.
ORDER = (
    ("core",),
    ("scene", "robot", "motion", "planning"),
    ("collision",),
    ("doctor",),
    ("pipeline",),
    ("output",),
    ("viewer",),
    ("ros",),
    ("api",),
    ("experiments", "cli"),
    ("__main__",),
)
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names}


@cache
def modules() -> dict[str, Path]:
    """Every module of the package and of the benchmarks by its dotted name."""
    found = {}
    for path in sorted((*PACKAGE.rglob("*.py"), *BENCHMARKS.rglob("*.py"))):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def folder(module: str) -> str:
    """The folder below `lime_planner` that a module lies in, or its own name."""
    name = module.split(".")[1]
    assert name in RANK, f"{module} has no place in the order: name it in ORDER of {Path(__file__).name}"
    return name


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def imported(path: Path) -> set[str]:
    """Names of modules that a file imports anywhere: at module level, inside functions, or for type checkers only."""
    names: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path.relative_to(ROOT)} imports relatively"
            base = node.module or ""
            # `from package import module` needs the module; any other name is the package's own.
            names.update(f"{base}.{alias.name}" if f"{base}.{alias.name}" in modules() else base for alias in node.names)
    return names


@cache
def graph() -> dict[str, frozenset[str]]:
    """Which modules each module imports, the package's root left out: it offers names of later modules, lazily, and its version."""
    known = modules()
    return {
        name: frozenset(other for other in imported(path) if other in known and other not in (name, "lime_planner"))
        for name, path in known.items()
        if name != "lime_planner"
    }


def test_imports_point_backwards() -> None:
    arrows = [
        (name, other)
        for name, others in graph().items()
        for other in others
        if name.startswith("lime_planner.") and other.startswith("lime_planner.") and folder(name) != folder(other)
    ]
    wrong = [f"{name} imports {other}" for name, other in arrows if RANK[folder(other)] >= RANK[folder(name)]]
    assert len(arrows) > 100
    assert not wrong, "arrows against the order of the house:\n" + "\n".join(wrong)


def test_the_package_never_imports_the_benchmarks() -> None:
    wrong = [
        f"{name} imports {other}"
        for name, others in graph().items()
        for other in others
        if name.startswith("lime_planner") and other.startswith("benchmarks")
    ]
    assert not wrong, "\n".join(wrong)


def test_no_circles() -> None:
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, "circle: " + " -> ".join([*trail[trail.index(name) :], name])
        if name in done:
            return
        for other in sorted(graph()[name]):
            visit(other, (*trail, name))
        done.add(name)

    for name in graph():
        visit(name, ())


def uses_ros(name: str) -> bool:
    """Whether a module may know ROS: those of ros/, and the programs that drive nodes from outside."""
    return name.startswith(("lime_planner.ros", "benchmarks.node"))


@pytest.mark.parametrize("name", [name for name in modules() if not uses_ros(name)])
def test_rclpy_only_in_ros(name: str) -> None:
    roots = {other.split(".")[0] for other in imported(modules()[name])}
    assert "rclpy" not in roots
    assert not any(root.endswith("_msgs") or root.endswith("_srvs") for root in roots), "messages belong in lime_planner/ros"


def test_imports_without_ros() -> None:
    """Everything outside ros/ imports in a process where rclpy and the messages cannot be imported."""
    names = [name for name in modules() if name.startswith("lime_planner") and not uses_ros(name) and not name.endswith("__main__")]
    script = f"""
import importlib, sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        root = name.split(".")[0]
        if root == "rclpy" or root.endswith(("_msgs", "_srvs")):
            raise ImportError(f"{{name}} is blocked")
sys.meta_path.insert(0, Blocked())
for name in {names!r}:
    importlib.import_module(name)
assert "open3d" not in sys.modules, "open3d (1.1 s) must be imported inside functions"
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr


def test_files_stay_short_and_folders_small() -> None:
    files = [path for top in (PACKAGE, BENCHMARKS, TESTS) for path in sorted(top.rglob("*.py"))]
    counts = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    long = [f"{path.relative_to(ROOT)}: {count} lines" for path, count in counts.items() if count > MAX_LINES]
    assert not long, f"over {MAX_LINES} lines, split by concept:\n" + "\n".join(long)
    folders = {path.parent for path in files}
    full = [
        f"{place.relative_to(ROOT)}: {count} files" for place in sorted(folders) if (count := len(list(place.glob("*.py")))) > MAX_FILES
    ]
    assert not full, f"over {MAX_FILES} files, make folders by concept:\n" + "\n".join(full)


def test_the_walk_through_names_what_there_is() -> None:
    """Every row of the walk from a cloud to a trajectory names a file that exists, and a function or class in it."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"\| `(lime_planner/[\w/]+\.py)` \| `([\w.]+)` \|", page)
    assert len(rows) > 15
    for name, function in rows:
        defined: set[str] = set()
        for node in tree(ROOT / name).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                defined.add(node.name)
            if isinstance(node, ast.ClassDef):
                defined |= {f"{node.name}.{part.name}" for part in node.body if isinstance(part, (ast.FunctionDef, ast.AsyncFunctionDef))}
        assert function in defined, f"docs/architecture.md: {name} defines no {function}"


def source_files() -> list[Path]:
    """Text files of the project, without what builds and tools leave behind."""
    left = {".git", ".venv", "build", "install", "log", "out", "dist", "site", "__pycache__"}
    kinds = {"", ".cfg", ".in", ".md", ".py", ".rst", ".sh", ".toml", ".urdf", ".xml", ".yaml"}
    found = []
    for path in sorted(ROOT.rglob("*")):
        parts = path.relative_to(ROOT).parts
        hidden = any(part.startswith(".") and part not in (".ci", ".github") for part in parts) or any(
            part.endswith(".egg-info") for part in parts
        )
        if path.is_file() and path.suffix in kinds and not hidden and not left & set(parts):
            found.append(path)
    return found


def test_words_that_do_not_belong() -> None:
    """No machine paths and no unfinished work in what is shipped."""
    # Put together here so that this file does not find itself.
    words = ["/ho" + "me/", "/ro" + "ot/", "/wo" + "rk/", "TO" + "DO", "FIX" + "ME", "XX" + "X"]
    found = []
    for path in source_files():
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            found += [f"{path.relative_to(ROOT)}:{number}: {word}" for word in words if word in line]
    assert not found, "\n".join(found)
