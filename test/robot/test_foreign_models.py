"""Descriptions as other people's tools write them: units, axes, encodings, soft limits, xacro, paths and the tool's frame."""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lime_planner.core.errors import RobotError
from lime_planner.robot.joint_limits import DEFAULT_VELOCITY
from lime_planner.robot.model import Robot, load_robot, robot_from_urdf

EXTENTS = np.array([0.1, 0.2, 0.4])
LOW, HIGH = np.array([-0.05, -0.1, 0.0]), np.array([0.05, 0.1, 0.4])

ONE_JOINT = """<robot name="r"><link name="base"/><link name="arm"><collision><geometry>{shape}</geometry></collision></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1.5" velocity="1" effort="1"/>{joint}</joint>{rest}</robot>"""
BOX = '<box size="0.1 0.2 0.4"/>'


def arm(shape: str = BOX, joint: str = "", rest: str = "") -> str:
    return ONE_JOINT.format(shape=shape, joint=joint, rest=rest)


def box_mesh() -> trimesh.Trimesh:
    """A box that stands on the origin, of three different lengths, so that every turn shows."""
    box = trimesh.creation.box(extents=EXTENTS)
    box.apply_translation([0, 0, 0.2])
    return box


def collada(factor: float, asset: str, order: list[int] | None = None, signs: list[int] | None = None) -> str:
    box = box_mesh()
    vertices = np.asarray(box.vertices)[:, order or [0, 1, 2]] * (signs or [1, 1, 1]) * factor
    numbers = " ".join(f"{x:.9g}" for x in vertices.ravel())
    corners = " ".join(str(i) for i in box.faces.ravel())
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{asset}</asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="{vertices.size}">{numbers}</float_array>
<technique_common><accessor source="#a" count="{len(vertices)}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="{len(box.faces)}">
<input semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def link_of(folder: Path, mesh: str, scale: str = "") -> Robot:
    attribute = f' scale="{scale}"' if scale else ""
    return robot_from_urdf(arm(f'<mesh filename="{mesh}"{attribute}/>'), base_dir=folder)


def bounds(robot: Robot) -> np.ndarray:
    vertices = robot.links[0].vertices
    return np.array([vertices.min(axis=0), vertices.max(axis=0)])


@pytest.mark.parametrize(
    ("factor", "asset", "order", "signs"),
    [
        (1.0, '<unit name="meter" meter="1"/><up_axis>Z_UP</up_axis>', None, None),
        (100.0, '<unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis>', None, None),
        (1000.0, '<unit meter="1e-3"/><up_axis> z_up </up_axis>', None, None),
        (1 / 0.0254, '<unit name="inch" meter="0.0254"/><up_axis>Z_UP</up_axis>', None, None),
        (1.0, '<unit name="meter"/><up_axis>Z_UP</up_axis>', None, None),
        (1.0, "<up_axis>Y_UP</up_axis>", [0, 2, 1], [1, 1, -1]),
        (100.0, '<unit meter="0.01"/>', [0, 2, 1], [1, 1, -1]),  # y up where nothing is said
        (1000.0, '<unit meter="0.001"/><up_axis>X_UP</up_axis>', [2, 0, 1], [1, -1, -1]),
    ],
)
def test_collada_units_and_axes_are_honoured(
    tmp_path: Path, factor: float, asset: str, order: list[int] | None, signs: list[int] | None
) -> None:
    (tmp_path / "box.dae").write_text(collada(factor, asset, order, signs))
    robot = link_of(tmp_path, "box.dae")
    np.testing.assert_allclose(bounds(robot), [LOW, HIGH], atol=1e-6)
    assert ("is not written z-up" in " ".join(robot.warnings)) == (order is not None)
    # The description's own scale comes after the file's unit and axis.
    np.testing.assert_allclose(bounds(link_of(tmp_path, "box.dae", "2 3 0.5")), [LOW * [2, 3, 0.5], HIGH * [2, 3, 0.5]], atol=1e-6)


