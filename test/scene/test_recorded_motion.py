"""Recordings of what moves: a camera on the arm, a base that drives, joints at each cloud's stamp; and files as other tools leave them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not in this environment (extra `bags`)")
from rosbags.rosbag2 import StoragePlugin
from test_from_recording import BEGIN_NS, LEAF, NAMES, STEM, STORE, at_x, cloud, joints, pose, transform, write

from lime_planner.core.errors import Refusal, SceneError
from lime_planner.core.status import Status
from lime_planner.scene import bag
from lime_planner.scene.from_recording import Frame, RecordedScene, read_recording
from lime_planner.scene.scene import Scene

Sent = list[tuple[float, str, Any]]


def stamped(at_s: float, msg: Any) -> Any:
    """The message with a stamp, from the recording's beginning; of a transform its own."""
    ns = BEGIN_NS + round(at_s * 1e9)
    header = msg.transforms[0].header if hasattr(msg, "transforms") else msg.header
    header.stamp.sec, header.stamp.nanosec = ns // 10**9, ns % 10**9
    return msg


def drive(parent: str, child: str, speed: float, until_s: float = 5.0) -> Sent:
    """Transforms at 10 Hz of a frame that moves along x, recorded 30 ms after their stamps."""
    times = np.arange(0.0, until_s + 0.01, 0.1)
    return [(t + 0.03, "/tf", stamped(t, transform(parent, child, speed * t))) for t in times]


def read(path: Path, seen: list[Any] | None = None, **options: Any) -> RecordedScene:
    def keep(scene: Scene, q: Any, padding_m: float, **_: Any) -> Scene:
        if seen is not None:
            seen.append(None if q is None else q.tolist())
        return scene

    own = {name: options.pop(name) for name in ("fixed_frame", "max_base_motion_m") if name in options}
    return read_recording(path, Frame("base", NAMES, keep, 0.01, **own), **options)


def test_each_cloud_by_the_transform_of_its_own_stamp(tmp_path: Path) -> None:
    """A camera on the arm has moved on since its last cloud, and between two transforms when that was taken."""
    sent = [*drive("base", "camera", 0.05), (1.1, STEM, stamped(1.05, cloud(at_x(0.6 - 0.05 * 1.05, 4), "camera")))]
    sent += [(2.2, LEAF, stamped(2.0, cloud(at_x(0.6 - 0.1, 4), "camera"))), (2.3, "/grasp_target", stamped(2.0, pose(0.5, "camera")))]
    recorded = read(write(tmp_path / "moving", sorted(sent, key=lambda row: row[0])))
    assert recorded.scene.stem_points[:, 0] == pytest.approx(0.6, abs=1e-6)
    assert recorded.scene.leaf_points[:, 0] == pytest.approx(0.6, abs=1e-6)
    assert recorded.scene.target_pose is not None and recorded.scene.target_pose[0] == pytest.approx(0.6, abs=1e-6)


def test_a_transform_that_came_after_its_cloud_is_taken(tmp_path: Path) -> None:
    sent = [*drive("base", "camera", 0.05), (1.01, STEM, stamped(1.0, cloud(at_x(0.55, 4), "camera")))]
    path = write(tmp_path / "late", sorted(sent, key=lambda row: row[0]))
    assert read(path, at_s=1.02).scene.stem_points[:, 0] == pytest.approx(0.6, abs=1e-6)


def test_a_cloud_without_a_stamp_and_one_older_than_the_transforms(tmp_path: Path) -> None:
    sent = [*drive("base", "camera", 0.05), (1.05, STEM, cloud(at_x(0.55, 4), "camera"))]
    path = write(tmp_path / "bare", sorted(sent, key=lambda row: row[0]))
    assert read(path).scene.stem_points[:, 0] == pytest.approx(0.6, abs=1e-6), "what was known when it came: of 1.0 s"
    sent = [*drive("base", "camera", 0.0), (1.0, STEM, stamped(-1000.0, cloud(at_x(0.6, 4), "camera")))]
    path = write(tmp_path / "old", sorted(sent, key=lambda row: row[0]))
    assert read(path).scene.stem_points[:, 0] == pytest.approx(0.6, abs=1e-6)


def test_the_arm_between_two_states_and_across_a_full_turn(tmp_path: Path) -> None:
    states = [(0.0, joints(0.0, 1.0, 3.1)), (0.1, joints(0.0, 1.2, -3.1)), (0.12, joints(0.5, names=("finger",)))]
    sent: Sent = [(t, "/joint_states", stamped(t, msg)) for t, msg in states]
    seen: list[Any] = []
    recorded = read(write(tmp_path / "states", [*sent, (0.15, STEM, stamped(0.05, cloud(at_x(0.6, 4))))]), seen)
    assert seen == [pytest.approx([np.pi, 1.1])], "half-way, the short way round"
    assert recorded.start is not None and recorded.start.q.tolist() == [-3.1, 1.2], "the finger's state is not the arm's"
    late: list[Any] = []
    read(write(tmp_path / "late", [(0.0, STEM, stamped(-3.0, cloud(at_x(0.6, 4)))), *[(t + 0.1, a, m) for t, a, m in sent]]), late)
    assert late == [None], "its states do not reach back so far"


