"""Real scans of tomato plants: the TomatoWUR data set, obtained through pip and converted.

Source: van Marrewijk et al., Data in Brief 61 (2025) 111852; the source distribution `tomatowur` carries five plants seen by 15
cameras, each point with the class that a network gave it: 0 leaf, 1 main stem, 2 stake, 3 side stem, 4 node. Their licence is
not this package's, so they are fetched and never shipped.
"""

from __future__ import annotations

import dataclasses
import io
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import numpy as np

from lime_planner.core.atomic_files import make_folder
from lime_planner.core.errors import SceneError
from lime_planner.core.types import Array, Int64
from lime_planner.scene.scene import Scene

VERSION = "1.3.7"
SHA256 = "1d136bd95edd7824ca2ea265465ee56d568ed934a3ae675e4eca7e10fff91f5f"
LICENCE_FILE = "LICENSE_tomatowur.txt"
SUMMARY = (
    "TomatoWUR, real potted tomato plants (van Marrewijk et al., Data in Brief 61 (2025) 111852), licensed under the GNU General "
    f"Public License, version 3; its text is in {LICENCE_FILE} beside the scans. Cite the article when you publish with them."
)

_SCAN = re.compile(r"[^/]+/Resources/output_semantic_segmentation/Harvest_(\d+)_PotNr_(\d+)\.txt")
_LICENCE = re.compile(r"[^/]+/LICENSE")
_LEAF, _MAIN_STEM, _STAKE, _SIDE_STEM, _NODE = range(5)
_MAX_MEMBER_BYTES = 200_000_000
_TIMEOUT_S = 600.0


@dataclasses.dataclass(frozen=True)
class Obtained:
    """What was written: the scans (`.npz`), the licence's text, and one paragraph on source and licence."""

    scans: tuple[Path, ...]
    licence: Path
    summary: str = SUMMARY


def obtain(directory: str | os.PathLike[str]) -> Obtained:
    """Download the scans through pip and write them to `directory` as scene files, with their licence.

    pip has no way to download a source distribution without preparing its metadata, which runs the package's build backend.
    So the archive is pinned by its SHA-256: nothing runs but what was looked at. The environment's own setuptools is tried first
    (5 s); where it has none, pip sets up a build environment of its own (about 40 s).

    Raises:
        SceneError: there is no pip, no network, or no room; one sentence says which.
    """
    with tempfile.TemporaryDirectory(prefix="lime_planner-") as folder:
        return convert(_download(Path(folder)), directory)


def convert(archive: str | os.PathLike[str], directory: str | os.PathLike[str]) -> Obtained:
    """Convert the scans in a downloaded source distribution to scene files in `directory`; nothing else is unpacked.

    Each scan keeps every point, moved so that the main stem's foot is above the origin and the lowest point at height 0, z up.
    Stems, nodes and the stake become impermeable points.

    Raises:
        SceneError: the archive cannot be read, holds no scans or no licence, or a scan has an unexpected layout.
    """
    archive, directory = Path(archive), Path(directory)
    scans: list[Path] = []
    licence: Path | None = None
    try:
        make_folder(directory)
        with tarfile.open(archive, "r:gz") as tar:
            for member in tar:
                scan = _SCAN.fullmatch(member.name)
                if not member.isfile() or not (scan or _LICENCE.fullmatch(member.name)):
                    continue
                content = tar.extractfile(member)
                if content is None or member.size > _MAX_MEMBER_BYTES:
                    raise SceneError(f"{archive}: {member.name} has {member.size} bytes, more than {_MAX_MEMBER_BYTES}")
                if scan:
                    path = directory / f"tomato_wur_h{int(scan[1]):02d}p{int(scan[2])}.npz"
                    _scan_to_scene(content.read(), member.name).save(path)
                    scans.append(path)
                else:
                    licence = directory / LICENCE_FILE
                    licence.write_bytes(content.read())
    except (tarfile.TarError, OSError, EOFError) as error:
        raise SceneError(f"{archive.name} cannot be converted to scenes in {directory} ({error})") from error
    if not scans or licence is None:
        raise SceneError(f"{archive}: holds {len(scans)} scans and {'a' if licence else 'no'} licence; both are needed")
    return Obtained(tuple(sorted(scans)), licence)


def _scan_to_scene(text: bytes, name: str) -> Scene:
    header, _, body = text.partition(b"\n")
    if header.strip() != b"x,y,z,class_pred":
        raise SceneError(f"{name}: its columns are {header[:80].decode(errors='replace')!r}, expected 'x,y,z,class_pred'")
    try:
        table = np.loadtxt(io.BytesIO(body), delimiter=",", ndmin=2)
    except ValueError as error:
        raise SceneError(f"{name}: {error}") from error
    if not len(table) or table.shape[1] != 4:
        raise SceneError(f"{name}: holds a table of shape {table.shape}, expected (N, 4)")
    points, classes = table[:, :3], table[:, 3].astype(np.int64)
    points = points - _foot(points, classes)
    stake = classes == _STAKE
    return Scene.from_points(
        points[~stake],
        classes[~stake],
        leaf_labels=(_LEAF,),
        stem_labels=(_MAIN_STEM, _SIDE_STEM, _NODE),
        fruit_labels=(),
        stake_points=points[stake],
    )


def _foot(points: Array, classes: Int64) -> Array:
    """Return the middle of the main stem's lowest 2 cm (x, y) at the height of the scan's lowest point (z), (3,) [m]."""
    stem = points[classes == _MAIN_STEM]
    if not len(stem):
        stem = points
    # Single mislabelled points far below the stem must not become its foot.
    x, y = np.median(stem[stem[:, 2] <= np.quantile(stem[:, 2], 0.002) + 0.02, :2], axis=0)
    return np.array([x, y, points[:, 2].min()])


def _download(folder: Path) -> Path:
    requirement = folder / "requirement.txt"
    requirement.write_text(f"tomatowur=={VERSION} --hash=sha256:{SHA256}\n", encoding="ascii")
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--no-binary", ":all:", "--disable-pip-version-check", "--no-input"]
    command += ["--retries", "2", "--timeout", "20", "--dest", str(folder), "--requirement", str(requirement)]
    said = ""
    for isolation in (["--no-build-isolation"], []):
        try:
            done = subprocess.run([*command, *isolation], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise SceneError(f"the TomatoWUR scans were not downloaded within {_TIMEOUT_S:.0f} s") from error
        except OSError as error:
            raise SceneError(f"pip could not be started with {sys.executable} ({error})") from error
        archives = sorted(folder.glob("tomatowur-*.tar.gz"))
        if done.returncode == 0 and archives:
            return archives[0]
        said = _reason(done.stderr)
        if "No module named pip" in said:
            raise SceneError(f"{sys.executable} has no pip, which downloads the TomatoWUR scans; install it with python -m ensurepip")
        if "No matching distribution" in said or "HASHES" in said:
            break  # a build environment of its own would not help
    raise SceneError(f"the TomatoWUR scans could not be downloaded, is there a network? pip says: {said}")


def _reason(stderr: str) -> str:
    """Return the line of pip's output that says most: the one on a wrong hash, else its last error, else its last line."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    errors = [line.removeprefix("ERROR: ") for line in lines if line.startswith("ERROR: ")]
    wrong = [line for line in errors if "HASHES" in line]
    return (wrong or errors[-1:] or lines[-1:] or ["nothing"])[0]
