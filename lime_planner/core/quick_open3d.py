"""Open3D without what only its viewers and its machine learning need, until somebody asks for those."""

from __future__ import annotations

import importlib.util
import sys
import threading
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

_UNUSED = ("open3d.visualization", "open3d.ml")
_lock = threading.Lock()


class _Later:
    """Finds the unused parts as modules that are imported when an attribute of theirs is first asked for."""

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder.find_spec`."""
        spec = PathFinder.find_spec(name, path, target) if name in _UNUSED else None
        if spec is not None and spec.loader is not None:
            spec.loader = importlib.util.LazyLoader(spec.loader)
        return spec


def open3d() -> Any:
    """Return the module `open3d`.

    Its viewers import dash, plotly, IPython and more, which takes a second or two and 40 MB: they are put off until a program uses them.
    """
    with _lock:
        if "open3d" not in sys.modules:
            later = _Later()
            sys.meta_path.insert(0, later)
            try:
                import open3d  # noqa: F401
            finally:
                sys.meta_path.remove(later)
    return sys.modules["open3d"]
