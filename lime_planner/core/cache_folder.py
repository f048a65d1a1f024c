"""The folder for what is computed once and kept: compiled kernels, and the arm's distance grids."""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import stat
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_VARIABLES = ("LIME_PLANNER_CACHE_DIR", "XDG_CACHE_HOME", "HOME")


@dataclass(frozen=True)
class CacheFolder:
    """Where caches are written.

    Attributes:
        path: the folder.
        wanted: the folder that was asked for by the environment, or is the usual one.
        trouble: why that one is not used; empty where it is.
        lasting: whether the folder is still there for the next process.
    """

    path: Path
    wanted: Path | None
    trouble: str = ""
    lasting: bool = True


def cache_root() -> Path:
    """Return the folder below which the package may write caches; see `find_cache_folder`."""
    return _found(tuple(os.environ.get(name, "") for name in _VARIABLES)).path


@cache
def _found(_: tuple[str, ...]) -> CacheFolder:
    found = find_cache_folder()
    if not found.lasting:
        atexit.register(shutil.rmtree, found.path, ignore_errors=True)
    return found


def find_cache_folder(environ: Mapping[str, str] = os.environ) -> CacheFolder:
    """Choose the folder for caches, and make it.

    `LIME_PLANNER_CACHE_DIR` if set, else `$XDG_CACHE_HOME/lime_planner`, else `~/.cache/lime_planner`. What lies there is code that
    will run: a folder of another user, or one that every user may write to, is not taken. In its place, and where it cannot be
    written (a service account without a home, a file system that is read-only), comes a private folder of the system's directory
    for temporary files; where another user holds that name, one for this process alone.
    """
    wanted = _wanted(environ)
    trouble = "there is no home directory" if wanted is None else why_not_usable(wanted)
    if wanted is not None and not trouble:
        return CacheFolder(wanted, wanted)
    private = Path(tempfile.gettempdir()) / f"lime_planner-{os.getuid()}"
    if not why_not_usable(private, private=True):
        return CacheFolder(private, wanted, trouble)
    return CacheFolder(Path(tempfile.mkdtemp(prefix="lime_planner-")), wanted, trouble, lasting=False)


def _wanted(environ: Mapping[str, str]) -> Path | None:
    if environ.get("LIME_PLANNER_CACHE_DIR"):
        return Path(environ["LIME_PLANNER_CACHE_DIR"])
    if environ.get("XDG_CACHE_HOME"):
        return Path(environ["XDG_CACHE_HOME"]) / "lime_planner"
    if environ.get("HOME"):
        return Path(environ["HOME"]) / ".cache" / "lime_planner"
    with contextlib.suppress(RuntimeError):
        return Path.home() / ".cache" / "lime_planner"
    return None


def why_not_usable(folder: Path, *, private: bool = False) -> str:
    """Return why caches cannot be kept in a folder, which is made if it is not there; empty if they can.

    Args:
        folder: to look at.
        private: whether it lies where everybody may make folders, and must therefore be ours alone, and no link.
    """
    try:
        folder.mkdir(mode=0o700 if private else 0o777, parents=True, exist_ok=True)
        state = folder.lstat() if private else folder.stat()
        if not stat.S_ISDIR(state.st_mode):
            return "it is no folder"
        if state.st_uid not in ((os.getuid(),) if private else (os.getuid(), 0)):
            return f"it belongs to the user {_name_of(state.st_uid)}, who could put other code there"
        if state.st_mode & (0o022 if private else 0o002):
            return f"its mode {stat.S_IMODE(state.st_mode):o} lets other users put code there"
        # A file is written, since permission bits do not tell about read-only file systems, quotas, and root.
        handle, name = tempfile.mkstemp(prefix=".probe-", dir=folder)
        os.close(handle)
        os.unlink(name)
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _name_of(uid: int) -> str:
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)
