"""What reading a robot's description gives, on disk: Pinocchio, meshes and a sample of collisions take longer than a plan."""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from lime_planner.core.atomic_files import replacing
from lime_planner.core.cache_folder import cache_root

T = TypeVar("T")

_UNUSED_S = 7 * 86400.0  # what was not used for longer is removed when something is written


def stored(description: str, choices: object, read: Callable[[], T]) -> T:
    """Return what `read` returns, from the package's cache where the same description was read before.

    Args:
        description: a URDF with mesh files as absolute paths; their contents count, not their names.
        choices: what else the result depends on; its `repr` tells.
        read: reads the description. What it raises is raised, and nothing is stored then.
    """
    digest = hashlib.sha256(repr((description, choices)).encode())
    try:
        for source in sorted(Path(__file__).parent.glob("*.py")):  # of the code that reads as well
            digest.update(source.read_bytes())
        for mesh in ET.fromstring(description).iter("mesh"):
            digest.update(hashlib.sha256(Path(mesh.get("filename", "")).read_bytes()).digest())
    except OSError:  # let whoever reads the meshes say so
        return read()
    path = cache_root() / f"arm-{digest.hexdigest()[:24]}.pickle"
    with contextlib.suppress(Exception):  # not there, half-written, or of another version of NumPy: read again
        found: T = pickle.loads(path.read_bytes())
        with contextlib.suppress(OSError):
            os.utime(path)  # used today
        return found
    made = read()
    with contextlib.suppress(OSError), replacing(path) as temporary:  # a full disk: do without
        temporary.write_bytes(pickle.dumps(made))
    for other in cache_root().glob("arm-*.pickle"):
        with contextlib.suppress(OSError):
            if other.stat().st_mtime < time.time() - _UNUSED_S:
                other.unlink()
    return made
