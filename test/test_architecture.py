"""The house keeps its shape: what may import what, how long a module may be, and words that do not belong."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "lime_planner"
TESTS = ROOT / "test"
MAX_LINES = 500

#: Imports point only backwards along this order; modules of one row may import each other as long as there is no circle.
ORDER = (
    ("core", ""),
    ("scene", "robot", "motion", "planning"),
    ("collision",),
    ("doctor",),
    ("pipeline",),
    ("output",),
    ("viewer", "ros"),
    ("api",),
    ("experiments", "cli", "__main__"),
)
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names}


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def rank(module: str) -> int:
    """Place of a module along the order."""
    name = [*module.split("."), ""][1]
    assert name in RANK, f"{module} has no place in the order: name it in ORDER of {Path(__file__).name}"
    return RANK[name]


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def imported(path: Path, *, lazy: bool) -> set[str]:
    """Names of modules that a file imports: at module level, or with `lazy` anywhere in it; never those for type checkers only."""
    names: set[str] = set()

    def walk(node: ast.AST) -> None:
        if is_type_checking(node) or (not lazy and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))):
            return
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                package = list(path.relative_to(ROOT).parts[:-1])
                base = ".".join([*package[: len(package) - node.level + 1], *([base] if base else [])])
            # `from package import module` needs the module; any other name is the package's own.
            names.update(f"{base}.{alias.name}" if f"{base}.{alias.name}" in modules() else base for alias in node.names)
        for child in ast.iter_child_nodes(node):
            walk(child)

    walk(tree(path))
    return names


def graph(*, lazy: bool) -> dict[str, set[str]]:
    known = modules()
    return {name: {other for other in imported(path, lazy=lazy) if other in known and other != name} for name, path in known.items()}


def test_imports_point_backwards() -> None:
    upward = [f"{name} imports {other}" for name, others in graph(lazy=True).items() for other in others if rank(other) > rank(name)]
    # The package's own __init__ may offer names of later modules, lazily.
    upward = [arrow for arrow in upward if not arrow.startswith("lime_planner imports ")]
    assert not upward, "arrows against the order of the house:\n" + "\n".join(upward)


def test_no_circles() -> None:
    edges = {name: others - {"lime_planner"} for name, others in graph(lazy=False).items()}
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, "circle: " + " -> ".join([*trail[trail.index(name) :], name])
        if name in done:
            return
        for other in sorted(edges[name]):
            visit(other, (*trail, name))
        done.add(name)

    for name in edges:
        visit(name, ())


@pytest.mark.parametrize("name", [n for n in modules() if not n.startswith("lime_planner.ros")])
def test_rclpy_only_in_ros(name: str) -> None:
    roots = {other.split(".")[0] for other in imported(modules()[name], lazy=False)}
    assert "rclpy" not in roots
    assert not any(root.endswith("_msgs") or root.endswith("_srvs") for root in roots), "messages belong in lime_planner/ros"


def test_imports_without_ros() -> None:
    """Everything outside ros/ imports in a process where rclpy and the messages cannot be imported."""
    names = [name for name in modules() if not name.startswith("lime_planner.ros") and not name.endswith("__main__")]
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


def test_modules_stay_short() -> None:
    counts = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in (*PACKAGE.rglob("*.py"), *TESTS.rglob("*.py"))}
    long = [f"{path.relative_to(ROOT)}: {count} lines" for path, count in sorted(counts.items()) if count > MAX_LINES]
    assert not long, f"over {MAX_LINES} lines, split by concept:\n" + "\n".join(long)


def source_files() -> list[Path]:
    """Text files of the project, without what builds and tools leave behind."""
    left = {".git", ".venv", "build", "install", "log", "out", "dist", "site", "__pycache__"}
    kinds = {"", ".cfg", ".in", ".md", ".py", ".rst", ".sh", ".toml", ".urdf", ".xml", ".yaml"}
    found = []
    for path in sorted(ROOT.rglob("*")):
        parts = path.relative_to(ROOT).parts
        hidden = any(part.startswith(".") and part != ".ci" for part in parts) or any(part.endswith(".egg-info") for part in parts)
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
