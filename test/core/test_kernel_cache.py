"""Compiled kernels on disk: an edit recompiles what it concerns, nothing else, and a checkout elsewhere finds them again."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lime_planner.core import kernel_cache

ROOT = Path(__file__).resolve().parents[2]
_USED = ("__init__.py", "core", "planning/__init__.py", "planning/space.py")
_KERNEL = "from lime_planner.core.jit import kernel\n{imports}\n\n@kernel\ndef {name}(x):\n    return {body}\n"
_FILES = {
    "lime_planner/innermost.py": ("", "inner", "x + 1.0"),
    "lime_planner/caller.py": ("from lime_planner.innermost import inner", "call", "2.0 * inner(x)"),
    "lime_planner/apart.py": ("", "alone", "x - 1.0"),
    "benchmarks/measure.py": ("from lime_planner.caller import call", "measured", "call(x) + 0.5"),
    "benchmarks/generic.py": ("from lime_planner.planning.space import distance", "generic", "x"),
}
_SCRIPT = """
import json
from benchmarks.generic import generic
from benchmarks.measure import measured
from lime_planner.apart import alone

found = {}
for kernel in (measured, alone, generic):
    value = kernel(1.0)
    found[kernel.__name__] = [value, sum(kernel.stats.cache_hits.values())]
print(json.dumps(found))
"""


def write(tree: Path, name: str, body: str = "") -> None:
    imports, function, usual = _FILES[name]
    path = tree / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(_KERNEL.format(imports=imports, name=function, body=body or usual), encoding="utf-8")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small copy of the project: its decorators, and a few kernels that call each other across files."""
    tree = tmp_path / "first"
    for name in _USED:
        source, place = ROOT / "lime_planner" / name, tree / "lime_planner" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, place, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, place)
    for name in _FILES:
        write(tree, name)
    (tree / "benchmarks" / "__init__.py").touch()
    return tree


def run(tree: Path) -> dict[str, list[float]]:
    """Value and hits of the cache of each kernel, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "LIME_PLANNER_CACHE_DIR": str(tree.parent / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT], cwd=tree, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_an_edit_recompiles_what_it_concerns_and_nothing_else(tree: Path) -> None:
    assert run(tree) == {"measured": [4.5, 0], "alone": [0.0, 0], "generic": [1.0, 0]}
    assert run(tree) == {"measured": [4.5, 1], "alone": [0.0, 1], "generic": [1.0, 1]}
    write(tree, "lime_planner/innermost.py", "x + 2.0")
    assert run(tree) == {"measured": [6.5, 0], "alone": [0.0, 1], "generic": [1.0, 1]}
    # A planner calls a space by its address: nothing of it is compiled into the planner.
    (tree / "lime_planner" / "plane.py").write_text("# @kernel\nfrom lime_planner.planning.space import make_handle\n", encoding="utf-8")
    assert run(tree) == {"measured": [6.5, 1], "alone": [0.0, 1], "generic": [1.0, 1]}
    write(tree, "lime_planner/innermost.py")
    assert run(tree) == {"measured": [4.5, 1], "alone": [0.0, 1], "generic": [1.0, 1]}


def test_a_checkout_elsewhere_finds_the_kernels_again(tree: Path) -> None:
    run(tree)
    tree.rename(tree.parent / "second")
    for path in (tree.parent / "second").rglob("*.py"):
        os.utime(path, (1.0e9, 1.0e9))
    assert run(tree.parent / "second") == {"measured": [4.5, 1], "alone": [0.0, 1], "generic": [1.0, 1]}


def test_versions_long_gone_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIME_PLANNER_CACHE_DIR", str(tmp_path))
    (tmp_path / "numba-0123456789abcdef").mkdir()  # the layout of version 0.1
    path = str(ROOT / "lime_planner" / "planning" / "space.py")
    for number in range(6):
        monkeypatch.setattr(kernel_cache, "_hash_of", lambda module, number=number: f"{number:016x}")
        folder = kernel_cache.kernel_folder.__wrapped__(path)
        assert folder.is_dir()
        os.utime(folder, (1.0e9 + number, 1.0e9 + number))
    recent = kernel_cache.kernel_folder.__wrapped__
    for number in range(6, 10):  # as many checkouts as somebody works on today
        monkeypatch.setattr(kernel_cache, "_hash_of", lambda module, number=number: f"{number:016x}")
        recent(path)
    left = sorted(path.name for path in (tmp_path / "kernels").iterdir())
    assert left == [f"lime_planner.planning.space-{number:016x}" for number in (6, 7, 8, 9)]
    assert not list(tmp_path.glob("numba-*"))


def test_what_cannot_be_read_is_compiled_again(tree: Path) -> None:
    run(tree)
    for path in (tree.parent / "cache").rglob("*apart*.nbc"):  # as another version of the package, or of a library, might leave it
        path.write_bytes(b"no pickle")
    assert run(tree) == {"measured": [4.5, 1], "alone": [0.0, 0], "generic": [1.0, 1]}
    assert run(tree)["alone"] == [0.0, 1]
