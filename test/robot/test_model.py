"""Built-in arms, other URDFs, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from lime_planner.core.errors import RobotError
from lime_planner.robot.builtin import BUILTIN_ARMS, TOOL_RPY, demo_arm
from lime_planner.robot.joint_limits import DEFAULT_ACCELERATION
from lime_planner.robot.model import Robot, home, load_robot, robot_from_urdf, touches_itself

BOX = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'


def urdf(joint: str = "", link: str = BOX, rest: str = "", axis: str = "0 1 0") -> str:
    """Two joints on a base, with a hand of two fingers; `joint` goes into the second joint."""
    return f"""<robot name="two"><link name="base">{BOX}</link><link name="upper">{BOX}</link><link name="lower">{link}</link>
    <link name="hand"/>    <link name="left">{BOX}</link><link name="right">{BOX}</link><link name="end_effector"/>
    <joint name="a" type="continuous"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/></joint>
    <joint name="b" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.3"/><axis xyz="{axis}"/>
      <limit lower="-1" upper="2" effort="1" velocity="0.7"/>{joint}</joint>
    <joint name="c" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0 0 0.3"/></joint>
    <joint name="f" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="1 0 0"/>
      <limit lower="0.02" upper="0.05" effort="1" velocity="1"/></joint>
    <joint name="g" type="prismatic"><parent link="hand"/><child link="right"/><axis xyz="1 0 0"/>
      <limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="f" multiplier="-2" offset="0.01"/></joint>
    <joint name="e" type="fixed"><parent link="hand"/><child link="end_effector"/><origin xyz="0 0 0.1"/></joint>{rest}</robot>"""


@pytest.fixture(scope="module")
def two() -> Robot:
    return robot_from_urdf(urdf())


@pytest.mark.parametrize("name", list(BUILTIN_ARMS))
def test_built_in_arms(name: str) -> None:
    robot = load_robot(name)
    prefix = name.removeprefix("kinova_")
    assert robot.name == name
    assert robot.planning_frame == "base"
    assert robot.tool_frame == f"{prefix}_end_effector"
    assert robot.joint_names == tuple(f"{prefix}_joint_{i}" for i in range(1, 7))
    np.testing.assert_allclose(np.rad2deg(robot.velocity_limits), [36, 36, 36, 48, 48, 48], atol=1e-6)
    np.testing.assert_allclose(robot.acceleration_limits, DEFAULT_ACCELERATION)
    np.testing.assert_allclose(np.rad2deg([robot.lower[1], robot.upper[1], robot.lower[2], robot.upper[2]]), [47, 313, 19, 341], atol=1e-4)
    spherical = prefix == "j2s6s200"
    assert robot.continuous.tolist() == [True, False, False, True, not spherical, True]
    if spherical:
        np.testing.assert_allclose(np.rad2deg([robot.lower[4], robot.upper[4]]), [30, 330], atol=1e-4)
    # One tool convention, the driver's: 0.16 m along -z of link 6, turned so that +z points out of the palm (-z of link 6).
    expected = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, -0.16]], dtype=float)
    np.testing.assert_allclose(robot.chain.tool, expected, atol=1e-9)
    assert TOOL_RPY in robot.urdf
    fingers = [link for link in robot.links if "finger" in link.name]
    assert len(fingers) == (4 if spherical else 6)
    assert all(link.gripper == (link.joint == 6) for link in robot.links)
    assert all(link.vertices.dtype == np.float64 and link.triangles.dtype == np.int32 for link in robot.links)
    # The fingers reach beyond the palm, in the direction of the tool's z.
    T_base_tool, poses = robot.forward(home(robot)), robot.link_poses(home(robot))
    tips = np.concatenate([link.vertices @ poses[6, :3, :3].T + poses[6, :3, 3] for link in fingers if "tip" in link.name])
    assert ((tips - poses[6, :3, 3]) @ T_base_tool[:3, 2]).min() > 0.12
    assert robot.within_limits(home(robot))
    assert np.isfinite(robot.forward(home(robot))).all()


def turned(rpy: tuple[float, float, float]) -> np.ndarray:
    """The rotation of a URDF's rpy [rad], (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def placed(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> np.ndarray:
    """The pose of a URDF's origin, (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turned(rpy), xyz
    return T


#: The driver's own description, `<name>_link_base` to link 6 and on to the tool: xyz [m] and rpy [rad] of every joint, each about +z.
ARM = [
    ((0, 0, 0.15675), (0, np.pi, 0)),
    ((0, 0.0016, -0.11875), (-np.pi / 2, 0, np.pi)),
    ((0, -0.410, 0), (0, np.pi, 0)),
    ((0, 0.2073, -0.0114), (-np.pi / 2, 0, np.pi)),
]
WRISTS = {
    "j2s6s200": [((0, 0, -0.10375), (np.pi / 2, 0, np.pi)), ((0, 0.10375, 0), (-np.pi / 2, 0, np.pi))],
    "j2n6s300": [((0, -0.03703, -0.06414), (np.pi / 3, 0, np.pi))] * 2,
}
TOOL = ((0, 0, -0.1600), (np.pi, 0, np.pi / 2))


@pytest.mark.parametrize("model", list(WRISTS))
def test_the_real_arms_configuration_plans_in_the_drivers_frame(model: str) -> None:
    """The driver's TF begins at the arm's own base, and there the tool is where the driver has it."""
    text = (Path(__file__).resolve().parents[2] / "config" / f"kinova_{model}.yaml").read_text(encoding="utf-8")
    values = yaml.safe_load(text)["/**/lime_planner"]["ros__parameters"]
    assert values["planning_frame"] == f"{model}_link_base"
    robot = load_robot(values["robot"], joint_names=values["arm_joints"], planning_frame=values["planning_frame"])
    assert robot.planning_frame == f"{model}_link_base"
    for q in (home(robot), *np.random.default_rng(0).uniform(-np.pi, np.pi, (5, 6))):
        T_base_tool = np.eye(4)
        for (xyz, rpy), angle in zip(ARM + WRISTS[model], q, strict=True):
            T_base_tool = T_base_tool @ placed(xyz, rpy) @ placed((0, 0, 0), (0, 0, angle))
        np.testing.assert_allclose(robot.forward(q), T_base_tool @ placed(*TOOL), atol=1e-9)
    assert robot.forward(home(robot))[1, 3] < -0.2  # the hand is on the side of -y, away from the plugs


@pytest.mark.parametrize(("model", "yaw_rad"), [("j2s6s200", np.pi / 2), ("j2n6s300", 0.0)])
def test_the_models_root_and_the_drivers_base(model: str, yaw_rad: float) -> None:
    """In whichever of the two frames is planned, the whole arm stands in the same place: base -> link_base is a turn, and known."""
    at_root, at_base = load_robot(f"kinova_{model}"), load_robot(f"kinova_{model}", planning_frame=f"{model}_link_base")
    T_root_base = placed((0, 0, 0), (0, 0, yaw_rad))
    assert at_base.reach_m == pytest.approx(at_root.reach_m)
    assert at_base.collision_pairs == at_root.collision_pairs
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (3, 6)):
        np.testing.assert_allclose(at_root.forward(q), T_root_base @ at_base.forward(q), atol=1e-9)
        for a, b in zip(at_root.links, at_base.links, strict=True):
            T_root_link, T_base_link = at_root.link_poses(q)[a.joint], at_base.link_poses(q)[b.joint]
            in_root = a.vertices @ T_root_link[:3, :3].T + T_root_link[:3, 3]
            in_base = b.vertices @ T_base_link[:3, :3].T + T_base_link[:3, 3]
            np.testing.assert_allclose(in_root, in_base @ T_root_base[:3, :3].T, atol=1e-9, err_msg=a.name)


@pytest.mark.parametrize("name", list(BUILTIN_ARMS))
def test_no_vertex_leaves_the_reach(name: str) -> None:
    robot = load_robot(name)
    farthest = 0.0
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (200, 6)):
        poses = robot.link_poses(q)
        for link in robot.links:
            placed = link.vertices[::20] @ poses[link.joint, :3, :3].T + poses[link.joint, :3, 3]
            farthest = max(farthest, np.linalg.norm(placed, axis=1).max())
    assert 0.9 < farthest <= robot.reach_m < 1.4


def test_meshes_are_undecimated() -> None:
    links = {link.name: link for link in load_robot("kinova_j2s6s200").links}
    assert len(links["j2s6s200_link_6"].triangles) == 44578
    assert len(links["j2s6s200_link_base"].triangles) == 16744


def test_primitive_housings_hold_the_meshes() -> None:
    """The arm's housings are the same on both models: every vertex of the meshes lies in the primitives, to 0.5 mm."""
    import open3d as o3d
    import trimesh

    meshes = {link.name[9:]: link for link in load_robot("kinova_j2s6s200").links}
    primitives = {link.name[9:]: link for link in load_robot("kinova_j2n6s300").links}
    for name in ("link_base", "link_1", "link_2", "link_3"):
        points = meshes[name].vertices.astype(np.float32)
        if name == "link_base":  # the mesh's model stands a quarter turn round
            points = np.stack([points[:, 1], -points[:, 0], points[:, 2]], axis=1)
        whole = trimesh.Trimesh(primitives[name].vertices, primitives[name].triangles, process=False)
        outside = np.full(len(points), np.inf)
        for part in _parts(whole):
            scene = o3d.t.geometry.RaycastingScene()
            scene.add_triangles(part.vertices.astype(np.float32), part.faces.astype(np.uint32))
            outside = np.minimum(outside, scene.compute_signed_distance(o3d.core.Tensor(points), nsamples=5).numpy())
        assert outside.max() < 5e-4, name


