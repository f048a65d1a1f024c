"""One decorator for every compiled kernel, with an on-disk cache that cannot go stale.

Numba keys its cache on the file that holds a function, not on the files of the functions it calls: after an edit of a callee in
another module the caller would go on running the old code. The cache directory's name therefore carries a hash of every source
file of the package, so that any edit starts a new directory, and the directories of earlier versions are removed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numba
import numba.extending

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).resolve().parents[1]
_KEPT_DIRECTORIES = 3  # more than one: two checkouts, or two Python versions, may share a user's cache


def cache_root() -> Path:
    """Return the folder below which the package may write caches.

    `LIME_PLANNER_CACHE_DIR` if set, else `$XDG_CACHE_HOME/lime_planner`, else `~/.cache/lime_planner`; a private folder of the
    system's temporary directory where that cannot be written (a service account without a home).
    """
    named = os.environ.get("LIME_PLANNER_CACHE_DIR")
    if named:
        root = Path(named)
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lime_planner"
    try:
        root.mkdir(parents=True, exist_ok=True)
        if os.access(root, os.W_OK):
            return root
    except OSError:
        pass
    root = Path(tempfile.gettempdir()) / f"lime_planner-{os.getuid()}"
    root.mkdir(mode=0o700, parents=True, exist_ok=True)
    return root


def _source_hash() -> str:
    digest = hashlib.sha256(f"{numba.__version__} {sys.version_info[:2]}".encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        text = path.read_bytes()
        if b"kernel\n" in text or b"@overload" in text or path.name == "jit.py":
            digest.update(str(path.relative_to(_PACKAGE)).encode())
            digest.update(text)
    return digest.hexdigest()[:16]


def _prepare_cache() -> str:
    root = cache_root()
    directory = root / f"numba-{_source_hash()}"
    if not directory.exists():
        directory.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(OSError):
            old = sorted(root.glob("numba-*"), key=lambda p: p.stat().st_mtime, reverse=True)
            for stale in old[_KEPT_DIRECTORIES:]:
                shutil.rmtree(stale, ignore_errors=True)
    return str(directory)


_CACHE_DIRECTORY = _prepare_cache()

#: Compiler options of every kernel: no GIL (services stay responsive), NaN and inf kept meaningful, fused multiply-add.
JIT_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}


@contextlib.contextmanager
def _our_cache() -> Iterator[None]:
    # Numba reads the directory when a function is decorated; other users of Numba in this process keep theirs.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _CACHE_DIRECTORY
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def kernel(function: F) -> F:
    """Compile `function` with Numba: no Python objects, no GIL, cached on disk under a hash of the package's sources."""
    with _our_cache():
        return numba.njit(cache=True, **JIT_OPTIONS)(function)  # type: ignore[no-any-return]


def hot_kernel(function: F) -> F:
    """Compile like `kernel`, but without reference counts: for the innermost functions, which take and pass on many arrays.

    Counting references of the arrays inside a named tuple costs atomic additions at every call, several times the work itself.
    Such a function must not allocate or return arrays; its callers keep them alive.
    """
    with _our_cache():
        return numba.njit(cache=True, _nrt=False, **JIT_OPTIONS)(function)  # type: ignore[no-any-return]


def inline_kernel(function: F) -> F:
    """Compile like `hot_kernel`, but merged into each caller, so that named tuples of many arrays are not copied at the call."""
    with _our_cache():
        return numba.njit(cache=True, forceinline=True, _nrt=False, **JIT_OPTIONS)(function)  # type: ignore[no-any-return]


def c_function(signature: Any, function: Callable[..., Any]) -> Any:
    """Compile `function` as a C function with an address (slow the first time, then read from the cache; keep the result alive)."""
    with _our_cache():
        return numba.cfunc(signature, cache=True, _nrt=False, **JIT_OPTIONS)(function)


def overload(stub: Callable[..., Any]) -> Callable[[F], F]:
    """Register a compiled implementation of `stub` for one type of space (see `lime_planner.planning.space`)."""
    return numba.extending.overload(stub, jit_options=dict(JIT_OPTIONS))  # type: ignore[no-any-return]