@pytest.mark.parametrize(
    ("asset", "sentence"),
    [
        ('<unit meter="0"/>', "unit of '0' metres"),
        ('<unit meter="many"/>', "unit of 'many' metres"),
        ("<up_axis>W_UP</up_axis>", "up_axis 'W_UP'; it must be one of X_UP, Y_UP, Z_UP"),
    ],
)
def test_collada_that_says_nonsense_is_refused(tmp_path: Path, asset: str, sentence: str) -> None:
    (tmp_path / "box.dae").write_text(collada(1.0, asset))
    with pytest.raises(RobotError, match=sentence):
        link_of(tmp_path, "box.dae")


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_mesh_files_without_a_unit_are_brought_to_metres_by_scale(tmp_path: Path, suffix: str) -> None:
    mesh = box_mesh()
    mesh.apply_scale(1000.0)
    mesh.export(tmp_path / f"mm.{suffix}")
    np.testing.assert_allclose(bounds(link_of(tmp_path, f"mm.{suffix}", "0.001 0.001 0.001")), [LOW, HIGH], atol=1e-6)
    with pytest.raises(RobotError, match=r"link arm extends over 400 m: is that in millimetres\? .*scale="):
        link_of(tmp_path, f"mm.{suffix}")


def test_a_mirrored_mesh_keeps_its_outside_outside(tmp_path: Path) -> None:
    box_mesh().export(tmp_path / "m.stl")
    for scale in ("1 -1 1", "-1 -1 -1", "-1 1 -1"):
        link = link_of(tmp_path, "m.stl", scale).links[0]
        volume = trimesh.Trimesh(link.vertices, link.triangles, process=False).volume
        assert volume == pytest.approx(np.prod(EXTENTS), rel=1e-4)


def test_absurd_sizes_are_refused_and_odd_ones_warned_of() -> None:
    for size, sentence in (
        ("100 50 400", "extends over 400 m: is that in millimetres"),
        ("10 5 40", "40 m: is that in centimetres, inches"),
    ):
        with pytest.raises(RobotError, match=sentence):
            robot_from_urdf(arm(f'<box size="{size}"/>'))
    far = '<link name="hand"/><joint name="t" type="fixed"><parent link="arm"/><child link="hand"/><origin xyz="0 0 160"/></joint>'
    with pytest.raises(RobotError, match="the tool frame is 160 m away from the last joint: is that in millimetres"):
        robot_from_urdf(arm(rest=far))
    second = '<link name="hand"/><joint name="k" type="continuous"><parent link="arm"/><child link="hand"/><origin xyz="0 0 420"/></joint>'
    with pytest.raises(RobotError, match="joint k is 420 m away from the joint before it"):
        robot_from_urdf(arm(rest=second))
    floor = ONE_JOINT.replace(
        '<link name="base"/>', '<link name="base"><collision><geometry><box size="50 50 0.1"/></geometry></collision></link>'
    )
    with pytest.raises(RobotError, match=r"link base is 50 m across: .*leave it out, and set floor_z_m"):
        robot_from_urdf(floor.format(shape=BOX, joint="", rest=""))
    assert robot_from_urdf(arm()).warnings == ()
    assert "link arm extends over 5 m on an arm whose joints span 0 m" in robot_from_urdf(arm('<box size="0.1 0.1 5"/>')).warnings[0]
    assert "only 0.4 mm large" in robot_from_urdf(arm('<box size="0.0001 0.0002 0.0004"/>')).warnings[0]
    degrees = arm().replace('lower="-1" upper="1.5" velocity="1"', 'lower="-180" upper="180" velocity="48"')
    assert robot_from_urdf(degrees).warnings == (
        "joint j has limits from -180 to 180 rad: are they in degrees?",
        "joint j may turn at 48 rad/s: is that in degrees per second?",
    )