def _parts(mesh):  # type: ignore[no-untyped-def]
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = mesh.edges_unique
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(mesh.vertices),) * 2)
    _, label = connected_components(graph)
    return [mesh.submesh([np.flatnonzero(label[mesh.faces[:, 0]] == k)], append=True) for k in np.unique(label)]


def test_another_urdf(two: Robot) -> None:
    assert two.joint_names == ("a", "b")
    assert two.tool_frame == "end_effector"
    assert two.planning_frame == "base"
    assert two.continuous.tolist() == [True, False]
    assert two.lower.tolist() == [-np.inf, -1.0]
    assert two.velocity_limits[1] == 0.7
    np.testing.assert_allclose(two.forward([0.0, np.pi / 2])[:3, 3], [0.4, 0.0, 0.6], atol=1e-12)
    np.testing.assert_allclose(two.forward([np.pi / 2, np.pi / 2])[:3, 3], [0.0, 0.4, 0.6], atol=1e-12)
    gripper = {link.name: link for link in two.links if link.gripper}
    assert set(gripper) == {"lower", "left", "right"}
    # Locked at the limit nearest to 0; the mimic joint follows: -2 · 0.02 + 0.01. The axis y has become z: x stays in its plane.
    centre = {name: link.vertices.mean(axis=0) for name, link in gripper.items()}
    assert np.linalg.norm(centre["left"] - centre["right"]) == pytest.approx(0.02 + 0.03)
    names = {(two.links[i].name, two.links[j].name) for i, j in two.collision_pairs}
    assert names == {("base", "lower"), ("base", "left"), ("base", "right"), ("upper", "left"), ("upper", "right")}


