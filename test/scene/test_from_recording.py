"""Recordings: scenes, targets and joint angles out of rosbag2 files of both kinds, without ROS; and what is refused in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lime_planner.core.errors import Refusal, SceneError
from lime_planner.scene.bag import CLOUD, JOINTS, POSE
from lime_planner.scene.files import Start, load_start
from lime_planner.scene.from_clouds import Labels
from lime_planner.scene.from_recording import Frame, RecordedScene, read_recording
from lime_planner.scene.scene import Scene

rosbags = pytest.importorskip("rosbags", reason="rosbags is not in this environment (extra `bags`)")
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
BEGIN_NS = 1_700_000_000_000_000_000
NAMES = ("j1", "j2")


def header(frame_id: str = "base") -> Any:
    return T["std_msgs/msg/Header"](stamp=T["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=frame_id)


def cloud(points: np.ndarray, frame_id: str = "base", *, labels: np.ndarray | None = None, rows: int = 1, big: bool = False) -> Any:
    """A cloud of float32 points, organised in rows, in either byte order."""
    order = ">" if big else "<"
    layout = np.dtype([(name, f"{order}f4") for name in "xyz"] + ([("label", "u1")] if labels is not None else []))
    table = np.empty(len(points), layout)
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    if labels is not None:
        table["label"] = labels
    field = T["sensor_msgs/msg/PointField"]
    fields = [field(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate("xyz")]
    fields += [field(name="label", offset=12, datatype=2, count=1)] if labels is not None else []
    return T[CLOUD](
        header=header(frame_id),
        height=rows,
        width=len(points) // rows,
        fields=fields,
        is_bigendian=big,
        point_step=layout.itemsize,
        row_step=layout.itemsize * (len(points) // rows),
        data=np.frombuffer(table.tobytes(), np.uint8),
        is_dense=True,
    )


def pose(x: float, frame_id: str = "base", length: float = 1.0) -> Any:
    point, quaternion = T["geometry_msgs/msg/Point"](x=x, y=0.0, z=0.0), T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=length)
    return T[POSE](header=header(frame_id), pose=T["geometry_msgs/msg/Pose"](position=point, orientation=quaternion))


def joints(*angles: float, names: tuple[str, ...] = ("finger", "j2", "j1")) -> Any:
    return T[JOINTS](header=header(), name=list(names), position=np.array(angles), velocity=np.array([]), effort=np.array([]))


def transform(parent: str, child: str, x: float) -> Any:
    vector = T["geometry_msgs/msg/Vector3"](x=x, y=0.0, z=0.0)
    moved = T["geometry_msgs/msg/Transform"](translation=vector, rotation=T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0))
    stamped = T["geometry_msgs/msg/TransformStamped"](header=header(parent), child_frame_id=child, transform=moved)
    return T["tf2_msgs/msg/TFMessage"](transforms=[stamped])


def write(path: Path, messages: list[tuple[float, str, Any]], plugin: StoragePlugin = StoragePlugin.MCAP, version: int = 9) -> Path:
    """Write a recording: time [s], topic, message of each."""
    with Writer(path, version=version, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for at_s, topic, msg in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msg.__msgtype__, typestore=STORE)
            writer.write(connections[topic], BEGIN_NS + round(at_s * 1e9), STORE.serialize_cdr(msg, msg.__msgtype__))
    return path


def at_x(x: float, count: int) -> np.ndarray:
    return np.column_stack([np.full(count, x), np.linspace(0.0, 0.2, count), np.full(count, 0.4)]).astype(np.float32)


def messages() -> list[tuple[float, str, Any]]:
    """Clouds of two, three and four leaves, at their time as x; a camera beside the base; the arm moves."""
    sent: list[tuple[float, str, Any]] = [
        (0.0, "/tf_static", transform("base", "camera", 0.5)),
        (0.0, "/joint_states", joints(9.0, 0.0, 0.1)),
    ]
    for k in range(3):
        sent += [
            (float(k), "/camera/leaf_cloud", cloud(at_x(k, 2 + k))),
            (k + 0.1, "/camera/stem_cloud", cloud(at_x(k, 6), "camera", rows=2, big=True)),
            (k + 0.2, "/grasp_target", pose(10.0 + k, "camera")),
            (k + 0.3, "/joint_states", joints(9.0, 2.0 + k, 1.0 + k)),
        ]
    return [*sent, (20.0, "/camera/leaf_cloud", cloud(at_x(20.0, 1)))]


def frame(seen: list[Any] | None = None) -> Frame:
    def keep(scene: Scene, q: np.ndarray | None, padding_m: float) -> Scene:
        if seen is not None:
            seen.append((None if q is None else q.tolist(), padding_m))
        return scene

    return Frame("base", NAMES, keep, 0.01)


def read(path: Path, **options: Any) -> RecordedScene:
    return read_recording(path, frame(), **options)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("bag") / "recording", messages())


@pytest.mark.parametrize(("plugin", "version"), [(StoragePlugin.SQLITE3, 8), (StoragePlugin.SQLITE3, 9), (StoragePlugin.MCAP, 9)])
def test_the_newest_messages_at_a_time(tmp_path: Path, plugin: StoragePlugin, version: int) -> None:
    path = write(tmp_path / "recording", messages(), plugin, version)
    seen: list[Any] = []
    recorded = read_recording(path, frame(seen), at_s=1.25)
    scene, start = recorded.scene, recorded.start
    assert scene.frame_id == "base"
    assert scene.leaf_points == pytest.approx(at_x(1.0, 3))
    assert scene.stem_points == pytest.approx(at_x(1.5, 6))  # 1 m before the camera, which is at 0.5
    assert scene.target_pose == pytest.approx([11.5, 0, 0, 0, 0, 0, 1])
    assert start is not None and start.joint_names == NAMES
    assert start.q.tolist() == [1.0, 2.0]  # of 0.3 s: the next comes at 1.3 s
    assert seen == [([1.0, 2.0], 0.01), ([1.0, 2.0], 0.01)]
    assert recorded.heard == pytest.approx(
        {"/camera/leaf_cloud": 1.0, "/camera/stem_cloud": 1.1, "/grasp_target": 1.2, "/joint_states": 0.3}
    )


def test_the_end_is_the_default_and_files_in_the_folder_do(bag: Path) -> None:
    for path in (bag, next(bag.glob("*.mcap"))):
        recorded = read(path)
        assert recorded.scene.leaf_points == pytest.approx(at_x(20.0, 1))  # from far later than the rest
        assert len(recorded.scene.stem_points) == 6
        assert recorded.start is not None and recorded.start.q.tolist() == [3.0, 4.0]
    assert read(bag, at_s=20.0).heard["/camera/leaf_cloud"] == 20.0


def test_a_labelled_cloud_with_classes_of_its_own(tmp_path: Path) -> None:
    labels = np.array([4, 4, 5, 6, 9, 9])
    path = write(tmp_path / "recording", [(0.0, "/seg/points", cloud(at_x(0.3, 6), labels=labels))])
    how = Labels("label", leaf=(4,), stem=(5,), fruit=(6,), ignored=())
    recorded = read(path, topics={"labelled_cloud": "/seg/points"}, labels=how)
    scene = recorded.scene
    assert (len(scene.leaf_points), len(scene.stem_points), len(scene.fruit_points)) == (2, 3, 1)  # unknown ones are hard
    assert scene.target_pose is None and recorded.start is None
    with pytest.raises(SceneError, match="has no field 'class'"):
        read(path, topics={"labelled_cloud": "/seg/points"}, labels=Labels("class"))


LEAF, STEM = "/camera/leaf_cloud", "/camera/stem_cloud"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"topics": {"leaf_cloud": "/leafs"}}, ["no topic /leafs", "type sensor_msgs/PointCloud2: /camera/leaf_cloud, /camera/stem_cloud"]),
        ({"topics": {"stem_cloud": "/joint_states"}}, ["/joint_states holds sensor_msgs/JointState, not sensor_msgs/PointCloud2"]),
        (
            {"topics": {"grasp_target": LEAF}},
            ["holds sensor_msgs/PointCloud2, not geometry_msgs/PoseStamped", "of that type: /grasp_target"],
        ),
        ({"at_s": 20.5}, ["is 20.000 s long; --at 20.5 lies outside"]),
        ({"at_s": -1.0}, ["--at -1 lies outside"]),
        ({"at_s": 0.05}, ["first message of /camera/stem_cloud comes at 0.100 s, after --at 0.05"]),
    ],
)
def test_requests_that_the_recording_cannot_serve(bag: Path, options: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(SceneError) as caught:
        read(bag, **options)
    sentence = str(caught.value)
    assert "\n" not in sentence and sentence.startswith(str(bag))
    assert all(word in sentence for word in words), sentence


def without_z(msg: Any) -> Any:
    msg.fields.pop()
    return msg


@pytest.mark.parametrize(
    ("sent", "kind", "words"),
    [
        ([(STEM, cloud(at_x(0, 3), "moon"))], Refusal, "/camera/stem_cloud: no transform from 'moon' to 'base'"),
        ([(STEM, cloud(at_x(0, 3), ""))], SceneError, "/camera/stem_cloud has an empty frame_id"),
        ([(STEM, without_z(cloud(at_x(0, 3))))], SceneError, "/camera/stem_cloud has no field 'z'"),
        (
            [(LEAF, cloud(at_x(0, 3)))],
            SceneError,
            "has no stem_cloud and no labelled_cloud; name one with --stem or --labelled: /camera/leaf",
        ),
        ([(STEM, cloud(at_x(0, 3))), ("/grasp_target", pose(1.0, length=0.0))], SceneError, "/grasp_target cannot be used"),
        (
            [(STEM, cloud(at_x(0, 3))), ("/joint_states", joints(1.0, names=("a",)))],
            SceneError,
            "/joint_states has no joint j1, j2; it has a",
        ),
    ],
)
def test_messages_that_cannot_be_used(tmp_path: Path, sent: list[tuple[str, Any]], kind: type[Exception], words: str) -> None:
    path = write(tmp_path / "recording", [(0.0, topic, msg) for topic, msg in sent])
    with pytest.raises(kind) as caught:
        read(path)
    assert words in str(caught.value)


def test_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "plan.mcap").write_bytes(b"")
    for path, words in (
        (tmp_path / "none", "no such recording"),
        (tmp_path / "empty", "has no metadata.yaml, and no .mcap or .db3 either"),
        (tmp_path / "plan.mcap", "is not a readable recording: it is empty.*mcap recover"),
    ):
        with pytest.raises(SceneError, match=words):
            read(path)
    write(tmp_path / "silent", [])
    with pytest.raises(SceneError, match="holds no messages"):
        read(tmp_path / "silent")
    damaged = write(tmp_path / "damaged", messages(), StoragePlugin.SQLITE3)
    next(damaged.glob("*.db3")).write_bytes(b"SQLite format 3\0 and then nothing")
    with pytest.raises(SceneError, match="is not a readable recording"):
        read(damaged)


def test_a_scene_file_keeps_the_start(tmp_path: Path) -> None:
    scene = Scene.from_points(at_x(0.5, 4), [0, 0, 1, 1])
    scene.save(tmp_path / "a.npz", Start(NAMES, np.array([0.5, 7.0])))
    start = load_start(tmp_path / "a.npz")
    assert start is not None and start.joint_names == NAMES and start.q.tolist() == [0.5, 7.0]
    assert Scene.load(tmp_path / "a.npz").n_points == 4
    scene.save(tmp_path / "b.npz")
    assert load_start(tmp_path / "b.npz") is None and load_start(tmp_path / "b.ply") is None
    np.savez(tmp_path / "c.npz", start=[1.0], start_joints=["a", "b"])
    with pytest.raises(SceneError, match=r"start has shape \(1,\), expected \(2,\)"):
        load_start(tmp_path / "c.npz")


def test_a_scene_file_keeps_how_far_points_were_moved(tmp_path: Path) -> None:
    """The stem margin grows by it, whenever the file is planned with."""
    scene = Scene.from_points(at_x(0.5, 4), [0, 0, 1, 1], stem_displacement_m=0.002)
    scene.save(tmp_path / "a.npz")
    assert Scene.load(tmp_path / "a.npz", scale=2.0).stem_displacement_m == pytest.approx(0.004)
    np.savez(tmp_path / "b.npz", points=at_x(0.5, 2), labels=[0, 1], stem_displacement_m=np.nan)
    with pytest.raises(SceneError, match=r"stem_displacement_m: .*nan.* is not a finite number of at least 0"):
        Scene.load(tmp_path / "b.npz")