@pytest.mark.parametrize(
    "content",
    [
        ('<?xml version="1.0" encoding="ISO-8859-1"?><!-- Länge -->' + arm()).encode("latin-1"),
        ("<?xml version='1.0' encoding='windows-1252'?><!-- 5 € -->" + arm()).encode("cp1252"),
        ('<?xml version="1.0" encoding="Shift_JIS"?><!-- 腕 -->' + arm()).encode("shift_jis"),
        ('<?xml version="1.0" encoding="UTF-16"?><!-- Länge -->' + arm()).encode("utf-16"),
        ('<?xml version="1.0" encoding="UTF-16"?><!-- Länge -->' + arm()).encode("utf-16-be"),
        codecs.BOM_UTF8 + ('<?xml version="1.0" encoding="utf-8"?><!-- Länge -->' + arm()).encode(),
        ('<?xml version="1.0" encoding="utf-16"?><!-- Länge -->' + arm()).encode(),  # converted, the line left alone
        ('\n  <?xml version="1.0"?>' + arm()).encode(),
        ("<!-- Länge, undeclared -->" + arm()).encode(),
        arm().replace("<robot", '<robot xmlns="http://www.ros.org"').encode(),
    ],
    ids=range(10),
)
def test_encodings_as_declared(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "arm.urdf").write_bytes(content)
    robot = load_robot(str(tmp_path / "arm.urdf"))
    assert (robot.joint_names, robot.upper.tolist()) == (("j",), [1.5])


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (("<!-- Länge -->" + arm()).encode("latin-1"), "byte 7, 0xe4, is not utf-8; name its encoding in the first line"),
        (('<?xml version="1.0" encoding="utf-8"?><!-- ä -->' + arm()).encode("latin-1"), "is not utf-8; correct that or save it as UTF-8"),
        (('<?xml version="1.0" encoding="klingon"?>' + arm()).encode(), "declares the encoding 'klingon', which is unknown here"),
    ],
    ids=range(3),
)
def test_bytes_that_are_not_what_they_declare(tmp_path: Path, content: bytes, sentence: str) -> None:
    (tmp_path / "arm.urdf").write_bytes(content)
    with pytest.raises(RobotError, match=sentence):
        load_robot(str(tmp_path / "arm.urdf"))


@pytest.mark.parametrize(
    ("safety", "limits"),
    [
        ('<safety_controller k_velocity="1" k_position="9" soft_lower_limit="-0.2" soft_upper_limit="0.9"/>', (-0.2, 0.9)),
        ('<safety_controller k_velocity="1" soft_lower_limit="-0.2"/>', (-0.2, 1.5)),
        ('<safety_controller k_velocity="1" soft_lower_limit="0" soft_upper_limit="0.9"/>', (0.0, 0.9)),
        ('<safety_controller k_velocity="1" soft_lower_limit="-9" soft_upper_limit="9"/>', (-1.0, 1.5)),  # the hard ones hold
        ('<safety_controller k_velocity="1"/>', (-1.0, 1.5)),
        ('<safety_controller k_velocity="1" soft_lower_limit="0" soft_upper_limit="0.0"/>', (-1.0, 1.5)),  # stands for none
    ],
)
def test_soft_limits(safety: str, limits: tuple[float, float]) -> None:
    robot = robot_from_urdf(arm(joint=safety))
    assert (robot.lower[0], robot.upper[0]) == limits
    turning = robot_from_urdf(arm(joint=safety).replace('"revolute"', '"continuous"'))
    assert (turning.lower[0], turning.upper[0]) == (-np.inf, np.inf)


def test_soft_limits_that_leave_no_room_are_refused() -> None:
    for low, high in (("2", "3"), ("1", "-1")):
        with pytest.raises(RobotError, match=f"joint j has the limits -1.0 to 1.5 rad, .* soft limits {low}.0 to {high}.0 rad"):
            robot_from_urdf(arm(joint=f'<safety_controller k_velocity="1" soft_lower_limit="{low}" soft_upper_limit="{high}"/>'))
    with pytest.raises(RobotError, match="joint j has the soft_upper_limit 'high' in its safety_controller"):
        robot_from_urdf(arm(joint='<safety_controller k_velocity="1" soft_upper_limit="high"/>'))


