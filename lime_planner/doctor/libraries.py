"""Which Python libraries are installed, in which versions, and whether they can be loaded at all.

What is needed is read from the installed package's own metadata, and so from the one list in setup.py. Every library is imported in
a process of its own: one that is there may still lack a system library, or take the interpreter down with it.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lime_planner.doctor.findings import Finding, fault, ok

if TYPE_CHECKING:
    from packaging.requirements import Requirement

PACKAGE = "lime_planner"

#: Import names that differ from the names of the distributions.
_IMPORT_NAMES = {"pin": "pinocchio", "python-fcl": "fcl", "open3d-cpu": "open3d", "pyyaml": "yaml"}
#: Distributions without a Python module: files that `lime_planner.robot.builtin` looks for.
_DATA = {"example-robot-data"}
#: Extras that are no user's business, and ROS, which has checks of its own.
_OTHER_EXTRAS = {"ros", "test", "colcon", "docs"}

_TIMEOUT_S = 120.0
_PROBE = """
import importlib, sys
for name in sys.argv[1:]:
    print("begin", name, flush=True)
    try:
        module = importlib.import_module(name)
    except BaseException as error:
        text = " ".join(str(error).split())
        print("failed", name, f"{type(error).__name__}: {text}", flush=True)
    else:
        print("loaded", name, getattr(module, "__version__", ""), flush=True)
"""


@dataclass(frozen=True)
class Loaded:
    """How an import went: the module's own version, or why it failed."""

    version: str = ""
    failure: str = ""


def library_findings() -> list[Finding]:
    """Check every library that the package requires, and the extras."""
    try:
        metadata = importlib.metadata.metadata(PACKAGE)
        requires = importlib.metadata.requires(PACKAGE) or []
    except importlib.metadata.PackageNotFoundError:
        return [fault(PACKAGE, "its installation has no metadata", "install it: pip install .")]
    from packaging.requirements import Requirement

    requirements = [Requirement(text) for text in requires]
    findings = [ok(PACKAGE, f"version {metadata['Version']} in {_folder()}")]
    findings += _required([r for r in requirements if r.marker is None or r.marker.evaluate({"extra": ""})])
    for extra in metadata.get_all("Provides-Extra") or []:
        if extra not in _OTHER_EXTRAS:
            mine = [r for r in requirements if r.marker is not None and _belongs(r, extra)]
            findings.append(_of_extra(extra, mine))
    return findings


def probe(modules: Sequence[str]) -> dict[str, Loaded]:
    """Import modules in a process of its own; one that crashes is named, and the others are tried without it."""
    found: dict[str, Loaded] = {}
    waiting = list(modules)
    while waiting:
        try:
            done = subprocess.run([sys.executable, "-c", _PROBE, *waiting], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
            output, end = done.stdout, _end_in_words(done.returncode)
        except subprocess.TimeoutExpired as expired:
            output = bytes(expired.stdout or b"").decode(errors="replace")  # bytes, whatever `text` says
            end = f"did not finish loading within {_TIMEOUT_S:g} s"
        began = ""
        for line in output.splitlines():
            word, _, rest = line.partition(" ")
            name, _, text = rest.partition(" ")
            if word == "begin":
                began = name
            elif word == "loaded":
                found[name] = Loaded(version=text)
            elif word == "failed":
                found[name] = Loaded(failure=text)
        if began not in found:  # the process ended while it was loading this one (or, without any line, before the first)
            found[began or waiting[0]] = Loaded(failure=end)
        waiting = [name for name in waiting if name not in found]
    return found


def _end_in_words(code: int) -> str:
    if code >= 0:
        return f"ended the interpreter with code {code}"
    return f"crashed the interpreter ({signal.Signals(-code).name})"


def _folder() -> str:
    spec = importlib.util.find_spec(PACKAGE)
    places = list(spec.submodule_search_locations or []) if spec is not None else []
    return places[0] if places else "an unknown folder"


def _belongs(requirement: Requirement, extra: str) -> bool:
    marker = requirement.marker
    return marker is not None and marker.evaluate({"extra": extra}) and not marker.evaluate({"extra": ""})


def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _required(requirements: Iterable[Requirement]) -> list[Finding]:
    requirements = list(requirements)
    names = {r.name: _IMPORT_NAMES.get(r.name.lower(), r.name.lower().replace("-", "_")) for r in requirements}
    loaded = probe([names[r.name] for r in requirements if r.name.lower() not in _DATA])
    return [_robot_data(r) if r.name.lower() in _DATA else _judge(r, loaded[names[r.name]]) for r in requirements]


def _judge(requirement: Requirement, loaded: Loaded) -> Finding:
    name, advice = requirement.name, f"pip install '{requirement.name}{requirement.specifier}'"
    if loaded.failure:
        missing = loaded.failure.startswith("ModuleNotFoundError") and not _version(name)
        sentence = "is not installed" if missing else f"cannot be loaded: {loaded.failure}"
        cure = advice if missing else f"install what it asks for, or install it again: {advice} --force-reinstall"
        return fault(name, sentence, cure)
    version = _version(name) or loaded.version
    if version and not requirement.specifier.contains(version, prereleases=True):
        return fault(name, f"is of version {version}, needed is {requirement.specifier}", advice)
    return ok(name, version or "of unknown version")


def _robot_data(requirement: Requirement) -> Finding:
    from lime_planner.core.errors import RobotError
    from lime_planner.robot.builtin import BUILTIN_ARMS, read_builtin

    try:
        for robot in BUILTIN_ARMS:
            read_builtin(robot)
    except RobotError as error:
        return fault(requirement.name, str(error), f"pip install '{requirement.name}{requirement.specifier}'")
    return ok(requirement.name, _version(requirement.name) or "of unknown version")


def _of_extra(extra: str, requirements: list[Requirement]) -> Finding:
    versions = {r.name: _version(r.name) for r in [*requirements, *_of_their_extras(requirements)]}
    missing = [name for name, version in versions.items() if not version]
    if missing:
        command = f"pip install '{PACKAGE}[{extra}]'"
        return ok(f"[{extra}]", f"optional, without {', '.join(missing)}: {command} brings it")
    return ok(f"[{extra}]", ", ".join(f"{name} {version}" for name, version in versions.items()))


def _of_their_extras(requirements: Iterable[Requirement]) -> list[Requirement]:
    """Return what the installed ones of some requirements need for the extras that are asked of them: a plug-in is no part of its host."""
    from packaging.requirements import Requirement

    found = []
    for requirement in requirements:
        if requirement.extras and _version(requirement.name):
            theirs = [Requirement(text) for text in importlib.metadata.requires(requirement.name) or []]
            found += [needed for needed in theirs if any(_belongs(needed, extra) for extra in requirement.extras)]
    return found
