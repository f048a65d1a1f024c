"""Print what pip has to install where a ROS 2 is sourced: the package's requirements without what ROS already brings.

ROS's Pinocchio and the system's NumPy belong together (one is compiled against the other). So where ROS has Pinocchio, it is used,
and NumPy stays as it is; pip's Pinocchio would ask for another NumPy.

Usage: python requirements_beside_ros.py EXTRA,EXTRA   (after `pip install --no-deps` of the package)
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from pathlib import Path

from pip._vendor.packaging.requirements import Requirement

#: Import names of the requirements that ROS 2 Jazzy has packages of.
IN_ROS = {"pin": "pinocchio", "toppra": "toppra"}


def brought_by_ros(module: str) -> bool:
    """Tell whether a module comes from outside this environment."""
    spec = importlib.util.find_spec(module)
    return spec is not None and spec.origin is not None and Path(sys.prefix) not in Path(spec.origin).parents


def main() -> None:
    """Print one requirement a line."""
    extras = sys.argv[1].split(",")
    for text in importlib.metadata.requires("lime_planner") or []:
        requirement = Requirement(text)
        wanted = requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in ["", *extras])
        name = requirement.name.lower().replace("_", "-")
        if wanted and not (name in IN_ROS and brought_by_ros(IN_ROS[name])):
            requirement.marker = None
            print(requirement)
    if brought_by_ros("pinocchio") and brought_by_ros("numpy"):
        print(f"numpy=={importlib.metadata.version('numpy')}")


if __name__ == "__main__":
    main()