def test_the_newest_kind_of_cloud_counts_as_in_the_node(tmp_path: Path) -> None:
    labelled = cloud(at_x(0.3, 6), labels=np.array([0, 0, 1, 1, 1, 1]))
    pair: Sent = [(1.0, LEAF, cloud(at_x(0.1, 2))), (1.1, STEM, cloud(at_x(0.2, 3)))]
    sizes = {}
    for name, sent in (("labelled", [*pair, (2.0, "/labelled_cloud", labelled)]), ("pair", [(0.5, "/labelled_cloud", labelled), *pair])):
        scene = read(write(tmp_path / name, sent)).scene
        sizes[name] = (len(scene.leaf_points), len(scene.stem_points))
    assert sizes == {"labelled": (2, 4), "pair": (2, 3)}


class TestBaseThatMoves:
    """The base drives at 0.2 m/s in `map`; the plant was seen at 1 s, at x 2 in `map`, and is planned at 5 s."""

    def bag(self, folder: Path, frame: str) -> Path:
        x = {"map": 2.0, "base": 1.8, "camera": 1.3}[frame]
        sent = [*drive("map", "base", 0.2), (0.0, "/tf_static", transform("base", "camera", 0.5))]
        sent += [(1.05, STEM, stamped(1.0, cloud(at_x(x, 4), frame))), (1.06, "/grasp_target", stamped(1.0, pose(x, frame)))]
        return write(folder / frame, sorted(sent, key=lambda row: row[0]))

    @pytest.mark.parametrize("frame", ["map", "base", "camera"])
    def test_with_a_fixed_frame_the_plant_stays_where_it_was(self, tmp_path: Path, frame: str) -> None:
        scene = read(self.bag(tmp_path, frame), fixed_frame="map").scene
        assert scene.stem_points[:, 0] == pytest.approx(1.0, abs=1e-6)
        assert scene.target_pose is not None and scene.target_pose[0] == pytest.approx(1.0, abs=1e-6)
        before = read(self.bag(tmp_path / "again", frame), fixed_frame="map", at_s=1.06).scene
        assert before.stem_points[:, 0] == pytest.approx(1.8, abs=1e-6)

    @pytest.mark.parametrize("frame", ["map", "base", "camera"])
    def test_without_one_it_is_stale(self, tmp_path: Path, frame: str) -> None:
        with pytest.raises(
            Refusal, match=r"'base' has moved by 0\.800 m in 'map' since the stamp of /camera/stem_cloud.*fixed_frame: map"
        ) as caught:
            read(self.bag(tmp_path, frame))
        assert caught.value.status is Status.STALE_INPUT
        assert len(read(self.bag(tmp_path / "soon", frame), at_s=1.06).scene.stem_points) == 4
        assert len(read(self.bag(tmp_path / "loose", frame), max_base_motion_m=1.0).scene.stem_points) == 4


def pad(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the writer leave behind a message what happened to be in its memory, as rclpy does."""
    serialize = STORE.serialize_cdr
    monkeypatch.setattr(type(STORE), "serialize_cdr", lambda self, msg, kind, **_: bytes(serialize(msg, kind)) + b"\x17\x01\xf0\x34" * 3)


def test_messages_that_a_python_writer_padded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = [
        *drive("base", "camera", 0.0, 1.0),
        (1.0, STEM, stamped(0.5, cloud(at_x(0.6, 4), "camera"))),
        (1.0, "/joint_states", joints(0.0, 1.0, 2.0)),
    ]
    pad(monkeypatch)
    recorded = read(write(tmp_path / "padded", sent))
    assert len(recorded.scene.stem_points) == 4 and recorded.start is not None


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_file_alone_and_a_folder_that_was_not_finished(tmp_path: Path, plugin: StoragePlugin) -> None:
    folder = write(tmp_path / "whole", [(0.0, STEM, cloud(at_x(0.6, 4)))], plugin)
    file = next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
    alone = shutil.copy(file, tmp_path / f"harvest_run{file.suffix}")
    assert len(read(Path(alone)).scene.stem_points) == 4
    (folder / "metadata.yaml").unlink()
    with pytest.raises(SceneError, match=f"ros2 bag reindex {folder}.*name one file alone: {file.name}"):
        read(folder)
    assert len(read(file).scene.stem_points) == 4


def test_a_file_that_was_cut_off(tmp_path: Path) -> None:
    folder = write(tmp_path / "whole", [(0.0, STEM, cloud(at_x(0.6, 400)))])
    file = next(folder.glob("*.mcap"))
    (tmp_path / "cut.mcap").write_bytes(file.read_bytes()[:-200])
    with pytest.raises(SceneError, match=r"is not a readable recording: .*mcap recover"):
        read(tmp_path / "cut.mcap")


def test_only_what_is_near_is_read_of_long_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spans: list[tuple[float, float]] = []
    transforms = bag.Recording.transforms

    def note(self: bag.Recording, until_s: float, since_s: float = 0.0) -> Any:
        spans.append((since_s, until_s))
        return transforms(self, until_s, since_s)

    monkeypatch.setattr(bag.Recording, "transforms", note)
    sent = [*drive("base", "camera", 0.0, 60.0), (55.0, STEM, stamped(55.0, cloud(at_x(0.6, 4), "camera")))]
    read(write(tmp_path / "long", sorted(sent, key=lambda row: row[0])))
    assert spans and all(since_s >= 44.9 for since_s, _ in spans)
