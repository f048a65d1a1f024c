"""What the planner needs of the machine: Python, a folder for compiled kernels, a valid ROS environment, room for big clouds."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from importlib import resources, util
from pathlib import Path

from lime_planner.core.cache_folder import find_cache_folder
from lime_planner.doctor.findings import Finding, fault, ok, warning

_PYTHONS = ((3, 11), (3, 12))
_KERNELS_BYTES = 200_000_000  #: room that compiled kernels of a few versions take
#: Environment variables that name a Fast DDS profile, in the order in which it looks.
_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_PROFILE_FILE = "fastdds_big_clouds.xml"
_BIG_SEGMENT_BYTES = 8_000_000  #: a cloud of 500,000 points
_SHARED_MEMORY = Path("/dev/shm")
_HIGHEST_DOMAIN = 232
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")


def machine_findings(environ: Mapping[str, str] = os.environ) -> list[Finding]:
    """Check the machine itself."""
    return [_python(), _compiler(environ), _cache(environ)]


def environment_findings(environ: Mapping[str, str] = os.environ) -> list[Finding]:
    """Check what the environment tells ROS, and what big clouds need."""
    return [_domain(environ), _discovery_range(environ), _profile(environ), *_shared_memory()]


def _python() -> Finding:
    version = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] not in _PYTHONS:
        return fault("python", f"is {version}; needed is 3.11 or 3.12", "make setup PYTHON=/path/to/python3.12")
    return ok("python", f"{version} in {sys.prefix}")


def _compiler(environ: Mapping[str, str]) -> Finding:
    if environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return fault(
            "compiler", f"NUMBA_DISABLE_JIT is {environ['NUMBA_DISABLE_JIT']!r}: nothing can be planned", "unset NUMBA_DISABLE_JIT"
        )
    return ok("compiler", "Numba's, switched on")


def _cache(environ: Mapping[str, str]) -> Finding:
    """Check the folder of compiled kernels."""
    found, name = find_cache_folder(environ), "kernel cache"
    free = shutil.disk_usage(found.path).free
    kernels = sum(1 for _ in found.path.glob("kernels/*/*.nbc"))
    if not found.lasting:
        found.path.rmdir()
    if found.trouble:
        cure = "name a folder of your own in LIME_PLANNER_CACHE_DIR"
        what = f"{found.wanted or 'the usual folder'} is not used ({found.trouble})"
        if not found.lasting:
            return warning(name, f"{what}, nor any that lasts: every start compiles for a minute", cure)
        return warning(name, f"{what}, but {found.path}, which the next start of the machine may empty", cure)
    if free < _KERNELS_BYTES:
        return warning(
            name, f"only {free / 1e6:.0f} MB are free in {found.path}", "make room, or name a folder elsewhere in LIME_PLANNER_CACHE_DIR"
        )
    return ok(name, f"{found.path}, {kernels} compiled kernels" if kernels else f"{found.path}, empty: the first plan takes a minute")


def _domain(environ: Mapping[str, str]) -> Finding:
    text = environ.get("ROS_DOMAIN_ID", "")
    if text and not (text.isascii() and text.isdigit() and int(text) <= _HIGHEST_DOMAIN):
        return fault(
            "ROS domain",
            f"ROS_DOMAIN_ID is {text!r}",
            f"set a whole number from 0 to 101, the same for all nodes (limit {_HIGHEST_DOMAIN})",
        )
    return ok("ROS domain", f"{int(text) if text else 0}{'' if text else ' (ROS_DOMAIN_ID is not set)'}")


def _discovery_range(environ: Mapping[str, str]) -> Finding:
    name, text = "discovery", environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if text and text not in _RANGES:
        return fault(name, f"ROS_AUTOMATIC_DISCOVERY_RANGE is {text!r}", f"set one of {', '.join(_RANGES)}, or unset it")
    if text == "OFF":
        cure = "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST (this machine) or SUBNET (the network)"
        return fault(name, "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: no node finds another", cure)
    if environ.get("ROS_LOCALHOST_ONLY") == "1":
        cure = "unset it, and set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        return warning(name, "ROS_LOCALHOST_ONLY is deprecated, and overrides the discovery range", cure)
    reach = "this machine only" if text == "LOCALHOST" else "every machine of the network segment: set LOCALHOST for a trial"
    return ok(name, f"{text or 'SUBNET'}, {reach}")


def _profile(environ: Mapping[str, str]) -> Finding:
    """Check whether Fast DDS was told to make room for big clouds."""
    name = "cloud profile"
    middleware = environ.get("RMW_IMPLEMENTATION", "")
    if middleware and "fastrtps" not in middleware:
        return ok(name, f"not needed by {middleware}")
    variable = next((v for v in _PROFILES if environ.get(v)), "")
    shipped = shipped_profile()
    cure = f"export {_PROFILES[0]}={shlex.quote(str(shipped or 'config/' + _PROFILE_FILE))}"
    if not variable:
        return warning(name, f"none is set ({_PROFILES[0]}): big best-effort clouds get lost", cure)
    path = Path(environ[variable])
    try:
        tree = ET.parse(path)
    except OSError as error:
        return fault(name, f"{variable} names {path}: {error.strerror or error}", cure)
    except ET.ParseError as error:
        return fault(name, f"{variable} names {path}, which is no XML ({error})", cure)
    sizes = [int(text) for node in tree.iter() if node.tag.endswith("segment_size") and (text := (node.text or "").strip()).isdigit()]
    if max(sizes, default=0) < _BIG_SEGMENT_BYTES:
        return warning(name, f"{path} has no shared-memory segment of {_BIG_SEGMENT_BYTES / 1e6:.0f} MB or more", cure)
    return ok(name, f"{path}, segments of {max(sizes) / 1e6:.0f} MB")


def shipped_profile() -> Path | None:
    """Return where this installation has the Fast DDS profile for big clouds; None if it has none."""
    return next((path for path in _shared("config", _PROFILE_FILE) if path.is_file()), None)


def _shared(*parts: str) -> Iterator[Path]:
    """Yield where a file of the package's share folder may be: in an ament prefix, in pip's, beside the sources."""
    for prefix in filter(None, [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]):
        yield Path(prefix, "share", "lime_planner", *parts)
    if util.find_spec("lime_planner") is not None:
        yield Path(str(resources.files("lime_planner"))).parent.joinpath(*parts)


def _shared_memory() -> list[Finding]:
    """Check the room for shared memory, which containers keep small and killed processes leave full."""
    if not _SHARED_MEMORY.is_dir():
        return []
    name = "shared memory"
    usage = shutil.disk_usage(_SHARED_MEMORY)
    text = f"{_SHARED_MEMORY} has {usage.free / 1e6:.0f} of {usage.total / 1e6:.0f} MB free"
    left = sum(1 for _ in _SHARED_MEMORY.glob("fastrtps_*"))
    if usage.free < 2 * 67_108_864:  # two segments of the shipped profile
        cure = f"start the container with --shm-size=1g; with no node running, remove what killed nodes left: {_SHARED_MEMORY}/fastrtps_*"
        return [warning(name, f"{text}, {left} files of Fast DDS", cure)]
    return [ok(name, text)]
