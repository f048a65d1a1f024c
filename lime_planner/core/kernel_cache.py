"""Where compiled kernels lie on disk, and under which name, so that none is ever stale and an edit recompiles only what it concerns.

Numba keys its cache on the file that holds a function, not on the files of the functions that it calls: after an edit of a callee in
another module the caller would go on running the old code. Here each source file with kernels has a folder whose name carries a hash
of everything that its kernels can be made of: the file, compiled code of the project that it imports, directly or not; a planner calls
a space's functions by their address, so that neither is made of the other. Nothing in the name depends on where the
package lies, so that two checkouts of the same sources share what was compiled.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba.core import caching
from numba.core.types import BaseNamedTuple

from lime_planner.core.cache_folder import cache_root

_PACKAGE = Path(__file__).resolve().parents[1]
#: Folders that hold kernels: the package, and in a checkout what measures it.
_SOURCES = (_PACKAGE, _PACKAGE.parent / "benchmarks")
_KEPT_VERSIONS = 3  # of one file's kernels, however old
_UNUSED_S = 7 * 86400.0  # what was used since then is kept too: several checkouts may share a user's cache
_IMPORT = re.compile(r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n(]+)|import[ \t]+([\w., ]+))", re.MULTILINE)


@cache
def _texts() -> dict[str, bytes]:
    """Sources of the project by the dotted name of their module."""
    found = {}
    for top in _SOURCES:
        for path in top.rglob("*.py"):
            parts = path.relative_to(top.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path.read_bytes()
    return found


@cache
def _imports(module: str) -> frozenset[str]:
    """Modules of the project that a module imports, wherever in its text."""
    known, found = _texts(), set()
    for base, names, plain in _IMPORT.findall(_texts()[module].decode("utf-8", "replace")):
        for name in (plain or names).strip("()").split(","):
            word = name.split()[0] if name.split() else ""
            found |= {other for other in (word, base, f"{base}.{word}") if other in known}
    return frozenset(found)


def _ingredients(module: str) -> set[str]:
    """The files that the kernels of a module can be made of.

    Of all that it imports, directly or not, these are the files with compiled code, those that they import themselves (a constant is
    compiled in), and those that define named tuples, whose fields a compiled function takes apart.
    """
    found: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting.extend(_imports(name))
    texts = _texts()
    compiled = {name for name in found if b"kernel\n" in texts[name]} | {module}
    direct = {other for name in compiled for other in _imports(name)}
    return compiled | direct | {name for name in found if b"NamedTuple" in texts[name]}


@cache
def _hash_of(module: str | None) -> str:
    """Hash of what the kernels of a module are made of; of the whole project for a file outside of it (None)."""
    digest = hashlib.sha256(f"{numba.__version__} {sys.version_info[:2]}".encode())
    for name in sorted(_texts() if module is None else _ingredients(module)):
        digest.update(name.encode())
        digest.update(_texts()[name])
    return digest.hexdigest()[:16]


def _module_at(path: Path) -> str | None:
    for top in _SOURCES:
        if path.is_relative_to(top):
            return ".".join(path.relative_to(top.parent).with_suffix("").parts)
    return None


@cache
def kernel_folder(path: str) -> Path:
    """Return the folder for the compiled kernels of a source file, and remove those of versions long gone.

    Args:
        path: the source file.
    """
    source = Path(path).resolve()
    module = _module_at(source)
    # A file outside the package, with kernels of this package's kind: told from others by its path.
    name = module or f"{source.stem}-{hashlib.sha256(str(source).encode()).hexdigest()[:8]}"
    root = cache_root() / "kernels"
    folder = root / f"{name}-{_hash_of(module)}"
    if not folder.is_dir():
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            versions = [other for other in root.glob(f"{name}-*") if re.fullmatch(r"[0-9a-f]{16}", other.name[len(name) + 1 :])]
            old = sorted(versions, key=lambda p: p.stat().st_mtime, reverse=True)[_KEPT_VERSIONS:]
            old = [version for version in old if version.stat().st_mtime < time.time() - _UNUSED_S]
            for stale in (*old, *cache_root().glob("numba-*")):  # the latter: what version 0.1 left behind
                shutil.rmtree(stale, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            os.utime(folder)  # used today
    return folder


def _mark() -> Path:
    """The file that says that all kernels are compiled, as they are now."""
    kernels = (name for name, text in _texts().items() if name.startswith("lime_planner.") and b"kernel\n" in text)
    digest = hashlib.sha256("".join(_hash_of(name) for name in sorted(kernels)).encode())
    return cache_root() / "kernels" / f"complete-{digest.hexdigest()[:16]}"


def all_compiled() -> bool:
    """Tell whether all kernels of the package were compiled (`note_all_compiled`) as they are now."""
    return _mark().exists()


def note_all_compiled() -> None:
    """Note that all kernels are compiled; notes about versions long gone are removed."""
    mark = _mark()
    with contextlib.suppress(OSError):
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
        for stale in sorted(mark.parent.glob("complete-*"), key=lambda p: p.stat().st_mtime, reverse=True)[_KEPT_VERSIONS:]:
            stale.unlink()


# Numba's own class for a folder that the user names; it had another name before 0.62.
_Locator: Any = getattr(caching, "UserProvidedCacheLocator", None) or getattr(caching, "_UserProvidedCacheLocator", object)


@cache
def _ensure_writable(folder: str) -> None:
    os.makedirs(folder, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()


class KernelLocator(_Locator):
    """Tells Numba where the kernels of a source file lie: in `kernel_folder`, wherever the file itself is."""

    def __init__(self, py_func: FunctionType, py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(kernel_folder(py_file))

    def ensure_cache_path(self) -> None:
        """Find out whether the folder can be written; once for all of a file's functions, which each process has three hundred of."""
        _ensure_writable(self._cache_path)

    def get_source_stamp(self) -> str:
        """Return the same for ever: the folder's name already tells versions apart, and the time of a checkout says nothing."""
        return "by the folder's name"


