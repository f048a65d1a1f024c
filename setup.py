"""Packaging. The list of Python dependencies below is the only one; version and description are read from package.xml."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from setuptools import find_packages, setup

NAME = "lime_planner"
HERE = Path(__file__).resolve().parent
MANIFEST = ET.parse(HERE / "package.xml").getroot()

INSTALL_REQUIRES = [
    "numpy>=1.26",
    "scipy>=1.11",
    "numba>=0.58",
    "PyYAML>=6.0",
    "pin>=3.3",  # Pinocchio, which reads URDFs, with Coal, which reads meshes
    "example-robot-data>=4.3",  # the Kinova j2s6s200's URDF and meshes
    "python-fcl>=0.7.0.8",  # exact collision checks
    "trimesh>=4.0",
    "toppra>=0.6.3",  # time parameterisation
    # Point clouds. The CPU build is a quarter of the download; it exists for Linux on x86-64 only.
    "open3d-cpu>=0.18; sys_platform == 'linux' and platform_machine == 'x86_64'",
    "open3d>=0.18; sys_platform != 'linux' or platform_machine != 'x86_64'",
    "matplotlib>=3.6",
    "rich>=13.0",
    "packaging>=23.0",  # `lime-planner doctor` reads this list
]

EXTRAS_REQUIRE = {
    # ROS 2 Jazzy as wheels, for machines without a ROS installation; never together with /opt/ros.
    "ros": ["ros-jazzy-rclpy[fastrtps]>=7.1", "ros-jazzy-common-interfaces>=5.3"],
    # The statistics of `lime-planner experiment`; its trials on other machines; the planners that `lime-planner bench` compares with.
    "experiments": ["pingouin>=0.7", "pandas>=2.3,<4"],
    "cluster": ["distributed>=2024.1"],
    "bench": ["ompl>=2.0"],
    # Recordings (rosbag2, as sqlite3 or MCAP) without ROS; the completion of `lime-planner` in bash and zsh.
    "bags": ["rosbags>=0.11"],
    "completion": ["shtab>=1.7"],
    # The 3-D page of `lime-planner view`; `lime-planner animate` into .mp4 (.gif needs nothing more).
    "viewer": ["viser>=1.1"],
    "video": ["imageio[ffmpeg]>=2.31"],
    # launch_testing's pytest plugin breaks on pytest 9.
    "test": [
        "pytest>=7.4,<9",
        "pytest-xdist>=3.5",
        "pytest-cov>=4.1",
        "hypothesis>=6.90",
        "ruff>=0.6",
        "mypy>=1.11",
        "scipy-stubs",
        "types-PyYAML",
        "playwright>=1.40",
    ],
    # The pages of docs/: MkDocs with Material, the Python reference, and the notebook, which the tests run.
    "docs": ["mkdocs-material>=9.5", "mkdocstrings[python]>=0.26", "nbconvert>=7.16", "nbclient>=0.10", "ipykernel>=6.29"],
    # setuptools 80 broke `colcon build --symlink-install`.
    "colcon": ["colcon-ros>=0.5", "colcon-bash>=0.5", "setuptools>=65,<80"],
}

CONSOLE_SCRIPTS = [
    "planner_node = lime_planner.ros.programs:planner_node",
    "mock_arm_node = lime_planner.ros.programs:mock_arm_node",
    "scene_node = lime_planner.ros.programs:scene_node",
    "lime-planner = lime_planner.cli.main:main",
]


def _text(tag: str) -> str:
    return " ".join((MANIFEST.findtext(tag) or "").split())


def _shared(folder: str) -> list[tuple[str, list[str]]]:
    # One entry for each folder below `folder`, to share/lime_planner as ament expects.
    found: dict[str, list[str]] = {}
    for path in sorted((HERE / folder).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            relative = path.relative_to(HERE)
            found.setdefault(f"share/{NAME}/{relative.parent}", []).append(str(relative))
    return list(found.items())


setup(
    name=NAME,
    version=_text("version"),
    description=_text("description"),
    long_description=(HERE / "README.md").read_text(encoding="utf-8") if (HERE / "README.md").is_file() else "",
    long_description_content_type="text/markdown",
    maintainer=_text("maintainer"),
    maintainer_email=MANIFEST.find("maintainer").get("email"),
    license=_text("license"),
    python_requires=">=3.11,<3.13",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", *(f"**/*.{kind}" for kind in ("urdf", "xml", "yaml", "json", "html", "css", "js"))]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *_shared("launch"),
        *_shared("config"),
        *_shared("rviz"),
        *_shared("foxglove"),
    ],
    zip_safe=False,
    install_requires=INSTALL_REQUIRES,
    extras_require=EXTRAS_REQUIRE,
    entry_points={"console_scripts": CONSOLE_SCRIPTS},
)
