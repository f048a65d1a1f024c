"""Files that are whole or not there, whatever interrupts their writing."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lime_planner.core.errors import ParameterError

_DESCRIPTOR = re.compile(r"^/(?:dev|proc/self|proc/thread-self)/fd/(\d+)$")
_STANDARD = {"/dev/stdin": 0, "/dev/stdout": 1, "/dev/stderr": 2}


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary file to write to, with the suffix of `path`; it takes the place of `path` if all went well.

    Symbolic links are followed: the file that they lead to is replaced, and they stay. A file keeps its mode. What is no file (a named
    pipe, a terminal, `/dev/stdout`, `/dev/fd/3`) is written to. Where a file may be written but its folder may not, the file is
    overwritten in place. A folder that is not there is made, and said on standard error.

    Raises:
        OSError: the path cannot be written.
    """
    path = Path(path)
    place = None if _is_stream(path) else _place(path)
    if place is not None:
        make_folder(place.parent)
    temporary = _temporary(place, path.suffix)
    try:
        yield temporary
        if place is not None and temporary.parent == place.parent:
            with contextlib.suppress(FileNotFoundError):
                temporary.chmod(stat.S_IMODE(place.stat().st_mode))
            os.replace(temporary, place)
        else:
            _copy(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Make sure that `replacing` can write a path, before the work whose outcome is to go there; nothing is left behind.

    Raises:
        ParameterError: it cannot; the text names the path and why.
    """
    path = Path(path)
    try:
        if _is_stream(path):
            return
        place = _place(path)
        existing = next(folder for folder in place.parents if os.path.lexists(folder))
        _temporary(existing / place.name, path.suffix).unlink(missing_ok=True)
    except OSError as error:
        raise ParameterError(f"{path}: cannot be written ({error.strerror or error})") from error


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Return a folder for several files; where it is not there yet, make it and say so on standard error.

    Raises:
        OSError: it cannot be made.
    """
    folder = Path(path)
    if not folder.is_dir():
        folder.mkdir(parents=True)
        print(f"made the folder {folder}", file=sys.stderr)
    return folder


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text; a reader never sees half of it.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | os.PathLike[str], figures: Mapping[str, Any], *, compact: bool = False) -> Path:
    """Write figures as JSON; a reader never sees half a file.

    Args:
        path: the file.
        figures: no number of them may be NaN or infinite.
        compact: on one line, for files of megabytes.

    Returns:
        The file.

    Raises:
        ParameterError: the file cannot be written.
    """
    path = Path(path)
    try:
        layout: dict[str, Any] = {"separators": (",", ":")} if compact else {"indent": 1}
        write_text(path, json.dumps(figures, allow_nan=False, **layout) + "\n")
    except BrokenPipeError:
        raise  # its reader has gone, which is no fault of the path
    except OSError as error:
        raise ParameterError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


def _descriptor(path: Path) -> int | None:
    """Return the number of the open file that a path stands for, if it stands for one."""
    text = os.path.abspath(path)
    match = _DESCRIPTOR.match(text)
    return int(match.group(1)) if match else _STANDARD.get(text)


def _is_stream(path: Path) -> bool:
    """Tell whether a path leads to something that is written to, not replaced."""
    if _descriptor(path) is not None:
        return True
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


def _place(path: Path) -> Path:
    """Return where the file is or is to be, behind all symbolic links.

    Raises:
        OSError: it is a folder, or there is no end to its links.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    place = Path(os.path.realpath(path))
    if place.is_symlink():
        raise OSError(errno.ELOOP, "its symbolic links lead in a circle")
    return place


def _temporary(place: Path | None, suffix: str) -> Path:
    """Make an empty file beside a place, or in the system's folder for temporary ones."""
    if place is not None:
        try:
            handle, name = tempfile.mkstemp(prefix=".lime-planner-", suffix=suffix, dir=place.parent)
        except PermissionError:
            if not os.access(place, os.W_OK):  # also where it is not there
                raise
        else:
            umask = os.umask(0)
            os.umask(umask)
            os.fchmod(handle, 0o666 & ~umask)
            os.close(handle)
            return Path(name)
    handle, name = tempfile.mkstemp(prefix="lime-planner-", suffix=suffix)
    os.close(handle)
    return Path(name)


def _copy(source: Path, path: Path) -> None:
    """Write a finished file's content to what `path` stands for."""
    descriptor = _descriptor(path)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()  # what was printed before comes before
    with source.open("rb") as content, open(path if descriptor is None else os.dup(descriptor), "wb") as sink:
        shutil.copyfileobj(content, sink)