@pytest.mark.parametrize(
    "text",
    [
        arm(rest="<!-- <xacro:gripper/> -->"),
        arm().replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"'),
        "<!-- <!DOCTYPE robot> -->" + arm(),
        arm(rest="<gazebo><plugin><note><![CDATA[<xacro:thing/> <!DOCTYPE x>]]></note></plugin></gazebo>"),
        arm(rest='<gazebo reference="arm"><x:thing xmlns:x="http://gazebosim.org/schema"/></gazebo>'),
    ],
)
def test_what_only_looks_like_xacro_is_read(text: str) -> None:
    assert robot_from_urdf(text).joint_names == ("j",)


@pytest.mark.parametrize(
    "text",
    [
        arm(rest="<xacro:gripper/>"),  # the prefix is not even declared
        arm(rest='<xacro:gripper xmlns:xacro="anything"/>'),
        arm(rest='<x:gripper r="1"/>').replace("<robot", '<robot xmlns:x="http://www.ros.org/wiki/xacro"'),
        arm('<tube:x xmlns:tube="http://wiki.ros.org/Xacro"/>'),
        arm(rest='<property name="r" value="1"/>'),
        arm('<box size="0.1 0.2 ${length}"/>'),
        arm('<mesh filename="$(find my_arm)/meshes/a.stl"/>'),
    ],
)
def test_unexpanded_xacro_is_refused(text: str) -> None:
    with pytest.raises(RobotError, match="run xacro on it first"):
        robot_from_urdf(text)


def test_document_types_are_refused() -> None:
    with pytest.raises(RobotError, match="document type or entities"):
        robot_from_urdf('<!DOCTYPE robot [<!ENTITY a "b">]>' + arm())


def test_the_end_effector_is_offered_first_and_cameras_last() -> None:
    hang = '<link name="{0}"/><joint name="on_{0}" type="fixed"><parent link="{1}"/><child link="{0}"/></joint>'
    frames = (
        ("camera_link", "ee_link"),
        ("camera_depth_optical_frame", "ee_link"),
        ("wrist_imu", "arm"),
        ("plate", "arm"),
        ("ee_link", "arm"),
    )
    rest = "".join(hang.format(*frame) for frame in frames)
    with pytest.raises(RobotError, match=r"to one of ee_link, plate, camera_link, camera_depth_optical_frame, wrist_imu$"):
        robot_from_urdf(arm(rest=rest))
    assert robot_from_urdf(arm(rest=rest), tool_frame="plate").tool_frame == "plate"
    sensors = "".join(hang.format(name, "arm") for name in ("RealSenseColor", "end_effector_link", "leftCamera"))
    with pytest.raises(RobotError, match=r"one of end_effector_link, RealSenseColor, leftCamera$"):
        robot_from_urdf(arm(rest=sensors))