def test_locked_joints_and_a_subset() -> None:
    robot = robot_from_urdf(urdf(), locked={"f": 0.05})
    centre = {link.name: link.vertices.mean(axis=0) for link in robot.links}
    assert np.linalg.norm(centre["left"] - centre["right"]) == pytest.approx(0.05 + 0.09)
    one = robot_from_urdf(urdf(), joint_names=["b"], locked={"a": np.pi / 2})
    assert one.joint_names == ("b",)
    assert one.held_joints == (("a", pytest.approx(np.pi / 2)),) and robot.held_joints == ()
    np.testing.assert_allclose(one.forward([np.pi / 2])[:3, 3], [0.0, 0.4, 0.6], atol=1e-12)
    assert {link.name: link.joint for link in one.links} == {"base": 0, "upper": 0, "lower": 1, "left": 1, "right": 1}


def test_fingers_that_turn_are_no_arm_joints() -> None:
    turning = urdf().replace('type="prismatic"', 'type="revolute"')
    robot = robot_from_urdf(turning)
    assert (robot.tool_frame, robot.joint_names) == ("end_effector", ("a", "b"))
    nameless = turning.replace("end_effector", "thing").replace('<mimic joint="f" multiplier="-2" offset="0.01"/>', "")
    with pytest.raises(RobotError, match=r"Set tool_frame to one of left, right$"):
        robot_from_urdf(nameless)
    assert robot_from_urdf(nameless, tool_frame="left").joint_names == ("a", "b", "f")
    assert robot_from_urdf(nameless, tool_frame="thing").joint_names == ("a", "b")


