"""The arms that need no file from the user: where their descriptions come from, and where they stand unless a start is given.

`kinova_j2s6s200` (spherical wrist, two fingers) is read from the package `example-robot-data`, which brings URDF and meshes.
`kinova_j2n6s300` (non-spherical wrist, three fingers) is described in `urdf/kinova_j2n6s300.urdf` of this package with primitive
shapes. Both have the root link `base` and the tool frame `<prefix>_end_effector` in the Kinova driver's convention: 0.16 m along
-z of link 6, turned by roll π, pitch 0, yaw π/2 there, so that +z points out of the palm.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources, util
from pathlib import Path

from lime_planner.core.errors import RobotError

#: Tool convention of both models, as a URDF's rpy [rad].
TOOL_RPY = "3.141592653589793 0 1.5707963267948966"


@dataclass(frozen=True)
class BuiltinArm:
    """A built-in model.

    Attributes:
        prefix: what the names of its joints and frames begin with.
        home: (6,) ready configuration [rad], within the limits and free of self-collision.
        endless: numbers of the joints that turn without end, from 1.
        fingers: joints of the hand and where they are when it is open [rad].
        source: file below example-robot-data's `robots` folder, or None for a URDF of this package.
    """

    prefix: str
    home: tuple[float, ...]
    endless: tuple[int, ...]
    fingers: dict[str, float]
    source: str | None

    @property
    def tool_frame(self) -> str:
        """Name of the tool frame."""
        return f"{self.prefix}_end_effector"

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the six joints in the driver's order."""
        return tuple(f"{self.prefix}_joint_{i}" for i in range(1, 7))

    @property
    def continuous(self) -> tuple[bool, ...]:
        """Which joints turn without end, as the model says once it is loaded."""
        return tuple(i in self.endless for i in range(1, 7))


_J2S6S200 = "kinova_description/robots/kinova.urdf"


def _fingers(prefix: str, count: int, at_base_rad: float, at_tip_rad: float) -> dict[str, float]:
    numbers = range(1, count + 1)
    bases = {f"{prefix}_joint_finger_{i}": at_base_rad for i in numbers}
    return bases | {f"{prefix}_joint_finger_tip_{i}": at_tip_rad for i in numbers}


# The second is the non-spherical arm's home in the driver's examples: 275°, 167°, 57°, 241°, 83°, 75°. Its fingers, at 0 wide apart, are
# bent so far that the tips are 9 cm apart.
BUILTIN_ARMS: dict[str, BuiltinArm] = {
    "kinova_j2s6s200": BuiltinArm(
        "j2s6s200", (4.7124, 2.8444, 1.3230, 4.6331, 2.0944, 1.5708), (1, 4, 6), _fingers("j2s6s200", 2, 0.0, 0.0), _J2S6S200
    ),
    "kinova_j2n6s300": BuiltinArm(
        "j2n6s300", (4.7997, 2.9147, 0.9948, 4.2062, 1.4486, 1.3090), (1, 4, 5, 6), _fingers("j2n6s300", 3, 0.7, 0.3), None
    ),
}


def read_builtin(name: str) -> tuple[str, Path]:
    """Return a built-in model's URDF text as it is shipped, and the folder its relative mesh paths start from.

    Raises:
        RobotError: an unknown name, or example-robot-data is not installed.
    """
    arm = BUILTIN_ARMS.get(name)
    if arm is None:
        raise RobotError(f"there is no built-in robot {name!r}; there are {', '.join(BUILTIN_ARMS)}")
    if arm.source is None:
        resource = resources.files("lime_planner.robot") / "urdf" / f"{name}.urdf"
        return resource.read_text(encoding="utf-8"), Path(str(resource)).parent
    for share in share_directories():
        path = share / "example-robot-data" / "robots" / arm.source
        if path.is_file():
            return path.read_text(encoding="utf-8"), path.parent
    raise RobotError(f"the model of {name} was not found: install it with `pip install example-robot-data` next to pinocchio (pip's `pin`)")


def demo_arm() -> tuple[str, str]:
    """Return the built-in arm to show things with, and why it is not the default one; empty where it is.

    The default's meshes come with a package that ROS and Ubuntu do not have; the other arm needs no file from outside.
    """
    first, second = BUILTIN_ARMS
    try:
        read_builtin(first)
    except RobotError as error:
        return second, f"{error}; the demo takes {second}, which needs no meshes"
    return first, ""


def share_directories() -> Iterator[Path]:
    """Yield the folders in which `package://NAME/...` may be found, each with packages as its subfolders.

    Those are the `share` folders of pip's cmeel prefix (example-robot-data), of every prefix in `AMENT_PREFIX_PATH` (a sourced
    ROS 2), and the folders in `ROS_PACKAGE_PATH`.
    """
    seen: set[Path] = set()
    for folder in _share_candidates():
        if folder not in seen and folder.is_dir():
            seen.add(folder)
            yield folder


def _share_candidates() -> Iterator[Path]:
    pinocchio = util.find_spec("pinocchio")
    if pinocchio is not None and pinocchio.origin is not None:
        for parent in Path(pinocchio.origin).resolve().parents:
            if parent.name == "cmeel.prefix":
                yield parent / "share"
    for entry in sys.path:
        if entry.endswith(("site-packages", "dist-packages")):
            yield Path(entry) / "cmeel.prefix" / "share"
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(prefix) / "share"
    for folder in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
        yield Path(folder)