def _words(numba_type: Any) -> str:
    """A compile-time type in words that tell named tuples apart by class and fields."""
    if not isinstance(numba_type, BaseNamedTuple):
        return repr(numba_type)
    named = numba_type.instance_class
    parts = (f"{name}: {_words(part)}" for name, part in zip(numba_type.fields, numba_type.types, strict=True))
    return f"{named.__module__}.{named.__qualname__}({', '.join(parts)})"


class KernelFiles(caching.IndexDataCacheFile):
    """The files of one function's compiled versions, each named by a hash of the types that it is for.

    Numba's own class numbers them and keeps an index: two processes that compile at the same time may give one number to two versions, and
    an index that another checkout has written names types that are not here.
    """

    def _file_of(self, key: Any) -> str:
        stem = self._index_name.removesuffix(".nbi")
        types, *rest = key
        words = repr(([_words(part) for part in types] if isinstance(types, tuple) else types, rest))
        return f"{stem}.{hashlib.sha256(words.encode()).hexdigest()[:16]}.nbc"

    def flush(self) -> None:
        """Do nothing: what is on the disk is right."""

    def save(self, key: Any, data: Any) -> None:
        """Write a version."""
        self._save_data(self._file_of(key), data)

    def load(self, key: Any) -> Any:
        """Read a version, None where there is none, or none that can be read here."""
        try:
            return self._load_data(self._file_of(key))
        except Exception:  # whatever unpickling raises: it is compiled again
            return None


def use_kernel_files(compiled: Any) -> Any:
    """Let a decorated function read and write its versions through `KernelFiles`, and return it."""
    cache_of_function = getattr(compiled, "_cache", None)
    files = getattr(cache_of_function, "_cache_file", None)
    if type(files) is caching.IndexDataCacheFile:
        files.__class__ = KernelFiles
    return compiled


@contextlib.contextmanager
def kernel_cache(function: Callable[..., Any]) -> Iterator[None]:
    """Have Numba cache what is decorated inside in this package's folders; other users of Numba in the process keep theirs.

    Args:
        function: what is about to be compiled.
    """
    config, implementation = numba.config, caching.CacheImpl
    before = config.CACHE_DIR, getattr(config, "CACHE_LOCATOR_CLASSES", ""), getattr(implementation, "_locator_classes", None)
    config.CACHE_DIR = str(kernel_folder(function.__code__.co_filename))
    if before[2] is not None and _Locator is not object:  # else the folders are as safe, but each checkout has its own
        config.CACHE_LOCATOR_CLASSES, implementation._locator_classes = "", [KernelLocator]
    try:
        yield
    finally:
        config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES, implementation._locator_classes = before
