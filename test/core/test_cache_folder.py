"""Where caches lie when the usual place will not do: what is cached is code that will run, so strangers must not have put it there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lime_planner.core.cache_folder import find_cache_folder, why_not_usable

FOREIGN = 12345
needs_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can be another user")


@pytest.fixture(autouse=True)
def own_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def test_the_usual_places(tmp_path: Path) -> None:
    named = {"LIME_PLANNER_CACHE_DIR": str(tmp_path / "named"), "XDG_CACHE_HOME": str(tmp_path / "xdg"), "HOME": str(tmp_path)}
    for expected in ("named", "xdg/lime_planner", ".cache/lime_planner"):
        found = find_cache_folder(named)
        assert (found.path, found.trouble, found.lasting) == (tmp_path / expected, "", True)
        assert found.path.is_dir() and not list(found.path.iterdir())
        named.pop(next(iter(named)))


@pytest.mark.parametrize(("mode", "usable"), [(0o755, True), (0o775, True), (0o777, False), (0o1777, False)])
def test_folders_that_anybody_may_write_to_are_not_used(tmp_path: Path, mode: int, usable: bool) -> None:
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(mode)
    found = find_cache_folder({"LIME_PLANNER_CACHE_DIR": str(tmp_path / "cache")})
    assert (found.path == tmp_path / "cache") is usable
    assert usable or found.trouble == f"its mode {mode:o} lets other users put code there"


@needs_root
def test_folders_of_others_are_not_used(tmp_path: Path, own_temporary_folder: Path) -> None:
    (tmp_path / "cache").mkdir()
    os.chown(tmp_path / "cache", FOREIGN, FOREIGN)
    found = find_cache_folder({"LIME_PLANNER_CACHE_DIR": str(tmp_path / "cache")})
    assert found.trouble == f"it belongs to the user {FOREIGN}, who could put other code there"
    private = own_temporary_folder / f"lime_planner-{os.getuid()}"
    assert found.path == private and private.stat().st_mode & 0o777 == 0o700
    # The private folder's name can be taken by anybody before us: by a folder of theirs, or by a link.
    os.chown(private, FOREIGN, FOREIGN)
    found = find_cache_folder({"LIME_PLANNER_CACHE_DIR": str(tmp_path / "cache")})
    assert not found.lasting and found.path != private and found.path.stat().st_uid == os.getuid()
    private.rmdir()
    private.symlink_to(tmp_path / "cache")
    assert why_not_usable(private, private=True) == "it is no folder"


@needs_root
@pytest.mark.parametrize("home", [None, "/nonexistent", "/root"])
def test_a_service_account_without_a_home(tmp_path: Path, home: str | None) -> None:
    """As the kernel sees it: another user's process, which may read the package and write nowhere but in the temporary folder."""
    script = "from lime_planner.core.cache_folder import *; f = find_cache_folder(); print(f.path, f.trouble, f.lasting, sep='|')"
    environment = {"PATH": os.environ["PATH"], "TMPDIR": "/tmp", "PYTHONDONTWRITEBYTECODE": "1", **({} if home is None else {"HOME": home})}
    package = Path(__file__).parents[2]
    command = [
        sys.executable,
        "-c",
        f"import os, sys; sys.path.insert(0, {str(package)!r}); os.setgid({FOREIGN}); os.setuid({FOREIGN}); {script}",
    ]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False, cwd="/")
    if "lime_planner" not in done.stdout:
        assert "core/cache_folder.py" not in done.stderr
        pytest.skip("the interpreter's own libraries lie where another user may not read")
    path, trouble, lasting = done.stdout.strip().split("|")
    assert (path, lasting) == (f"/tmp/lime_planner-{FOREIGN}", "True"), done.stderr
    assert trouble == ("there is no home directory" if home is None else "Permission denied")