@pytest.mark.parametrize(
    ("place", "address"),
    [
        ("my_arm/meshes/a b.stl", "meshes/a b.stl"),
        ("my_arm/meshes/a b.stl", "meshes/a%20b.stl"),
        ("my_arm/meshes/a%20b.stl", "meshes/a%20b.stl"),  # really called so
        ("my_arm/meshes/a#1?.stl", "package://my_arm/meshes/a#1?.stl"),
        ("my_arm/meshes/ä.stl", "package://my_arm/meshes/%C3%A4.stl"),
        ("my_arm/meshes/a.STL", "../my_arm/meshes/a.STL"),
        ("my_arm/meshes/a.stl", "meshes\\a.stl"),
        ("my_arm/meshes/a b.stl", "file://{folder}/my_arm/meshes/a%20b.stl"),
        ("my_arm/meshes/a.stl", "file:{folder}/my_arm/meshes/a.stl"),
        ("my_arm/meshes/a.stl", "file://localhost{folder}/my_arm/meshes/a.stl"),
        ("my_arm/meshes/a.stl", "file://meshes/a.stl"),
        ("my_arm/meshes/a.stl", "{folder}/my_arm/meshes/a.stl"),
        ("other_parts/a.stl", "package://other_parts/a.stl"),  # beside the description's own package, nothing sourced
        ("my_arm/meshes/a.stl", " meshes/a.stl "),
    ],
)
def test_where_meshes_are_found(tmp_path: Path, place: str, address: str) -> None:
    folder = tmp_path / "with space"
    (folder / place).parent.mkdir(parents=True)
    (folder / place).write_bytes(box_mesh().export(file_type="stl"))
    (folder / "my_arm").mkdir(exist_ok=True)
    description = folder / "my_arm" / "arm.urdf"
    description.write_text(arm(f'<mesh filename="{address.format(folder=folder)}"/>'), encoding="utf-8")
    np.testing.assert_allclose(bounds(load_robot(str(description))), [LOW, HIGH], atol=1e-6)


def test_packages_on_the_ros_package_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "src" / "far_parts"
    package.mkdir(parents=True)
    box_mesh().export(package / "a.stl")
    text = arm('<mesh filename="package://far_parts/a.stl"/>')
    with pytest.raises(RobotError, match="source the workspace that holds the package far_parts"):
        robot_from_urdf(text)
    for entry in (package.parent, package):
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(entry))
        np.testing.assert_allclose(bounds(robot_from_urdf(text)), [LOW, HIGH], atol=1e-6)


def test_mimic_joints_and_limits_that_are_odd() -> None:
    finger = f"""<link name="finger"><collision><geometry>{BOX}</geometry></collision></link><link name="tcp"/>
        <joint name="t" type="fixed"><parent link="arm"/><child link="tcp"/></joint>
        <joint name="f" type="revolute"><parent link="arm"/><child link="finger"/><limit lower="0" upper="1"/>{{}}</joint>"""
    with pytest.raises(RobotError, match="joint f has the multiplier 'twice' in its mimic"):
        robot_from_urdf(arm(rest=finger.format('<mimic joint="j" multiplier="twice"/>')))
    assert robot_from_urdf(arm(rest=finger.format(""))).joint_names == ("j",)
    with pytest.raises(RobotError, match=r"joint j has the limits 0.0 to 0.0 rad; lower must be less"):
        robot_from_urdf(arm().replace('lower="-1" upper="1.5" ', ""))
    with pytest.raises(RobotError, match="joint j is revolute and needs limits"):
        robot_from_urdf(arm().replace('<limit lower="-1" upper="1.5" velocity="1" effort="1"/>', ""))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('velocity="1" effort="1"', ""),
        ('velocity="1" effort="1"', 'velocity="inf" effort="inf"'),
        ('velocity="1" effort="1"', 'velocity="0" effort="as much as you like"'),
        ('<robot name="r">', "<robot>"),
        ('xyz="0 0 1"', 'xyz="0\t0\n  1"'),
        ('<link name="base"/>', '<link name="base"><inertial><mass value="heavy"/></inertial><visual><geometry/></visual></link>'),
        ("</joint>", '<dynamics damping="much"/><calibration rising="x"/></joint><gazebo><a/></gazebo><transmission/>'),
    ],
)
def test_what_is_not_used_may_be_odd(old: str, new: str) -> None:
    text = arm()
    assert old in text
    robot = robot_from_urdf(text.replace(old, new))
    assert robot.velocity_limits.tolist() == ([1.0] if "velocity" not in old else [DEFAULT_VELOCITY])
    np.testing.assert_allclose(robot.forward([0.5]), robot_from_urdf(text).forward([0.5]))