def test_planning_frame_that_is_not_the_root() -> None:
    rest = '<link name="world"/><joint name="w" type="fixed"><parent link="world"/><child link="base"/>'
    rest += '<origin xyz="1 2 3" rpy="0 0 1.5"/></joint>'
    at_world, at_base = robot_from_urdf(urdf(rest=rest)), robot_from_urdf(urdf(rest=rest), planning_frame="base")
    q = [0.3, 0.8]
    T_world_base = at_world.forward(q) @ np.linalg.inv(at_base.forward(q))
    np.testing.assert_allclose(T_world_base[:3, 3], [1, 2, 3], atol=1e-12)
    assert at_world.planning_frame == "world"
    np.testing.assert_allclose(at_base.links[0].vertices.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(at_world.links[0].vertices.mean(axis=0), [1, 2, 3], atol=1e-12)


def test_loading_is_deterministic(two: Robot) -> None:
    again = robot_from_urdf(urdf())
    assert again.collision_pairs == two.collision_pairs
    assert all((a.vertices == b.vertices).all() for a, b in zip(again.links, two.links, strict=True))


def test_a_urdf_file_with_a_relative_mesh(tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.box(extents=(0.2, 0.3, 0.4)).export(tmp_path / "box.stl")
    mesh = '<collision><origin xyz="0 0 1"/><geometry><mesh filename="box.stl" scale="1 1 0.5"/></geometry></collision>'
    (tmp_path / "arm.urdf").write_text(urdf(link=mesh))
    lower = next(link for link in load_robot(str(tmp_path / "arm.urdf")).links if link.name == "lower")
    assert sorted(np.ptp(lower.vertices, axis=0).round(6)) == [0.2, 0.2, 0.3]
    assert len(lower.vertices) == 8  # corners that an STL file repeats are merged
    assert np.linalg.norm(lower.vertices.mean(axis=0)) == pytest.approx(1.0, abs=1e-6)


MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'


@pytest.mark.parametrize(
    ("text", "arguments", "sentence"),
    [
        ("<robot", {}, "not well-formed"),
        ("<house/>", {}, "<house>"),
        ('<robot name="x"/>', {}, "no link"),
        ('<robot name="x"><link name="a"/><link name="b"/></robot>', {}, "one root link; it has 2: a, b"),
        ('<robot name="x"><link name="a"/><link name="a"/></robot>', {}, "two links named a"),
        ('<robot xmlns:xacro="x"><xacro:macro/></robot>', {}, "xacro"),
        ("<!DOCTYPE x><robot/>", {}, "document type"),
        (urdf(rest='<joint name="z" type="fixed"><parent link="nowhere"/><child link="base"/></joint>'), {}, "'nowhere'"),
        (urdf(link='<collision><geometry><capsule radius="1" length="1"/></geometry></collision>'), {}, "link lower .*shape capsule"),
        (urdf(link=MESH.format("package://no_such_package/a.stl")), {}, "link lower was not found; .*no_such_package"),
        (urdf(link=MESH.format("gone.stl")), {}, "gone.stl"),
        (urdf(link=MESH.format("http://host/a.stl")), {}, "http://"),
        (urdf(joint='<mimic joint="a"/>'), {"joint_names": ["a", "b"]}, "b mimics"),
        (urdf(), {"joint_names": ["a", "x"]}, "'x' is not in .*a, b"),
        (urdf(), {"joint_names": ["b", "a"]}, "from base to tool: a, b"),
        (urdf(), {"joint_names": ["a", "a"]}, "twice"),
        (urdf(), {"joint_names": ["a", "f"]}, "prismatic"),
        (urdf(), {"joint_names": ["a", "c"]}, "fixed"),
        (urdf().replace('"a" type="continuous">', '"a" type="prismatic"><limit lower="0" upper="1"/>'), {}, r"joint a \(prismatic\) moves"),
        (urdf(), {"tool_frame": "nose"}, "'nose'.*end_effector"),
        (urdf(), {"planning_frame": "hand"}, "no joint turns"),
        (urdf(), {"planning_frame": "upper", "joint_names": ["a", "b"]}, "stands still: base"),
        (urdf(), {"locked": {"a": 0.0}, "joint_names": ["a", "b"]}, "'a': it is a joint of the arm"),
        (urdf(), {"locked": {"x": 0.0}}, "'x': there is none of this name; joints outside the arm: f, g$"),
        (urdf(), {"locked": {"c": 0.0}}, "'c': it is fixed; joints outside"),
        (urdf(), {"locked": {"f": 5.0}}, "'f' cannot be at 5: its limits are 0.02 to 0.05"),
        (urdf().replace('lower="-1" upper="2"', 'lower="2" upper="-1"'), {}, "lower must be less"),
        (urdf().replace("end_effector", "thing"), {}, "Set tool_frame to one of left, right, thing"),
        (urdf(joint="").replace('<mimic joint="f"', '<mimic joint="a"'), {}, "g mimics the arm joint a"),
        (urdf(link="").replace(BOX, ""), {}, "has collision geometry"),
        (urdf(axis="0 0 0"), {}, "joint b has an axis of length 0"),
        (urdf(axis="nan 0 1"), {}, "joint b has the xyz 'nan 0 1' in its axis"),
        (urdf().replace('xyz="0 0 0.3"', 'xyz="0 0"', 1), {}, "joint a has the xyz '0 0' in its origin, .*3 finite numbers"),
        (urdf().replace('type="revolute"', 'type="spherical"'), {}, "joint b is of type 'spherical'"),
        (urdf(joint="").replace('<limit lower="-1" upper="2" effort="1" velocity="0.7"/>', ""), {}, "joint b is revolute and needs limits"),
        (
            urdf(link='<collision><geometry><cylinder radius="0" length="1"/></geometry></collision>'),
            {},
            "cylinder whose radius is not positive",
        ),
        (urdf(link="<collision/>"), {}, "link lower has the collision shape nothing"),
        (urdf(rest='<joint name="z" type="fixed"><parent link="hand"/><child link="base"/></joint>'), {}, "one root link; it has 0$"),
        (
            urdf(rest='<link name="q"/><joint name="z" type="fixed"><parent link="q"/><child link="q"/></joint>'),
            {},
            "q is its own ancestor",
        ),
        (urdf().replace('<mimic joint="f"', '<mimic joint="g"'), {}, "g mimics 'g'"),
    ],
    ids=range(40),
)
def test_refused_with_a_sentence(text: str, arguments: dict[str, object], sentence: str) -> None:
    with pytest.raises(RobotError, match=sentence):
        robot_from_urdf(text, **arguments)  # type: ignore[arg-type]


def test_a_broken_mesh_is_named(tmp_path: Path) -> None:
    (tmp_path / "junk.stl").write_bytes(b"junk" * 100)
    (tmp_path / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for name, sentence in (("junk.stl", "Could not load resource .*junk.stl"), ("nan.obj", "link lower has no triangles, no extent")):
        with pytest.raises(RobotError, match=sentence) as caught:
            robot_from_urdf(urdf(link=MESH.format(name)), base_dir=tmp_path)
        assert "\n" not in str(caught.value)


def test_home_of_another_arm_is_free_of_self_collision() -> None:
    # In the middle of the second joint's limits the hand is inside the base.
    folding = urdf().replace('lower="-1" upper="2"', 'lower="1.28" upper="5"').replace('xyz="0 0 0.3"', 'xyz="0.02 0 0.3"')
    robot = robot_from_urdf(folding)
    assert touches_itself(robot.chain, robot.links, robot.collision_pairs, np.array([0.0, 3.14]))
    q = home(robot)
    assert robot.within_limits(q)
    assert not touches_itself(robot.chain, robot.links, robot.collision_pairs, q)
    np.testing.assert_array_equal(q, home(robot_from_urdf(folding)))


def test_unknown_robots(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"kinova_j2s6s200, kinova_j2n6s300\) nor a URDF file"):
        load_robot("jaco")
    (tmp_path / "x.urdf").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RobotError, match="cannot be read"):
        load_robot(str(tmp_path / "x.urdf"))


def test_wrong_configurations(two: Robot) -> None:
    with pytest.raises(RobotError, match="2 joints"):
        two.forward([0.0] * 6)
    assert two.limit_violation([9.0, 2.5]) == "b is at 2.5000 rad, outside its limits -1.0000 to 2.0000 rad"
    assert two.limit_violation([np.nan, 0.0]) == "a is nan"
    assert two.limit_violation([9.0, 1.5]) is None
    assert not two.within_limits([0.0, 2.5])
    np.testing.assert_allclose(home(two), [0.0, 0.5])


def test_the_demo_s_arm_where_the_default_s_meshes_are_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert demo_arm() == ("kinova_j2s6s200", "")
    monkeypatch.setattr("lime_planner.robot.builtin.share_directories", lambda: iter(()))
    name, why = demo_arm()
    assert name == "kinova_j2n6s300"
    assert "pip install example-robot-data" in why and "takes kinova_j2n6s300, which needs no meshes" in why
    assert load_robot(name).n == 6
